"""Joint centres in the frames of two segments, with covariances: by functional calibration, landmarks or regression.

Functional: the symmetrical centre of rotation estimation of R. M. Ehrig, W. R. Taylor, G. N. Duda and M. O. Heller,
J. Biomech. 39 (2006) 2798-2809. The points p of the proximal and d of the distal segment are those that minimise the
sum of ``|R1 p + t1 - R2 d - t2|^2`` over all frames. A hinge leaves the position along its axis open; the plane of
motion is perpendicular to it, so that a weak pseudo-observation places the centre between both clusters there.
Errors of the rotations would pull both points towards their clusters: the squares that they add, ``s^2 p^T (trace(J^-1)
I - J^-1) p`` for each frame (`rigid_clusters`), are subtracted (W. A. Fuller, Measurement Error Models, 1987).

The covariance is that of the least-squares estimate for the artefacts of the markers (`rigid_clusters`), which are
correlated in time. If the residual of the fit is larger than they explain, because the skin moves all markers of a
segment together, the covariance is multiplied by the ratio of the squares (R. T. Birge, Phys. Rev. 40 (1932) 207).
Skin that moves in step with the joint shifts the centre without a residual (`SegmentPair.in_step`).

Combined: a centre by landmarks or regression is a second observation of p, which is independent of the motion. The
least-squares estimate by both weighs them by their covariances. If they differ by more than their covariances explain,
its covariance is multiplied by the ratio of the squares too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.engine.linear_systems import inverse_of, product, symmetric_eigenvectors
from mbdkit_biomech.persons.landmarks import Side
from mbdkit_biomech.persons.rigid_clusters import Artefact, MarkerCluster, Poses

MOST_FRAMES = 300  #: Largest number of frames, evenly spaced, in a functional calibration.

ACROSS = 0.05  #: Standard deviation of the pseudo-observation across the plane of motion [m].

#: Standard deviation of the residual of a functional calibration that weighs the pseudo-observation [m].
EXPECTED = 0.005

#: Functional centres are refused if their standard deviation in the plane of motion is larger [m], about a tenth of a
#: thigh or shank. In walking, that of hips and ankles by the motion alone is 20 to 40 mm along the segments.
LARGEST_DEVIATION = 0.05

#: Functional centres are refused if the root mean square distance of both points is larger [m]. In walking it is below
#: 10 mm; a squat whose thigh moves within its skin gave 25 mm and a shank of 0.72 m.
LARGEST_RESIDUAL = 0.02

#: Standard deviation of the middle of two landmarks along each axis [m]. Marks of different examiners at the side of
#: the knee are 12 mm apart on average (M. J. Simmonds and S. Kumar, Int. J. Ind. Ergonomics 11 (1993) 145-151), which
#: is 12 / sqrt(pi) = 6.8 mm along each axis of the skin. The middle of two such landmarks would be known to 4.8 mm;
#: this contains 5 mm by which it may differ from the centre of rotation, an assumption.
LANDMARKS = 0.007

#: Standard deviation of `hip_center` along each axis [m]: G. Mantovani, K. C. G. Ng and M. Lamontagne, Gait Posture 44
#: (2016) 48-54, found distances of 12.3 mm with a standard deviation of 5.9 mm for 67 adults, which is 7.9 mm along
#: each axis, from landmarks on the bone. Their skin, 9.7 +- 7.0 mm in front and 19.6 +- 10.9 mm behind, and markers
#: with a radius of 7 mm add 6.4 +- 5.9 mm forward, which is not corrected. The root mean square of 11.7 mm forward and
#: 7.9 mm up is 10 mm, a distance of 16 mm on average; R. Hara et al., Sci. Rep. 6 (2016) 37707, quote 15 to more than
#: 30 mm.
REGRESSION = 0.01


#: Translations along and rotations about each axis by which the skin moves all markers of a segment together, relative
#: to the bone [m, rad]: standard deviations of oscillations with the ranges 18 mm and 10 degrees of the thigh, 17 mm
#: and 7 degrees of the shank, which A. Ancillao, E. Aertbelien and J. De Schutter, Hum. Mov. Sci. 80 (2021) 102866,
#: found in walking by fluoroscopy. In the angle of the knee they add up to 4.3 degrees; D. L. Benoit et al., Gait
#: Posture 24 (2006) 152-164, found up to 4.4 degrees with markers on bone pins.
TOGETHER: Mapping[str, tuple[float, float]] = {"thigh": (0.006, 0.061), "shank": (0.006, 0.044)}

#: Angle over which skin moves by `TOGETHER` in step with a joint [rad]: that of a knee in walking. Skin of larger
#: motions moves in proportion (T. Bonci et al., J. Biomech. 47 (2014) 2354-2361).
WALKING = 1.05


@dataclass(frozen=True)
class CenterFit:
    """How the points of two segments stay together in a calibration."""

    residual: float  #: Root mean square distance of both points [m].
    #: Standard deviations along each axis by which the skin moves all markers of each segment together at the joint
    #: [m]. They explain the part of the residual that the motion of the markers relative to each other does not.
    #: `TOGETHER` divides the residual among both segments.
    slip: tuple[float, float]
    #: Weights of both points in the position of the centre, by their variances; their sum is 1.
    weights: tuple[float, float]


@dataclass(frozen=True)
class JointCenter:
    """The centre of a joint between a proximal and a distal segment."""

    #: ``functional``, ``hip-regression``, ``midpoint``, ``static``, or ``combined`` of the first and another one.
    method: str
    proximal: np.ndarray
    distal: np.ndarray  #: (3,) the centre in the frames of the clusters of both segments [m].
    #: (3, 3) covariance of the position, along the axes forward, up and right of the plane of motion, in the pose of
    #: the reference frame of the person [m^2].
    covariance: np.ndarray
    fit: CenterFit
    turn: float  #: Range of the angle between both segments in these frames [rad].
    #: Root mean square difference of two combined centres, relative to what their covariances explain; 0 for others.
    misfit: float = 0.0
    #: Square of this difference in the plane, relative to its covariance: chi-square with two degrees of freedom.
    square: float = 0.0

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations forward and up [m]."""
        x, y = np.sqrt(np.diag(self.covariance)[:2]).tolist()
        return x, y

    def position(self, first: Poses, second: Poses) -> np.ndarray:
        """Return the positions (T, 3) in the laboratory [m]; nan where a pose is unknown."""
        own, other = self.fit.weights
        return own * first.point(self.proximal) + other * second.point(self.distal)


