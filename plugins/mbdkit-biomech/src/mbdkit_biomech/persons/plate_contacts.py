"""Force plates of a C3D file under the feet of a person: which foot stands on which plate, and the load of each foot.

A contact is a time in which the force of a plate exceeds `UNLOADED`. It belongs to the foot that is nearest to the
point of application, on average over the contact with the force as weight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.c3d_file import UNLOADED
from mbdkit_biomech.inverse_dynamics.inverse_sections import ColumnOfTable
from mbdkit_biomech.inverse_dynamics.measured import si_values
from mbdkit_biomech.persons.marker_files import MarkerFile
from mbdkit_biomech.persons.motion_plane import MotionPlane

SHORTEST = 0.05
"""Shorter contacts [s] are vibrations of the plate, and left out."""

FARTHEST = 0.25
"""Largest mean horizontal distance of the point of application from the middle of the markers of a foot [m]: half a
foot and a tolerance of 0.1 m."""

BOTH = 0.5
"""Two feet stand on a plate if both rest within this share of `FARTHEST` of its point of application for this share of
a contact."""

AT_REST = 0.15
"""Speed below which a foot rests [m/s]."""

LARGEST_OFFSET = 0.1
"""Largest offset between the times of plates and markers that is looked for [s]."""


class FootMotion(NamedTuple):
    """Middle of the markers of a foot (T, 3) [m] and its velocity (T, 3) [m/s], as (forward, up, right), and rate of
    the angle of the foot (T,) [rad/s], counter-clockwise.
    """

    middle: np.ndarray
    velocity: np.ndarray
    angle_rate: np.ndarray

    @property
    def at_rest(self) -> np.ndarray:
        """(T,) whether the foot rests."""
        return np.asarray(np.sqrt(np.sum(self.velocity * self.velocity, axis=1)) < AT_REST)


class Contact(NamedTuple):
    """A contact of a foot with a plate, from a first frame to the one before `end`, at a mean horizontal distance of
    the point of application from the middle of the foot [m].
    """

    plate: int
    body: str
    first: int
    end: int
    distance: float

    def when(self, time: np.ndarray) -> str:
        """Return the time of the contact as a phrase."""
        return f"from t = {time[self.first]:.3f} to {time[self.end - 1]:.3f} s"


class PlateLoad(NamedTuple):
    """Force on a foot (T, 2) [N], its point of application (T, 2) [m], nan without force, and free torque (T,) [N m],
    in the plane of motion.
    """

    force: np.ndarray
    point: np.ndarray
    torque: np.ndarray


class PlateResult(NamedTuple):
    """Loads of feet by name, contacts, time by which plates are late and half the width of the range of offsets that
    explain the data almost as well [s] (None without contacts), and what was found.
    """

    loads: Mapping[str, PlateLoad] = {}
    contacts: Sequence[Contact] = ()
    offset: tuple[float, float] | None = None
    findings: Sequence[Finding] = ()


class _Plate:
    """Force, point of application and torque of a plate, each (T, 3), as (forward, up, right)."""

    def __init__(self, file: MarkerFile, number: int, plane: MotionPlane, key: str):
        if number not in (numbers := plate_numbers(file)):
            have = f"plates {listed(list(map(str, numbers)), 'and')}" if numbers else "no force plates"
            why = f" ({file.table.remark})" if file.table.remark else ""
            raise SpecError(f"{file.table.name} has no plate {number}: it has {have}{why}", key=key)
        self.number, self.force, self.point, self.torque = number, *(
            plane.coordinates(np.stack([si_values(ColumnOfTable(column=f"plate{number}.{quantity}.{axis}"), file.table,
                                                  unit, key) for axis in "xyz"], axis=1))
            for quantity, unit in (("force", "N"), ("point", "m"), ("torque", "N m"))
        )  # fmt: skip
        if (missing := np.flatnonzero(np.isnan(self.force + self.torque).any(axis=1))).size:
            raise file.table.error(f"force or torque of plate {number} is missing", row=int(missing[0]), key=key)
        self.acts = np.sqrt(np.sum(self.force * self.force, axis=1)) > UNLOADED
        self.is_reversed = float(np.sum(self.force[self.acts, 1])) < 0
        if self.is_reversed:
            self.force, self.torque = -self.force, -self.torque

    def distances(self, foot: FootMotion, frames: slice) -> np.ndarray:
        """Return the horizontal distances of the points of application from the middle of a foot in some frames."""
        gap = (self.point - foot.middle)[frames][:, [0, 2]]
        return np.asarray(np.sqrt(np.sum(gap * gap, axis=1)))

    def contacts(self, feet: Mapping[str, FootMotion], time: np.ndarray, key: str) -> list[Contact]:
        """Return the contacts; raise SpecError if a force acts far from all feet, unless `key` is empty."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.acts, [False]]))).reshape(-1, 2)
        found = []
        for first, end in edges.tolist():
            if time[end - 1] - time[first] < SHORTEST:
                continue
            weight, distances = self.force[first:end, 1], {}
            for body, foot in feet.items():
                gap = self.distances(foot, slice(first, end))
                own = ~np.isnan(gap) & (weight > 0)
                distances[body] = float(np.sum((weight * gap)[own]) / np.sum(weight[own])) if own.any() else np.inf
            body = min(distances, key=lambda name: distances[name])
            contact = Contact(self.number, body, first, end, distances[body])
            if not contact.distance <= FARTHEST and not key:
                continue
            if not contact.distance <= FARTHEST:
                where = f"{contact.distance:.2f} m from the nearest foot"
                raise SpecError(
                    f"the force of plate {self.number} {contact.when(time)} acts "
                    f"{where if np.isfinite(contact.distance) else 'at no known point'} (at most {FARTHEST:g} m are "
                    "accepted): the corners of the plate may be in another frame or unit than the markers, or "
                    "something else stands on the plate, which `loads` should then leave out",
                    key=key,
                )
            found.append(contact)
        return found


