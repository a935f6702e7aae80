"""Chains of rods of 0.5 m and 1 kg, raised by 0.6 rad in 1 s with least squares of torques; run as a script, compares
predictions with another transcription.

    PYTHONPATH=plugins/mbdkit-predict/tests python -m predict.rods [COUNT ...]

The witness has joint angles and the recursive Newton-Euler equations, collocation with Radau points of CasADi, and
neither accelerations nor multipliers as unknowns. It is solved cold with 20 intervals of 3 points, as a user would do,
with 7 points on three meshes, and with 7 points from the motion of the prediction. The last solution tells whether the
prediction is an optimum, those before it whether there are others. Chains of four rods have two local optima at least,
52.07 and 56.18; with six rods, four were seen on two meshes or more, 243.4, 246.7, 246.8 and 265.
"""

from __future__ import annotations

import json
import resource
import sys
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

import mbdkit
from predict.chains import GRAVITY, chain

LENGTH, ANGLE, ITERATIONS, WALL = 0.5, 0.6, 300, 900.0


def torques(count: int) -> ca.Function:
    """Return the function of joint angles, velocities and accelerations whose values are the torques in the joints."""
    angle, speed, acceleration = (ca.SX.sym(name, count) for name in ("angle", "speed", "acceleration"))
    turned, turning, turn = (ca.vertsplit(ca.cumsum(x)) for x in (angle, speed, acceleration))
    ways: Any = [ca.vertcat(ca.sin(x), -ca.cos(x)) for x in turned]
    sides: Any = [ca.vertcat(ca.cos(x), ca.sin(x)) for x in turned]
    base, centres, torque, force = ca.SX([0.0, GRAVITY]), list[Any](), ca.SX(0), ca.SX([0.0, 0.0])
    for way, side, rate, change in zip(ways, sides, turning, turn, strict=True):
        step = LENGTH * (change * side - rate**2 * way)
        centres.append(base + 0.5 * step)
        base = base + step
    values = []
    for way, centre, change in zip(ways[::-1], centres[::-1], turn[::-1], strict=True):
        moment = way[0] * (0.5 * centre + force)[1] - way[1] * (0.5 * centre + force)[0]
        torque = torque + LENGTH**2 / 12.0 * change + LENGTH * moment
        force = force + centre
        values.append(torque)
    return ca.Function("torques", [angle, speed, acceleration], [ca.cse(ca.vertcat(*values[::-1]))])


def witness(count: int, intervals: int, points: int, guess: Any) -> tuple[float, int, str, Any]:
    """Return the objective, the number of iterations, the status, and the motion as a function of time, by a guess of
    the same kind.
    """
    c = np.array(ca.collocation_points(points, "radau"))
    slopes, _, b = (np.array(matrix) for matrix in ca.collocation_coeff(c.tolist()))
    total, each = intervals * points, ca.DM.eye(intervals)
    unknowns = [ca.MX.sym(name, count, total) for name in ("angle", "speed", "torque")]

    def rate(x: ca.MX) -> ca.MX:
        begins = ca.horzcat(ca.MX(ca.DM.zeros(count)), x[:, points - 1 : -1 : points])
        whole = ca.mtimes(x, ca.kron(each, ca.DM(slopes[1:]))) + ca.mtimes(begins, ca.kron(each, ca.DM(slopes[:1])))
        return whole * intervals

    angle, speed, torque = unknowns
    wanted = ca.DM([ANGLE, *[0.0] * (count - 1)])
    missed = torque - torques(count).map(total)(angle, speed, rate(speed))
    rows = ca.veccat(rate(angle) - speed, missed, angle[:, -1] - wanted, speed[:, -1])
    effort = ca.mtimes(ca.sum1(torque**2), ca.DM(np.tile(b.ravel(), intervals))) / intervals
    times = (np.arange(intervals)[:, None] + c).ravel() / intervals
    options = {
        "ipopt.print_level": 0,
        "print_time": False,
        "ipopt.sb": "yes",
        "ipopt.max_iter": ITERATIONS,
        "expand": True,
    }
    solver = ca.nlpsol("witness", "ipopt", {"x": ca.veccat(*unknowns), "f": effort, "g": rows}, options)
    found: Any = solver(x0=np.concatenate([x.ravel("F") for x in guess(times)]), lbg=0.0, ubg=0.0)
    parts = [x.reshape(count, total, order="F") for x in np.split(np.array(found["x"]).ravel(), 3)]
    status = solver.stats()
    return float(found["f"]), status["iter_count"], status["return_status"], _interpolated(times, parts)


def _interpolated(times: np.ndarray, parts: Any) -> Any:
    angle, speed, torque = (PchipInterpolator(times, x, axis=1, extrapolate=True) for x in parts)
    return lambda t: (angle(t), speed(t), torque(t))


def straight(count: int) -> Any:
    """Return the guess of a user: angles on straight lines, nothing else."""
    return lambda t: (np.outer([ANGLE, *[0.0] * (count - 1)], t), *np.zeros((2, count, len(t))))


def motion_of(run: mbdkit.Run, count: int) -> Any:
    """Return the motion of a prediction as a function of time, in joint angles."""
    rods = [f"rod{k}" for k in range(count)]
    angle, speed, change = (
        np.diff([getattr(run.bodies[rod], name) for rod in rods], axis=0, prepend=0.0)
        for name in ("angle", "angular_velocity", "angular_acceleration")
    )
    first, second = (
        CubicHermiteSpline(run.time, angle, speed, axis=1),
        CubicHermiteSpline(run.time, speed, change, axis=1),
    )
    torque = PchipInterpolator(run.time, [run.controls[f"forces.{rod}.value"].value for rod in rods], axis=1)
    return lambda t: (first(t), second(t), torque(t))


def processor_time() -> float:
    """Return the processor time of this process and of those that it has started [s]."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def main() -> None:
    """Print the tables."""
    mbdkit.predict(chain(1))  # imports what predictions need
    for count in map(int, sys.argv[1:] or ("2", "4", "6", "8", "12")):
        begin = processor_time()
        run = mbdkit.predict(chain(count, LENGTH, ANGLE) | {"limits": {"wall_time": WALL}})
        seconds = processor_time() - begin
        print(f"{count} rods: {run.objective:.6f} +- {run.objective_error:.1e}, {run.verdict}, {seconds:.1f} s")
        print(
            *(run.verdict_reasons or [run.status_reason]),
            *json.loads(str(run.provenance["mesh"])),
            sep="\n  ",
            flush=True,
        )
        guess, cases = (
            straight(count),
            [("cold", 20, 3), ("cold", 20, 7), ("then", 40, 7), ("then", 80, 7), ("ours", 80, 7)],
        )
        for case, intervals, points in cases:
            start = {"cold": straight(count), "then": guess, "ours": motion_of(run, count)}[case]
            begin = processor_time()
            objective, iterations, status, guess = witness(count, intervals, points, start)
            seconds = processor_time() - begin
            how = f"{iterations} iterations, {status}, {seconds:.1f} s"
            print(f"  witness, {case} {intervals} x {points}: {objective:.6f}, {how}", flush=True)


if __name__ == "__main__":
    main()
