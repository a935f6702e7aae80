"""Kinematic analysis: the motion of a fully driven mechanism, computed without forces and without integration."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np

from mbdkit.base.errors import RunError, StepError
from mbdkit.base.text import counted, csv_cell, listed
from mbdkit.mechanism.beams import named_body
from mbdkit.spec.loading import RunSource, Sections
from mbdkit_statics.prepared_mechanism import PreparedMechanism
from mbdkit_statics.reduced import at_rest, reduce

#: A step is halved if the new position deviates from the extrapolated one by more than this fraction of the
#: displacement.
ASIDE = 0.1

#: Deviations below this, relative to the size of the mechanism or to 1 rad, never cause a step to be halved.
SMALL = 1e-6

FINEST = 2.0**-12  #: Smallest step that is tried, relative to the interval between two recorded times.

#: A coordinate counts as driven if its component in the mass-orthonormal basis of the free motions is below this.
STILL = 1e-6

COLUMNS = ("x", "y", "angle", "vx", "vy", "rate", "ax", "ay", "angular_acceleration")


@dataclass(frozen=True)
class Kinematics:
    """The motion of a fully driven mechanism.

    Attributes
    ----------
    time : (T,) array
        Times [s].
    bodies
        Names of the bodies.
    position, velocity, acceleration : (T, B, 3) arrays
        x, y [m] and angle [rad] of each body, and their first and second time derivatives. The angle of a point mass is
        constant.
    """

    time: np.ndarray
    bodies: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    def __getitem__(self, body: str) -> BodyMotion:
        """Return the motion of a body by its name."""
        at = self.bodies.index(named_body(body, self.bodies))
        return BodyMotion(self.position[:, at], self.velocity[:, at], self.acceleration[:, at])

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.bodies)

    def write_csv(self, path: Path) -> None:
        """Write a CSV table with one row per time: time, then x, y, angle and their derivatives of each body."""
        with path.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(["time", *(csv_cell(f"{body}.{column}") for body in self.bodies for column in COLUMNS)])
            together = np.concatenate([self.position, self.velocity, self.acceleration], axis=2)
            for t, row in zip(self.time.tolist(), together.reshape(len(self.time), -1).tolist(), strict=True):
                table.writerow([repr(x) for x in (t, *row)])


@dataclass(frozen=True)
class BodyMotion:
    """The motion of one body: position, velocity and acceleration, each (T, 3) for x, y [m] and angle [rad]."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


def kinematics(source: RunSource, **sections: Unpack[Sections]) -> Kinematics:
    """Compute the motion of a fully driven mechanism from its joints and drivers alone.

    At each time, Newton's method closes the joints, and then linear equations are solved for velocities and
    accelerations, both to round-off. Masses and forces have no influence. A step between two recorded times is halved
    if the new position is far from its extrapolation, which keeps the mechanism in the same assembly configuration.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism. A Mechanism also needs
        ``time={"end": ..., "step": ...}``.
    **sections
        Sections of the spec that replace those of `source`; only `model` and `time` are used.

    Returns
    -------
    Kinematics
        Positions, velocities and accelerations at the start, after every step, and at the end.

    Raises
    ------
    SpecError
        If the input is wrong, or the mechanism is not fully driven; the message names the free coordinates.
    RunError
        If the mechanism cannot follow its drivers, or passes a singular position.

    Examples
    --------
    A crank of length 0.1 m that turns at 5 rad/s:

    >>> import mbdkit
    >>> m = mbdkit.Mechanism()
    >>> crank = m.body("crank", mass=1.0, inertia=0.01, position=(0.1, 0.0))
    >>> m.revolute("A", m.ground, crank, at=(0, 0))
    >>> m.driver("motor", m.ground, crank, coordinate="angle", motion="5*t")
    >>> motion = mbdkit.kinematics(m, time={"end": 1.0, "step": 0.1})
    >>> [round(float(speed), 9) for speed in motion["crank"].velocity[0]]  # x, y [m/s], angle [rad/s]
    [0.0, 0.5, 5.0]
    """
    return kinematics_of(PreparedMechanism.of(source, **sections))