def plate_numbers(file: MarkerFile) -> list[int]:
    """Return the numbers of the plates of a file."""
    headings = file.table.headings
    return [int(one[5:-8]) for one in headings if one.startswith("plate") and one.endswith(".force.x")]


def plates_under_feet(
    file: MarkerFile,
    plane: MotionPlane,
    feet: Mapping[str, FootMotion],
    asked: Mapping[str, tuple[str, Sequence[int]]],
    *,
    every: bool,
) -> PlateResult:
    """Return the loads of feet by plates.

    Parameters
    ----------
    feet
        Motion of the feet by body.
    asked
        Foot and numbers of the plates by name of the load.
    every
        Whether a load without contact is an error; otherwise it is left out, and so are, with one leg, contacts of the
        other foot.

    Raises
    ------
    SpecError
        If the file has no such plate, a foot is on none of its plates, or a force acts far from all feet.
    """
    time, loads, findings = file.time, {}, []
    keys = {number: f"loads.{name}.plates" for name, (_, own) in asked.items() for number in own}
    plates = {number: _Plate(file, number, plane, key) for number, key in keys.items()}
    strict = every or len(feet) == 2
    contacts = [
        one for number, plate in plates.items() for one in plate.contacts(feet, time, keys[number] if strict else "")
    ]
    for name, (body, own) in asked.items():
        if body not in feet:
            feet_named = listed([f"'{foot}'" for foot in feet])
            raise SpecError(f"should be a foot of the person ({feet_named}), not '{body}'", key=f"loads.{name}.body")
        mine = [one for one in contacts if one.plate in own and one.body == body]
        other = next((f"'{one.body}' stands on plate {one.plate}" for one in contacts if one.plate in own), "")
        if mine:
            loads[name] = _load([plates[one.plate] for one in mine], mine, len(time))
        elif every:
            raise SpecError(
                f"'{body}' stands on none of the plates {listed(list(map(str, own)), 'and')}; "
                f"{other or 'they carry no force'}",
                key=f"loads.{name}.plates",
            )
    for number in (number for number, plate in plates.items() if plate.is_reversed):
        sentence = f"plate {number} states the force on the plate; the force on the foot is its opposite"
        findings.append(Finding("plates", None, sentence))
    for one in contacts:
        where = f"plate {one.plate} {one.when(time)}"
        if not any(body == one.body and one.plate in own for body, own in asked.values()):
            findings.append(Finding("plates", "doubtful", f"{one.body} stands on {where}, but no load of it names it"))
        frames = slice(one.first, one.end)
        near = [plates[one.plate].distances(foot, frames) < BOTH * FARTHEST for foot in feet.values()]
        rest = [foot.at_rest[frames] for foot in feet.values()]
        if len(feet) == 2 and np.mean(np.all([*near, *rest], axis=0)) > BOTH:
            sentence = f"both feet stand on {where}, so that its force is not that of {one.body} alone"
            findings.append(Finding("plates", "doubtful", sentence))
    offset = _offset(time, [(plates[one.plate], one, feet[one.body]) for one in contacts]) if contacts else None
    if offset is not None and abs(offset[0]) > offset[1]:
        findings.append(
            Finding(
                "plates",
                "doubtful",
                f"the plates are {1000 * abs(offset[0]):.0f} ms {'late' if offset[0] > 0 else 'early'} relative to the "
                f"markers (known to {1000 * offset[1]:.0f} ms), since the feet slip least with this offset: check the "
                "synchronisation",
            )
        )
    return PlateResult(loads, contacts, offset, findings)