@dataclass(frozen=True)
class SegmentPair:
    """Both segments of a joint in the frames of a calibration, and the axes of the plane of motion."""

    joint: str
    clusters: tuple[MarkerCluster, MarkerCluster]
    #: Clusters of the proximal and the distal segment, and their artefacts.
    artefacts: tuple[Artefact, Artefact]
    poses: tuple[Poses, Poses]  #: Their poses in the frames of the calibration.
    reference: tuple[np.ndarray, np.ndarray]  #: Their rotations (3, 3) in the reference frame of the person.
    axes: np.ndarray  #: (3, 3) rows: directions forward, up and right in the laboratory.

    def in_step(self, points: tuple[np.ndarray, np.ndarray], turn: float) -> np.ndarray:
        """Return the covariance (3, 3), in the laboratory, of the shift of a functional centre, `points` in the frames
        of both clusters [m], by skin that moves in step with the joint [m^2].

        While the joint turns by an angle f about the axis n, the skin moves the points of both clusters at the centre
        apart by u, which leaves no residual, but shifts the centre by n x u / f. The deviations of translations and
        turns of both clusters are `TOGETHER`: they are the main motions of the skin in walking, and those of the thigh
        are in step with the knee (A. Barre et al., J. Biomech. 62 (2017) 21-26). With clusters 0.2 m from a knee, u is
        14 mm forward on average; bone pins showed up to 13.0 mm (Benoit et al. 2006). By motions of `WALKING`, hips
        are 18 mm off on average; by motions along several axes, whose errors are independent, 13 mm were found (J. L.
        Hicks and J. G. Richards, Gait Posture 22 (2005) 138-145).
        """
        moved, side = np.zeros((3, 3)), self.axes[2]
        for cluster, rotation, point in zip(self.clusters, self.reference, points, strict=True):
            shift, angle = together(cluster.body)
            cross = angle * np.cross(np.eye(3), product(rotation, point))
            moved = moved + shift * shift * np.eye(3) + product(cross, cross.T)
        quarter, along = np.cross(np.eye(3), side), side[:, None] * side  # n x u; along n, as much is assumed
        shifted = product(product(quarter, moved), quarter.T) + product(product(along, moved), along)
        return np.asarray(shifted / min(max(turn, 1e-3), WALKING) ** 2)

    @property
    def key(self) -> str:
        """Key of the spec with the method."""
        return f"motion.centers.{self.joint}"

    def known(self) -> tuple[Poses, Poses]:
        """Return both poses in the frames in which both are known."""
        first, second = self.poses
        if not (frames := np.flatnonzero(first.known & second.known)).size:
            raise SpecError("in no frame are the markers of both segments seen", key=self.key)
        return first.rows(frames), second.rows(frames)

    def center(self, method: str, points: tuple[np.ndarray, np.ndarray], covariance: np.ndarray) -> JointCenter:
        """Return the centre with its fit and the range of the joint."""
        return JointCenter(method, *points, covariance, self.fit(points), turn_of(*self.known()))

    def fit(self, points: tuple[np.ndarray, np.ndarray]) -> CenterFit:
        """Return how the points of both segments stay together."""
        first, second = self.known()
        gap = first.point(points[0]) - second.point(points[1])
        square = float(np.mean(np.sum(gap * gap, axis=1)))
        sizes, alike = np.zeros(2), np.zeros(2)
        for side, (artefact, cluster, point) in enumerate(zip(self.artefacts, self.clusters, points, strict=True)):
            shift, turn = together(cluster.body)
            sizes[side] = artefact.deviation * artefact.deviation * float(np.trace(cluster.covariance(point)))
            alike[side] = 3 * shift * shift + 2 * turn * turn * float(np.sum(point * point))
        whole = sizes + alike
        slip = np.sqrt(np.maximum(0.0, square * whole / np.sum(whole) - sizes) / 3.0).tolist()
        weight = float(whole[1] / np.sum(whole))
        return CenterFit(float(np.sqrt(square)), (slip[0], slip[1]), (weight, 1.0 - weight))


