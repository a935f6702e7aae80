"""`python -m tests.benchmarks frontal --count N`: the frontal bound of knees, on drawn persons.

Persons are those of `drawn_persons`, with a frontal plane of their own: a stick model in three dimensions, from which
the moment of the ground's force about the forward axis of the right knee follows as a cross product. The pelvis sways
to the foot that stands, feet are half a step width to the side, the knee is beside the line from hip to ankle by the
alignment of the leg and by a turn of the leg about this line, and the ground's force points from the foot to a share of
the way across to the middle of the body. The truth has compartments that carry this moment. The draws do not use
formulas of mbdkit.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import redirect_stderr
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console

import mbdkit
from mbdkit.base.errors import MbdkitError

from .drawn_persons import Array, drawn_person, errors_of_knee, page_walker
from .person_markers import HIP, MARKERS, SHANK, THIGH

SWAY, STEP = (0.022, 0.005), (0.10, 0.03)
"""Means and standard deviations: amplitude of the pelvis, and distance of the ankles, across [m] (assumptions)."""
ALIGNMENT, TURN = (np.radians(1.3), np.radians(2.3)), (np.radians(5.0), np.radians(8.0))
"""Varus of the leg (Bellemans et al. 2012), and outward turn of the leg about the line from hip to ankle (an
assumption) [rad]."""
KNEE = ("KNE", "KNM")
BOUNDS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "a landmark outside, with the bound": (KNEE[:1], {}),
    "a landmark outside, no bound": (KNEE[:1], {"frontal": "none"}),
    "landmarks, with the bound": (KNEE, {}),
    "landmarks, no bound": (KNEE, {"frontal": "none"}),
}
"""Landmarks of the knees, and sections of the spec."""
HIPS, FEET, PRESSURE = 0.01, 0.01, 0.006
"""Standard deviations of the hip from its regression, of the markers of the foot from the ankle, and of the mean point
of the ground's force from the ankle [m], all across."""
POINTS_TO_BODY, CENTER = (0.8, 0.1), 1.0
"""Share of the way across to the middle of the body at which the ground's force points there, and height of this
point [m]."""


