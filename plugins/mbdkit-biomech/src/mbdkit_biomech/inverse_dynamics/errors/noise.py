"""Noise of measured data: its propagation through fit and smoothing to first order, and its estimation from residuals.

The fit is linearised at the fitted poses; smoothing with fixed parameters is linear in the data.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.linear_systems import product, products
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.motion.manifold import Directions, Quantities
from mbdkit_biomech.inverse_dynamics.motion.measured import bridged
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Independent
from mbdkit_biomech.inverse_dynamics.motion.smoothing import (
    FEWEST,
    Smoothed,
    fixed,
    local_derivatives,
    smoothed_each,
    with_cutoff,
)
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import ErrorBars, Gaps, Smoothing

CUBIC = Gaps(longest=1.0)  #: Gaps that cubic splines fill.

#: Number of noise samples per column used to estimate the share of the noise that remains in the residuals.
DRAWS = 20

#: Number of iterations of the method that attributes the residuals to the noise of the columns.
ITERATIONS = 500

#: The noise of a column can be estimated if at least this share of it remains in the residuals.
LEAST_SHARE = 0.01

NUMBERS_AT_ONCE = 4_000_000  #: Largest number of noise values that are smoothed together.


CUTOFFS = (0.8, 1.25)  #: The result is compared with results whose cutoff is multiplied by these factors.


class NoisePath:
    """The effect of small changes of the data on the smoothed coordinates and on the residuals.

    Parameters
    ----------
    result
        The result, with U independent coordinates and K observed quantities.
    independent
        Independent coordinates of the result.
    how
        Smoothing of each coordinate, with fixed parameters.
    """

    def __init__(self, result: Inverse, independent: Independent, how: Sequence[Smoothing]):
        self._time, self._how = result.motion.time, tuple(how)
        self._missing = np.isnan(result.fitted.measured.raw)
        self._person, self._names = result.problem.source.person, result.fitted.measured.names
        manifold, target, q = result.problem.fitter.manifold, result.fitted.measured.target, result.fitted.q
        directions = manifold.directions_at(target.time, q)
        observed, coordinates = target.quantities.jacobian(q), independent.quantities.jacobian(q)
        moved = _solved(directions, observed * target.root_weight[:, None], np.diag(target.root_weight))
        self._fitted = products(coordinates, moved)  # (T, U, K)
        self._placed = placed = result.fitted.placed
        if placed is not None:  # effect of noise on the values according to the other columns, (R, K, K)
            own, weight = directions.rows(placed.rows), placed.root_weight[..., None]
            seen = observed[placed.rows]
            self._predicted = products(seen, _solved(own, seen * weight, weight * np.eye(seen.shape[1])))
        self._q, self._intervals = q, independent.intervals
        self._follow = np.zeros((len(q), manifold.n, len(independent.names)))
        for begin, end, places in independent.intervals:
            rows, columns = slice(begin, end), list(places)
            own = directions.rows(rows)
            self._follow[rows][:, :, columns] = _solved(own, coordinates[rows][:, columns], np.eye(len(columns)))
        self._seen = products(observed, self._follow)

    @property
    def columns(self) -> int:
        """Number of observed quantities."""
        return int(self._fitted.shape[2])

    def smoothed(self, noise: np.ndarray, how: Sequence[Smoothing] | None = None) -> Smoothed:
        """Return the changes (T, U, S) of the coordinates and their derivatives due to noise (T, K, S) of the data.

        Parameters
        ----------
        how
            Smoothing of each coordinate that replaces the one of the result.
        """
        return smoothed_each(self._time, products(self._fitted, noise), self._how if how is None else how)

    def residual(self, noise: np.ndarray) -> np.ndarray:
        """Return the changes (T, K, S) that noise causes in the differences between data and smoothed motion."""
        return np.asarray(noise - products(self._seen, self.smoothed(noise).value))

    def smoothed_as(self, quantities: Quantities, noise: np.ndarray) -> Smoothed:
        """Return the changes (T, Q, S) of other quantities and their derivatives due to noise (T, K, S) of the data."""
        x, by = self.smoothed(noise), products(quantities.jacobian(self._q), self._follow)
        rate, bend = np.zeros((2, *by.shape))
        for begin, end, _ in self._intervals:
            if end - begin >= FEWEST:
                own = by[begin:end]
                slopes = local_derivatives(self._time[begin:end], own.reshape(len(own), -1))
                rate[begin:end], bend[begin:end] = (part.reshape(own.shape) for part in slopes)
        speed = products(by, x.rate) + products(rate, x.value)
        bending = products(by, x.acceleration) + products(2 * rate, x.rate) + products(bend, x.value)
        return Smoothed(products(by, x.value), speed, bending)

    def samples(self, deviation: np.ndarray, count: int, random: np.random.Generator) -> Iterator[np.ndarray]:
        """Yield blocks (T, K, S) of Gaussian noise, independent at each time, with `count` samples in total.

        In gaps, the noise is that of the values that fill them, due to the noise of the samples from which these values
        are computed. Straight lines are corrected by cubic splines (`changes_of_lines`), whose noise it then is.

        Parameters
        ----------
        deviation
            (K,) standard deviations.
        """
        rows = len(self._time)
        most = max(1, NUMBERS_AT_ONCE // (rows * max(1, self.columns)))
        for begin in range(0, count, most):
            noise = random.standard_normal((rows, self.columns, min(most, count - begin))) * deviation[:, None]
            for column in np.flatnonzero(np.any(self._missing, axis=0)):
                noise[:, column] = bridged(self._time, noise[:, column], self._missing[:, column], CUBIC)
            if self._placed is not None:
                predicted = products(self._predicted, noise[self._placed.rows])
                for gap in self._placed.gaps:
                    own = predicted[self._placed.of(gap), gap.column]
                    beside = noise[[gap.first - 1, gap.last], gap.column]
                    noise[gap.first : gap.last, gap.column] = gap.filled(self._time, own, beside)
            yield noise

    def white(self, noise: Noise, residual: np.ndarray) -> np.ndarray:
        """Return the standard deviations (K,) of the noise that is independent from sample to sample.

        For a person, residuals contain artefacts of the markers and errors of joint centres, which change slowly. The
        noise is then at most what second differences of the residuals (T, K) show: their variance is 6 times its own.
        """
        if self._person is None:
            return noise.deviation
        bend = residual[2:] - 2.0 * residual[1:-1] + residual[:-2]
        known = ~np.isnan(bend)
        square = np.sum(np.where(known, bend * bend, 0.0), axis=0) / np.maximum(np.sum(known, axis=0), 1)
        return np.asarray(np.minimum(noise.deviation, np.sqrt(square / 6.0)))

    def artefacts(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return changes (T, K, `count`) of the data by artefacts of the markers of a person, which are correlated in
        time; zero without a person.

        The correlation is that of moving averages of white noise. Their weights are ``r(sqrt(2) l)`` at the lag l for
        the correlation r of the artefacts, which is exact for Gaussian functions.
        """
        values = np.zeros((len(self._time), self.columns, count))
        if self._person is None:
            return values
        columns = list(self._person.columns)
        chosen = [columns.index(name) for name in self._names]
        for body, shifts in self._person.shifts.items():
            correlation = self._person.artefacts[body].correlation
            lags = np.arange(len(correlation))
            side = np.interp(np.sqrt(2.0) * lags, lags, correlation, right=0.0)
            weights = np.concatenate([side[:0:-1], side])
            weights = weights / np.sqrt(np.sum(weights * weights))
            white = random.standard_normal((len(self._time) + len(weights) - 1, shifts.shape[1] * count))
            rows = len(self._time)
            series = sum(weight * white[lag : lag + rows] for lag, weight in enumerate(weights.tolist()))
            values += products(shifts[chosen], np.asarray(series).reshape(rows, shifts.shape[1], count))
        return values


