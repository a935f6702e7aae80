"""Force plates of a C3D file under the feet of a person: which foot stands on which plate, and the load of each foot.

A contact is a time in which the force of a plate exceeds `UNLOADED`. It belongs to the foot that is nearest to the
point of application, on average over the contact with the force as weight.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.files.c3d_file import UNLOADED
from mbdkit_biomech.inverse_dynamics.motion.smoothing import low_passed
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Smoothing
from mbdkit_biomech.persons.calibration import MotionPlane
from mbdkit_biomech.persons.landmarks import MarkerFile

SHORTEST = 0.05  #: Shorter contacts [s] are vibrations of the plate, and left out.

#: Largest mean horizontal distance of the point of application from the middle of the markers of a foot [m]: half a
#: foot and a tolerance of 0.1 m.
FARTHEST = 0.25

#: Two feet stand on a plate if both rest within this share of `FARTHEST` of its point of application for this share of
#: a contact.
BOTH = 0.5

AT_REST = 0.15  #: Speed below which a foot rests [m/s].

#: A foot stands flat while its angle changes more slowly than this [rad/s] and its height more slowly than `AT_REST`;
#: smallest number of such frames from which the speed of a belt is found.
FLAT, LEAST_FLAT = 0.5, 5

#: Feet that stand flat on plates and move faster than this [m/s], with a scatter below this share, are on a belt.
SLIDES, EVENLY = 0.3, 0.2

LARGEST_OFFSET = 0.1  #: Largest offset between the times of plates and markers that is looked for [s].


#: Standard deviation of the offset by feet that are not rigid [s]. In a walk with known joints, heel pads that yield by
#: 9 mm (D. De Clercq, P. Aerts and M. Kunnen, J. Biomech. 27 (1994) 1213-1222) changed the offset by 1 to 2 ms, balls
#: of the foot that yield by 5 mm by 1 to 4 ms, and toes that bend by 50 degrees by 1 ms.
SOFT = 0.004


class FootMotion(NamedTuple):
    """Middle of the markers of a foot (T, 3) [m], its velocity over the ground or the belt of a treadmill (T, 3) [m/s],
    as (forward, up, right), and rate of the angle of the foot (T,) [rad/s], counter-clockwise.
    """

    middle: np.ndarray
    velocity: np.ndarray
    angle_rate: np.ndarray

    @property
    def at_rest(self) -> np.ndarray:
        """(T,) whether the foot rests."""
        return np.asarray(np.linalg.norm(self.velocity, axis=1) < AT_REST)


@dataclass(frozen=True)
class PlateContact:
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
        return f"from t = {time[self.first]:.4f} to {time[self.end - 1]:.4f} s"


class PlateLoad(NamedTuple):
    """Force on a foot (T, 2) [N], its point of application (T, 2) [m], nan without force, and free torque (T,) [N m],
    in the plane of motion; the body; and the force to the right [N] and the moment about the forward axis through the
    origin [N m], (T, 2).
    """

    force: np.ndarray
    point: np.ndarray
    torque: np.ndarray
    body: str
    across: np.ndarray

    def frontal_moment(self, point: np.ndarray) -> np.ndarray:
        """Return the moment (T,) about the forward axis through points (T, 3) [N m]."""
        right, moment = self.across.T
        return np.asarray(moment - (point[:, 1] * right - point[:, 2] * self.force[:, 1]))


@dataclass(frozen=True)
class Offset:
    """Time by which plates are later than markers, and its standard deviation [s]."""

    late: float
    deviation: float

    @property
    def corrected(self) -> float:
        """The offset of the loads that is corrected [s]: 0 if it is smaller than two standard deviations."""
        return self.late if abs(self.late) > 2.0 * self.deviation else 0.0


class PlateResult(NamedTuple):
    """Loads of feet by name, contacts, offset in time of the plates (None without contacts), and what was found."""

    loads: Mapping[str, PlateLoad] = {}
    contacts: Sequence[PlateContact] = ()
    offset: Offset | None = None
    findings: Sequence[Finding] = ()


class _Sums(NamedTuple):
    """Sums over plates, each (T,): force [N]; free torque and moment about the axis to the right, and moment about the
    forward axis [N m]; height of the point of application times the force upward [N m].
    """

    forward: np.ndarray
    up: np.ndarray
    right: np.ndarray
    torque: np.ndarray
    moment: np.ndarray
    tilt: np.ndarray
    height: np.ndarray


class _Plate:
    """Force, point of application and torque of a plate, each (T, 3), as (forward, up, right)."""

    def __init__(self, file: MarkerFile, number: int, plane: MotionPlane, key: str):
        if number not in (numbers := plate_numbers(file)):
            have = f"plates {listed(list(map(str, numbers)), 'and')}" if numbers else "no force plates"
            why = f" ({file.table.remark})" if file.table.remark else ""
            raise SpecError(f"{file.table.name} has no plate {number}: it has {have}{why}", key=key)
        self.number = number
        self.force, self.point, self.torque = (
            plane.coordinates(file.vectors(f"plate{number}.{quantity}", unit, key))
            for quantity, unit in (("force", "N"), ("point", "m"), ("torque", "N m"))
        )
        if (missing := np.flatnonzero(np.isnan(self.force + self.torque).any(axis=1))).size:
            raise file.table.error(f"force or torque of plate {number} is missing", row=int(missing[0]), key=key)
        self.acts = np.linalg.norm(self.force, axis=1) > UNLOADED
        self.is_reversed = float(np.sum(self.force[self.acts, 1])) < 0
        if self.is_reversed:
            self.force, self.torque = -self.force, -self.torque

    def distances(self, foot: FootMotion, frames: slice) -> np.ndarray:
        """Return the horizontal distances of the points of application from the middle of a foot in some frames."""
        return np.asarray(np.linalg.norm((self.point - foot.middle)[frames][:, [0, 2]], axis=1))

    def contacts(self, feet: Mapping[str, FootMotion], time: np.ndarray, key: str) -> list[PlateContact]:
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
            contact = PlateContact(self.number, body, first, end, distances[body])
            if contact.distance <= FARTHEST:
                found.append(contact)
            elif key:
                where = f"{contact.distance:.2f} m from the nearest foot"
                raise SpecError(
                    f"the force of plate {self.number} {contact.when(time)} acts "
                    f"{where if np.isfinite(contact.distance) else 'at no known point'} (at most {FARTHEST:g} m are "
                    "accepted): the corners of the plate may be in another frame or unit than the markers, or "
                    "something else stands on the plate, which `loads` should then leave out",
                    key=key,
                )
        return found


def plate_numbers(file: MarkerFile) -> list[int]:
    """Return the numbers of the plates of a file."""
    found = (re.fullmatch(r"plate(\d+)\.force\.x", heading) for heading in file.table.headings)
    return [int(match[1]) for match in found if match]


def plates_under_feet(
    file: MarkerFile,
    plane: MotionPlane,
    feet: Mapping[str, FootMotion],
    asked: Mapping[str, tuple[str, Sequence[int]]],
    smooth: Smoothing,
    *,
    every: bool,
    belt: float = 0.0,
) -> PlateResult:
    """Return the loads of feet by plates.

    Parameters
    ----------
    feet
        Motion of the feet by body.
    asked
        Foot and numbers of the plates by name of the load.
    smooth
        Smoothing of the motion.
    every
        Whether a load without contact is an error; otherwise it is left out, and so are, with one leg, contacts of the
        other foot.
    belt
        Speed with which the belt of a treadmill moves backward, as stated [m/s].

    Raises
    ------
    SpecError
        If the file has no such plate, a foot is on none of its plates, or a force acts far from all feet.
    """
    time, loads, findings = file.time, {}, []
    keys = {number: f"loads.{name}.plates" for name, (_, own) in asked.items() for number in own}
    plates = {number: _Plate(file, number, plane, key) for number, key in keys.items()}
    strict = keys if every or len(feet) == 2 else dict.fromkeys(keys, "")
    contacts = [one for number, plate in plates.items() for one in plate.contacts(feet, time, strict[number])]
    standing = [(plates[one.plate], one, feet[one.body]) for one in contacts]
    slide, offset = _slide(standing), None
    if slide:
        way = "backward" if slide < 0 else "forward"
        sentence = (
            f"feet that stand flat on the plates move {way} with about {abs(slide):.2f} m/s over the ground or the "
            f"stated belt: on a treadmill, state `motion.belt: {belt - slide:.2f}`. Without the speed of the belt, the "
            "offset in time between plates and markers is not known, and not corrected"
        )
        findings.append(Finding("plates", "doubtful", sentence))
    elif standing:
        offset = _offset(time, standing)
    late = 0.0 if offset is None else offset.corrected
    for name, (body, own) in asked.items():
        if body not in feet:
            feet_named = listed([f"'{foot}'" for foot in feet])
            raise SpecError(f"should be a foot of the person ({feet_named}), not '{body}'", key=f"loads.{name}.body")
        mine = [contact for contact in contacts if contact.plate in own and contact.body == body]
        other = next((f"'{one.body}' stands on plate {one.plate}" for one in contacts if one.plate in own), "")
        if mine:
            loads[name] = _load([plates[one.plate] for one in mine], mine, time, late, smooth)
        elif every:
            raise SpecError(
                f"'{body}' stands on none of the plates {listed(list(map(str, own)), 'and')}; "
                f"{other or 'they carry no force'}",
                key=f"loads.{name}.plates",
            )
    for number, plate in plates.items():
        if plate.is_reversed:
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
    if offset is not None and abs(late) > float(np.median(np.diff(time))):
        side = "late" if late > 0 else "early"
        sentence = (
            f"the plates are {1000 * abs(late):.0f} ms {side} relative to the markers (known to "
            f"{1000 * offset.deviation:.0f} ms), since the feet slip least with this offset, which is corrected: check "
            "the synchronisation"
        )
        findings.append(Finding("plates", "doubtful", sentence))
    return PlateResult(loads, contacts, offset, findings)


def _slide(contacts: Sequence[tuple[_Plate, PlateContact, FootMotion]]) -> float:
    """Return the median velocity forward of feet at the points of application while they stand flat on plates [m/s]; 0
    if they rest or move unevenly.
    """
    found = [np.zeros(0)]
    for plate, contact, foot in contacts:
        own = slice(contact.first, contact.end)
        rate, height = foot.angle_rate[own], (plate.point - foot.middle)[own, 1]
        is_flat = (np.abs(foot.velocity[own, 1]) < AT_REST) & (np.abs(rate) < FLAT)  # not in gaps, which are nan
        speed = (foot.velocity[own, 0] - rate * height)[is_flat]
        found.append(speed[~np.isnan(speed)])
    speeds = np.concatenate(found)
    if len(speeds) < LEAST_FLAT:
        return 0.0
    middle = float(np.median(speeds))
    scatter = float(np.median(np.abs(speeds - middle)))
    return middle if abs(middle) > SLIDES and scatter < EVENLY * abs(middle) else 0.0


def later(time: np.ndarray, values: np.ndarray, late: float) -> np.ndarray:
    """Return values (T, ...) as they are at times that are later by `late` [s]."""
    columns = values.reshape(len(time), -1)
    return np.stack([np.interp(time + late, time, column) for column in columns.T], axis=-1).reshape(values.shape)


def _load(
    plates: Sequence[_Plate], contacts: Sequence[PlateContact], time: np.ndarray, late: float, smooth: Smoothing
) -> PlateLoad:
    """Return the sum of the forces of contacts at the point about which they have no moment but the free torques.

    The time by which plates are late [s] is corrected. Forces and moments are filtered as the motion: if they had more
    of the impact at heel strike than the accelerations, moments of joints would have peaks that are artefacts (S. K.
    Bisseling and A. L. Hof, J. Biomech. 39 (2006) 2438-2444; E. Kristianslund, T. Krosshaug and A. J. van den Bogert,
    J. Biomech. 45 (2012) 666-671).
    """
    sums = _Sums(*np.zeros((len(_Sums._fields), len(time))))
    for plate, contact in zip(plates, contacts, strict=True):
        own = np.s_[contact.first : contact.end]
        (forward, up, right), (x, y, across) = plate.force[own].T, np.nan_to_num(plate.point[own]).T
        sums.forward[own] += forward
        sums.up[own] += up
        sums.right[own] += right
        sums.torque[own] += plate.torque[own, 2]
        sums.moment[own] += x * up - y * forward
        sums.height[own] += up * y
        sums.tilt[own] += y * right - across * up + plate.torque[own, 0]
    filtered = low_passed(time, later(time, np.stack(sums, axis=1), late), smooth).T
    sums = _Sums(*np.where(_Sums(*filtered).up <= UNLOADED, 0.0, filtered))
    with np.errstate(divide="ignore", invalid="ignore"):
        y = sums.height / sums.up
        x = (sums.moment + y * sums.forward) / sums.up
    point = np.where(sums.up[:, None] > 0, np.stack([x, y], axis=1), np.nan)
    force, across = np.stack([sums.forward, sums.up], axis=1), np.stack([sums.right, sums.tilt], axis=1)
    return PlateLoad(force, point, sums.torque, contacts[0].body, across)


def _offset(time: np.ndarray, contacts: Sequence[tuple[_Plate, PlateContact, FootMotion]]) -> Offset | None:
    """Return the offset of the plates for which the points of the feet at the points of application have the least mean
    square velocity; None if it is not known.

    The standard deviation is that by the scatter of the contacts (P. J. Huber, Proc. 5th Berkeley Symp. 1 (1967)
    221-233), and at least that of least squares with an independent velocity in each frame; and that of soft feet,
    `SOFT`. It is `LARGEST_OFFSET` if no offset is better than all others.
    """
    interval = float(np.median(np.diff(time)))
    most = int(LARGEST_OFFSET / interval)
    squares, weights = np.zeros((2, len(contacts), 2 * most + 1))
    for row, (plate, contact, foot) in enumerate(contacts):
        for column, step in enumerate(range(-most, most + 1)):
            own = np.arange(max(contact.first, step), min(contact.end, len(time) + step))
            arm, speed = (plate.point[own] - foot.middle[own - step]), foot.velocity[own - step]
            rate, force = foot.angle_rate[own - step], plate.force[own, 1]
            x, y = speed[:, 0] - rate * arm[:, 1], speed[:, 1] + rate * arm[:, 0]
            slip = (x * x + y * y) * force
            known = ~np.isnan(slip)
            squares[row, column], weights[row, column] = float(np.sum(slip[known])), float(np.sum(force[known]))
    whole = np.sum(weights, axis=0)
    shares = np.where(whole > 0, squares / np.where(whole > 0, whole, 1.0), np.inf)
    costs = np.sum(shares, axis=0)
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        return None
    if not 0 < best < 2 * most or not np.isfinite(costs[best + 1] + costs[best - 1]):
        return Offset((best - most) * interval, LARGEST_OFFSET)
    slopes = (shares[:, best + 1] - shares[:, best - 1]) / 2.0
    bends = shares[:, best + 1] - 2.0 * shares[:, best] + shares[:, best - 1]
    bend, count = float(np.sum(bends)), len(contacts)
    shift = -float(np.sum(slopes)) / bend  # least value of the parabola through three costs
    slopes = slopes + shift * bends
    scatter = float(np.sqrt(np.sum(slopes * slopes) * count / max(1, count - 1))) / bend
    frames = sum(contact.end - contact.first for _, contact, _ in contacts)
    alone = float(np.sqrt(costs[best] / (bend * frames)))
    return Offset((best - most + shift) * interval, float(np.hypot(interval * max(scatter, alone), SOFT)))
