"""Fit of a mechanism to measured quantities: weighted Gauss-Newton iteration on the constraint manifold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import RunError, SpecError
from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.linear_systems import least_norms, products, pseudoinverses, singular_values
from mbdkit.engine.observed_states import JointSums
from mbdkit_biomech.inverse_dynamics.motion.manifold import Manifold, Quantities

MOST_ITERATIONS = 200
#: Scaled step up to which an iteration has converged.
#:
#: A scaled step is the largest change of a coordinate, divided by the scale of the coordinate (`Manifold.scale`).
ROUND_OFF = 1e-13

#: Scaled step below which an iteration also ends if the step is at least half as large as the previous one.
STAGNANT = 1e-8

#: Scaled step below which the pose of a key frame is accurate enough to start the fit of other frames.
SETTLED = 0.03

#: Largest scaled step of an iteration, and largest scaled change of the pose between key frames that are not
#: consecutive frames.
LONGEST = 0.5

#: Smallest number of key frames, if there are as many frames. Key frames are fitted one after the other; there are more
#: of them if the pose changes much.
KEYS = 50

#: A direction counts as not observed if its effect on the data, relative to the effect of the best observed direction,
#: is below this.
UNSEEN = 1e-7

#: A coordinate is named in messages if its component is larger than this share of the largest component.
MOVES = 1e-3


@dataclass(frozen=True)
class FitTarget:
    """The measured values to which a mechanism is fitted in T frames.

    Attributes
    ----------
    time
        (T,) [s].
    quantities
        The K observed quantities.
    values
        (T, K) their measured values [m, rad].
    root_weight
        (K,) or (T, K) square roots of the weights of the squared residuals.
    """

    time: np.ndarray
    quantities: Quantities
    values: np.ndarray
    root_weight: np.ndarray

    def rows(self, part: slice | np.ndarray) -> FitTarget:
        """Return the target in a selection of frames."""
        weight = self.root_weight if self.root_weight.ndim == 1 else self.root_weight[part]
        return FitTarget(self.time[part], self.quantities, self.values[part], weight)


class FitError(RunError):
    """No pose of the mechanism fits the data.

    Attributes
    ----------
    time
        Time of the frame without a pose [s].
    """

    def __init__(self, message: str, time: float = np.nan):
        super().__init__(message)
        self.time = time


class Fitter:
    """Fits a mechanism to targets.

    Parameters
    ----------
    manifold
        The constraints of the mechanism.
    bodies
        Names of the bodies of the mechanism.
    """

    def __init__(self, manifold: Manifold, bodies: tuple[str, ...]):
        self.manifold, self.bodies = manifold, bodies

    def first_pose(self, target: FitTarget, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose (n,) of the first frame, and the target values (K,) in this frame, with angles shifted by
        full turns so that they are nearest to those of the pose.

        Parameters
        ----------
        start
            (n,) pose from which the search begins.
        """
        first, quantities = target.rows(slice(0, 1)), target.quantities
        turn = 2 * np.pi * quantities.scale
        q = start[None]
        for _ in range(3):
            q = self.refined(first, q)
            turns = np.round((quantities.values(q) - first.values) / turn) * quantities.is_angle
            if not np.any(turns):
                break
            first = FitTarget(first.time, first.quantities, first.values + turn * turns, first.root_weight)
        return q[0], first.values[0]

    def misfit(self, target: FitTarget, start: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the pose (n,) of the first frame, and its root mean square residual in rad or longest links."""
        pose, values = self.first_pose(target, start)
        left = (values - target.quantities.values(pose[None])[0]) / target.quantities.sizes(self.manifold.length)
        return pose, float(np.sqrt(np.mean(left**2)))

    def poses(self, target: FitTarget, first: np.ndarray) -> np.ndarray:
        """Return the poses (T, n) that fit a target best; `first` (n,) is the pose of the first frame.

        Key frames are fitted one after the other, each starting from the pose of the previous one. The frames between
        them are fitted together, starting from interpolated poses.

        Raises
        ------
        RunError
            If no pose is found.
        """
        count = len(target.time)
        keys, poses, stride = [0], [first], max(1, count // KEYS)
        while keys[-1] < count - 1:
            following = min(keys[-1] + stride, count - 1)
            pose, moved = self._following(target, following, poses[-1])
            if moved > LONGEST and following > keys[-1] + 1:
                stride = max(1, (following - keys[-1]) // 2)
                continue
            keys.append(following)
            poses.append(pose)
            if moved < LONGEST / 2:
                stride = min(max(1, count // KEYS), 2 * stride)
        start = np.column_stack([np.interp(np.arange(count), keys, column) for column in np.array(poses).T])
        return self.refined(target, start)

    def _following(self, target: FitTarget, frame: int, start: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the pose of a key frame, and its distance from `start`, the pose of the previous key frame."""
        rows, q = target.rows(slice(frame, frame + 1)), start[None]
        for _ in range(MOST_ITERATIONS):
            step = self._step(rows, q)
            q = q + step
            if self._size(step)[0] < SETTLED:
                break
        return q[0], float(self._size(q - start)[0])

    def refined(self, target: FitTarget, start: np.ndarray) -> np.ndarray:
        """Return the poses (T, n) that fit a target best, near the poses `start` (T, n); all frames are computed
        together.
        """
        q, active, before = start.copy(), np.arange(len(start)), np.full(len(start), np.inf)
        for _ in range(MOST_ITERATIONS):
            step = self._step(target.rows(active), q[active])
            q[active] += step
            size = self._size(step)
            done = (size <= ROUND_OFF) | ((size >= 0.5 * before[active]) & (size < STAGNANT))
            before[active] = size
            if not (active := active[~done]).size:
                return q
        raise FitError(
            f"the mechanism cannot be fitted to the motion at t = {target.time[active[0]]:.6g} s: the iteration does "
            "not converge; the measured values may belong to another configuration, or to a singular position",
            float(target.time[active[0]]),
        )

    def _step(self, target: FitTarget, q: np.ndarray) -> np.ndarray:
        """Return the Gauss-Newton step (T, n), shortened to a scaled size of at most `LONGEST`."""
        frames = self.manifold.frames(target.time, q)
        directions = self.manifold.directions(frames.jacobian)
        observed = target.quantities.jacobian(q) * target.root_weight[..., None]
        values = (target.values - target.quantities.values(q)) * target.root_weight
        try:
            step = directions.least_squares(-frames.phi, observed, values)
        except np.linalg.LinAlgError:
            raise FitError(
                f"the mechanism is in a singular position near t = {target.time[0]:.6g} s, where the motion that fits "
                "the data is not unique",
                float(target.time[0]),
            ) from None
        return np.asarray(step * np.minimum(1.0, LONGEST / np.maximum(self._size(step), LONGEST))[:, None])

    def _size(self, step: np.ndarray) -> np.ndarray:
        """Return the largest scaled change of a coordinate in each frame, (T,)."""
        scale = self.manifold.scale
        return np.asarray(np.max(np.abs(step) / np.where(scale > 0, scale, 1.0), axis=1))

    def require_observed(self, target: FitTarget, q: np.ndarray, key: str) -> None:
        """Raise SpecError if the quantities do not determine the poses `q` (T, n) of all frames.

        The message names the bodies that move in a free direction without any change of the quantities.
        """
        free = self.manifold.directions_at(target.time, q).free
        if not free.shape[2]:
            return
        seen = products(target.quantities.jacobian(q) * self.manifold.scale, free)
        values = singular_values(seen)
        least = values[:, -1] if values.shape[1] == free.shape[2] else np.zeros(len(q))
        blind = np.flatnonzero(least <= UNSEEN * np.max(values, axis=1, initial=0.0))
        if not blind.size:
            return
        frame = int(blind[0])
        most = np.max(values[frame], initial=0.0)
        unseen = np.array([i >= values.shape[1] or values[frame, i] <= UNSEEN * most for i in range(free.shape[2])])
        vectors = np.linalg.svd(seen[frame], full_matrices=True)[2]
        moves = np.abs(free[frame] @ vectors[unseen].T).max(axis=1)
        named = self.names_of(moves)
        where = "" if blind.size == len(q) else f" at t = {target.time[frame]:.6g} s"
        raise SpecError(
            f"the columns do not observe {named}{where}: {int(unseen.sum())} of {free.shape[2]} degrees of freedom "
            f"{'is' if unseen.sum() == 1 else 'are'} not determined by the columns; add columns, or drivers to the "
            "model",
            key=key,
        )

    def names_of(self, moves: np.ndarray) -> str:
        """Return the names of the bodies, with their coordinates, whose scaled components `moves` (n,) are not
        small.
        """
        parts = moves.reshape(-1, 3) > MOVES * np.max(moves)
        words = ("x", "y", "angle")
        texts = [
            f"{name} ({listed([word for word, moving in zip(words, part, strict=True) if moving])})"
            for name, part in zip(self.bodies, parts, strict=True)
            if np.any(part)
        ]
        return listed(texts, "and", 6)


#: Largest number of Gauss-Newton steps that place the bodies freely. Few suffice, because they start from the fitted
#: poses, which are close to the solution.
PLACINGS = 4

PLACED = 1e-14  #: The steps end if a scaled step is below this; the positions are then exact to round-off.

#: A direction counts as not observed if its singular value, relative to the largest one of the Jacobian, is below
#: this.
NEGLIGIBLE = 1e-9

#: The residual of a constraint row counts as undetermined if the part of the row that the data do not observe exceeds
#: this share of the row.
BLIND = 1e-6


def raw_misalignment(manifold: Manifold, mechanism: CompiledMechanism, target: FitTarget, q: np.ndarray) -> np.ndarray:
    """Return the misalignment of each joint (T, J) [m] for bodies placed by the data alone, without constraints.

    All bodies are moved freely from the fitted poses, by the smallest displacement that minimises the sum of the
    weighted squared residuals. Where the data do not determine the misalignment of a joint, it is nan.

    Parameters
    ----------
    q
        (T, n) fitted poses.
    """
    place, none = q.copy(), np.zeros((len(q), manifold.m))
    for _ in range(PLACINGS):
        observed = target.quantities.jacobian(place) * target.root_weight[:, None] * manifold.scale
        left = (target.values - target.quantities.values(place)) * target.root_weight
        step = least_norms(observed, left, NEGLIGIBLE)
        place += step * manifold.scale
        if np.max(np.abs(step), initial=0.0) < PLACED:
            break
    residual = manifold.reactions(target.time, place, np.zeros_like(place), none).residual
    values: np.ndarray = JointSums(mechanism).misalignment(residual)
    jacobian = manifold.frames(target.time, q).jacobian * manifold.scale
    seen = products(pseudoinverses(observed, NEGLIGIBLE), observed)
    hidden = np.linalg.norm(jacobian - products(jacobian, seen), axis=2) > BLIND * np.linalg.norm(jacobian, axis=2)
    names = [row.label.rpartition(".")[0] for row in mechanism.solved_rows]
    for number, name in enumerate(mechanism.joints):
        if rows := [row for row, joint in enumerate(names) if joint == name]:
            values[np.any(hidden[:, rows], axis=1), number] = np.nan
    return values