def _load(plates: Sequence[_Plate], contacts: Sequence[Contact], count: int) -> PlateLoad:
    """Return the sum of the forces of contacts, at the point about which they have no moment but the free torques."""
    force, torque, moment, height = np.zeros((count, 2)), np.zeros(count), np.zeros(count), np.zeros(count)
    for plate, one in zip(plates, contacts, strict=True):
        own = np.s_[one.first : one.end]
        f, p = plate.force[own, :2], np.nan_to_num(plate.point[own, :2])
        force[own] += f
        torque[own] += plate.torque[own, 2]
        moment[own] += p[:, 0] * f[:, 1] - p[:, 1] * f[:, 0]
        height[own] += f[:, 1] * p[:, 1]
    acts = force[:, 1] > 0
    force[~acts], torque[~acts] = 0.0, 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        y = height / force[:, 1]
        x = (moment + y * force[:, 0]) / force[:, 1]
    return PlateLoad(force, np.where(acts[:, None], np.stack([x, y], axis=1), np.nan), torque)


def _offset(time: np.ndarray, contacts: Sequence[tuple[_Plate, Contact, FootMotion]]) -> tuple[float, float] | None:
    """Return the offset of the plates for which the points of the feet at the points of application move least, and the
    largest distance of offsets whose mean square velocity is at most twice as large; None if it is not known.
    """
    interval = float(np.median(np.diff(time)))
    most = int(LARGEST_OFFSET / interval)
    steps, costs = np.arange(-most, most + 1), []
    for step in steps.tolist():
        square = weight = 0.0
        for plate, contact, foot in contacts:
            own = np.arange(max(contact.first, step), min(contact.end, len(time) + step))
            arm, speed = (plate.point[own] - foot.middle[own - step]), foot.velocity[own - step]
            rate, force = foot.angle_rate[own - step], plate.force[own, 1]
            x, y = speed[:, 0] - rate * arm[:, 1], speed[:, 1] + rate * arm[:, 0]
            slip = (x * x + y * y) * force
            known = ~np.isnan(slip)
            square, weight = square + float(np.sum(slip[known])), weight + float(np.sum(force[known]))
        costs.append(square / weight if weight > 0 else np.inf)
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        return None
    within = np.flatnonzero(np.array(costs) <= 2.0 * costs[best])
    return float(steps[best]) * interval, max(float(np.max(np.abs(within - best))) * interval, interval / 2)
