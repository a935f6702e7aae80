"""Error bars of the results of inverse dynamics: from the noise of the data, and from the choice of the cutoff.

Noise is Gaussian and independent from sample to sample. Samples of it, passed through the linearised fit and the
smoothing, give the covariance of coordinates, rates and accelerations in each frame; derivatives of the dynamics by
central differences give the covariance of the forces. Loads are not smoothed, so that their noise is added to this
covariance unchanged. The effect of the cutoff is added by root sum of squares: the mean of the squared changes of the
result with a lower and a higher cutoff, minus the mean square change caused by noise alone.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from mbdkit.archive.accuracy import Accuracy
from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.inverse_dynamics.compute import Inverse, forces_of, recorded_states
from mbdkit.inverse_dynamics.noise import NoisePath, noise_deviation
from mbdkit.inverse_dynamics.reduced_motion import Independent, motion_of_series
from mbdkit.inverse_dynamics.smoothing import Smoothed, fixed, smoothed_each, with_cutoff
from mbdkit.spec.inverse_sections import ErrorBars as Asked
from mbdkit.spec.inverse_sections import Smoothing

LEVEL = 0.95
"""Probability that an error stays below its bar."""

CUTOFFS = (0.8, 1.25)
"""Factors of the cutoff between which the result is compared."""


LOAD_UNITS = {"force": "N", "point": "m", "torque": "N m"}


@dataclass(frozen=True)
class ErrorBars:
    """Bounds of the errors of a result in T frames, each of which holds with the probability `LEVEL`.

    Attributes
    ----------
    deviation
        (K,) standard deviations of the noise of the observed quantities.
    actuators
        (T, U) bounds of the values of the actuators.
    accuracy
        Bounds of the errors of bodies and joints; those of reaction forces bound the norm of the vector error.
    """

    deviation: np.ndarray
    actuators: np.ndarray
    accuracy: Accuracy


@dataclass(frozen=True)
class _Outcome:
    """Results that have error bars: actuators (T, U), reactions (T, J, 3), positions and velocities (T, B, 3)."""

    actuators: np.ndarray
    reactions: np.ndarray
    position: np.ndarray
    velocity: np.ndarray

    def minus(self, other: _Outcome) -> _Outcome:
        return _Outcome(*(a - b for a, b in zip(self.parts, other.parts, strict=True)))

    @property
    def parts(self) -> tuple[np.ndarray, ...]:
        return self.actuators, self.reactions, self.position, self.velocity


class _Response:
    """The outcome of a series of independent coordinates, near that of a result."""

    def __init__(self, result: Inverse, independent: Independent):
        self.result, self.independent = result, independent

    def __call__(self, series: Smoothed) -> _Outcome:
        base = self.result
        fitter, q = base.problem.fitter, base.motion.q
        motion = motion_of_series(fitter, self.independent, base.motion.time, q, series)
        return _outcome(forces_of(base.problem, base.fitted, self.independent, motion))


def _outcome(result: Inverse) -> _Outcome:
    states, count = recorded_states(result), len(result.motion.time)
    q, v = (x.reshape(count, -1, 3) for x in (result.motion.q, result.motion.v))
    return _Outcome(result.dynamics.value, states.reactions, q, v)


def error_bars(result: Inverse) -> ErrorBars | None:
    """Return the error bars of a result.

    Returns
    -------
    ErrorBars or None
        None if no error bars are requested, if derivatives are part of the data, or if the noise of a column is neither
        stated nor can be estimated from the residuals.
    """
    begin = time.perf_counter()
    problem, fitted, independent = result.problem, result.fitted, result.independent
    asked = problem.spec.motion.errors
    if asked == "none" or independent is None or not independent.names:
        return None
    random = np.random.default_rng(asked.seed)
    measured, times = fitted.measured, result.motion.time
    coordinates = independent.quantities.values(fitted.q)
    how = fixed(times, coordinates, problem.spec.motion.smooth)
    path = NoisePath(result, independent, how)
    left = measured.raw - measured.quantities.values(result.motion.q)
    deviation = noise_deviation(path, left, measured.deviation, random)
    if np.any(np.isnan(deviation)):
        return None
    response = _Response(result, independent)
    cutoffs = _other_cutoffs(response, coordinates, how)
    covariance, *of_changes = _covariances(path, deviation, asked, [how, *(cutoff.how for cutoff in cutoffs)], random)
    sensitivity = _sensitivity(response, smoothed_each(times, coordinates, how), covariance)
    squares = [bound**2 for bound in _bounds(*_with_loads(result, sensitivity, covariance))]
    beyond = [np.zeros_like(square) for square in squares]
    for one, own in zip(cutoffs, of_changes, strict=True):
        for index, (change, noise) in enumerate(zip(one.change, _squares(sensitivity, own), strict=True)):
            beyond[index] += (change**2 - noise) / len(cutoffs)
    bounds = [np.sqrt(one + np.maximum(0.0, more)) for one, more in zip(squares, beyond, strict=True)]
    method = _method(result, deviation, [cutoff.factor for cutoff in cutoffs])
    actuators, force, torque, position, velocity = bounds
    return ErrorBars(
        deviation,
        actuators,
        Accuracy(
            times, position, velocity, force, torque, float(times[-1]), np.nan, method, time.perf_counter() - begin
        ),
    )


def _covariances(
    path: NoisePath, deviation: np.ndarray, asked: Asked, how: list[list[Smoothing]], random: np.random.Generator
) -> list[np.ndarray]:
    """Return covariances (T, 3 U, 3 U), due to noise, of the coordinates, their rates and accelerations in each frame.

    The first is that of the first smoothing; the others are those of the differences from it.
    """
    totals: list[np.ndarray | float] = [0.0] * len(how)
    for noise in path.samples(deviation, asked.samples, random):
        smooth = [path.smoothed(noise, one) for one in how]
        every = [np.concatenate([one.value, one.rate, one.acceleration], axis=1) for one in smooth]
        for index, one in enumerate(every):
            change = one - every[0] if index else one
            totals[index] = totals[index] + change @ np.swapaxes(change, 1, 2)
    return [np.asarray(total / asked.samples) for total in totals]


def _sensitivity(response: _Response, series: Smoothed, covariance: np.ndarray) -> list[np.ndarray]:
    """Return the derivatives (3 U, ...) of each part of the outcome, by central differences over the deviations."""
    parts = (series.value, series.rate, series.acceleration)
    count = series.value.shape[1]
    typical = np.sqrt(np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
    found: list[list[np.ndarray]] = []
    for index in range(3 * count):
        order, column = divmod(index, count)
        step = typical[index] or 1e-6 * max(1.0, float(np.max(np.abs(parts[order][:, column]))))
        sides = []
        for sign in (1.0, -1.0):
            moved = [part.copy() for part in parts]
            moved[order][:, column] += sign * step
            sides.append(response(Smoothed(*moved)))
        found.append([one / (2 * step) for one in sides[0].minus(sides[1]).parts])
    return [np.array(one) for one in zip(*found, strict=True)]


def _with_loads(
    result: Inverse, sensitivity: list[np.ndarray], covariance: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the derivatives of each part of the outcome, and the covariance, both including the noise of the loads.

    Each of their C noisy components is one more variable in each frame, as independent of the others as of the motion.
    """
    problem, base = result.problem, _outcome(result)
    deviations, columns = [], []
    for name, series in problem.loads.items():
        for component, deviation in series.deviation.items():
            loads = problem.loads | {name: series.moved(component, deviation)}  # the outcome is linear in each of them
            moved = forces_of(replace(problem, loads=loads), result.fitted, result.independent, result.motion)
            columns.append([part / deviation for part in _outcome(moved).minus(base).parts])
            deviations.append(deviation)
    if not columns:
        return sensitivity, covariance
    own, count = covariance.shape[1], len(deviations)
    every = np.zeros((len(covariance), own + count, own + count))
    every[:, :own, :own] = covariance
    every[:, range(own, own + count), range(own, own + count)] = np.square(deviations)
    of_loads = [np.array(one) for one in zip(*columns, strict=True)]
    return [np.concatenate(pair) for pair in zip(sensitivity, of_loads, strict=True)], every


