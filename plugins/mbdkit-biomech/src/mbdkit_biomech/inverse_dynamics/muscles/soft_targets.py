"""Soft targets of recruitment: forces that the compartments of a knee need at least, and activations that EMG shows.

The ground's force on a foot has a moment M about the forward axis of the knee, which two compartments, a width w apart,
carry: their forces are N / 2 + M / w and N / 2 - M / w, where N is the compression of the knee. Neither can pull, so
that N is at least ``2 |M| / w``. The frontal moments of muscles, and of the weight of shank and foot, are left out.

A target t of a linear function ``A a`` of the activations, with the standard deviation s, adds the cost ``|(t - A a) /
s|^p`` to that of recruitment: an equation ``A a + s r = t`` with an unknown r like the share of a reserve. For a bound,
it is the inequality ``A a + s r >= t``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.linear_systems import least_norms, product, products
from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import Shared, share_loads

LEAST_DEVIATION = 0.03  #: Smallest standard deviation of an activation by EMG: that of a muscle at rest.

#: Deviation [1] that a channel has in addition for a correlation of 0.5 with the activation that recruitment finds
#: without EMG: it is this times (1 - correlation) / correlation, up to the second number.
DISAGREES, MOST_DISAGREES = 0.2, 10.0

FOLLOWS = 0.5  #: Correlation below which a channel is named.

#: Prior of the largest activation in a trial, and the standard deviation of its logarithm; mean peaks in walking are
#: 0.05 to 0.42 (M. O. Ericson et al., Scand. J. Rehabil. Med. 18 (1986) 159-163).
USUAL_PEAK, PEAKS = 0.2, 1.0

#: Standard deviation of the logarithm of a scale by the strength of a muscle, which scales activations.
STRENGTH = 0.28

#: Standard deviations of scales about those of `EmgTarget.scaled_to`, as a share, and of moments by EMG, as a share of
#: their root mean square.
SCALES, MOMENTS = 0.7, 0.3

INDEPENDENT = 10.0  #: Number of independent samples in the EMG of a trial.


@dataclass(frozen=True)
class Compartments:
    """The compartments of a knee in T frames."""

    joint: str
    index: int  #: Name of the joint, and its index.
    shank: int  #: Index of the shank among the bodies.
    width: float  #: Distance of the compartments [m].
    deviation: float  #: Standard deviation of the place of the knee across the plane of motion [m].
    #: (T,) moment of the ground's force about the forward axis of the knee, positive if it presses the medial side.
    moment: np.ndarray
    load: np.ndarray  #: (T,) vertical force of the ground [N].


@dataclass(frozen=True)
class EmgTarget:
    """Activations (T,) of a muscle by its EMG, with their relative standard deviation, and one that does not depend on
    their size.
    """

    muscle: int
    activation: np.ndarray
    deviation: float
    column: str = ""
    has_scale: bool = True  #: Whether the scale of the activations is known.
    spread: float = LEAST_DEVIATION

    def scaled_to(self, activation: np.ndarray) -> EmgTarget:
        """Return the target with the scale that activations (T,) of recruitment without EMG show.

        The scale is the mean of that of least squares and of that with the largest activation `USUAL_PEAK`, both as
        logarithms, weighted by their variances.
        """
        own, known = self.activation, np.isfinite(activation)
        square, both = float(np.sum(own[known] ** 2)), float(np.sum((own * activation)[known]))
        usual = USUAL_PEAK / float(np.max(own))
        fitted = both / square if both > 0 else usual
        left = float(np.sum((fitted * own - activation)[known] ** 2)) / (fitted**2 * square)
        weight = 1.0 / (left / INDEPENDENT + STRENGTH**2), 1.0 / PEAKS**2
        share = weight[0] / sum(weight)
        return replace(self, activation=float(elementary.pow(fitted, share) * elementary.pow(usual, 1.0 - share)) * own)


class Axial(NamedTuple):
    """Compression of K knees in T frames without muscles (T, K) [N], and by unit tensions of M muscles (T, K, M)."""

    without: np.ndarray
    unit: np.ndarray


@dataclass(frozen=True)
class SoftTargets:
    """Targets (T, S) of linear functions (T, S, M) of activations with standard deviations (T, S); some (S,) are lower
    bounds.
    """

    matrix: np.ndarray
    right: np.ndarray
    deviation: np.ndarray
    is_bound: np.ndarray


@dataclass(frozen=True)
class Targets:
    """What is known of knees and muscles beside the moments of joints."""

    knees: tuple[Compartments, ...] = ()
    emg: tuple[EmgTarget, ...] = ()
    remarks: tuple[tuple[EmgTarget, str], ...] = ()  #: Channels that disagree with recruitment, and how.

    def __bool__(self) -> bool:
        return bool(self.knees or self.emg)

    def soft(
        self,
        axial: Axial,
        capacity: np.ndarray,
        passive: np.ndarray,
        shifts: Sequence[np.ndarray | float] = (),
        gains: Sequence[np.ndarray | float] = (),
    ) -> SoftTargets:
        """Return the targets of N = T * S programmes, S samples of each frame.

        Parameters
        ----------
        axial, capacity, passive
            Compressions, and capacities and passive forces (N, M) of the muscles.
        shifts, gains
            By knee, the change (N,) of its place across [m]; by channel of EMG, the factor (N,) of its activation.
        """
        rows, muscles = capacity.shape
        right, deviation = np.empty((2, rows, len(self.knees) + len(self.emg)))
        matrix = np.zeros((*right.shape, muscles))
        for k, knee in enumerate(self.knees):
            moment, load = (np.repeat(x, rows // len(x)) for x in (knee.moment, knee.load))
            least = 2.0 * np.abs(moment + (shifts[k] if shifts else 0.0) * load) / knee.width
            matrix[:, k] = axial.unit[:, k] * capacity
            right[:, k] = least - axial.without[:, k] - np.sum(axial.unit[:, k] * passive, axis=1)
            deviation[:, k] = np.maximum(2.0 * knee.deviation * load / knee.width, 1.0)
        for k, channel in enumerate(self.emg, len(self.knees)):
            matrix[:, k, channel.muscle] = 1.0
            value = np.repeat(channel.activation, rows // len(channel.activation))
            right[:, k] = value * (gains[k - len(self.knees)] if gains else 1.0)
            deviation[:, k] = np.hypot(channel.deviation * value, channel.spread)
        return SoftTargets(matrix, right, deviation, np.arange(right.shape[1]) < len(self.knees))

    def changed(self, shifts: Sequence[float], gains: Sequence[float]) -> Targets:
        """Return the targets with knees at other places across, and EMG multiplied by factors; see `soft`."""
        knees = [replace(one, moment=one.moment + x * one.load) for one, x in zip(self.knees, shifts, strict=True)]
        emg = [replace(one, activation=x * one.activation) for one, x in zip(self.emg, gains, strict=True)]
        return Targets(tuple(knees), tuple(emg))

    def repeated(self, count: int) -> Targets:
        """Return the targets of `count` repetitions of all frames, one after the other."""
        knees = [replace(one, moment=np.tile(one.moment, count), load=np.tile(one.load, count)) for one in self.knees]
        emg = [replace(one, activation=np.tile(one.activation, count)) for one in self.emg]
        return Targets(tuple(knees), tuple(emg))

    def calibrated(self, alone: np.ndarray, activation: np.ndarray, programme: Programme) -> Targets:
        """Return the targets with EMG whose scales and deviations follow from the moments, and remarks.

        Muscles without EMG have the activations `alone` (T, M) of recruitment without EMG. The scales s of the channels
        are those with which all muscles together produce the moments of `programme` best, as least squares with the
        prior of `EmgTarget.scaled_to` for the activations (T, M) of recruitment with the last scales. The deviation is
        larger the less a channel is like its activation without EMG, and its moments like those that the other muscles
        leave: with EMG, they would follow noise.
        """
        if not (free := [k for k, one in enumerate(self.emg) if not one.has_scale]):
            return self
        emg = [one if one.has_scale else one.scaled_to(activation[:, one.muscle]) for one in self.emg]
        known = np.all(np.isfinite(alone), axis=1)
        matrix, right = programme.matrix[known][..., : alone.shape[1]], programme.right[known]
        own, counts = alone[known], np.bincount([one.muscle for one in emg], minlength=alone.shape[1])
        shares = [matrix[..., one.muscle] * (one.activation[known, None] / counts[one.muscle]) for one in emg]
        rest = right - products(matrix, np.where(counts > 0, 0.0, own))
        rest = rest - sum((share for one, share in zip(self.emg, shares, strict=True) if one.has_scale), start=0.0)
        size = np.maximum(MOMENTS * np.sqrt(np.mean(rest * rest, axis=0)), 1e-9 * np.max(programme.size))
        weigh = np.sqrt(INDEPENDENT / len(rest)) / size
        columns, wanted = np.stack([(shares[k] * weigh).ravel() for k in free], axis=1), (rest * weigh).ravel()
        normal = product(columns.T, columns) + np.eye(len(free)) / SCALES**2
        factors = least_norms(normal[None], (product(columns.T, wanted) + 1.0 / SCALES**2)[None], 0.0)[0]
        factors = np.clip(factors, 0.2, 5.0)
        left = wanted - product(columns, factors)
        remarks = list(self.remarks)
        for k, column, factor in zip(free, columns.T, factors.tolist(), strict=True):
            one = emg[k]
            acts, alike = column != 0, correlation(one.activation, alone[:, one.muscle])
            changes = (np.where(acts, x, 0.0).reshape(right.shape) for x in (factor * column, left))
            mine, lacks = (x - np.mean(x, axis=0) for x in changes)
            follows = max(alike, correlation(mine.ravel(), (mine + lacks).ravel()), 1e-9)
            spread = min(DISAGREES * (1.0 - follows) / follows, MOST_DISAGREES)
            spread = float(np.hypot(spread, LEAST_DEVIATION) * np.sqrt(counts[one.muscle]))
            values = np.minimum(factor * one.activation, 1.0)
            emg[k] = replace(one, activation=values, has_scale=True, spread=spread)
            if alike < FOLLOWS:
                why = (
                    f"does not follow the activation that the moments of the joints need (correlation {alike:.2f}), "
                    f"so that its activations count with a standard deviation of {spread:.2g}"
                )
                remarks.append((emg[k], why))
        return replace(self, emg=tuple(emg), remarks=tuple(remarks))


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return the correlation of two series (T,); 0 if one is constant."""
    known = np.isfinite(a) & np.isfinite(b)
    a, b = (x[known] - np.mean(x[known]) for x in (a, b))
    size = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return float(np.sum(a * b)) / size if size > 0 else 0.0


