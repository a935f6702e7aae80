"""Segments and joints of a person in a motion and, if there is one, in a calibration trial; and the plane of motion in
the laboratory: stated by axes, or found from the motion of the markers.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import did_you_mean, listed, shown
from mbdkit_biomech.persons.joint_centers import (
    JointCenter,
    SegmentPair,
    functional_center,
    hip_center,
    landmark_center,
    turn_of,
)
from mbdkit_biomech.persons.landmarks import LEFT, SIDES, MarkerFile, Side, landmark, side_of
from mbdkit_biomech.persons.person_sections import Center, Midpoint, PlaneAxes
from mbdkit_biomech.persons.rigid_clusters import Artefact, MarkerCluster, Poses, poses_of, rate_of

#: A calibration trial is used for a functional centre if the joint turns by at least this angle in it [rad].
LEAST_TURN = np.radians(20.0)

#: A person stands still in frames in which no segment is faster than this [m/s]; smallest number of such frames.
STILL, LEAST_FRAMES = 0.05, 5

LEAST_ROWS = 10  #: Least number of rows of a motion.


#: Joints at the ends of the segments whose lengths are measured.
ENDS = {"thigh": ("hip", "knee"), "shank": ("knee", "ankle")}


def legs_of(count: int) -> tuple[str, ...]:
    """Return the suffixes of the names of the legs."""
    return ("", LEFT)[:count]


def joints_of(legs: tuple[str, ...]) -> dict[str, tuple[str, str]]:
    """Return the proximal and the distal body of each joint, by joint, for suffixes of legs."""
    chains = {leg: ("trunk", f"thigh{leg}", f"shank{leg}", f"foot{leg}") for leg in legs}
    names = ("hip", "knee", "ankle")
    return {f"{name}{leg}": two for leg, one in chains.items() for name, two in zip(names, pairwise(one), strict=True)}


@dataclass(frozen=True)
class Trial:
    """A file of markers with the poses of all segments, and the artefacts of their markers, by body."""

    file: MarkerFile
    poses: Mapping[str, Poses]
    artefacts: Mapping[str, Artefact]

    @classmethod
    def of(cls, file: MarkerFile, clusters: Mapping[str, MarkerCluster]) -> Trial:
        """Return the trial of a file."""
        markers = {body: file.markers(cluster.names, f"motion.clusters.{body}") for body, cluster in clusters.items()}
        poses = {body: poses_of(clusters[body].template, own) for body, own in markers.items()}
        return cls(file, poses, {body: Artefact.of(own) for body, own in poses.items()})

    def still(self) -> np.ndarray:
        """Return the frames in which the person stands still; raise SpecError if there are too few."""
        speeds = [np.linalg.norm(rate_of(own.position, self.file.time), axis=1) for own in self.poses.values()]
        frames = np.flatnonzero(np.max(speeds, axis=0) < STILL)
        if len(frames) < LEAST_FRAMES:
            raise SpecError(
                f"shows the person standing still in {len(frames)} frames ({LEAST_FRAMES} are needed, in which no "
                f"segment is faster than {STILL:g} m/s); let the trial begin with a person who stands upright",
                key="motion.static",
            )
        return frames


@dataclass(frozen=True)
class Segments:
    """The segments of a person in a motion, and in a calibration trial if there is one."""

    legs: tuple[str, ...]  #: Suffixes of the names of the legs.
    clusters: Mapping[str, MarkerCluster]  #: Clusters by body.
    motion: Trial
    static: Trial | None  #: The trials.
    reference: int  #: The first frame of the motion in which all segments are seen.
    belt: float = 0.0  #: Speed with which the belt of a treadmill moves backward [m/s].

    @classmethod
    def of(
        cls, asked: Mapping[str, list[str]] | None, legs: tuple[str, ...], motion: MarkerFile, static: MarkerFile | None
    ) -> Segments:
        """Find the segments of a person; raise SpecError if a segment has no cluster, a marker is missing, or a cluster
        has no pose.
        """
        if len(motion.time) < LEAST_ROWS:
            raise SpecError(f"has {len(motion.time)} rows, but a person needs {LEAST_ROWS}", key="motion.file")
        bodies = ["trunk", *(f"{name}{leg}" for leg in legs for name in ("thigh", "shank", "foot"))]
        for body in bodies:
            if body not in (asked or {}):
                raise SpecError(
                    f"is missing: with `subject`, each of {listed(bodies, 'and')} needs the names of its markers",
                    key=f"motion.clusters.{body}" if asked else "motion.clusters",
                )
        assert asked is not None
        for body in asked:
            if body not in bodies:
                hint = did_you_mean(body, bodies) or f"; segments: {listed(bodies)}"
                second = "is for a second leg: add `legs: 2` to the model"
                what = second if body.endswith(LEFT) else f"is no segment{hint}"
                raise SpecError(what, key=f"motion.clusters.{quoted(body)}")
        clusters = {}
        for body in bodies:
            names, key = tuple(asked[body]), f"motion.clusters.{body}"
            if len(set(names)) < len(names):
                raise SpecError("has a marker twice", key=key)
            clusters[body] = MarkerCluster.of(body, names, (static or motion).markers(names, key))
        trial = Trial.of(motion, clusters)
        together = np.flatnonzero(np.all([own.known for own in trial.poses.values()], axis=0))
        if not together.size:
            raise SpecError("no frame of the motion shows three markers of every segment", key="motion.clusters")
        return cls(legs, clusters, trial, None if static is None else Trial.of(static, clusters), int(together[0]))

    @property
    def joints(self) -> dict[str, tuple[str, str]]:
        """The proximal and the distal body of each joint, by joint."""
        return joints_of(self.legs)

    def trials(self) -> list[Trial]:
        """Return the calibration trial, if there is one, and the motion."""
        return [self.motion] if self.static is None else [self.static, self.motion]

    def side(self, leg: str) -> Side:
        """Return the side of a leg: a single leg is that of its markers, otherwise the first one is the right one."""
        if len(self.legs) == 2:
            return "l" if leg else "r"
        return side_of(self.clusters[f"thigh{leg}"].names)

    def pair(self, joint: str, trial: Trial, plane: MotionPlane) -> SegmentPair:
        """Return both segments of a joint in a trial."""
        a, b = self.joints[joint]
        return SegmentPair(
            joint,
            (self.clusters[a], self.clusters[b]),
            (trial.artefacts[a], trial.artefacts[b]),
            (trial.poses[a], trial.poses[b]),
            (self.motion.poses[a].rotation[self.reference], self.motion.poses[b].rotation[self.reference]),
            plane.axes,
        )

    def named(self, kind: str, side: Side | None) -> tuple[Trial, str] | None:
        """Return the trial and the name of the marker of a landmark; None if there is none."""
        for trial in self.trials():
            if name := landmark(trial.file.names, kind, side):
                return trial, name
        return None

    def centers(self, asked: Mapping[str, Center], plane: MotionPlane) -> dict[str, JointCenter]:
        """Return the joint centres by joint; raise SpecError with the reason if a centre is not determined."""
        require_known(asked, self.joints, "motion.centers")
        return {joint: self._center(joint, asked.get(joint), plane) for joint in self.joints}

    def _center(self, joint: str, method: Center | None, plane: MotionPlane) -> JointCenter:
        kind, key = joint.removesuffix(LEFT), f"motion.centers.{joint}"
        side = self.side(LEFT if joint.endswith(LEFT) else "")
        pelvis = self._pelvis() if kind == "hip" else None
        sides = [] if kind == "hip" else [self.named(f"{kind}.{one}", side) for one in ("medial", "lateral")]
        names = method.midpoint if isinstance(method, Midpoint) else [one[1] for one in sides if one is not None]
        for trial in self.trials():
            moving = self.pair(joint, trial, plane)
            if turn_of(*moving.known()) >= LEAST_TURN:
                break
        if method is None and (pelvis or len(names) == 2):
            other = self._center(joint, "hip-regression" if pelvis else "static", plane)
            try:
                return functional_center(moving, other)
            except SpecError:  # the motion does not determine it
                return other
        if method is None or method == "functional":
            try:
                return functional_center(moving)
            except SpecError as error:
                if method:
                    raise
                known = zip(("medial", "lateral"), sides, strict=False)
                lacking = listed([f"the {one} side" for one, marker in known if marker is None], "and")
                raise SpecError(
                    f"the markers do not determine the centre of the joint '{joint}': they lack "
                    f"{lacking or 'landmarks'} of it, and the motion alone does not suffice: a centre that "
                    f"{error.message}", key=key) from None  # fmt: skip
        if method == "hip-regression":
            if kind != "hip":
                raise SpecError("is for hips; this joint takes functional, static or a midpoint", key=key)
            if pelvis is None:
                raise SpecError(
                    "needs markers of the right and left anterior superior iliac spines (RASI, LASI, R.ASIS, ...) and "
                    "of the posterior ones or the sacrum, which are not among the markers; use `functional`, or name "
                    "them like this",
                    key=key,
                )
            return hip_center(self.pair(joint, self.motion, plane), pelvis, side)
        if len(names) < 2:
            raise SpecError(
                "needs a marker on the medial and on the lateral side of the joint whose names say so, such as "
                f"{side.upper()}.{kind.capitalize()}.Medial; write {{midpoint: [MARKER, MARKER]}} for others, or use "
                "`functional`",
                key=key,
            )
        trial = next((one for one in self.trials() if all(map(one.file.has, names))), self.motion)
        points = [trial.file.marker(name, key) for name in names]
        name = "static" if method == "static" else "midpoint"
        return landmark_center(self.pair(joint, trial, plane), name, (points[0] + points[1]) / 2)

    def _pelvis(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return the landmarks of `hip_center`; None if some are missing."""
        right, left, *back = (self.named(kind, side) for kind in ("asis", "psis") for side in SIDES)
        if None in back:
            back = [self.named("sacrum", None)]
        named = [one for one in (right, left, *back) if one is not None]
        if len(named) < 2 + len(back):
            return None
        points = [self.inside(one, "trunk") for one in named]
        return points[0], points[1], np.mean(points[2:], axis=0)

    def inside(self, landmark: tuple[Trial, str], body: str) -> np.ndarray:
        """Return the mean place (3,) of a landmark in the frame of a segment [m]; raise SpecError if it is never seen
        together with the segment.
        """
        trial, name = landmark
        own = trial.poses[body].inside(trial.file.marker(name, f"motion.clusters.{body}"))
        if np.isnan(own[:, 0]).all():
            raise SpecError(f"in no frame is {shown(name)} seen together with three markers of the {body}",
                            key=f"motion.clusters.{body}")  # fmt: skip
        return np.asarray(np.nanmean(own, axis=0))


