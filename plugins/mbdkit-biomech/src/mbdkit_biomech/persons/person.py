"""A person: joint centres with covariances, lengths, masses, plates under feet, and the motion in its plane."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.engine.linear_systems import product, symmetric_eigenvectors
from mbdkit.trust.finding import Finding
from mbdkit_biomech.models._segments import BodySegments
from mbdkit_biomech.persons.calibration import ENDS, LEAST_FRAMES, MotionPlane, Segments, angle_of, plane_of
from mbdkit_biomech.persons.joint_centers import JointCenter
from mbdkit_biomech.persons.landmarks import LEFT
from mbdkit_biomech.persons.person_sections import Center, PlaneAxes, Subject
from mbdkit_biomech.persons.plate_contacts import FootMotion, PlateResult
from mbdkit_biomech.persons.rigid_clusters import Artefact, rate_of

#: Heights of the markers of the trunk above those of the feet, as shares of body height, between which the unit of
#: length can be right.
TRUNK_ABOVE_FEET = 0.2, 1.2

LEAST_FLEXION = np.radians(20.0)  #: Flexion of a knee that shows in which direction the person faces [rad].

#: Length of thigh and shank together, as shares of body height, outside of which it is doubtful: tables give 0.462 to
#: 0.492, and persons differ from them by about 3 % (standard deviation).
LEG_SHARE = 0.42, 0.535

#: Standard deviation of the length of a segment over time from which its markers are doubtful [m].
VARIES = 0.03

#: Angle between the stated and the found plane [deg], and residual of the plane [m], from which it is doubtful.
STATED, THICKNESS = 10.0, 0.04

#: Misfit of a centre by landmarks and by the motion from which it is doubtful: 0.03 % of such centres exceed it by
#: chance.
MISFIT = 2.5

#: Standard deviation of the place of a knee across the plane of motion from which it is not known, unless a landmark on
#: one side of the knee shows it [m]: half the width of the compartments, less a third.
ACROSS = 0.015

#: Landmarks on one side of a knee: how far the knee is inward of each, and the standard deviation [m]. The first one is
#: in front of it, so that some degrees of rotation of the leg move it by millimetres (an assumption). Epicondyles are
#: beside it by half the breadth of a knee with its skin, 90 mm, and deviate by 5 mm between persons, and by palpation.
BESIDE_KNEE = {"patella": (0.0, 0.01), "knee.lateral": (0.045, 0.01), "knee.medial": (-0.045, 0.01)}

#: Mean distance of two knees or ankles across the plane of motion from which they are no longer doubtful [m].
APART = 0.02

#: Mean distance across the plane of motion of the ground's force from the ankle from which it is doubtful [m], about
#: half the width of a foot: in walks of two persons, it is 2 to 20 mm.
BESIDE = 0.04

#: Root mean square change of the mean places of the markers of a cluster from the static trial to the motion, as a
#: share of the size of the cluster, from which it is doubtful, and the median over all clusters: in walks of two
#: persons, shares are 0.001 to 0.03.
CHANGED, CHANGED_ALL = 0.15, 0.08

SIDES = 3.0  #: Difference of the lengths of two legs that is doubtful, in standard deviations.


@dataclass(frozen=True)
class SegmentLength:
    """Mean length of a segment of both legs in the plane of motion, weighted by their variances, its standard
    deviation, and the largest standard deviation over time [m], with the lengths by body.
    """

    value: float
    deviation: float
    variation: float
    by_leg: Mapping[str, float]


class KneeLoad(NamedTuple):
    """Moment of the ground's force about the forward axis of a knee (T,) [N m], positive if it presses the medial side,
    vertical force of the ground (T,) [N], and standard deviation of the place of the knee across the plane [m].
    """

    moment: np.ndarray
    load: np.ndarray
    deviation: float


@dataclass(frozen=True)
class Person:
    """What the markers of a motion tell about a person."""

    subject: Subject
    plane: MotionPlane  #: Mass, height and sex, and the plane of motion.
    centers: Mapping[str, JointCenter]  #: Joint centres by joint, each with its covariance.
    lengths: Mapping[str, SegmentLength]  #: Lengths of `thigh` and `shank`.
    masses: Mapping[str, float]  #: Masses of trunk, thigh, shank and foot [kg].
    artefacts: Mapping[str, Artefact]  #: Artefacts of the markers by body.
    #: Standard deviations of the zeros of the angles of trunk and feet, by body [rad]; nan where it is not known.
    zeros: Mapping[str, float]
    plates: PlateResult  #: Contacts and loads of the feet.
    findings: tuple[Finding, ...]  #: Doubts and remarks.
    time: np.ndarray
    #: Times (T,) and observed quantities (T,) of the model by name; nan in gaps.
    columns: Mapping[str, np.ndarray]
    reference: int  #: Index of the frame in whose pose the covariances of the centres and `shifts` are given.
    #: (C, E) shifts of the C columns, by body, for artefacts of its cluster: E independent errors with the standard
    #: deviation 1, six of its pose, and two of each of its joints by the slip of the whole cluster.
    shifts: Mapping[str, np.ndarray]
    #: Knees by joint, whose foot stands on a plate, and whose place across the plane landmarks show.
    knees: Mapping[str, KneeLoad]

    def to_dict(self) -> dict[str, Any]:
        """Return the person without motion and loads as dicts, lists and arrays, for the archive."""
        data = asdict(self)
        kept = {name: data[name] for name in ("plane", "centers", "lengths", "masses", "zeros", "artefacts")}
        return kept | {"contacts": data["plates"].contacts, "offset": data["plates"].offset}

    def lines(self) -> dict[str, str]:
        """Return lines of a summary by label."""
        of, kg = self.subject, self.masses
        plates = [f"{one.body} on plate {one.plate} {one.when(self.time)}" for one in self.plates.contacts]
        sizes = ((name, length.value, length.deviation) for name, length in self.lengths.items())
        lengths = (
            f"{name} {size:.3f} m (deviation {deviation:.3f} m), {kg[name]:.3g} kg" for name, size, deviation in sizes
        )
        centers = (
            f"{name} {one.method} (deviation {1000 * max(one.deviation):.0f} mm)" for name, one in self.centers.items()
        )
        offset = ""
        if (own := self.plates.offset) is not None:
            done = "corrected" if own.corrected else "not corrected"
            offset = f"; {1000 * own.late:.0f} ms late (deviation {1000 * own.deviation:.0f} ms), {done}"
        return {
            "subject": f"{of.described}; {', '.join(lengths)}",
            "centres": ", ".join(centers),
            "plane": f"{'found' if self.plane.is_fitted else 'stated'}, residual {1000 * self.plane.residual:.0f} mm",
        } | ({"plates": ", ".join(plates) + offset} if plates else {})


@dataclass(frozen=True)
class Skeleton:
    """A person before the plates are assigned to its feet."""

    subject: Subject
    segments: Segments
    plane: MotionPlane
    centers: Mapping[str, JointCenter]  #: Joint centres by joint.
    points: Mapping[str, np.ndarray]  #: (T, 3) joint centres by joint, as (forward, up, right).
    lengths: Mapping[str, SegmentLength]
    #: (T,) angles of trunk and feet by body [rad], zero as when the person stands upright.
    angles: Mapping[str, np.ndarray]
    zeros: Mapping[str, float]
    findings: tuple[Finding, ...]

    @classmethod
    def of(
        cls, subject: Subject, segments: Segments, asked_plane: PlaneAxes | None, asked_centers: Mapping[str, Center]
    ) -> Skeleton:
        """Determine plane, joint centres, lengths and angles from the segments of a person.

        Raises
        ------
        SpecError
            With key and reason, if the markers do not determine the person.
        """
        poses = segments.motion.poses
        plane = plane_of(asked_plane, poses, segments.motion.file.time)
        _require_units(subject, segments, plane)
        shape = [*_shape_doubts(segments)]
        try:
            centers = segments.centers(asked_centers, plane)
        except SpecError as error:  # other clusters are a cause of whatever then fails
            raise (SpecError(f"{shape[0]} With them, {error}", key="motion.static") if shape else error) from None
        positions = {joint: centers[joint].position(poses[a], poses[b]) for joint, (a, b) in segments.joints.items()}
        if not _faces_forward(segments, plane, positions):
            plane = plane.reversed()
            signs = np.array([[1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, 1.0]])  # forward and right change theirs
            centers = {joint: replace(one, covariance=signs * one.covariance) for joint, one in centers.items()}
        findings = _doubts("centers", [*_side_doubts(segments, plane), *shape])
        plane = plane.with_residual(list(positions.values()))
        findings += _doubts("plane", _plane_doubts(plane)) + _doubts("centers", _center_doubts(centers))
        points = {joint: plane.coordinates(own) for joint, own in positions.items()}
        findings += _doubts("centers", _place_doubts(points))
        lengths = {}
        for name in ENDS:
            lengths[name], doubts = _length(name, segments, centers, points)
            findings += doubts
        findings += _doubts("lengths", _length_doubts(subject, lengths))
        angles, zeros = {}, {}
        for body in poses:
            if body.startswith(("trunk", "foot")):
                angles[body], zeros[body], remarks = _angle(body, segments, plane)
                findings += remarks
        return cls(subject, segments, plane, centers, points, lengths, angles, zeros, tuple(findings))

    def feet(self) -> dict[str, FootMotion]:
        """Return the motion of the feet by body."""
        own = {body: angle for body, angle in self.angles.items() if body != "trunk"}
        return {body: _foot(body, angle, self.segments, self.plane) for body, angle in own.items()}

    def person(self, plates: PlateResult) -> Person:
        """Return the person with its plates."""
        subject, thigh, shank = self.subject, self.lengths["thigh"].value, self.lengths["shank"].value
        own = BodySegments(subject.mass, subject.height, subject.table, thigh, shank)
        masses = {name: getattr(own, name).mass for name in ("trunk", "thigh", "shank", "foot")}
        hips = np.mean([self.points[f"hip{leg}"] for leg in self.segments.legs], axis=0)
        points = {"hip": hips} | {name: own for name, own in self.points.items() if not name.startswith("hip")}
        columns = {f"markers.{name}.{axis}": own[:, k] for name, own in points.items() for k, axis in enumerate("xy")}
        columns |= {f"bodies.{body}.angle": angle for body, angle in self.angles.items()}
        knees, remarks = self._knees(plates)
        return Person(
            subject=subject, plane=self.plane, centers=self.centers, lengths=self.lengths, masses=masses,
            artefacts=self.segments.motion.artefacts, zeros=self.zeros, plates=plates, knees=knees, columns=columns,
            findings=(*self.findings, *plates.findings, *remarks), time=self.segments.motion.file.time,
            reference=self.segments.reference, shifts=self._shifts(list(columns)),
        )  # fmt: skip

    def _knees(self, plates: PlateResult) -> tuple[dict[str, KneeLoad], list[Finding]]:
        """Return the knees above plates, and what was found about places of forces and knees across the plane."""
        found: dict[str, KneeLoad] = {}
        unknown: list[str] = []
        findings: list[Finding] = []
        for leg in self.segments.legs:
            knee, loads = f"knee{leg}", [one for one in plates.loads.values() if one.body == f"foot{leg}"]
            side, vertical = 1.0 if self.segments.side(leg) == "r" else -1.0, sum(one.force[:, 1] for one in loads)
            at, deviation = self.points[knee], float(np.sqrt(self.centers[knee].covariance[2, 2]))
            for kind, (inward, own) in BESIDE_KNEE.items():
                if deviation > ACROSS and (landmark := self.segments.named(kind, self.segments.side(leg))):
                    seen = self.segments.motion.poses[f"thigh{leg}"].point(
                        self.segments.inside(landmark, f"thigh{leg}")
                    )
                    across = self.plane.coordinates(seen)[:, 2] - side * inward
                    at, deviation = np.column_stack([at[:, :2], across]), own
            if loads and deviation > ACROSS:
                unknown.append(f"{knee} {1000 * deviation:.0f} mm")
            if loads and np.sqrt(self.centers[f"ankle{leg}"].covariance[2, 2]) <= ACROSS:
                moments = sum(one.frontal_moment(self.points[f"ankle{leg}"]) for one in loads)
                beside = float(np.nansum(moments) / np.sum(vertical, where=~np.isnan(moments)))
                if abs(beside) > BESIDE:
                    where = f"{1000 * abs(beside):.0f} mm to the {'left' if beside > 0 else 'right'} of the ankle"
                    sentence = (
                        f"the force on foot{leg} acts {where} on average (doubtful from {1000 * BESIDE:.0f} mm): check "
                        "the place of its plates across the plane of motion, on which the forces in the knee depend"
                    )
                    findings += _doubts("plates", [sentence])
            if loads and deviation <= ACROSS:
                moment = side * sum(one.frontal_moment(at) for one in loads)
                found[knee] = KneeLoad(np.asarray(moment), np.maximum(vertical, 0.0), deviation)
        sentence = (
            f"where knees are across the plane of motion is not known ({listed(unknown, 'and')}; at most "
            f"{1000 * ACROSS:.0f} mm are accepted), so that their compartments do not bound the forces of muscles: use "
            "markers on the patella, or on a side of the knees, in the motion or in a static trial"
        )
        return found, findings + [Finding("centers", None, sentence)] * bool(unknown)

    def _shifts(self, columns: Sequence[str]) -> dict[str, np.ndarray]:
        """Return the shifts of columns by artefacts; see `Person.shifts`."""
        found = {}
        for body, cluster in self.segments.clusters.items():
            motion = self.segments.motion
            size, rotation = motion.artefacts[body].deviation, motion.poses[body].rotation
            to_plane = product(self.plane.axes, rotation[self.segments.reference])
            values, vectors = symmetric_eigenvectors(cluster.inverse_inertia)
            turns = size * vectors * np.sqrt(np.maximum(values, 0.0))
            shifts = [np.zeros((len(columns), 6))]
            if (angle := f"bodies.{body}.angle") in columns:
                shifts[0][columns.index(angle), 3:] = product(to_plane, turns)[2]
            for joint, pair in self.segments.joints.items():
                if body not in pair:
                    continue
                center, side = self.centers[joint], pair.index(body)
                is_hip = joint.startswith("hip")
                weight = center.fit.weights[side] / (len(self.segments.legs) if is_hip else 1)
                point = (center.proximal, center.distal)[side]
                shift = size / np.sqrt(len(cluster.names)) * np.eye(3)
                moves = np.hstack([shift, -product(np.cross(np.eye(3), point), turns)])
                row = columns.index(f"markers.{'hip' if is_hip else joint}.x")
                shifts[0][row : row + 2] += weight * product(to_plane, moves)[:2]
                slip = np.zeros((len(columns), 2))
                slip[row : row + 2] = weight * center.fit.slip[side] * np.eye(2)
                shifts.append(slip)
            found[body] = np.hstack(shifts)
        return found


def _doubts(criterion: str, sentences: Iterable[str]) -> list[Finding]:
    return [Finding(criterion, "doubtful", sentence) for sentence in sentences]


def _require_units(subject: Subject, segments: Segments, plane: MotionPlane) -> None:
    up, (least, most) = plane.axes[1], TRUNK_ABOVE_FEET
    poses = segments.motion.poses
    heights = {body: float(np.nanmean(np.sum(own.position * up, axis=1))) for body, own in poses.items()}
    above = heights["trunk"] - min(heights.values())
    if not least <= above / subject.height <= most:
        raise SpecError(
            f"the markers of the trunk are {above:.3g} m above those of the feet, which is "
            f"{above / subject.height:.3g} times the height of the person ({least:g} to {most:g} is possible): check "
            "the unit of length that the file states, such as mm or m, and `subject.height`",
            key="motion.file",
        )


def _faces_forward(segments: Segments, plane: MotionPlane, positions: Mapping[str, np.ndarray]) -> bool:
    """Return whether the plane points forward: knees bend backward, and feet point forward. Raise SpecError if a stated
    plane does not.
    """
    turns, feet = [], []
    for leg in segments.legs:
        points = [positions[f"{name}{leg}"] for name in ("hip", "knee", "ankle")]
        points.append(segments.motion.poses[f"foot{leg}"].position)
        hip, knee, ankle, foot = map(plane.coordinates, points)
        turn = angle_of(hip - knee) - angle_of(knee - ankle)
        turns.append(turn - 2 * np.pi * np.round(turn / (2 * np.pi)))
        feet.append((foot - ankle)[:, 0])
    least, most = float(np.nanmin(turns)), float(np.nanmax(turns))
    if (most + least if max(most, -least) >= LEAST_FLEXION else float(np.nanmean(feet))) >= 0:
        return True
    if not plane.is_fitted:
        raise SpecError(
            "is opposite to the direction in which the person faces, as knees and feet show: reverse its sign, or "
            "leave out `plane`",
            key="motion.plane.forward",
        )
    return False


def _side_doubts(segments: Segments, plane: MotionPlane) -> Iterator[str]:
    """Yield a sentence about the side of a single leg; raise SpecError if two legs are exchanged."""
    poses = segments.motion.poses
    mean = {body: float(np.nanmean(plane.coordinates(own.position)[:, 2])) for body, own in poses.items()}
    if len(segments.legs) == 2:
        if wrong := [name for name in ("thigh", "shank", "foot") if mean[name] < mean[name + LEFT]]:
            raise SpecError(
                f"sides are exchanged: the markers of {listed(wrong, 'and')}, the right side, are to the left of those "
                f"of {listed([name + LEFT for name in wrong], 'and')} as the person faces"
                f"{'' if plane.is_fitted else ' by `motion.plane`, which is to be checked first'}",
                key=f"motion.clusters.{wrong[0]}",
            )
    elif (mean["thigh"] > mean["trunk"]) != ((side := segments.side("")) == "r"):
        leg = "right" if side == "r" else "left"
        yield f"by the names of its markers, the leg is the {leg} one, but it is on the other side"


def _place_doubts(points: Mapping[str, np.ndarray]) -> Iterator[str]:
    """Yield a sentence for each knee or ankle that is hardly to the right of that of the left leg."""
    for joint in (name for name in ("knee", "ankle") if name + LEFT in points):
        apart = float(np.nanmean((points[joint] - points[joint + LEFT])[:, 2]))
        if apart < APART:
            yield (
                f"{joint} is {1000 * abs(apart):.0f} mm to the {'left' if apart < 0 else 'right'} of {joint}{LEFT} on "
                f"average (doubtful unless {1000 * APART:g} mm to the right): check `motion.centers` and the landmarks "
                "of this joint, whose sides may be exchanged"
            )


def _shape_doubts(segments: Segments) -> Iterator[str]:
    """Yield a sentence if markers are at other places of the segments in the motion than in the static trial."""
    shares = {}
    for body, cluster in segments.clusters.items():
        residual = segments.motion.poses[body].residual
        change = np.nansum(residual, axis=0) / np.maximum(np.sum(~np.isnan(residual), axis=0), 1)
        shares[body] = float(np.sqrt(np.sum(change * change) / np.sum(cluster.template * cluster.template)))
    most = CHANGED if np.median(list(shares.values())) < CHANGED_ALL else CHANGED_ALL
    if segments.static is not None and (changed := {body: one for body, one in shares.items() if one > most}):
        worst = max(changed, key=lambda body: changed[body])
        yield (
            f"the clusters of {listed(list(changed), 'and')} have another shape in `motion.static` than in the motion "
            f"(by up to {changed[worst]:.0%} of the size, of {worst}; doubtful above {most:.0%}): is it a trial of "
            "this person with the same markers at the same places, and are names or sides exchanged in one of both?"
        )


def _plane_doubts(plane: MotionPlane) -> Iterator[str]:
    off, residual = float(np.degrees(plane.off)), plane.residual
    if off > STATED and plane.sideways > 0:
        yield (
            f"the stated plane is {off:.0f} deg off the one across which the segments move least (doubtful from "
            f"{STATED:g} deg); leave out `motion.plane` to use that one"
        )
    if residual > THICKNESS:
        yield (
            f"joint centres leave the plane by {1000 * residual:.0f} mm (root mean square, doubtful above "
            f"{1000 * THICKNESS:.0f} mm): the person turns or moves sideways, which a planar model leaves out"
        )


def _center_doubts(centers: Mapping[str, JointCenter]) -> Iterator[str]:
    for joint, center in centers.items():
        if center.misfit > MISFIT:
            yield (
                f"landmarks and motion determine centres of {joint} that differ {center.misfit:.1f} times as much as "
                f"their uncertainties explain (doubtful above {MISFIT:g}): check names and places of the markers, or "
                f"choose one of both with `motion.centers.{joint}`"
            )


def _length(
    name: str, segments: Segments, centers: Mapping[str, JointCenter], points: Mapping[str, np.ndarray]
) -> tuple[SegmentLength, list[Finding]]:
    """Return the length of a segment, with a doubt if those of both legs differ."""
    values, variances, variation = {}, [], 0.0
    for leg in segments.legs:
        first, last = (f"{end}{leg}" for end in ENDS[name])
        gap = (points[first] - points[last])[:, :2]
        sizes = np.linalg.norm(gap, axis=1)
        direction = gap[segments.reference] / sizes[segments.reference]
        covariance = (centers[first].covariance + centers[last].covariance)[:2, :2]
        values[f"{name}{leg}"] = float(np.nanmean(sizes))
        variances.append(float(np.sum(direction[:, None] * covariance * direction)))
        variation = max(variation, float(np.nanstd(sizes)))
    weights, size = 1.0 / np.array(variances), float(np.sqrt(sum(variances)))
    lengths, doubts = list(values.values()), []
    if abs(lengths[0] - lengths[-1]) > SIDES * size:
        told = listed([f"{body} {own:.3f} m" for body, own in values.items()], "and")
        apart = f"{told} long differ by more than {SIDES:g} standard deviations ({1000 * size:.0f} mm)"
        doubts = _doubts("lengths", [f"{apart}: check markers and joint centres of both legs"])
    mean = float(np.sum(weights * np.array(lengths)) / np.sum(weights))
    return SegmentLength(mean, float(np.sqrt(1.0 / np.sum(weights))), variation, values), doubts


def _length_doubts(subject: Subject, lengths: Mapping[str, SegmentLength]) -> Iterator[str]:
    for name, length in lengths.items():
        if length.variation > VARIES:
            yield (
                f"the length of the {name} varies by {1000 * length.variation:.0f} mm (standard deviation, doubtful "
                f"above {1000 * VARIES:.0f} mm): markers move with the skin or belong to another segment"
            )
    whole, (least, most) = sum(length.value for length in lengths.values()), LEG_SHARE
    if not least <= whole / subject.height <= most:
        yield (
            f"thigh and shank together are {whole:.3f} m long, {whole / subject.height:.3f} of the body height of "
            f"{subject.height:g} m (doubtful outside {least:g} to {most:g}): check `subject.height` and the joint "
            "centres"
        )


def _angle(body: str, segments: Segments, plane: MotionPlane) -> tuple[np.ndarray, float, list[Finding]]:
    """Return the angle of trunk or foot (T,) [rad], the standard deviation of its zero, and remarks."""
    poses, static = segments.motion.poses[body], segments.static
    rotation = poses.rotation[[segments.reference]]
    if static is not None:
        rotation = static.poses[body].rotation[static.still()]
    upright = np.sum(rotation * plane.axes[1][:, None], axis=1)
    mean = np.mean(upright, axis=0)
    found = angle_of(plane.coordinates(product(poses.rotation, mean)))
    if static is not None:
        lean = upright - mean
        return found, float(np.sqrt(np.mean(np.sum(lean * lean, axis=1)))), []
    if body == "trunk":
        sentence = "without `motion.static`, the mean angle of the trunk counts as upright"
        return np.asarray(found - np.nanmean(found)), np.nan, [Finding("centers", None, sentence)]
    rest = found[_foot(body, found, segments, plane).at_rest & ~np.isnan(found)]
    if len(rest) < LEAST_FRAMES:
        raise SpecError(
            f"is needed, because '{body}' rests flat on the ground in {len(rest)} frames of the motion "
            f"({LEAST_FRAMES} are needed): the file of a trial in which the person stands upright",
            key="motion.static",
        )
    flat = float(np.median(rest))
    return np.asarray(found - flat), 1.4826 * float(np.median(np.abs(rest - flat))), []


def _foot(body: str, angle: np.ndarray, segments: Segments, plane: MotionPlane) -> FootMotion:
    middle, time = plane.coordinates(segments.motion.poses[body].position), segments.motion.file.time
    belt = np.array([segments.belt, 0.0, 0.0])
    return FootMotion(middle, rate_of(middle, time) + belt, rate_of(angle, time))
