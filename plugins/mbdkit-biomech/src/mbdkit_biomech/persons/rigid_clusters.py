"""Poses of clusters of markers by least squares, and how far artefacts of the skin move the points of a segment.

The rotation from a template to the markers of a frame is the quaternion of B. K. P. Horn, J. Opt. Soc. Am. A 4 (1987)
629-642: the eigenvector of the largest eigenvalue of a symmetric matrix (4, 4). If each coordinate of each of N markers
has an independent error with the variance s^2, the point p of the segment, relative to the centroid of the template,
has an error with the covariance

    K(p) = s^2 (I / N - [p] J^-1 [p]),      J = sum of (|x|^2 I - x x^T) over the markers x of the template,

with the cross-product matrix [p] (J. M. Fitzpatrick, J. B. West and C. R. Maurer, IEEE Trans. Med. Imaging 17 (1998)
694-702: target registration error). Products and sums are those of NumPy without BLAS, so that results do not depend on
the processor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed, shown
from mbdkit.engine.linear_systems import inverse_of, product, symmetric_eigenvectors

LEAST_MARKERS = 3  #: Number of markers that determine a pose.

#: Markers count as lying on a line if their root mean square distance from it is less than this [m].
LEAST_WIDTH = 0.01

TEMPLATE_FRAMES = 100  #: Number of frames, evenly spaced, from which a template is averaged.

CAMERA = 1e-4  #: Least standard deviation of a coordinate of a marker [m], of cameras and of rounding in files.

SPAN = 2  #: Rates are differences over this number of frames in both directions.

ROUNDS = 3  #: Number of averages for a template; further ones change it by rounding errors.


def rate_of(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return rates (T, ...) of values (T, ...) by differences; one-sided at the ends."""
    rows = np.arange(len(time))
    first, last = np.maximum(rows - SPAN, 0), np.minimum(rows + SPAN, len(time) - 1)
    interval = (time[last] - time[first]).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((values[last] - values[first]) / interval)


