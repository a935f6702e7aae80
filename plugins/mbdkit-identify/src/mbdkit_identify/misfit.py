"""Whether a fitted model is right, and if not, where it is wrong.

An effect that the model lacks changes the predicted values along its derivatives. A test of each effect compares the
likelihoods of the model with and without it, to first order, as score tests do (C. R. Rao, Proc. Cambridge Philos. Soc.
44, 1948, 50-57), but with the noise estimated in both: otherwise, a misfit would count as correlated noise, and
hide itself. Further tests compare the residuals with white noise (G. M. Ljung, G. E. P. Box, Biometrika 65, 1978,
297-303) and with the deviations that were stated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from mbdkit.plugin import listed
from mbdkit_identify.estimation import Fit
from mbdkit_identify.identification import Doubt, Residuals
from mbdkit_identify.noise import Noise
from mbdkit_identify.probes import Probe
from mbdkit_identify.problem import Problem

LEVEL = 0.005  #: Probability that the tests of one kind doubt a right model.
INSIDE = 1e-4  #: Effects of which the parameters of the model explain all but this share are not tested.
#: Directions of the Jacobian with singular values below this share of the largest are rounding errors.
SINGULAR = 1e-10
ALIKE = 0.15  #: Effects whose statistics differ by less than this share explain the misfit almost equally well.
MOST_ALIKE = 4  #: Largest number of such effects that are named.
MOST_PLACES = 3  #: Largest number of effects that are found one after the other.
#: Later effects have a statistic of at least this share of the first one's; less may be due to its nonlinearity.
REST = 0.2
LAGS = 20  #: Number of correlations of which whiteness is the absence.
FAR = 3.0  #: Root mean square of the errors of a prediction, relative to their deviation, that is far above 1.
ROUNDS = 6  #: Number of times that the noise is estimated with an effect.
#: Smallest deviation of noise in units of the one of the fit, which differs from 1 for data without noise.
SMALLEST = 1e-3
#: Relative difference between jumps of residuals and a whole turn, within which a column counts as wrapped.
WRAPPED = 0.2
LITTLE = 0.1  #: Share of the deviation of the data below which the deviation of a fit is no motion.
#: Root mean square of residuals, in deviations that follow from their median, above which few values determine it.
OUTLYING = 5.0
WITHOUT_NOISE = 1e-6  #: Residuals below this share of the deviation of the data are not noise.
CORRELATIONS = (-0.95, 0.999)  #: Smallest and largest correlation of noise from sample to sample.


@dataclass(frozen=True)
class _Signal:
    """Products of the columns of a signal: derivatives and residuals, the last column.

    With autoregressive noise, the sum of squares of whitened columns combines products of columns with themselves and
    with those one sample before, so that the noise can be estimated again without the columns.

    Attributes
    ----------
    count
        Number of values.
    first
        (C, C) product of the first values.
    steps
        For each number n of samples from one value to the next, which is above 1 at gaps: how often it occurs, and the
        (C, C) products of the later values with themselves, of the later with the earlier values, twice and symmetric,
        and of the earlier values with themselves.
    is_stated, is_white
        Whether the deviation was stated, and whether the noise is assumed to be uncorrelated.
    """

    count: int
    first: np.ndarray
    steps: Mapping[int, tuple[int, np.ndarray, np.ndarray, np.ndarray]]
    is_stated: bool
    is_white: bool

    @staticmethod
    def of(columns: np.ndarray, time: np.ndarray, *, is_stated: bool, is_white: bool) -> _Signal:
        """Return the products of columns (T, C) at given times."""
        intervals = np.diff(time)
        samples = np.maximum(np.rint(intervals / np.median(intervals)), 1).astype(int)
        steps = {}
        for number in np.unique(samples).tolist():
            now, before = columns[1:][samples == number], columns[:-1][samples == number]
            cross = now.T @ before
            steps[number] = len(now), now.T @ now, cross + cross.T, before.T @ before
        return _Signal(len(time), np.outer(columns[0], columns[0]), steps, is_stated, is_white)

    def product(self, correlation: float) -> np.ndarray:
        """Return the products (C, C) of the columns whitened by this correlation."""
        total = self.first
        for number, (_, now, cross, before) in self.steps.items():
            power = correlation**number
            total = total + (now - power * cross + power**2 * before) / (1 - power**2)
        return total

    def noise(self, weights: np.ndarray, present: Noise) -> Noise:
        """Return the noise of the combination of the columns with these weights (C,), by maximum likelihood given the
        first value; its deviation is relative to that of the fit.
        """
        deviation, correlation = present.deviation, present.correlation
        if not self.is_white and 1 in self.steps:
            _, _, cross, before = self.steps[1]
            size = max(float(weights @ before @ weights), SMALLEST**2)
            correlation = float(np.clip(weights @ cross @ weights / (2 * size), *CORRELATIONS))
        if not self.is_stated:
            square = float(weights @ self.product(correlation) @ weights) / self.count
            deviation = max(square, SMALLEST**2) ** 0.5
        return Noise(deviation, correlation)

    def cost(self, weights: np.ndarray, noise: Noise) -> float:
        """Return -2 times the logarithm of the likelihood of this combination of the columns."""
        squares = weights @ self.product(noise.correlation) @ weights / noise.deviation**2
        powers = sum(count * np.log1p(-(noise.correlation ** (2 * n))) for n, (count, *_) in self.steps.items())
        return float(squares + 2 * self.count * np.log(noise.deviation) + powers)


@dataclass(frozen=True)
class _Fit:
    """The most likely combination of some columns, its costs by signal, and the noise."""

    weights: np.ndarray
    costs: np.ndarray
    noise: tuple[Noise, ...]


@dataclass(frozen=True)
class _Effect:
    """An effect that the data ask for.

    Attributes
    ----------
    index, statistic, value
        Its index among the probes, its statistic, and the first estimate of its parameter.
    signal
        The signal that it explains most.
    alike
        Indices of effects that explain the residuals almost as well, best first.
    """

    index: int
    statistic: float
    value: float
    signal: int
    alike: tuple[int, ...]


class EffectTests:
    """Tests of effects that a model lacks.

    Parameters
    ----------
    residuals
        The S fitted signals.
    jacobian, columns
        (R, K) and (R, P) derivatives of the predicted values with respect to the parameters of the model, and to those
        of the effects. The R rows are the values of the signals, one after the other, and priors.
    stated
        (S,) whether the deviation of each signal was stated.
    priors
        Residuals of the priors, divided by their deviations, as the derivatives are.
    limits
        (P,) smallest and largest plausible value of the parameter of each effect.
    bounded
        Number of parameters of the model at a bound, which are the last of the effects: not tested, but free to leave
        their bounds when another effect is added.

    Attributes
    ----------
    distinct
        Indices of the effects that the parameters of the model do not imitate.
    """

    def __init__(
        self, residuals: Sequence[Residuals], jacobian: np.ndarray, columns: np.ndarray, stated: Sequence[bool],
        priors: np.ndarray, limits: Sequence[tuple[float, float]], bounded: int = 0,
    ):  # fmt: skip
        sizes = np.concatenate([np.full(len(one.time), one.deviation) for one in residuals] + [np.ones(len(priors))])
        errors = np.concatenate([*(one.measured - one.fitted for one in residuals), priors]) / sizes
        norms = np.linalg.norm(jacobian / sizes[:, None], axis=0)
        scaled = (jacobian / sizes[:, None])[:, norms > 0] / norms[norms > 0]
        basis, values, _ = np.linalg.svd(scaled, full_matrices=False)
        basis = basis[:, values > SINGULAR * values.max(initial=0.0)]
        columns = columns / sizes[:, None]
        rest = columns - basis @ (basis.T @ columns)
        self._size = np.linalg.norm(rest, axis=0)
        distinct = np.flatnonzero(self._size > INSIDE * np.linalg.norm(columns, axis=0)).tolist()
        tested = len(self._size) - bounded
        self.distinct = [index for index in distinct if index < tested]
        self._bounded = [index for index in distinct if index >= tested]
        every = np.column_stack([basis, rest / np.where(self._size > 0, self._size, 1.0), errors])
        self.count, self._signals, start = basis.shape[1], [], 0
        for one, is_stated in zip(residuals, stated, strict=True):
            end = start + len(one.time)
            signal = _Signal.of(every[start:end], one.time, is_stated=is_stated, is_white=one.correlation == 0.0)
            self._signals.append(signal)
            start = end
        self._priors = every[start:].T @ every[start:]
        self._limits = limits
        self._noise = tuple(Noise(1.0, one.correlation) for one in residuals)

    def _fit(self, effects: Sequence[int], noise: tuple[Noise, ...]) -> _Fit:
        """Return the fit with some effects; `noise` is where the estimate of the noise begins."""
        moved = self._bounded
        for _ in range(ROUNDS):
            used = [*range(self.count), *(self.count + index for index in (*effects, *moved))]
            weights = np.zeros(len(self._priors))
            weights[-1] = 1.0
            normal = self._priors + sum(
                signal.product(one.correlation) / one.deviation**2
                for signal, one in zip(self._signals, noise, strict=True)
            )
            weights[used] = -np.linalg.lstsq(normal[np.ix_(used, used)], normal[used, -1], rcond=None)[0]
            moved = [index for index in moved if self._is_plausible(index, weights)]
            noise = tuple(signal.noise(weights, one) for signal, one in zip(self._signals, noise, strict=True))
        costs = [signal.cost(weights, one) for signal, one in zip(self._signals, noise, strict=True)]
        return _Fit(weights, np.array([*costs, weights @ self._priors @ weights]), noise)

    def statistics(self, added: Sequence[int] = ()) -> tuple[np.ndarray, dict[int, _Fit], _Fit]:
        """Return the statistics (P,) of all effects, the fit with each distinct one, and the fit without them.

        For a right model, each statistic has the chi-squared distribution with one degree of freedom. It is 0 for
        effects that are not distinct, or whose first estimate is not plausible. Effects that were `added` belong to the
        model.
        """
        without = self._fit(added, self._noise)
        fits = {index: self._fit([*added, index], without.noise) for index in self.distinct if index not in added}
        gains = np.zeros(len(self._size))
        for index, fit in fits.items():
            if self._is_plausible(index, fit.weights):
                gains[index] = max(float(np.sum(without.costs - fit.costs)), 0.0)
        return gains, fits, without

    def _value(self, index: int, weights: np.ndarray) -> float:
        """Return the first estimate of the parameter of an effect."""
        return float(-weights[self.count + index] / self._size[index])

    def _is_plausible(self, index: int, weights: np.ndarray) -> bool:
        low, high = self._limits[index]
        return low < self._value(index, weights) < high

    def found(self, limit: float) -> list[_Effect]:
        """Return the effects with significant statistics, each after those before it were added to the model."""
        effects: list[_Effect] = []
        while len(effects) < min(MOST_PLACES, len(self.distinct)):
            gains, fits, without = self.statistics([effect.index for effect in effects])
            largest = float(gains.max())
            if largest < max(limit, REST * effects[0].statistic if effects else 0.0):
                break
            order = np.argsort(-np.round(gains / largest, 4), kind="stable").tolist()  # equal effects in their order
            best = order[0]
            alike = tuple(index for index in order[1:] if gains[index] > (1 - ALIKE) * largest)
            signal = int(np.argmax((without.costs - fits[best].costs)[:-1]))
            effects.append(_Effect(best, float(gains[best]), self._value(best, fits[best].weights), signal, alike))
        return effects


def whiteness(white: np.ndarray, estimated: int = 1) -> tuple[float, float]:
    """Return the Ljung-Box statistic of a signal, and its p-value.

    Parameters
    ----------
    white
        (T,) whitened residuals.
    estimated
        Number of parameters of the noise that were estimated from them.
    """
    count = len(white)
    lags = min(LAGS, count // 5)
    if lags <= estimated:
        return 0.0, 1.0
    white = white - white.mean()
    if np.sum(white**2) < SMALLEST**2 * count:
        return 0.0, 1.0
    correlations = np.array([white[lag:] @ white[:-lag] for lag in range(1, lags + 1)]) / (white @ white)
    statistic = float(count * (count + 2) * np.sum(correlations**2 / (count - np.arange(1, lags + 1))))
    return statistic, float(stats.chi2.sf(statistic, lags - estimated))


def doubts_of(
    residuals: Sequence[Residuals],
    problem: Problem,
    fit: Fit,
    probes: Sequence[Probe],
    columns: np.ndarray,
    level: float,
) -> tuple[Doubt, ...]:
    """Return the reasons to doubt a fitted model, the most significant first.

    Parameters
    ----------
    residuals
        The signals of the problem, and those that were held out.
    columns
        (R, P) derivatives of the predicted values with respect to the parameters of the probes.
    level
        Share of the values that the bands of predictions should contain.
    """
    fitted, is_stated = [one for one in residuals if not one.is_hold_out], [bool(known) for known in problem.known]
    order, count = np.concatenate([piece.places for piece in problem.pieces]), len(problem.measured)
    slopes, priors = fit.jacobian[count:], fit.white[count:]  # of priors
    sides = fit.at_high.astype(int) - fit.at_low  # of the bounds at which parameters are
    jacobian, bounded = np.concatenate([problem.slopes(fit.x)[order], slopes]), np.flatnonzero(sides)
    columns = np.concatenate([columns[order], np.zeros((len(priors), columns.shape[1]))])
    limits = [one.limits for one in probes] + [(0.0, np.inf) if sides[k] < 0 else (-np.inf, 0.0) for k in bounded]
    columns = np.column_stack([columns, jacobian[:, bounded]])
    tests = EffectTests(fitted, jacobian[:, sides == 0], columns, is_stated, priors, limits, len(bounded))
    tested = max(len(tests.distinct), 1)
    limit = float(stats.chi2.isf(1 - (1 - LEVEL) ** (1 / tested), 1))  # Sidak
    doubts = []
    for number, effect in enumerate(tests.found(limit)):
        probe = probes[effect.index]
        others = dict.fromkeys(probes[i].place for i in effect.alike if probes[i].place != probe.place)
        signal = _name(fitted[effect.signal])
        text = f"{'after that, ' * bool(number)}the residuals of {signal} are explained by {probe.kind}"
        text += ", which the model lacks" if probe.is_lacking else ""
        amount = f"{effect.value:.2g} {probe.unit}" if probe.unit else f"{100 * effect.value:+.2g} %"
        text += f" (about {amount}, statistic {effect.statistic:.4g}, limit {limit:.3g})"
        text += f", or almost as well by the {listed([*others][:MOST_ALIKE], 'or')}" if others else ""
        text += ": add it and estimate again" if probe.is_lacking else ": estimate it too, or correct its value"
        doubts.append(Doubt(probe.place, text, (effect.statistic, limit)))
    doubts += [] if doubts else _unexplained(fitted, tested)
    doubts += _larger_than_stated([one for one, known in zip(fitted, is_stated, strict=True) if known])
    return (*doubts, *_missed([one for one in residuals if one.is_hold_out], level))


def _name(signal: Residuals) -> str:
    return f"{signal.quantity} in '{signal.experiment}'"


def _unexplained(fitted: Sequence[Residuals], tested: int) -> Iterator[Doubt]:
    """Yield the signals whose whitened residuals are correlated, although no effect explains them."""
    for one in fitted:
        statistic, p = whiteness(one.white, int(one.correlation != 0.0))
        if p < LEVEL / len(fitted):
            lags = min(LAGS, len(one.white) // 5) - int(one.correlation != 0.0)
            limit = float(stats.chi2.isf(LEVEL / len(fitted), lags))
            text = (
                f"the residuals of {_name(one)} are not white noise after their correlation was estimated (Ljung-Box "
                f"statistic {statistic:.4g}, limit {limit:.3g}), and none of the {tested} effects that were tested "
                "explains them"
            )
            yield Doubt("", text, (statistic, limit))


def useless(residuals: Sequence[Residuals], turns: Sequence[float], *, is_robust: bool) -> Iterator[Doubt]:
    """Yield the fitted signals of which the model explains nothing, and those that do not measure what they should.

    Parameters
    ----------
    turns
        Change of each signal in one turn of what it measures; nan if it does not measure an angle.
    is_robust
        Whether the loss reduces the influence of outliers.
    """
    for one, turn in zip(residuals, turns, strict=True):
        rest, name = one.measured - one.fitted, _name(one)
        jumps = np.flatnonzero(np.abs(np.abs(np.diff(rest)) / turn - 1.0) < WRAPPED)
        sizes = np.abs(rest - np.median(rest))
        usual = max(float(np.median(sizes)) / stats.norm.ppf(0.75), WITHOUT_NOISE * float(np.std(one.measured)))
        rms, varied, last = one.rms, np.std(one.measured), one.time[int(np.argmax(sizes))]
        if np.ptp(one.measured) == 0.0:
            text = f"the column of {name} never changes: if its sensor is dead, leave it out"
        elif len(jumps):
            text = f"the column of {name} jumps by a whole turn at {one.time[jumps[0] + 1]:.6g} s, as if it wraps: "
            text += "unwrap it, for example by numpy.unwrap, and estimate again"
        elif np.std(one.fitted) > LITTLE * varied and rms > varied:
            text = f"the fit explains {name} no better than a constant would (root mean square error {rms:.3g}, "
            text += f"standard deviation of the data {varied:.3g}): check columns, units, initial state and bounds"
        elif rms > OUTLYING * usual and not is_robust:
            text = f"few values determine the noise of {name}, such as the one at {last:.6g} s: remove them, or use a"
            text += " robust loss"
        else:
            continue
        yield Doubt("", text)


def _larger_than_stated(fitted: Sequence[Residuals]) -> Iterator[Doubt]:
    for one in fitted:
        statistic = float(one.white @ one.white)
        limit = float(stats.chi2.isf(LEVEL / len(fitted), len(one.white)))
        if statistic > limit:
            ratio = np.sqrt(statistic / len(one.white))
            text = (
                f"the residuals of {_name(one)} are {ratio:.3g} times as large as the stated deviation (sum of squares "
                f"{statistic:.4g}, limit {limit:.4g}): the model lacks an effect, or the deviation is larger"
            )
            yield Doubt("", text, (statistic, limit))


def _missed(held: Sequence[Residuals], level: float) -> Iterator[Doubt]:
    """Yield the signals that were held out and lie far outside of their bands.

    The errors of a prediction may be those of the parameters and thus a single random number; a doubt therefore needs
    errors that are large themselves, not only many values outside of the band.
    """
    for one in held:
        errors = (one.measured - one.fitted) / one.band * stats.norm.isf((1 - level) / 2)
        size = float(np.sqrt(np.mean(errors**2)))
        if one.covered < level / 2 and size > FAR:
            text = (
                f"the prediction of {_name(one)} misses the data: {100 * one.covered:.0f} % of the values lie within "
                f"the band that should contain {100 * level:g} %, and the errors are {size:.3g} times their deviation"
            )
            yield Doubt("", text, (size, FAR))
