"""How uncertain scalars change the results of inverse dynamics: bars from samples, and shares of the sources.

Bars are quantiles of the magnitudes of the changes in samples of all scalars together, so that they contain the bounds
of activations, interactions of the sources, and the bias of the result. Bars of largest forces are about the median of
the samples. Normal scalars of the samples are orthogonal to each other and come in pairs of opposite sign: for linear
functions, mean squares over samples are then exact.

The share of a source in the mean square of a change d is ``E[d_k . d] / E[d . d]``, with the change d_k of the source
alone: its variance plus the product of its mean change with the mean change of all. Moments of d_k are those of a
quadrature (`UncertainScalar.nodes`), which is first order for linear functions and follows corners otherwise.
Interactions are what the shares leave.

On average, the largest value of a disturbed curve exceeds that of the curve, to second order by a sum over the sources.
Errors of what is measured on a person disturb the result, whose largest force is then too large. Muscles and devices of
the person differ from those of the model, so that the true curve is the disturbed one, and the result too small. So do
its masses, which count as measured here, because they hardly change forces.

First order alone would not suffice. For a person without muscles, its bars are within 10 % of those of samples at all
times; for nine muscles of one leg in 29 % of the frames, and for 18 muscles of two legs in 46 %. They are mostly too
small, by half in one of twenty frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mbdkit.archive.result_table import TableColumn
from mbdkit.base import elementary
from mbdkit.base.text import counted, listed
from mbdkit.engine.linear_systems import product
from mbdkit_biomech.inverse_dynamics.compute import Inverse, compression, knees_of, reactions_of, without_followers
from mbdkit_biomech.inverse_dynamics.signals.chi_square import LEVEL, quantile
from mbdkit_biomech.uncertainty.sources import LEVELS, Kind, UncertainScalar, asked_uncertainty, sources_of
from mbdkit_biomech.uncertainty.stacked_outcomes import LOST, Outcomes, StackedOutcomes

_TJ = ("time", "joint")
#: Names of the first and the last row of contributions.
OF_DATA, INTERACTIONS = "noise of the data", "interactions"

KINDS: tuple[Kind, ...] = ("person", "muscles", "devices")

CHANGES = ("largest", "mean", "added")  #: What bodies that follow the motion change, in the order of `AddedBars`.

#: Relative standard error of the quantile `LEVEL`, 1.96, of magnitudes of Gaussian numbers, times the root of their
#: number: ``sqrt(LEVEL (1 - LEVEL)) / (1.96 f)`` with their density f = 0.1169 there.
GAUSSIAN = 0.95

LARGEST_SCATTER = 0.1  #: Relative standard error of bars from which the number of samples is too small.


class AddedBars(NamedTuple):
    """Bounds for bodies that follow the motion, by all sources but the noise of the data [N]."""

    without: np.ndarray  #: (T, J) of the forces of joints without them.
    added: np.ndarray  #: (T, J) of what they add to the forces.
    largest_without: np.ndarray  #: (J,) of the largest forces without them.
    #: (3, J) of the changes of the largest and of the mean force, and of the largest added force.
    changes: np.ndarray


@dataclass(frozen=True)
class KneeBars:
    """Compressions of K knees along the shank in T frames by recruitment, and quantiles over samples [N].

    Muscles pull, so that a compression is not smaller than that without them.
    """

    joints: Sequence[int]  #: Indices of the knees among the joints.
    center: np.ndarray  #: (T, K) compressions by the recruitment of the spec.
    low: np.ndarray
    high: np.ndarray  #: (T, K) quantiles of 2.5 and 97.5 %.
    least: np.ndarray  #: (T, K) quantiles of 2.5 % of the compressions without muscles.

    @classmethod
    def of(cls, stacked: StackedOutcomes, sampled: Outcomes, values: np.ndarray) -> KneeBars:
        """Return the quantiles of samples of values (S, K) of the scalars."""
        result, reactions = stacked.result, reactions_of(stacked.result)
        knees, angles = knees_of(result.problem), result.motion.q.reshape(len(result.motion.time), -1, 3)[..., 2]
        found = np.empty((4, len(angles), len(knees)))
        for k, (joint, shank) in enumerate(knees):
            angle = angles[:, shank] + product(values, stacked.moves[:, :, shank, 2])  # (S, T)
            x, y = elementary.sin(angle), -elementary.cos(angle)
            own, without = (
                x * one[:, :, joint, 0] + y * one[:, :, joint, 1] for one in (sampled.reactions, sampled.without)
            )
            found[0, :, k] = compression(reactions[:, joint], result.motion.q, shank)
            found[1:3, :, k] = [_bound(own, level) for level in (0.5 - LEVEL / 2, 0.5 + LEVEL / 2)]
            found[3, :, k] = _bound(np.where(np.isnan(own), np.nan, without), 0.5 - LEVEL / 2)
        return cls([joint for joint, _ in knees], *found)

    def with_data(self, of_data: np.ndarray, is_unknown: np.ndarray) -> np.ndarray:
        """Return compressions and both sides of their bars (T, K, 3), given squared bars of forces of joints (T, J) by
        the data, and where forces are not known.
        """
        noise, unknown = of_data[:, self.joints], is_unknown[:, self.joints]
        lower, upper = (np.maximum(one, 0.0) for one in (self.center - self.low, self.high - self.center))
        lower = np.minimum(np.sqrt(lower**2 + noise), np.maximum(self.center - self.least, 0.0))
        sides = (np.where(unknown, np.nan, one) for one in (lower, np.sqrt(upper**2 + noise)))
        return np.stack([self.center, *sides], axis=-1)


@dataclass(frozen=True)
class UncertainResult:
    """Effects of uncertain scalars on a result in T frames."""

    #: Squared bounds of actuators (T, U), forces (T, J) and torques (T, J) of joints, positions and velocities (T, B,
    #: 3), and tensions (T, M); each bound holds with the probability `LEVEL`.
    squares: list[np.ndarray]
    peaks: np.ndarray  #: (J,) bounds of the errors of the largest forces of joints over the motion [N].
    #: (J,) expected excess of the largest forces of joints over the true ones, without noise [N]; see the module.
    peak_bias: np.ndarray
    #: (J,) relative standard errors of the bounds of forces, by the number of samples, where the forces are largest.
    scatter: np.ndarray
    kinds: Mapping[str, Kind]  #: Kinds of the G sources by name.
    shares: np.ndarray  #: (G, T, J) shares of the sources in the mean square changes of the forces of joints.
    scalars: int
    samples: int
    failed: int  #: Number of scalars, of samples, and of samples in which some frames have no result.
    added: AddedBars | None  #: Bars of what bodies that follow the motion add; None without such bodies.
    failed_rows: float  #: Share of the frames of all samples that have no result.
    reasons: str  #: Why, with the numbers of samples.
    knees: KneeBars | None  #: Compressions of knees; None without muscles.

    @property
    def remarks(self) -> list[str]:
        """Sentences on the samples without solution, and on the number of samples if it is too small."""
        sentences = []
        if self.failed:
            sentences.append(
                f"in {self.failed} of {self.samples} samples of the uncertain muscles, some frames have no result "
                f"({self.failed_rows:.2%} of all), and error bars leave them out: {self.reasons}"
            )
        if (worst := float(np.nanmax(self.scatter, initial=0.0))) > LARGEST_SCATTER:
            needed = math.ceil(self.samples * (worst / LARGEST_SCATTER) ** 2 / 100) * 100
            sentences.append(
                f"uncertainty.samples: {self.samples} samples leave the error bars of the largest forces of joints "
                f"uncertain by up to {worst:.1%} (standard error); it falls to {LARGEST_SCATTER:.0%} with about "
                f"{needed}"
            )
        return sentences

    @property
    def told(self) -> str:
        """A sentence for the description of the method."""
        failed = f", of which {self.failed} have frames without result" if self.failed else ""
        return (
            f" Uncertain properties of the person, loads and muscles: {counted(self.samples, 'sample')} of "
            f"{counted(self.scalars, 'scalar')} of {counted(len(self.kinds), 'source')}{failed}."
        )

    def parts(self, of_data: np.ndarray, whole: np.ndarray, excess: np.ndarray) -> dict[str, TableColumn]:
        """Return the parts of the bars of joint forces, by the name of their arrays in the archive.

        Parameters
        ----------
        of_data, whole
            (T, J) squared bars by the data alone, and of the result.
        excess
            (J,) expected excess of the largest forces by noise [N].
        """
        square = self.squares[1]
        safe = np.where(whole == 0, 1.0, whole)  # nan where the bars are not known
        rows = [of_data / safe, *(self.shares * (square / safe)), (1.0 - np.sum(self.shares, axis=0)) * (square / safe)]
        kinds = [kind for kind in KINDS if kind != "devices" or self.added is not None]
        by_kind = {kind: np.sqrt(self.share_of(kind) * square) for kind in kinds}
        words = {"person": "the person"}
        what = "error of the largest reaction_force over the motion by person and muscles"
        more = "expected excess of the largest reaction_force over the true one"
        share = "share of the source in the square of reaction_error, nan where unknown"
        sources = np.array([OF_DATA, *self.kinds, INTERACTIONS], object)
        return {
            "reaction_error_data": TableColumn(np.sqrt(of_data), _TJ, "N", "part of reaction_error by the data"),
            **{
                f"reaction_error_{kind}": TableColumn(x, _TJ, "N", f"part of reaction_error by {words.get(kind, kind)}")
                for kind, x in by_kind.items()
            },
            **self._added_parts(),
            "reaction_peak_error": TableColumn(self.peaks, ("joint",), "N", what),
            "reaction_peak_bias": TableColumn(self.peak_bias + excess, ("joint",), "N", more),
            "source": TableColumn(sources, ("source",), "1", "name of the source of uncertainty"),
            "contribution": TableColumn(np.array(rows), ("source", *_TJ), "1", share),
        }

    def _added_parts(self) -> dict[str, TableColumn]:
        if self.added is None:
            return {}
        noise = "by all sources but the noise"
        without = "error of followers/reaction_force_without, not by noise"
        added = f"error of what devices add to reaction_force {noise}"
        what = f"error of the largest followers/reaction_force_without, {noise}"
        change = f"errors of the changes of the largest and the mean force, and of the largest added force, {noise}"
        return {
            "reaction_without_error": TableColumn(self.added.without, _TJ, "N", without),
            "reaction_added_error": TableColumn(self.added.added, _TJ, "N", added),
            "reaction_without_peak_error": TableColumn(self.added.largest_without, ("joint",), "N", what),
            "change": TableColumn(np.array(CHANGES, object), ("change",), "1", "what devices change"),
            "reaction_change_error": TableColumn(self.added.changes, ("change", "joint"), "N", change),
        }

    def share_of(self, kind: Kind) -> np.ndarray:
        """Return the share (T, J) of a kind of sources in the squared bars; interactions are divided among the kinds in
        proportion.
        """
        own = [np.sum(self.shares[[kind == each for kind in self.kinds.values()]], axis=0) for each in KINDS]
        own = [np.maximum(one, 0.0) for one in own]
        whole = np.sum(own, axis=0)
        return np.asarray(own[KINDS.index(kind)] / np.where(whole > 0, whole, 1.0))


def uncertain_result(result: Inverse, random: np.random.Generator) -> UncertainResult | None:
    """Return the effects of the uncertain scalars of a result; None if its spec states none. Raise MbdkitError if the
    result does not exist for a scalar that is changed by its standard deviation.
    """
    if not (sources := sources_of(result.problem)):
        return None
    asked = asked_uncertainty(result.problem)
    assert asked is not None
    stacked = StackedOutcomes(result, sources)
    nominal = stacked.at(np.zeros((1, len(sources))))
    values = drawn(sources, asked.samples, random)
    sampled = stacked.at(values)
    actuators, reactions, _, muscles = (one - own for one, own in zip(sampled[:-1], nominal[:-1], strict=True))
    force = reactions[..., :2]
    sizes, changes = (np.linalg.norm(one[..., :2], axis=-1) for one in (sampled.reactions, reactions))
    moves = np.sum(stacked.moves * stacked.moves, axis=0) * quantile(1.0)
    squares = [
        _bound(np.abs(actuators)) ** 2,
        _bound(changes) ** 2,
        _bound(np.abs(reactions[..., 2])) ** 2,
        moves[..., :3],
        moves[..., 3:],
        _bound(np.abs(muscles)) ** 2,
    ]
    largest, at = np.max(sizes, axis=1), np.argmax(np.linalg.norm(nominal.reactions[0, ..., :2], axis=-1), axis=0)
    kinds = {source.group: source.kind for source in sources}
    shares, bias = _shares(stacked, sources, nominal, force, [*kinds])
    peaks = _bound(np.abs(largest - np.nanmedian(largest, axis=0)))
    failed, added = sampled.lost > 0, _added(result, sources, values, sampled.reactions, nominal.reactions)
    counts = [int(np.sum((sampled.lost == number).any(axis=1))) for number in range(1, 1 + len(LOST))]
    reasons = listed([f"{one} in {count}" for one, count in zip(LOST, counts, strict=True) if count], "and")
    failures = int(np.sum(failed.any(axis=1))), added, float(np.mean(failed)), reasons
    scatter = _scatter(changes[:, at, np.arange(len(at))])
    knees = None if result.recruited is None else KneeBars.of(stacked, sampled, values)
    return UncertainResult(squares, peaks, bias, scatter, kinds, shares, len(sources), len(values), *failures, knees)


def _added(
    result: Inverse, sources: Sequence[UncertainScalar], values: np.ndarray, reactions: np.ndarray, nominal: np.ndarray
) -> AddedBars | None:
    """Return the bars of what bodies that follow the motion add, given the reactions (S, T, J, 3) with them for values
    (S, K) of the scalars, and those (1, T, J, 3) of the result; None without such bodies.
    """
    if not result.problem.followers:
        return None
    stacked = StackedOutcomes(without_followers(result), sources)
    own = [stacked.at(numbers).reactions for numbers in (values, np.zeros((1, len(sources))))]
    sampled, plain = ((one[..., :2], other[..., :2]) for one, other in zip((reactions, nominal), own, strict=True))
    of_without = _bound(np.linalg.norm(sampled[1] - plain[1], axis=-1))
    of_added = _bound(np.linalg.norm((sampled[0] - sampled[1]) - (plain[0] - plain[1]), axis=-1))
    sizes, nominal_sizes = (_changes(*pair, result.motion.time) for pair in (sampled, plain))
    largest, *changes = (_bound(np.abs(x - y)) for x, y in zip(sizes, nominal_sizes, strict=True))
    return AddedBars(of_without, of_added, largest, np.stack(changes))


def _changes(force: np.ndarray, without: np.ndarray, time: np.ndarray) -> list[np.ndarray]:
    """Return numbers (S, J) of forces (S, T, J, 2) with and without further bodies: the largest force without, and the
    changes in the order of `CHANGES`.
    """
    first, second, added = (np.linalg.norm(one, axis=-1) for one in (force, without, force - without))
    mean = np.trapezoid(first - second, time, axis=1) / (time[-1] - time[0])
    largest = np.max(second, axis=1)
    return [largest, np.max(first, axis=1) - largest, mean, np.max(added, axis=1)]


def _scatter(sizes: np.ndarray) -> np.ndarray:
    """Return relative standard errors (...) of the bounds of magnitudes (S, ...).

    The share of n samples below a quantile has the standard deviation ``sqrt(LEVEL (1 - LEVEL) / n)``; half the
    distance of the quantiles that differ by it is the standard error (Woodruff 1952). It is that of the first half of
    the samples, which are independent, divided by the root of 2, and at least that of Gaussian changes.
    """
    half = sizes[: len(sizes) // 2]
    shift = np.sqrt(LEVEL * (1.0 - LEVEL) / len(half))
    low, middle, high = (_bound(half, level) for level in (LEVEL - shift, LEVEL, min(1.0, LEVEL + shift)))
    scatter = (high - low) / (np.sqrt(8.0) * np.where(middle > 0, middle, 1.0))
    return np.where(middle > 0, np.maximum(scatter, GAUSSIAN / np.sqrt(len(sizes))), 0.0)


def _bound(sizes: np.ndarray, level: float = LEVEL) -> np.ndarray:
    """Return the quantile (...) of magnitudes (S, ...); nan where more than half of them are nan.

    With S samples, the probability of the k-th smallest one is ``k / (S + 1)`` on average.
    """
    known = np.sum(np.isfinite(sizes), axis=0)
    ordered = np.sort(sizes, axis=0)
    place = np.clip(level * (known + 1) - 1, 0, np.maximum(known - 1, 0))
    low = np.floor(place).astype(int)
    high = np.minimum(low + 1, np.maximum(known - 1, 0))
    first, second = (np.take_along_axis(ordered, one[None], axis=0)[0] for one in (low, high))
    return np.asarray(np.where(2 * known >= len(sizes), first + (place - low) * (second - first), np.nan))


def drawn(sources: Sequence[UncertainScalar], samples: int, random: np.random.Generator) -> np.ndarray:
    """Return values (S, K) of the scalars of samples; S is even.

    Scalars with a range have each of their levels equally often. If there are fewer than twice as many samples as
    scalars, normal scalars are not orthogonal.
    """
    half = -(-samples // 2)
    values = np.zeros((2 * half, len(sources)))
    normal = [index for index, source in enumerate(sources) if source.span is None]
    own = random.standard_normal((half, len(normal)))
    if len(normal) < half:
        for column in range(len(normal)):  # Gram-Schmidt, modified
            own[:, column] *= np.sqrt(half / np.sum(own[:, column] * own[:, column]))
            share = product(own[:, column + 1 :].T, own[:, column]) / half
            own[:, column + 1 :] -= own[:, column, None] * share
    values[:, normal] = np.concatenate([own, -own])
    for index, source in enumerate(sources):
        if source.span is not None:
            values[:, index] = source.levels[random.permutation(2 * half) % LEVELS]
    return values


def _shares(
    stacked: StackedOutcomes,
    sources: Sequence[UncertainScalar],
    nominal: Outcomes,
    force: np.ndarray,
    groups: Sequence[str],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares (G, T, J) of groups in the mean squares of changes `force` (S, T, J, 2), and expected excesses
    (J,) of the largest forces; see the module.
    """
    known = np.isfinite(force)
    number = np.maximum(np.sum(known, axis=0), 1)
    mean = np.sum(np.where(known, force, 0.0), axis=0) / number
    square = np.sum(np.sum(np.where(known, force * force, 0.0), axis=0) / number, axis=-1)
    safe = np.where(square > 0, square, 1.0)
    result, excess = np.zeros((len(groups), *square.shape)), np.zeros(square.shape[1])
    largest = np.max(np.linalg.norm(nominal.reactions[0, ..., :2], axis=-1), axis=0)
    for source, weights, changed in _alone(stacked, sources):
        more = np.max(np.nan_to_num(np.linalg.norm(changed, axis=-1)), axis=1) - largest
        excess += (1.0 if source.kind == "person" else -1.0) * np.sum(weights[:, None] * more, axis=0)
        change = np.nan_to_num(changed - nominal.reactions[..., :2])
        weighted = weights[:, None, None, None] * change
        own, own_square = np.sum(weighted, axis=0), np.sum(np.sum(weighted * change, axis=0), axis=-1)
        result[groups.index(source.group)] += (own_square + np.sum(own * (mean - own), axis=-1)) / safe
    return result, excess


def _alone(
    stacked: StackedOutcomes, sources: Sequence[UncertainScalar]
) -> Iterator[tuple[UncertainScalar, np.ndarray, np.ndarray]]:
    """Yield each scalar with the weights (N,) and the forces (N, T, J, 2) of its nodes."""
    units = zip(np.eye(len(sources)), sources, strict=True)
    values = np.array([value * unit for unit, one in units for value, _ in one.nodes])
    every, begin = stacked.at(values).reactions[..., :2], 0
    for source in sources:
        weights = np.array([weight for _, weight in source.nodes])
        yield source, weights, every[begin : begin + len(weights)]
        begin += len(weights)