def require_known(asked: Iterable[str], known: Collection[str], key: str, kind: str = "joint") -> None:
    """Raise SpecError if names below a key of the spec are not among the joints or segments of a model."""
    for name in asked:
        if name not in known:
            hint = did_you_mean(name, known) or f"; {kind}s: {listed(known)}"
            raise SpecError(f"is no {kind}{hint}", key=f"{key}.{quoted(name)}")


def angle_of(direction: np.ndarray) -> np.ndarray:
    """Return the angles (T,), counter-clockwise, by which vectors (T, 3), as (forward, up, right), are turned from
    up.
    """
    return np.asarray(elementary.atan2(-direction[:, 0], direction[:, 1]))


#: A motion has no plane if its root mean square velocity across the best one exceeds this share of that along it.
SIDEWAYS = 0.5


@dataclass(frozen=True)
class MotionPlane:
    """The plane of motion."""

    axes: np.ndarray  #: (3, 3) rows: the directions forward, up, and right of the person, in the laboratory.
    is_fitted: bool  #: Whether the plane was found from the motion.
    #: Root mean square horizontal velocity of the segments across the plane, relative to that along the plane.
    sideways: float
    off: float = 0.0  #: Angle between this plane and the one with the least motion across [rad].
    #: Root mean square deviation of the joint centres from their mean distances to the plane [m].
    residual: float = 0.0

    def coordinates(self, points: np.ndarray) -> np.ndarray:
        """Return points or vectors (..., 3) of the laboratory as (forward, up, right)."""
        return np.asarray(np.sum(self.axes * points[..., None, :], axis=-1))

    def reversed(self) -> MotionPlane:
        """Return the plane of a person who faces the other way."""
        return replace(self, axes=self.axes * np.array([[-1.0], [1.0], [-1.0]]))

    def with_residual(self, centers: Sequence[np.ndarray]) -> MotionPlane:
        """Return the plane with the residual of joint centres, (T, 3) each in the laboratory."""
        across = [self.coordinates(points)[:, 2] for points in centers]
        square = [np.nanmean((own - np.nanmean(own)) * (own - np.nanmean(own))) for own in across]
        return replace(self, residual=float(np.sqrt(np.mean(square))))