def _solved(directions: Directions, observed: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the displacements (T, n, K) along the manifold that change `observed` (T, k, n) by `values`, (k, K) or
    (T, k, K).
    """
    rows = np.zeros((len(observed), directions.triangle.shape[1]))
    columns = [
        directions.least_squares(rows, observed, np.broadcast_to(one, observed.shape[:2]))
        for one in np.moveaxis(values, -1, 0)
    ]
    return np.stack(columns, axis=2) if columns else np.zeros((*observed.shape[::2], 0))


class Noise(NamedTuple):
    """Standard deviations of the noise of K observed quantities.

    Attributes
    ----------
    deviation
        (K,) the stated deviations and, for other quantities, those seen in the residuals; nan if neither is known.
    seen
        (K,) deviations that the residuals show if none is stated; nan if the noise does not appear in the residuals.
    excess
        (K,) ratios of the root mean square residuals that are expected with `deviation` to the actual ones.
    """

    deviation: np.ndarray
    seen: np.ndarray
    excess: np.ndarray


def noise_of(path: NoisePath, residual: np.ndarray, stated: np.ndarray, random: np.random.Generator) -> Noise:
    """Return the standard deviations of the noise, stated or estimated from the residuals.

    A part of the noise remains in the smoothed motion, the rest in the residuals. Samples show how much noise of each
    column appears in the residuals of each column.

    Parameters
    ----------
    residual
        (T, K) differences between data and smoothed motion; nan in gaps.
    stated
        (K,) deviations that are known; nan for the others.
    """
    known_rows = ~np.isnan(residual)
    # entry [i, j]: mean square of the residuals of quantity i due to the noise of quantity j
    share = np.empty((path.columns, path.columns))
    for index in range(path.columns):
        one = np.zeros(path.columns)
        one[index] = 1.0
        squares = [np.sum(path.residual(noise) ** 2, axis=2) for noise in path.samples(one, DRAWS, random)]
        share[:, index] = np.mean(np.sum(squares, axis=0), axis=0, where=known_rows) / DRAWS
    actual = np.nanmean(residual**2, axis=0)
    deviation, seen = _estimated(share, actual, stated), _estimated(share, actual, np.full_like(stated, np.nan))
    expected = product(share, np.nan_to_num(deviation) ** 2)
    excess = np.sqrt(np.divide(expected, actual, out=np.full_like(actual, np.inf), where=actual > 0))
    return Noise(deviation, seen, excess)


def _estimated(share: np.ndarray, actual: np.ndarray, stated: np.ndarray) -> np.ndarray:
    """Return deviations (K,), those that are stated or those for which the expected mean squares of all residuals equal
    the actual ones; nan for columns that have neither.

    Richardson-Lucy iteration keeps the variances positive and distributes them evenly over columns that the residuals
    cannot distinguish.

    Parameters
    ----------
    share
        (K, K) mean squares of the residuals of each column due to noise of each column with a deviation of 1.
    actual
        (K,) mean squares of the residuals.
    stated
        (K,) deviations that are known; nan for the others.
    """
    known = ~np.isnan(stated)
    seen = ~known & (np.sum(share, axis=0) > LEAST_SHARE)
    variance = np.where(known, stated, 0.0) ** 2
    if np.any(seen) and np.any(actual > 0):
        given, rest = product(share[:, known], variance[known]), share[:, seen]
        result = np.full(int(np.sum(seen)), max(0.0, np.sum(actual - given)) / np.sum(rest))
        for _ in range(ITERATIONS):
            expected = given + product(rest, result)
            ratio = np.divide(actual, expected, out=np.zeros_like(actual), where=expected > 0)
            result = result * product(rest.T, ratio) / np.sum(rest, axis=0)
        variance[seen] = result
    return np.asarray(np.where(known | seen, np.sqrt(variance), np.nan))


class NoisyData(NamedTuple):
    """The coordinates of a result before and after smoothing, and the noise of its data.

    Attributes
    ----------
    asked
        How errors are estimated.
    time
        (T,) [s].
    independent
        The independent coordinates.
    coordinates, series
        (T, U) values before smoothing, and after.
    how
        Smoothing of each coordinate, with fixed parameters; the same method for all of them.
    path
        Propagation of noise.
    noise
        Noise of the observed quantities.
    deviation
        (K,) standard deviations of its part that is independent from sample to sample.
    random
        Generator of all samples.
    """

    asked: ErrorBars
    time: np.ndarray
    independent: Independent
    coordinates: np.ndarray
    series: Smoothed
    how: list[Smoothing]
    path: NoisePath
    noise: Noise
    deviation: np.ndarray
    random: np.random.Generator

    @classmethod
    def of(cls, result: Inverse) -> NoisyData | None:
        """Return the data of a result; None if no error bars are requested, if derivatives are part of the data, or if
        the noise of a column is neither stated nor can be estimated from the residuals.
        """
        spec, independent = result.problem.spec, result.independent
        asked = spec.motion.errors
        if asked == "none" or independent is None or not independent.names:
            return None
        random = np.random.default_rng(asked.seed)
        measured, time = result.fitted.measured, result.motion.time
        coordinates = independent.quantities.values(result.fitted.q)
        how = fixed(time, coordinates, spec.motion.smooth)
        path = NoisePath(result, independent, how)
        left = measured.raw - measured.quantities.values(result.motion.q)
        noise = noise_of(path, left, measured.deviation, random)
        deviation = path.white(noise, left)
        if np.any(np.isnan(deviation)):
            return None
        series = smoothed_each(time, coordinates, how)
        return cls(asked, time, independent, coordinates, series, how, path, noise, deviation, random)

    def samples(self, count: int) -> Iterator[np.ndarray]:
        """Yield blocks (T, K, S) of noise with artefacts of markers, with `count` samples in total."""
        for white in self.path.samples(self.deviation, count, self.random):
            yield white + self.path.artefacts(white.shape[2], self.random)

    def other_cutoffs(self) -> Iterator[tuple[float, list[Smoothing], Smoothed]]:
        """Yield those of the factors `CUTOFFS` that the sampling rate allows, the smoothing, and the coordinates."""
        for factor in CUTOFFS:
            how = [with_cutoff(one, factor) or one for one in self.how]
            if how != self.how:
                with suppress(SpecError):  # the cutoff is too high for the sampling rate
                    yield factor, how, smoothed_each(self.time, self.coordinates, how)
