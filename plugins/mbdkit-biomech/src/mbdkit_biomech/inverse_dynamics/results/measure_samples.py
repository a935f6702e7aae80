"""Errors of measures of inverse dynamics, by samples of noise, of the person and its muscles, and by other cutoffs.

The error bars of `mbdkit_biomech.inverse_dynamics.errors.error_bars` hold at single times, while a measure depends on
all times.
Measures are therefore computed again from noisy motions and loads, whose accelerations at both ends are drawn too.
Errors are unknown if long gaps may hide changes of a measure. The same seed gives the same noise, which cancels in the
difference of two results for one motion, such as those with and without a device.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import RunError
from mbdkit.engine.linear_systems import product
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem, compute, forces_of
from mbdkit_biomech.inverse_dynamics.errors.ends_and_gaps import (
    changes_at_ends,
    changes_in_gaps,
    changes_of_lines,
    long_gaps,
)
from mbdkit_biomech.inverse_dynamics.errors.error_bars import HIDDEN
from mbdkit_biomech.inverse_dynamics.errors.noise import NoisyData
from mbdkit_biomech.inverse_dynamics.loads.loads import LoadSeries
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Independent, motion_of_series
from mbdkit_biomech.inverse_dynamics.motion.smoothing import Smoothed
from mbdkit_biomech.inverse_dynamics.results.record import run_of
from mbdkit_biomech.inverse_dynamics.signals.chi_square import quantile
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_biomech.uncertainty.changed_problem import Changer
from mbdkit_biomech.uncertainty.sources import change_of, sources_of
from mbdkit_biomech.uncertainty.uncertain_result import drawn

#: Number of samples; with this number, the relative scatter of the bounds is 1 / sqrt(2 * SAMPLES), 11 %.
SAMPLES = 40

UNCERTAIN_SAMPLES = 60  #: Number of samples of the person and its muscles, each of which is computed exactly.

HIDDEN_SAMPLES = 8  #: Number of samples of what long gaps may hide.

#: Number of results whose samples are kept: designs ask twice for those of the start and of the best point.
MOST_KEPT = 4

FACTOR = float(quantile(1.0))  #: Ratio of the squared bound of a Gaussian variable to its mean square.

#: Ratio of the bias that the noise of the data causes to the mean change that further noise causes.
#:
#: Noise always increases a largest value or a root mean square. If noise dominates, these are proportional to its
#: standard deviation, which the samples increase by a factor of sqrt(2). If noise is small, the ratio is 1 or so; the
#: bias is then small compared with the scatter.
FIRST_NOISE = 1.0 / (np.sqrt(2.0) - 1.0)


_latest: dict[tuple[object, ...], SampledMeasures] = {}  #: Latest samples by all that determines them.


class SampledMeasures(NamedTuple):
    """Measures of inverse dynamics for the data, for noisy data, for other cutoffs, and for other persons and muscles.

    Attributes
    ----------
    value
        (..., K) measures for the data.
    noisy
        (S, ..., K) measures with noise added to the data.
    cutoffs
        (C, ..., K) measures with other cutoffs; C may be 0.
    uncertain
        (P, ..., K) measures with other uncertain properties of the person and its muscles; P may be 0.
    straight
        (1, ..., K) measures after `changes_of_lines`; (0, ..., K) without gaps that straight lines fill.
    """

    value: np.ndarray
    noisy: np.ndarray
    cutoffs: np.ndarray
    uncertain: np.ndarray
    straight: np.ndarray

    def minus(self, other: SampledMeasures) -> SampledMeasures:
        """Return the differences between two results, sample by sample, for the same noise, cutoffs, persons and
        muscles.
        """
        return SampledMeasures(*(own - their for own, their in zip(self, other, strict=True)))

    def bounds(self) -> np.ndarray:
        """Return the bounds (..., K) of the errors, which hold with the probability `LEVEL`; nan if they are unknown.

        The bounds are root sums of squares of the effects of noise, person and muscles, and cutoffs. The effect of
        noise is the bound of the scatter of the measure plus its bias, which is `FIRST_NOISE` times the mean change.
        The square of the effect of person and muscles is `FACTOR` times the mean square change, which contains the
        bias; for cutoffs, it is the mean square change itself. Samples that are nan, because the muscles cannot produce
        the motion, are ignored. The bounds are nan if these are more than half of the samples.
        """
        square = np.zeros_like(self.value)
        if len(self.noisy):
            change = self.noisy - self.value
            mean, number = known_mean(change), np.sum(np.isfinite(change), axis=0)
            variance = known_mean((change - mean) ** 2)
            bias = FIRST_NOISE * np.sqrt(np.maximum(0.0, mean**2 - variance / np.maximum(1, number)))
            square = (bias + np.sqrt(FACTOR * variance)) ** 2
        for factor, samples in ((FACTOR, self.uncertain), (1.0, self.cutoffs), (1.0, self.straight)):
            if len(samples):
                square = square + factor * known_mean((samples - self.value) ** 2)
        return np.asarray(np.sqrt(square))


def errors_of_measures(result: Inverse) -> dict[str, float]:
    """Return the bounds of the errors of all measures of a result by name, in the units of the measures; empty if the
    bounds are unknown.
    """
    names = [measure.name for measure in result.problem.spec.defined_measures()]
    samples = samples_of(result, names) if names else None
    return {} if samples is None else dict(zip(names, samples.bounds().tolist(), strict=True))


def sampled_measures(spec: InverseSpec, measures: Sequence[str]) -> SampledMeasures | None:
    """Return K measures of a spec, given by their names, with their samples; see `samples_of`.

    Raises
    ------
    MbdkitError
        If the computation fails for the data.
    """
    return samples_of(compute(InverseProblem.of(spec)), measures)


def samples_of(result: Inverse, measures: Sequence[str]) -> SampledMeasures | None:
    """Return K measures of a result, given by their names, with their samples.

    Returns
    -------
    SampledMeasures or None
        None if no error bars are requested, if derivatives are part of the data, or if the noise of a column is neither
        stated nor can be estimated from the residuals.
    """
    if (data := NoisyData.of(result)) is None:
        return None
    value = _measured(result, measures)
    numbers, spec = (SAMPLES, UNCERTAIN_SAMPLES, HIDDEN_SAMPLES), result.problem.spec.canonical_json()
    key = numbers, spec, *measures, result.motion.q.tobytes(), value.tobytes()
    if (found := _latest.get(key)) is None:
        found = _samples_of(result, measures, data, value)
        if len(_latest) >= MOST_KEPT:
            _latest.clear()
        _latest[key] = found
    return found


def _samples_of(result: Inverse, measures: Sequence[str], data: NoisyData, value: np.ndarray) -> SampledMeasures:
    own, gaps = result.problem.loads, long_gaps(result)

    def measured(series: Smoothed, loads: dict[str, LoadSeries]) -> np.ndarray:
        return _measured(_moved(result, data.independent, series, loads), measures)

    noisy = [measured(*moved) for moved in _noisy(data, own)]
    of_lines = changes_of_lines(result, data.path)
    straight = [measured(_added(data.series, of_lines, one), own) for one in np.eye(of_lines.value.shape[2])]
    others = [measured(series, own) for _, _, series in data.other_cutoffs()]
    samples = noisy, others, [*_uncertain(result, measures, data.random)], straight
    found = SampledMeasures(value, *(np.array(sample).reshape(len(sample), len(value)) for sample in samples))
    change = changes_in_gaps(result, data.path, gaps)
    for _ in range(HIDDEN_SAMPLES if gaps else 0):
        phase = data.random.uniform(0.0, 2 * np.pi, len(gaps))
        shares = np.stack([elementary.cos(phase), elementary.sin(phase)], axis=1).ravel()
        hidden = measured(_added(data.series, change, shares), own)
        found.noisy[:, np.abs(hidden - value) > HIDDEN * found.bounds()] = np.nan
    return found


def _noisy(data: NoisyData, loads: Mapping[str, LoadSeries]) -> Iterator[tuple[Smoothed, dict[str, LoadSeries]]]:
    """Yield samples of the coordinates, with noise and with changes at both ends, and of the loads."""
    at_ends = changes_at_ends(data)
    for block in data.samples(SAMPLES):
        change = data.path.smoothed(block)
        for own in np.eye(block.shape[2]):
            ends = data.random.uniform(-1.0, 1.0, at_ends.value.shape[2:])
            moved = _added(_added(data.series, change, own), at_ends, ends)
            yield moved, {name: load.with_noise(data.random) for name, load in loads.items()}


def _uncertain(result: Inverse, measures: Sequence[str], random: np.random.Generator) -> Iterator[np.ndarray]:
    """Yield the measures (K,) for samples of the person and its muscles; nan where they cannot be computed, for example
    because a tendon is longer than its path.
    """
    sources = sources_of(result.problem)
    changer = Changer(result)
    for values in drawn(sources, UNCERTAIN_SAMPLES, random) if sources else ():
        try:
            yield _measured(changer.at(change_of(sources, values)).forces(), measures)
        except RunError:
            yield np.full(len(measures), np.nan)


def known_mean(samples: np.ndarray) -> np.ndarray:
    """Return the mean (...) over the finite samples of (S, ...); nan where more than half of them are not finite."""
    known = np.isfinite(samples)
    number = np.sum(known, axis=0)
    total = np.sum(np.where(known, samples, 0.0), axis=0)
    return np.asarray(np.where(2 * number >= len(samples), total / np.maximum(number, 1), np.nan))


def _added(series: Smoothed, changes: Smoothed, shares: np.ndarray) -> Smoothed:
    """Return series (T, U) plus changes (T, U, C) times `shares` (C,)."""
    return Smoothed(*(part + product(change, shares) for part, change in zip(series, changes, strict=True)))


def _moved(result: Inverse, independent: Independent, series: Smoothed, loads: dict[str, LoadSeries]) -> Inverse:
    """Return the result for other coordinates and loads; tensions are nan in frames that muscles cannot produce."""
    problem = replace(result.problem, loads=loads)
    motion = motion_of_series(problem.fitter, independent, result.motion.time, result.motion.q, series)
    return forces_of(problem, result.fitted, independent, motion, strict=False)


def _measured(result: Inverse, measures: Sequence[str]) -> np.ndarray:
    with run_of(result) as run:
        return np.array([run.measures[name] for name in measures])