@dataclass(frozen=True)
class Poses:
    """Poses of a segment in T frames; nan where too few of its markers were seen."""

    rotation: np.ndarray  #: (T, 3, 3) from the frame of the segment to the laboratory.
    position: np.ndarray  #: (T, 3) origin of the segment in the laboratory [m].
    #: (T, N, 3) markers minus template, in the frame of the segment [m]; nan where a marker was not seen.
    residual: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """(T,) whether the pose is known."""
        return np.asarray(~np.isnan(self.position[:, 0]))

    def point(self, p: np.ndarray) -> np.ndarray:
        """Return the positions (T, 3) in the laboratory of a point `p` (3,) of the segment."""
        return np.asarray(product(self.rotation, p) + self.position)

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Return points (T, 3) of the laboratory in the frame of the segment."""
        return product(points - self.position, self.rotation)

    def rows(self, frames: np.ndarray) -> Poses:
        """Return the poses in some frames."""
        return Poses(self.rotation[frames], self.position[frames], self.residual[frames])


@dataclass(frozen=True)
class MarkerCluster:
    """Markers that count as fixed to a segment."""

    body: str
    names: tuple[str, ...]  #: Names of the N markers.
    #: (N, 3) positions of the markers in the frame of the segment, whose origin is their centroid [m]. Its axes are
    #: parallel to those of the laboratory in the first frame of the template.
    template: np.ndarray

    @classmethod
    def of(cls, body: str, names: tuple[str, ...], markers: np.ndarray) -> MarkerCluster:
        """Return the mean shape of markers (T, N, 3); raise SpecError if there are less than three, if they lie on a
        line, or if no frame has all of them.
        """
        key = f"motion.clusters.{body}"
        if len(names) < LEAST_MARKERS:
            raise SpecError(
                f"has {len(names)} markers, but a pose needs three that are not on a line; add markers of this "
                "segment, such as those of the joints at its ends",
                key=key,
            )
        if not (whole := np.flatnonzero(~np.isnan(markers).any(axis=(1, 2)))).size:
            never = [name for index, name in enumerate(names) if np.isnan(markers[:, index, 0]).all()]
            why = f"marker {listed(list(map(shown, never)))} is never seen" if never else "no frame has all its markers"
            raise SpecError(f"{why}; leave out a marker of this cluster", key=key)
        frames = markers[whole[:: max(1, len(whole) // TEMPLATE_FRAMES)]]
        template = frames[0] - np.mean(frames[0], axis=0)
        _, axes = symmetric_eigenvectors(product(template.T, template))
        across = np.sum(template * axes[:, 1], axis=1), np.sum(template * axes[:, 0], axis=1)
        width = float(np.sqrt(np.mean(across[0] * across[0] + across[1] * across[1])))
        if width < LEAST_WIDTH:
            raise SpecError(
                f"its markers lie on a line to {1000 * width:.1f} mm, so that turns about it are not known; add a "
                "marker beside the line",
                key=key,
            )
        for _ in range(ROUNDS):
            template = template + np.mean(poses_of(template, frames).residual, axis=0)
            template = template - np.mean(template, axis=0)
        return cls(body, names, template)

    def covariance(self, p: np.ndarray) -> np.ndarray:
        """Return the covariance (3, 3) of a point of the segment for errors of markers with the variance 1."""
        cross = np.cross(np.eye(3), p)  # [p]
        return np.asarray(np.eye(3) / len(self.template) - product(product(cross, self.inverse_inertia), cross))

    @property
    def lever_matrix(self) -> np.ndarray:
        """(3, 3) matrix whose quadratic form in a point is the part of the trace of `covariance` by rotations."""
        return np.asarray(np.trace(self.inverse_inertia) * np.eye(3) - self.inverse_inertia)

    @property
    def inverse_inertia(self) -> np.ndarray:
        """(3, 3) inverse of J, see the module; the covariance of rotations for errors of markers with variance 1."""
        x = self.template
        return inverse_of(np.sum(x * x) * np.eye(3) - product(x.T, x))


def poses_of(template: np.ndarray, markers: np.ndarray) -> Poses:
    """Return the poses of a template (N, 3) that fit markers (T, N, 3), nan where they were not seen."""
    seen = ~np.isnan(markers).any(axis=2)
    x = np.where(seen[..., None], markers, 0.0)
    share = seen / np.maximum(np.sum(seen, axis=1), 1)[:, None]
    x_mean, p_mean = np.sum(share[..., None] * x, axis=1), np.sum(share[..., None] * template, axis=1)
    p = (template - p_mean[:, None]) * seen[..., None]
    moments = np.sum(p[..., :, None] * (x - x_mean[:, None])[..., None, :], axis=1)
    fits = {pattern.tobytes(): _determines(template[pattern]) for pattern in np.unique(seen, axis=0)}
    known = np.array([fits[pattern.tobytes()] for pattern in seen])
    rotation = np.full((len(markers), 3, 3), np.nan)
    for frame in np.flatnonzero(known):
        rotation[frame] = _rotation(moments[frame])
    position = x_mean - product(p_mean, rotation.mT)
    position[~known] = np.nan
    return Poses(rotation, position, product(markers - position[:, None], rotation[:, None]) - template)


def _determines(template: np.ndarray) -> bool:
    """Return whether markers determine a pose: at least three that are not on a line."""
    if len(template) < LEAST_MARKERS:
        return False
    own = template - np.mean(template, axis=0)
    values, _ = symmetric_eigenvectors(product(own.T, own))
    return bool(values[0] + values[1] >= len(own) * LEAST_WIDTH * LEAST_WIDTH / 4)


def _rotation(s: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) by the moments (3, 3) of template and markers."""
    trace, skew = s[0, 0] + s[1, 1] + s[2, 2], [s[1, 2] - s[2, 1], s[2, 0] - s[0, 2], s[0, 1] - s[1, 0]]
    matrix = np.vstack([[trace, *skew], np.column_stack([skew, s + s.T - trace * np.eye(3)])])
    w, x, y, z = symmetric_eigenvectors(matrix)[1][:, -1].tolist()
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


@dataclass(frozen=True)
class Artefact:
    """Motion of the markers of a cluster relative to each other."""

    deviation: float  #: Standard deviation of a coordinate of a marker [m].
    #: (L,) correlation of errors that are 0, 1, ..., L - 1 frames apart, up to its first zero. The correlation of
    #: artefacts that oscillate is negative beyond, and without it, covariances are too large rather than too small.
    correlation: np.ndarray

    @classmethod
    def of(cls, poses: Poses) -> Artefact:
        """Return the artefact that the residuals of poses show: N markers leave 3 N - 6 free coordinates."""
        own = poses.residual[poses.known]
        seen = ~np.isnan(own)
        own = np.where(seen, own, 0.0)
        own = np.where(seen, own - np.sum(own, axis=0) / np.maximum(np.sum(seen, axis=0), 1), 0.0)
        free = float(np.sum(np.maximum(np.sum(seen, axis=(1, 2)) - 6, 0)))
        square = float(np.sum(own * own))
        correlation = [1.0]
        for lag in range(1, len(own)):
            share = float(np.sum(own[:-lag] * own[lag:])) / square if square > 0 else 0.0
            if not share > 0:
                break
            correlation.append(share)
        return cls(max(float(np.sqrt(square / max(free, 1.0))), CAMERA), np.array(correlation))