def share_softly(
    programme: Programme, exponent: float, soft: SoftTargets, start: np.ndarray | None = None
) -> tuple[Programme, Shared]:
    """Return the programmes with soft targets, and their solutions; `start` as in `share_loads`.

    In the programmes that are returned, targets are equations; those of bounds that do not act, and their unknowns, are
    zero.
    """
    whole = _softened(programme, soft)
    shared = share_loads(whole, exponent, start)
    targets, muscles = soft.matrix.shape[1:]
    idle = soft.is_bound & (products(soft.matrix, shared.value[:, :muscles]) >= soft.right)
    for one in (whole.matrix, whole.right, whole.low, whole.high):
        one[:, -targets:][idle] = 0.0
    return replace(whole, lowest=np.array(-np.inf)), shared


def _softened(programme: Programme, soft: SoftTargets) -> Programme:
    """Return programmes with an equation or inequality, and an unknown, for each target."""
    (rows, equations, unknowns), targets = programme.matrix.shape, soft.right.shape[1]
    matrix = np.zeros((rows, equations + targets, unknowns + targets))
    matrix[:, :equations, :unknowns] = programme.matrix
    matrix[:, equations:, : soft.matrix.shape[2]] = soft.matrix
    places = np.arange(targets)
    matrix[:, equations + places, unknowns + places] = soft.deviation
    free = np.full((rows, targets), np.inf)
    return Programme(
        matrix,
        np.hstack([programme.right, soft.right]),
        np.hstack([programme.low, -free]),
        np.hstack([programme.high, free]),
        np.concatenate([programme.weight, np.ones(targets)]),
        np.hstack([programme.lowest, np.where(soft.is_bound, 0.0, -free)]),
    )