@dataclass(frozen=True)
class FrontalPlane:
    """Places across the plane of motion, positive to the right (T,) [m], of a person with a right leg."""

    pelvis: Array
    hip: Array
    knee: Array
    ankle: float
    foot: float
    """The middle of the markers of the foot less that of an exact person."""
    pressed: Array
    """The point of application of the ground's force."""
    across: Array
    """Force across as a share of the vertical one."""
    landmarks: tuple[str, ...] = ()
    """Landmarks of the knee, moved with the skin of the thigh."""

    @classmethod
    def drawn(cls, random: np.random.Generator) -> FrontalPlane:
        """Return the plane of a person drawn at random."""
        walker, normal = page_walker(), random.standard_normal
        (first, end), *_ = [pair for foot, *pair in walker.contacts() if foot == "foot" and pair[0] > 0]
        share = (walker.time - walker.time[first]) / (walker.time[end] - walker.time[first])
        sway = (SWAY[0] + SWAY[1] * normal()) * np.cos(2 * np.pi * 0.62 * (share - 0.5))  # 0.62 of a stride is a stance
        ankle = 0.5 * (STEP[0] + STEP[1] * normal())
        hip = sway + HIP[2] + HIPS * normal()
        points = [np.stack([*walker.joints[name][:, :2].T], axis=1) for name in ("hip", "knee", "ankle")]
        line, beside = points[2] - points[0], points[1] - points[0]
        length = np.linalg.norm(line, axis=1)
        along = np.sum(line * beside, axis=1) / length**2
        off = (line[:, 0] * beside[:, 1] - line[:, 1] * beside[:, 0]) / length  # in front of the line
        varus, turn = ALIGNMENT[0] + ALIGNMENT[1] * normal(), TURN[0] + TURN[1] * normal()
        outward = THIGH * SHANK / (THIGH + SHANK) * np.sin(varus) + off * np.sin(turn)
        knee = hip + along * (ankle - hip) + outward
        rolls = 0.008 * np.sin(np.pi * np.clip(share, 0.0, 1.0))  # outward in the middle of the stance
        pressed = ankle + PRESSURE * normal() + rolls
        across = (POINTS_TO_BODY[0] + POINTS_TO_BODY[1] * normal()) * (sway - pressed) / CENTER
        return cls(sway, hip, knee, ankle, FEET * normal(), pressed, across)

    @property
    def moment(self) -> Array:
        """Moment (T,) of the ground's force about the forward axis of the knee, positive if it presses the medial side
        [N m].
        """
        walker = page_walker()
        force, point = walker.loads["foot"]
        knee = np.column_stack([walker.joints["knee"][:, :2], self.knee])
        way = np.column_stack([np.nan_to_num(point[:, 0]), 0.0 * self.knee, self.pressed]) - knee
        return np.cross(way, np.column_stack([force, self.across * force[:, 1]]))[:, 0]

    def columns(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """Return columns of markers and plates in a laboratory, whose second axis points to the left, with these places
        across.
        """
        left_out = set(KNEE) - set(self.landmarks)
        found = {name: own.copy() for name, own in columns.items() if name[1:] not in left_out}
        middle = {"thigh": (self.hip, self.knee, THIGH), "shank": (self.knee, self.ankle, SHANK)}
        for kind, points in MARKERS.items():
            for name, (_, y, _) in points.items():
                if f"R{name}" not in found:
                    continue
                first, last, length = middle.get(kind, (self.ankle + self.foot, 0.0, np.inf))
                if kind in middle:
                    first = first + (-y / length) * (last - first)
                found[f"R{name}"][:, 1] -= first - HIP[2]
        for name in ("RASI", "LASI", "RPSI", "LPSI"):
            found[name][:, 1] -= self.pelvis
        for number, (foot, *_) in enumerate(page_walker().contacts(), 1):
            if foot == "foot":
                found[f"plate{number}.point"][:, 1] = -self.pressed
                found[f"plate{number}.force"][:, 1] = -self.across * found[f"plate{number}.force"][:, 2]
        return found


def frontal(console: Console, count: int = 20, seed: int = 93, samples: int = 100) -> None:
    """Print how well the compression of the knees of `count` persons is known, with each of `BOUNDS`."""
    errors: dict[str, list[Array]] = {key: [] for key in BOUNDS}
    for number in range(count):
        try:
            for key, own in errors_of_all(np.random.default_rng([seed, number]), samples).items():
                errors[key].append(own)
        except MbdkitError as error:
            console.print(f"failed: {number}: {error}")
    for key, rows in errors.items():
        console.print(f"{key}, {len(rows)} persons: {words_of(np.array(rows))}")


def errors_of_all(random: np.random.Generator, samples: int) -> dict[str, Array]:
    """Return errors of the compression of the knee, both sides of its bars, and shares of the stance (T, 4)."""
    plane, found = FrontalPlane.drawn(random), {}
    drawn = random.bit_generator.state
    with redirect_stderr(io.StringIO()):
        for key, (landmarks, sections) in BOUNDS.items():
            random.bit_generator.state = drawn
            own = replace(plane, landmarks=landmarks)
            person = drawn_person(random, plane=own, uncertainty={"samples": samples}, **sections)
            with mbdkit.inverse(person.measured) as run:
                found[key] = errors_of_knee(run, person)
    return found


def words_of(errors: Array) -> str:
    """Return what errors (N, T, 4) in stances say."""
    error, lower, upper, share = np.moveaxis(errors, -1, 0)
    stance, middle = (share >= 0) & (share < 1), (share >= 0.2) & (share < 0.6)
    inside = np.abs(error) <= np.where(error > 0, upper, lower)
    own = [np.mean(row[where]) for row, where in zip(inside, stance, strict=True)]
    return (
        f"covered {np.mean(inside[stance]):.1%} +- {np.std(own) / len(own) ** 0.5:.1%} of the stance, "
        f"{np.mean(inside[middle]):.1%} of its middle; rms {np.sqrt(np.mean(error[stance] ** 2)):.0f} and "
        f"{np.sqrt(np.mean(error[middle] ** 2)):.0f} N, median error {np.median(error[middle]):.0f} N in the middle, "
        f"half width {np.median(0.5 * (lower + upper)[stance]):.0f} N"
    )
