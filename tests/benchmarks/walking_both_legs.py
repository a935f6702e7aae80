"""`python -m tests.benchmarks.walking_both_legs FILE`: the table of the example `walking-two-legs`.

The legs of `tests.benchmarks.walking_data` move in space as there, left and right half a stride apart. What differs:

- the ground force is multiplied by a complex number, 1.029 at -0.47 degrees, with which its mean is half of the
  weight: over a stride, the body is neither accelerated nor lifted;
- the trunk is one body that both legs carry. Its tilt and the motion of the hip follow from Newton's and Euler's laws
  of the whole body, so that the ground forces alone move it; they repeat after half a stride. Hip flexion is counted
  from this trunk, and the first harmonic of the thigh in space is again the one with which the flat foot rests.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from tests.inverse_dynamics.running import reference, table

from tests.benchmarks.walking_data import (
    COLUMNS,
    FLAT,
    GRAVITY,
    GRID,
    PERSON,
    PERSON_MASS,
    PHASES,
    SPEED,
    STRIDE,
    Array,
    Gait,
    fitted,
    harmonics,
    header,
    pressure,
    rows,
    with_sole,
)

HIGHEST = 20
"""Highest harmonic of the stride in the motions of hip and trunk; odd ones are zero, since steps are alike."""
ROUNDS = 16
"""The centre of pressure depends on the motion of the hip; after so many rounds, neither changes any more."""
SEGMENTS = (PERSON.thigh, PERSON.shank, PERSON.foot)
DIGITS = (6, 2, 7)
"""Decimal places of angles, forces and lengths; residuals are second derivatives, in which rounding errors grow."""
UNKNOWN = ("hip_x", "hip_y", "trunk_tilt")


def on_both_legs(gait: Gait, winter: Any) -> Gait:
    """Return the gait of a person whose legs carry one trunk.

    Parameters
    ----------
    gait
        The gait of one leg.
    winter
        Winter's table.
    """
    series = dict(gait.series)
    force = gait.force(GRID)
    turned = 0.5j * PERSON_MASS * GRAVITY / np.mean(force) * (series["force_x"] + 1j * series["force_y"])
    series |= {"force_x": turned.real, "force_y": turned.imag}
    thigh = np.linalg.lstsq(harmonics(GRID, HIGHEST), gait.angles(GRID)[0], rcond=None)[0]
    found = _with_trunk(series, thigh, np.zeros((3, 2 * HIGHEST + 1)))
    for _ in range(ROUNDS):
        found = _balanced(found, thigh, pressure(found, winter, GRID))
        thigh = _resting(found, thigh)
    return _balanced(found, thigh, pressure(found, winter, GRID))


def _resting(gait: Gait, thigh: Array) -> Array:
    """Return the angle of the thigh with the first harmonic for which the foot comes nearest to resting while flat."""

    def turned(change: Array) -> Array:
        own = thigh.copy()
        own[1:3] += change
        return own

    def slip(change: Array) -> Array:
        flexed = Gait(gait.series | {"hip_flexion": turned(change) - gait.series["trunk_tilt"]})
        ankle = flexed.hip(FLAT) + flexed.below_hip(FLAT)[1]
        return np.asarray(np.gradient(ankle.real, STRIDE * FLAT))

    return turned(least_squares(slip, np.zeros(2)).x)


def _with_trunk(series: dict[str, Array], thigh: Array, trunk: Array) -> Gait:
    """Return the gait with series (3, 2 HIGHEST + 1) of hip and trunk, for the angle of the thigh in space."""
    own = dict(zip(UNKNOWN, trunk, strict=True))
    return with_sole(Gait(series | own | {"hip_flexion": thigh - own["trunk_tilt"]}))


def _balanced(gait: Gait, thigh: Array, centre: Array) -> Gait:
    """Return the gait with the motions of hip and trunk for which forces and moments of the whole body balance.

    Parameters
    ----------
    thigh
        (2 HIGHEST + 1,) series of the angle of the thigh in space.
    centre
        (250,) centres of pressure x [m] at `GRID`.
    """
    even = np.zeros(2 * HIGHEST + 1, dtype=bool)
    even[[2 * order - half for order in range(2, HIGHEST + 1, 2) for half in (0, 1)]] = True
    free = np.array([even, even, even])
    free[2, 0] = True  # the mean tilt
    fixed = np.array([gait.series[name] for name in UNKNOWN])
    arm = centre - gait.hip(GRID).real  # this far from the hip stays the centre of pressure in this round

    def with_free(numbers: Array) -> Gait:
        trunk = fixed.copy()
        trunk[free] = numbers
        return _with_trunk(gait.series, thigh, trunk)

    def left_over(numbers: Array) -> Array:
        return np.concatenate(residuals(with_free(numbers), GRID, arm)) / PERSON_MASS

    return with_free(least_squares(left_over, fixed[free], x_scale="jac", xtol=1e-14, ftol=1e-14).x)


def residuals(gait: Gait, phase: Array, arm: Array) -> tuple[Array, Array, Array]:
    """Return force x, y [N] and moment about the hip [N m], (T,) each, that the ground forces leave to the trunk.

    Parameters
    ----------
    phase
        (T,) phases, evenly spaced over a stride, T even.
    arm
        (T,) centre of pressure in front of the hip [m]; nan where the foot is in the air.
    """
    acceleration = gait.at("hip_x", phase, 2) + 1j * gait.at("hip_y", phase, 2)
    angles = [(gait.at("trunk_tilt", phase, order)) for order in range(3)]
    centre, inertial = _moving(angles, PERSON.trunk.centre)
    force, moment = np.zeros(len(phase), dtype=complex), np.zeros(len(phase))
    parts = [(PERSON.trunk, centre, inertial, angles[2])]
    for shift in (0.0, 0.5):
        joint, joint_acceleration = np.zeros(len(phase), dtype=complex), np.zeros(len(phase), dtype=complex)
        turns = zip(*(gait.angles(phase + shift, order) for order in range(3)), strict=True)
        for segment, length, own in zip(SEGMENTS, (PERSON.thigh_length, PERSON.shank_length, 0.0), turns, strict=True):
            centre, inertial = _moving(own, segment.centre)
            parts.append((segment, joint + centre, joint_acceleration + inertial, own[2]))
            end, end_acceleration = _moving(own, -1j * length)
            joint, joint_acceleration = joint + end, joint_acceleration + end_acceleration
        ground = gait.force(phase + shift)
        own_arm = arm if shift == 0.0 else np.roll(arm, -(len(phase) // 2))
        point = np.where(np.isnan(own_arm), 0.0, own_arm) - 1j * gait.at("hip_y", phase)
        force, moment = force - ground, moment - (np.conj(point) * ground).imag
    for segment, place, relative, spin in parts:
        inert = segment.mass * (acceleration + relative + 1j * GRAVITY)
        force, moment = force + inert, moment + (np.conj(place) * inert).imag + segment.inertia * spin
    return force.real, force.imag, moment


def _moving(angles: Any, point: complex) -> tuple[Array, Array]:
    """Return a point of a turning segment and its acceleration, for the angle and its two derivatives."""
    angle, rate, spin = angles
    place = point * np.exp(1j * angle)
    return place, (1j * spin - rate * rate) * place


LEFT = ("hip_flexion", "knee_flexion", "ankle_dorsiflexion", "force_x", "force_y", "pressure_x")


def text(gait: Gait, winter: Any) -> str:
    """Return the table: comments with the coefficients of all series, headings, and rows."""
    lines = [
        *header("walking_both_legs"),
        "# The columns of the left leg are those of the right one half a stride later.",
        *(f"# {name}: {' '.join(f'{round(x, 9):.6g}' for x in gait.series[name])}" for name in COLUMNS),
        ",".join(("time", *COLUMNS, "pressure_x", *(f"{name}_left" for name in LEFT))),
    ]
    right = rows(gait, PHASES, pressure(gait, winter, PHASES), DIGITS)
    back = SPEED * STRIDE / 2  # half a stride later, the person is so far ahead
    left = rows(gait, PHASES + 0.5, pressure(gait, winter, PHASES + 0.5) - back, DIGITS)
    return "\n".join([*lines, *(",".join([*one, *other[4:]]) for one, other in zip(right, left, strict=True))]) + "\n"


def main(path: str) -> None:
    """Write the table."""
    winter = table(reference("winter_normal_gait.csv"))
    Path(path).write_text(text(on_both_legs(fitted(winter), winter), winter), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