def plane_of(asked: PlaneAxes | None, poses: Mapping[str, Poses], time: np.ndarray) -> MotionPlane:
    """Return the plane of motion with the axes that are asked for; if they are None, it is found, and
    `MotionPlane.reversed` may be the one in which the person faces forward. Raise SpecError if the axes contradict the
    poses, or the motion has no plane.

    Up is the axis of the laboratory along which the trunk is above the feet. The horizontal direction forward is that
    across which the segments have the least mean square velocity.
    """
    feet = np.mean([np.nanmean(own.position, axis=0) for body, own in poses.items() if body.startswith("foot")], axis=0)
    above = np.nanmean(poses["trunk"].position, axis=0) - feet
    axis = int(np.argmax(np.abs(above)))
    up = np.sign(above[axis]) * np.eye(3)[axis]
    if asked is not None and not np.array_equal(up, direction(asked.up)):
        name = ("-" if above[axis] < 0 else "") + "xyz"[axis]
        raise SpecError(
            f"is {asked.up}, but the trunk is above the feet along {name}; the markers may be in another frame",
            key="motion.plane.up",
        )
    first, second = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
    v = np.concatenate([rate_of(own.position, time) for own in poses.values()])
    v = v[~np.isnan(v[:, 0])]
    a, b = np.sum(v * first, axis=1), np.sum(v * second, axis=1)
    angle = 0.5 * elementary.atan2(2 * float(np.mean(a * b)), float(np.mean(a * a) - np.mean(b * b)))
    best = elementary.cos(angle) * first + elementary.sin(angle) * second
    forward = best if asked is None else direction(asked.forward)
    right = np.cross(forward, up)
    along, across = (float(np.sqrt(np.mean(np.sum(v * axis, axis=1) ** 2))) for axis in (forward, right))
    sideways = across / along if along > 0 else np.inf
    if asked is None and not sideways <= SIDEWAYS:
        how = f"move sideways {sideways:.2g} times as fast as forward (at most {SIDEWAYS:g} times is accepted)"
        raise SpecError(
            f"cannot be found, because the segments {how if np.isfinite(sideways) else 'do not move'}; state it, "
            f"such as {{forward: x, up: {'xyz'[axis]}}}",
            key="motion.plane",
        )
    off = elementary.acos(min(1.0, abs(float(np.sum(best * forward)))))
    return MotionPlane(np.stack([forward, up, right]), asked is None, sideways, off)


def direction(name: str) -> np.ndarray:
    """Return the direction (3,) of an axis of the laboratory, such as -x."""
    return np.asarray((-1.0 if name.startswith("-") else 1.0) * np.eye(3)["xyz".index(name[-1])])