def kinematics_of(prepared: PreparedMechanism) -> Kinematics:
    """Compute the motion of a prepared, fully driven mechanism; see `kinematics`."""
    _require_driven(prepared)
    time = prepared.spec.time
    if time.step is None or time.count is None:
        raise prepared.error("is missing: a kinematic analysis needs a step in seconds", key="time.step")
    times = np.array([*(time.start + time.step * np.arange(time.count)), time.final])
    path = _DrivenMotion(prepared)
    rows = np.empty((len(times), 3, prepared.equations.n))
    for i, t in enumerate(times.tolist()):
        path.go_to(t)
        rows[i] = path.q, path.v, path.a
    position, velocity, acceleration = (rows[:, k].reshape(len(times), -1, 3) for k in range(3))
    return Kinematics(times, prepared.equations.bodies, position, velocity, acceleration)


class _DrivenMotion:
    def __init__(self, prepared: PreparedMechanism):
        self.placed, self.p = prepared, prepared.equations
        self.size = np.tile([prepared.extent, prepared.extent, 1.0], len(self.p.bodies))
        self.t = self.p.t0
        try:
            self.arrive(self.t, self.p.project_positions(self.t, self.p.q0))
        except StepError as error:
            raise self.stopped(error) from error

    def go_to(self, t: float) -> None:
        """Advance to time `t` [s] in steps that are halved if necessary, and doubled after each success."""
        step = whole = t - self.t
        while self.t < t:
            there = t if self.t + step >= t or step == whole else self.t + step
            try:
                if self.advance(there):
                    step = min(2 * step, whole)
                    continue
                why: StepError | None = None
            except StepError as error:
                why = error
            step = 0.5 * (there - self.t)
            if step < FINEST * whole:
                raise self.stopped(why)

    def advance(self, t: float) -> bool:
        """Try one step to time `t`; return whether the new position is close to its second-order extrapolation."""
        h = t - self.t
        move = h * self.v + 0.5 * h * h * self.a
        q = self.p.project_positions(t, self.q + move)
        aside = float(np.max(np.abs(q - self.q - move) / self.size))
        if aside > SMALL and aside > ASIDE * float(np.max(np.abs(move) / self.size)):
            return False
        self.arrive(t, q)
        return True

    def arrive(self, t: float, q: np.ndarray) -> None:
        """Store a position in which the joints are closed, and compute the velocities and accelerations there."""
        p = self.p
        v = p.project_velocities(t, q, np.zeros(p.n))
        a, _ = p.solve(t, q, np.zeros(p.n), p.gamma(t, q, v))
        self.t, self.q, self.v, self.a = t, q, v, a

    def stopped(self, why: StepError | None) -> RunError:
        reason = f": {why}" if why is not None else ": no continuous motion was found"
        return RunError(
            f"the mechanism cannot follow its drivers beyond t = {self.t:.6g} s{reason}; "
            "it is near a dead centre, or the prescribed position cannot be reached"
        )


def _require_driven(prepared: PreparedMechanism) -> None:
    if prepared.freedoms == 0:
        return
    p = prepared.equations
    with prepared.as_spec_errors():
        basis = reduce(prepared, at_rest(prepared, p.q0, np.zeros(p.m))).basis
    moves = np.linalg.norm(basis * np.sqrt(p.mass)[:, None], axis=1).reshape(-1, 3)
    free = [
        f"{name} ({listed([word for word, x in zip(('x', 'y', 'angle'), part, strict=True) if x > STILL])})"
        for name, part in zip(p.bodies, moves, strict=True)
        if np.any(part > STILL)
    ]
    shown = listed(free[:6], "" if len(free) > 6 else "and") + (f" and {len(free) - 6} more" if len(free) > 6 else "")
    raise prepared.error(
        f"a kinematic analysis needs a mechanism that is fully driven, and {counted(prepared.freedoms, 'degree')} of "
        f"freedom {'is' if prepared.freedoms == 1 else 'are'} left in {shown}; add "
        f"{counted(prepared.freedoms, 'driver')}, or run it as dynamics with `mbdkit run`",
        key="model.joints",
    )
