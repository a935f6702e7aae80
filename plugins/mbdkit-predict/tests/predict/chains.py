"""Chains of rods with torques in all joints, as specs, and as programs of another transcription in absolute angles."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

GRAVITY, ANGLE, DURATION = 9.81, 0.3, 1.0


def chain(count: int, length: float = 1.0, angle: float = 0.3) -> dict[str, Any]:
    """Return a problem of rods of 1 kg that hang in a row and are raised by an angle, with torques in all joints."""
    names = ["ground", *(f"rod{k}" for k in range(count))]
    pairs = list(pairwise(names))
    model = {
        "name": "mechanism",
        "bodies": {
            b: {"mass": 1, "inertia": length**2 / 12, "position": [0, -length * (k + 0.5)]}
            for k, (_, b) in enumerate(pairs)
        },
        "joints": {b: {"type": "revolute", "bodies": [a, b], "at": [0, -length * k]} for k, (a, b) in enumerate(pairs)},
        "forces": {
            b: {"type": "torque", "body": b, "value": 0.0, **({} if a == "ground" else {"reaction_body": a})}
            for a, b in pairs
        },
    }
    return {
        "mbdkit_predict": 1, "base": {"model": model}, "duration": 1.0,
        "controls": {f"forces.{b}.value": {"bounds": [-1e4, 1e4]} for b in names[1:]},
        "initial": {f"bodies.{b}.{what}": 0 for b in names[1:] for what in ("angle", "angular_velocity")},
        "final": {
            f"bodies.{b}.{what}": x for b in names[1:] for what, x in (("angle", angle), ("angular_velocity", 0))
        },
        "minimize": " + ".join(f"integral(forces.{b}.value**2)" for b in names[1:]),
    }  # fmt: skip


def equations(count: int) -> ca.Function:
    """Return the function of angles, angular velocities, accelerations and torques whose values are the equations of
    motion of the chain in absolute angles, which are closed sums of cosines.
    """
    angle, speed, acceleration, torque = (ca.SX.sym(name, count) for name in ("angle", "speed", "acc", "torque"))
    below = count - np.arange(count) - 1.0
    rows = []
    for i in range(count):
        row = -torque[i] + (torque[i + 1] if i + 1 < count else 0.0)
        row += GRAVITY * (below[i] + 0.5) * ca.sin(angle[i]) + (below[i] + 1.0 / 3.0) * acceleration[i]
        for j in range(count):
            if j != i:
                both = below[max(i, j)] + 0.5
                turn = angle[i] - angle[j]
                row += both * (ca.cos(turn) * acceleration[j] + ca.sin(turn) * speed[j] ** 2)
        rows.append(row)
    return ca.Function("equations", [angle, speed, acceleration, torque], [ca.cse(ca.vertcat(*rows))])


def program(count: int, intervals: int, points: int = 3) -> tuple[dict[str, ca.MX], dict[str, np.ndarray]]:
    """Return the program of direct collocation with Radau points, and its first guess and bounds.

    Angles, angular velocities and torques are the unknowns; accelerations are the slopes of the collocation.
    """
    c = ca.collocation_points(points, "radau")
    slopes, _, weights = (np.array(matrix) for matrix in ca.collocation_coeff(c))
    total, h = intervals * points, DURATION / intervals
    angle, speed, torque = (ca.MX.sym(name, count, total) for name in ("angle", "speed", "torque"))

    def derivatives(values: ca.MX) -> ca.MX:
        begins = ca.horzcat(ca.MX(ca.DM.zeros(count)), values[:, points - 1 : -1 : points])
        each = ca.DM.eye(intervals)
        return (
            ca.mtimes(values, ca.kron(each, ca.DM(slopes[1:]))) + ca.mtimes(begins, ca.kron(each, ca.DM(slopes[:1])))
        ) / h

    residual = equations(count).map(total)(angle, speed, derivatives(speed), torque)
    last = ca.vertcat(angle[:, -1] - ANGLE, speed[:, -1])
    rows = ca.vertcat(ca.vec(derivatives(angle) - speed), ca.vec(residual), last)
    effort = h * ca.mtimes(ca.sum1(torque**2), ca.DM(np.tile(weights.ravel(), intervals)))
    shares = (np.arange(intervals)[:, None] + np.array(c)).ravel() / intervals
    guess = np.concatenate([np.repeat(ANGLE * shares, count), np.zeros(2 * count * total)])
    limit = np.repeat([np.inf, np.inf, 1e4], count * total)
    x = ca.vertcat(*map(ca.vec, (angle, speed, torque)))
    return {"x": x, "f": effort, "g": rows}, {"x0": guess, "lbx": -limit, "ubx": limit, "lbg": 0.0, "ubg": 0.0}