def together(body: str) -> tuple[float, float]:
    """Return the motion of the skin of a segment as a whole; that of trunk and foot is assumed to be that of the
    shank.
    """
    return TOGETHER["thigh" if body.startswith("thigh") else "shank"]


def turn_of(first: Poses, second: Poses) -> float:
    """Return the largest angle [rad] between the relative orientations of two segments in any two frames; of longer
    motions, `MOST_FRAMES` frames are compared.
    """
    step = -(-len(first.rotation) // MOST_FRAMES)
    relative = product(first.rotation[::step].mT, second.rotation[::step, None]).reshape(-1, 9)
    trace = np.min(product(relative, relative.T))
    return float(elementary.acos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))


def functional_center(pair: SegmentPair, other: JointCenter | None = None) -> JointCenter:
    """Return the symmetrical centre of rotation of two segments.

    Parameters
    ----------
    other
        The centre by landmarks or regression, in the frame of the proximal segment, that is combined with it.

    Raises
    ------
    SpecError
        If the motion does not determine it in the plane, or the two segments do not turn about a common point.
    """
    first, second = pair.known()
    step = -(-len(first.position) // MOST_FRAMES)
    first, second = (own.rows(np.arange(0, len(own.position), step)) for own in (first, second))
    matrix = np.concatenate([first.rotation, -second.rotation], axis=2)  # (T, 3, 6)
    right = second.position - first.position
    side = pair.axes[2]
    radians = turn_of(first, second)
    turn = float(np.degrees(radians))
    middle = (np.mean(first.position, axis=0) + np.mean(second.position, axis=0)) / 2
    weight = EXPECTED * EXPECTED / (ACROSS * ACROSS) * len(right)
    columns = matrix.mT
    normal = np.sum(columns[:, :, None, :] * columns[:, None, :, :], axis=(0, 3))
    vector = np.sum(columns * right[:, None, :], axis=(0, 2))
    across = np.zeros(6)
    for number, poses in enumerate((first, second)):
        part = slice(3 * number, 3 * number + 3)
        square = pair.artefacts[number].deviation * pair.artefacts[number].deviation
        normal[part, part] -= len(right) * square * pair.clusters[number].lever_matrix
        row = np.zeros(6)
        row[part] = np.mean(product(poses.rotation.mT, side), axis=0)
        normal, across = normal + weight * row[:, None] * row, across + weight * ACROSS * row
        vector = vector + weight * row * float(np.mean(np.sum(side * (middle - poses.position), axis=1)))
    if not symmetric_eigenvectors(normal)[0][0] > 0:
        raise _undetermined(pair, turn, np.inf)
    inverse = inverse_of(normal)
    result = product(inverse, vector)
    points = result[:3], result[3:]
    gap = np.sum(matrix * result, axis=2) - right
    residual = float(np.sqrt(np.mean(np.sum(gap * gap, axis=1))))
    if residual > LARGEST_RESIDUAL:
        raise SpecError(
            f"is functional, but no point of one segment stays at a point of the other: they move apart by "
            f"{1000 * residual:.0f} mm (root mean square; at most {1000 * LARGEST_RESIDUAL:.0f} mm are accepted) while "
            f"the joint turns by {turn:.0f} deg; markers move with the skin, or belong to other segments: check "
            "`clusters`, or determine the centre by landmarks or from a static trial",
            key=pair.key,
        )
    spread, expected = np.zeros((6, 6)), 0.0
    for number, (cluster, artefact) in enumerate(zip(pair.clusters, pair.artefacts, strict=True)):
        own = artefact.deviation * artefact.deviation * cluster.covariance(points[number])
        rotation = (first, second)[number].rotation
        spread = spread + _spread(product(rotation.mT, matrix[:, None]), own, artefact.correlation[::step])
        expected += float(np.trace(own))
    birge = max(1.0, residual * residual / expected)
    covariance = product(product(inverse, birge * spread + across[:, None] * across), inverse)
    common = np.concatenate([one.T for one in pair.reference])  # a shift of both points in the laboratory
    covariance = covariance + product(product(common, pair.in_step(points, radians)), common.T)
    misfit = square = 0.0
    if other is not None:
        to_plane = product(pair.axes, pair.reference[0])[:2]
        gap = product(to_plane, other.proximal - result[:3])
        both = product(product(to_plane, covariance[:3, :3] + other.covariance), to_plane.T)
        square = float(np.sum(gap * product(inverse_of(both), gap)))
        result, covariance, misfit = _combined(result, covariance, other)
        points = result[:3], result[3:]
    fit = pair.fit(points)
    weighed = zip(fit.weights, pair.reference, strict=True)
    to_plane = np.concatenate([weight * product(pair.axes, rotation) for weight, rotation in weighed], axis=1)
    own = product(product(to_plane, covariance), to_plane.T)
    deviation = float(np.sqrt(np.max(np.diag(own)[:2])))
    if not deviation <= LARGEST_DEVIATION:
        raise _undetermined(pair, turn, deviation)
    return JointCenter("functional" if other is None else "combined", *points, own, fit, radians, misfit, square)


def _combined(points: np.ndarray, covariance: np.ndarray, other: JointCenter) -> tuple[np.ndarray, np.ndarray, float]:
    """Return points (6,) with their covariance (6, 6), corrected by another, independent estimate of the first one, and
    the misfit of both.
    """
    gap = other.proximal - points[:3]
    weight = inverse_of(covariance[:3, :3] + other.covariance)  # variances of `other` are equal along all axes
    gain = product(covariance[:, :3], weight)
    misfit = float(np.sqrt(np.sum(gap[:, None] * weight * gap) / len(gap)))
    birge = max(1.0, misfit * misfit)
    return points + product(gain, gap), birge * (covariance - product(gain, covariance[:3])), misfit


def _undetermined(pair: SegmentPair, turn: float, deviation: float) -> SpecError:
    """Return the error that a motion does not determine a centre, because markers move relative to each other by more
    than the joint, which turns by `turn` [deg], moves them; `deviation` of the centre [m], or inf.
    """
    moved = 1000 * max(artefact.deviation for artefact in pair.artefacts)
    known = f"is known to {1000 * deviation:.0f} mm only" if np.isfinite(deviation) else "is not known"
    return SpecError(
        f"is functional, but the motion does not determine the centre: the angle between both segments changes by "
        f"{turn:.0f} deg, and the markers of a segment move relative to each other by {moved:.0f} mm, so that the "
        f"centre {known} (a standard deviation of at most {1000 * LARGEST_DEVIATION:.0f} mm is accepted); bend the "
        "joint more in a calibration trial (`motion.static`), or determine the centre by landmarks",
        key=pair.key,
    )


def _spread(matrix: np.ndarray, covariance: np.ndarray, correlation: np.ndarray) -> np.ndarray:
    """Return the covariance (6, 6) of the sum over frames of ``matrix^T error``.

    Parameters
    ----------
    matrix
        (T, 3, 6) matrices.
    covariance
        (3, 3) covariance of the error in a frame.
    correlation
        (L,) correlation of errors that are 0, 1, ... frames apart; zero beyond.
    """
    frames = len(matrix)
    values = np.zeros((6, 6))
    weighted = product(covariance, matrix[:, None])
    for lag, share in enumerate(correlation[:frames]):
        own = np.sum(matrix[: frames - lag, :, :, None] * weighted[lag:, :, None, :], axis=(0, 1))
        values = values + share * (own if lag == 0 else own + own.T)
    return values


def landmark_center(pair: SegmentPair, method: str, points: np.ndarray) -> JointCenter:
    """Return a centre midway between landmarks.

    Parameters
    ----------
    points
        (T, 3) the middle of the landmarks in the frames of the calibration [m].
    """
    inside = [poses.inside(points) for poses in pair.poses]
    if any(np.isnan(own[:, 0]).all() for own in inside):
        raise SpecError("in no frame are both landmarks and the markers of both segments seen", key=pair.key)
    result = np.nanmean(inside[0], axis=0), np.nanmean(inside[1], axis=0)
    return pair.center(method, result, LANDMARKS * LANDMARKS * np.eye(3))


def hip_center(pair: SegmentPair, landmarks: tuple[np.ndarray, np.ndarray, np.ndarray], side: Side) -> JointCenter:
    """Return the centre of a hip by regression.

    M. E. Harrington et al., J. Biomech. 40 (2007) 595-602: from the middle of the anterior superior iliac spines, with
    the depth D and the width W of the pelvis, the hip is 0.24 D + 9.9 mm behind, 0.30 W + 10.9 mm below, and 0.33 W +
    7.3 mm to its side.

    Parameters
    ----------
    landmarks
        (3,) the right and the left anterior superior iliac spine, and the middle of the posterior ones or the sacrum,
        in the frame of the cluster of the pelvis [m].
    """
    right, left, back = landmarks
    middle = (right + left) / 2
    width, depth = np.linalg.norm(right - left, axis=0), np.linalg.norm(middle - back, axis=0)
    lateral, forward = (right - left) / width, (middle - back) / depth
    forward = forward - lateral * np.sum(lateral * forward)
    forward = forward / np.linalg.norm(forward, axis=0)
    out = (0.33 * width + 0.0073) * (1.0 if side == "r" else -1.0)
    behind, below = 0.24 * depth + 0.0099, 0.30 * width + 0.0109
    point = middle - behind * forward - below * np.cross(lateral, forward) + out * lateral
    first, second = pair.known()
    distal = np.mean(second.inside(first.point(point)), axis=0)
    return pair.center("hip-regression", (point, distal), REGRESSION * REGRESSION * np.eye(3))