def _bounds(sensitivity: list[np.ndarray], covariance: np.ndarray) -> list[np.ndarray]:
    """Return the bounds, due to noise, of actuators, reaction forces, torques, positions and velocities."""
    reactions, factor = sensitivity[1], np.sqrt(chi2.ppf(LEVEL, 1))
    x, y = reactions[..., 0], reactions[..., 1]
    found = [factor * np.sqrt(square) for square in _squares(sensitivity, covariance)]
    found[1] = _norm_bound(*(_product(a, b, covariance) for a, b in ((x, x), (y, y), (x, y))))
    return found


def _squares(sensitivity: list[np.ndarray], covariance: np.ndarray) -> list[np.ndarray]:
    """Return the mean squares, due to noise, of actuators, norms of forces, torques, positions and velocities."""
    actuators, reactions, position, velocity = sensitivity
    x, y, torque = (_product(moveaxi, moveaxi, covariance) for moveaxi in np.moveaxis(reactions, -1, 0))
    own, place, rate = (_product(one, one, covariance) for one in (actuators, position, velocity))
    return [own, x + y, torque, place, rate]


def _product(a: np.ndarray, b: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the covariance (T, ...) of quantities with the derivatives `a` and `b` (3 U, T, ...)."""
    found: np.ndarray = np.einsum("it...,tij,jt...->t...", a, covariance, b, optimize=True)
    return found


def _norm_bound(xx: np.ndarray, yy: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Return the bound of the norm of a Gaussian vector with these covariances.

    The squared norm is taken as a multiple of chi-square with the same mean and variance (Welch and Satterthwaite),
    which is exact for errors along a line and for errors that are equal in all directions.
    """
    mean, square = xx + yy, xx**2 + yy**2 + 2 * xy**2
    safe = np.where(mean > 0, mean, 1.0)
    freedoms = np.where(mean > 0, safe**2 / np.where(square > 0, square, 1.0), 1.0)
    bound: np.ndarray = np.sqrt(np.where(mean > 0, square / safe, 0.0) * chi2.ppf(LEVEL, freedoms))
    return bound


@dataclass(frozen=True)
class _OtherCutoff:
    """The smoothing with another cutoff, and the changes of the outcome, in the order of `_bounds`."""

    factor: float
    how: list[Smoothing]
    change: list[np.ndarray]


def _other_cutoffs(response: _Response, coordinates: np.ndarray, how: list[Smoothing]) -> list[_OtherCutoff]:
    """Return the other cutoffs that the sampling rate allows."""
    times, base = response.result.motion.time, _outcome(response.result)
    found = []
    for factor in CUTOFFS:
        moved = [with_cutoff(one, factor) or one for one in how]
        if moved == how:
            continue
        try:
            series = smoothed_each(times, coordinates, moved)
        except SpecError:  # the cutoff is too high for the sampling rate
            continue
        one = response(series).minus(base)
        force, torque = np.linalg.norm(one.reactions[..., :2], axis=2), one.reactions[..., 2]
        found.append(_OtherCutoff(factor, moved, [one.actuators, force, torque, one.position, one.velocity]))
    return found


def _method(result: Inverse, deviation: np.ndarray, factors: list[float]) -> str:
    measured = result.fitted.measured
    stated = ~np.isnan(measured.deviation)
    told = [
        f"{name} {value:.3g} {quantity.unit}{' (stated)' if given else ''}"
        for name, value, quantity, given in zip(
            measured.names, deviation, measured.quantities.quantities, stated, strict=True
        )
    ]
    shown = listed(told[:6], "" if len(told) > 6 else "and") + (f" and {len(told) - 6} more" if told[6:] else "")
    loads = [
        f"{name}.{array}{'' if axis is None else '.' + 'xy'[axis]} {value:.3g} {LOAD_UNITS[array]}"
        for name, series in result.problem.loads.items()
        for (array, axis), value in series.deviation.items()
    ]
    of_loads = f"; noise of loads with the standard deviations {listed(loads, 'and')}" if loads else ""
    cutoff = (
        f", and the mean square change of the result with {listed([f'{factor:g}' for factor in factors], 'and')} "
        f"times the "
        f"cutoff, minus that caused by noise, by root sum of squares"
        if factors
        else "; no cutoff was varied"
    )
    return (
        f"Bounds that hold with a probability of {LEVEL:.0%} at each time: Gaussian noise, independent from sample "
        f"to sample, with the standard deviations {shown}, passed through the linearised fit, smoothing and dynamics"
        f"{of_loads}{cutoff}."
    )
