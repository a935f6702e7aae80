"""Error bars of the results of inverse dynamics: from noise of the data, and the choice of cutoff and coordinates.

Noise is assumed to be Gaussian and independent from sample to sample. Samples of noise, passed through the linearised
fit and the smoothing, give the covariance of coordinates, rates and accelerations in each frame. Derivatives of the
dynamics by central differences then give the covariance of the forces. The noise of loads is added to this covariance
without smoothing, because loads are not smoothed.

Other effects are added by root sum of squares. The square of the effect of the cutoff is the mean of the squared
changes of the result with a lower and with a higher cutoff, minus the mean square of these changes due to noise. If the
independent coordinates are not the measured quantities, the square of the effect of their choice is the squared change
of the result if other coordinates are smoothed, minus the mean square of this change due to noise. The effects of the
ends of the record and of straight lines in gaps are added too, and those of an uncertain person and its muscles
(`mbdkit_biomech.uncertainty`). Bars on which a long gap has an effect are nan (see
`mbdkit_biomech.inverse_dynamics.errors.ends_and_gaps`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.base.errors import RunError
from mbdkit.base.text import listed
from mbdkit.engine.linear_systems import products
from mbdkit_biomech.inverse_dynamics.compute import Inverse, compression, forces_of, knees_of, reactions_of
from mbdkit_biomech.inverse_dynamics.errors.ends_and_gaps import (
    LongGap,
    changes_at_ends,
    changes_in_gaps,
    changes_of_lines,
    likely_at_ends,
    long_gaps,
    straight_columns,
    told_gaps,
)
from mbdkit_biomech.inverse_dynamics.errors.noise import Noise, NoisePath, NoisyData
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Independent, motion_of_series, other_coordinates
from mbdkit_biomech.inverse_dynamics.motion.smoothing import Smoothed, fixed, smoothed, smoothed_each
from mbdkit_biomech.inverse_dynamics.signals.chi_square import LEVEL, quantile
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import NoSmoothing, QuinticSpline
from mbdkit_biomech.uncertainty.uncertain_result import UncertainResult, uncertain_result

#: An error is unknown if a long gap may hide a change that exceeds this share of the other errors.
HIDDEN = 0.1

FRAMES = 10_000  #: Number of frames that are computed together.

NAMED = 6  #: Largest number of columns and coordinates that are named.
LOAD_UNITS = {"force": "N", "point": "m", "torque": "N m"}


@dataclass(frozen=True)
class ResultBars:
    """Bounds of the errors of a result in T frames, each of which holds with the probability `LEVEL`.

    Attributes
    ----------
    noise
        Standard deviations of the noise of the observed quantities.
    actuators
        (T, U) bounds of the values of the actuators and reserves.
    muscles
        (T, M) bounds of the tensions of the muscles.
    accuracy
        Bounds of the errors of bodies and joints; those of reaction forces bound the norm of the vector error.
    of_ends
        Parts of the bounds of actuators (T, U) and of reaction forces (T, J) due to the ends of the record.
    of_gaps
        Changes of actuators (T, U) and of reaction forces (T, J) that long gaps may hide.
    likely
        Magnitudes of actuators (T, U) and of reaction forces (T, J) with the accelerations at both ends that the data
        before smoothing show.
    knees
        (T, K, 3) compressions of knees with both sides of their bars; None without knees.
    uncertain
        Effects of the person and its muscles, which the bounds contain; None if they count as exact.
    """

    noise: Noise
    actuators: np.ndarray
    muscles: np.ndarray
    accuracy: Accuracy
    of_ends: tuple[np.ndarray, np.ndarray]
    of_gaps: tuple[np.ndarray, np.ndarray]
    likely: tuple[np.ndarray, np.ndarray]
    knees: np.ndarray | None = None
    uncertain: UncertainResult | None = None


class _Outcome(NamedTuple):
    """The quantities that have error bars.

    Actuators (T, U), reactions (T, J, 3), positions and velocities (T, B, 3), and muscles (T, M).
    """

    actuators: np.ndarray
    reactions: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    muscles: np.ndarray

    def minus(self, other: _Outcome) -> _Outcome:
        return _Outcome(*(a - b for a, b in zip(self, other, strict=True)))


class _Response:
    """Computes the outcome for series of independent coordinates close to those of the result."""

    def __init__(self, result: Inverse, independent: Independent):
        self.result, self.independent = result, independent

    def __call__(self, series: Smoothed) -> _Outcome:
        return next(self.each([series]))

    def each(self, every: Sequence[Smoothed]) -> Iterator[_Outcome]:
        """Yield the outcomes of several series; many frames are computed together, because they are independent, unless
        bodies follow the motion over time.
        """
        base, time, q = self.result, self.result.motion.time, self.result.motion.q
        own, frames = self.independent, len(time)
        most = 1 if base.problem.followers else max(1, FRAMES // frames)
        for begin in range(0, len(every), most):
            count = len(block := every[begin : begin + most])
            shifts = range(0, count * frames, frames)
            intervals = tuple((a + at, b + at, places) for at in shifts for a, b, places in own.intervals)
            if len(own.intervals) == 1:
                intervals = ((0, count * frames, own.intervals[0][2]),)
            independent = replace(own, intervals=intervals)
            series = Smoothed(*(np.concatenate(parts) for parts in zip(*block, strict=True)))
            times, poses = np.tile(time, count), np.tile(q, (count, 1))
            motion = motion_of_series(base.problem.fitter, independent, times, poses, series)
            problem, recruiter = base.problem, base.problem.recruiter
            if recruiter is not None and base.recruited is not None:
                recruiter = recruiter.with_targets(base.recruited.targets.repeated(count))
                problem = replace(problem, recruiter=recruiter)
            outcome = _outcome(forces_of(problem, base.fitted, independent, motion, strict=False))
            yield from (_Outcome(*(part[at : at + frames] for part in outcome)) for at in shifts)


def _outcome(result: Inverse) -> _Outcome:
    q, v = (x.reshape(len(x), -1, 3) for x in (result.motion.q, result.motion.v))
    muscles = np.zeros((len(q), 0)) if result.recruited is None else result.recruited.force
    return _Outcome(result.actuators[:, :, 0], reactions_of(result), q, v, muscles)


def error_bars(result: Inverse) -> ResultBars | None:
    """Return the error bars of a result.

    Returns
    -------
    ResultBars or None
        None if no error bars are requested, if derivatives are part of the data, if the noise of a column is neither
        stated nor can be estimated from the residuals, or if recruitment couples the frames.
    """
    begin = time.perf_counter()
    recruiter = result.problem.recruiter
    if recruiter is not None and recruiter.couples_frames:
        return None  # forces of muscles depend on the noise of other frames; the covariances are those within a frame
    if (data := NoisyData.of(result)) is None:
        return None
    times, series = data.time, data.series
    response = _Response(result, data.independent)
    groups = [_other_cutoffs(response, data), _other_coordinates(response)]
    covariance, *of_others = _covariances(data, [*groups[0], *groups[1]])
    sensitivity = _sensitivity(response, series, covariance)
    squares = [bound**2 for bound in _bounds(*_with_loads(result, sensitivity, covariance))]
    for group in groups:
        beyond = [np.zeros_like(square) for square in squares]
        for one in group:
            for total, change, noise in zip(beyond, one.change, _squares(sensitivity, of_others.pop(0)), strict=True):
                total += (change**2 - noise) / len(group)
        squares = [square + np.maximum(0.0, more) for square, more in zip(squares, beyond, strict=True)]
    of_ends = _squares_of_changes(sensitivity, changes_at_ends(data))
    likely = response(likely_at_ends(data))
    of_lines = _squares_of_changes(sensitivity, changes_of_lines(result, data.path))
    squares = [square + ends + lines for square, ends, lines in zip(squares, of_ends, of_lines, strict=True)]
    uncertain, of_data = uncertain_result(result, data.random), squares[1]
    if uncertain is not None:
        squares = [square + more for square, more in zip(squares, uncertain.squares, strict=True)]
    gaps = long_gaps(result)
    of_gaps = _squares_of_changes(sensitivity, changes_in_gaps(result, data.path, gaps))
    for square, more in zip(squares, of_gaps, strict=True):
        square[more > HIDDEN**2 * square] = np.nan
    method = _method(result, data.deviation, *([one.name for one in group] for group in groups), gaps=gaps)
    parts = {}
    if uncertain is not None:
        method += uncertain.told
        parts = uncertain.parts(of_data, squares[1], _excess_by_noise(data, result, sensitivity[1]))
    actuators, force, torque, position, velocity, muscles = (np.sqrt(square) for square in squares)
    end, took = float(times[-1]), time.perf_counter() - begin
    return ResultBars(
        data.noise,
        actuators,
        muscles,
        Accuracy(times, position, velocity, force, torque, end, np.nan, method, took, further=parts),
        (np.sqrt(of_ends[0]), np.sqrt(of_ends[1])),
        (np.sqrt(of_gaps[0]), np.sqrt(of_gaps[1])),
        (np.abs(likely.actuators), np.linalg.norm(likely.reactions[:, :, :2], axis=2)),
        _knee_bars(result, uncertain, of_data, np.isnan(squares[1])),
        uncertain,
    )


def _knee_bars(
    result: Inverse, uncertain: UncertainResult | None, of_data: np.ndarray, is_unknown: np.ndarray
) -> np.ndarray | None:
    """Return the compressions of knees with both sides of their bars; see `ResultBars.knees`."""
    knees = knees_of(result.problem)
    if uncertain is not None and uncertain.knees is not None:
        return uncertain.knees.with_data(of_data, is_unknown)
    if not knees:
        return None
    own, sides = reactions_of(result), np.where(is_unknown, np.nan, np.sqrt(of_data))
    columns = [(compression(own[:, j], result.motion.q, shank), sides[:, j], sides[:, j]) for j, shank in knees]
    return np.moveaxis(np.array(columns), -1, 0)


def _covariances(data: NoisyData, others: Sequence[_Other]) -> list[np.ndarray]:
    """Return covariances (T, 3 U, 3 U), due to noise, of the coordinates, their rates and accelerations in each frame.

    The first covariances are those of the result. Each of the following ones belongs to the differences between the
    coordinates with one of the smoothings `others` and the coordinates of the result.
    """
    totals: list[np.ndarray | float] = [0.0] * (1 + len(others))
    for noise in data.samples(data.asked.samples):
        every = data.path.smoothed(noise).every
        for index, change in enumerate([every, *(other.noise(noise).every - every for other in others)]):
            totals[index] = totals[index] + products(change, np.swapaxes(change, 1, 2))
    return [np.asarray(total / data.asked.samples) for total in totals]


def _excess_by_noise(data: NoisyData, result: Inverse, sensitivity: np.ndarray) -> np.ndarray:
    """Return by how much the largest forces (J,) exceed those without noise on average, given the derivatives (3 U, T,
    J, 3) of the reactions.
    """
    force = reactions_of(result)[..., :2]
    frames, joints, _ = force.shape
    derivatives = np.moveaxis(sensitivity[..., :2], 0, -1).reshape(frames, 2 * joints, -1)
    largest, total = np.max(np.linalg.norm(force, axis=2), axis=0), np.zeros(joints)
    for noise in data.samples(data.asked.samples):
        change = np.nan_to_num(products(derivatives, data.path.smoothed(noise).every).reshape(frames, joints, 2, -1))
        sizes = np.linalg.norm(force[..., None] + change, axis=2)
        total += np.sum(np.max(sizes, axis=0) - largest[:, None], axis=1)
    return np.asarray(total / data.asked.samples)


def _sensitivity(response: _Response, series: Smoothed, covariance: np.ndarray) -> list[np.ndarray]:
    """Return the derivatives (3 U, ...) of each quantity of the outcome with respect to coordinates, rates and
    accelerations.

    Differences are central. The step of each variable is the typical standard deviation of its noise.
    """
    count = series.value.shape[1]
    typical = np.sqrt(np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
    steps, moves = [], []
    for index in range(3 * count):
        order, column = divmod(index, count)
        steps.append(typical[index] or 1e-6 * max(1.0, float(np.max(np.abs(series[order][:, column])))))
        for sign in (1.0, -1.0):
            moved = [part.copy() for part in series]
            moved[order][:, column] += sign * steps[-1]
            moves.append(Smoothed(*moved))
    sides = response.each(moves)
    results = [[part / (2 * step) for part in next(sides).minus(next(sides))] for step in steps]
    return [np.array(one) for one in zip(*results, strict=True)]


def _with_loads(
    result: Inverse, sensitivity: list[np.ndarray], covariance: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return derivatives and covariance with C further variables: the components of loads that are noisy.

    The noise of each component is independent of all other noise.

    Parameters
    ----------
    sensitivity
        Derivatives (3 U, ...) of each quantity of the outcome with respect to the variables of the motion.
    covariance
        (T, 3 U, 3 U) covariances of these variables.

    Returns
    -------
    tuple
        The derivatives (3 U + C, ...) and the covariances (T, 3 U + C, 3 U + C).
    """
    problem, base = result.problem, _outcome(result)
    deviations, columns = [], []
    for name, series in problem.loads.items():
        for component, deviation in series.deviation.items():
            # the outcome is linear in each component, so that one change of any size gives the exact derivative
            with_noise = replace(problem, loads=problem.loads | {name: series.moved(component, deviation)})
            moved = forces_of(with_noise, result.fitted, result.independent, result.motion, strict=False)
            columns.append([part / deviation for part in _outcome(moved).minus(base)])
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
    """Return the bounds, due to noise, of actuators, reaction forces, torques, positions, velocities and muscles."""
    reactions, factor = sensitivity[1], np.sqrt(quantile(1.0))
    x, y = reactions[..., 0], reactions[..., 1]
    values = [factor * np.sqrt(square) for square in _squares(sensitivity, covariance)]
    values[1] = _norm_bound(*(_product(a, b, covariance) for a, b in ((x, x), (y, y), (x, y))))
    return values


def _squares(sensitivity: list[np.ndarray], covariance: np.ndarray) -> list[np.ndarray]:
    """Return the mean squares, due to noise, of actuators, force norms, torques, positions, velocities and muscles."""
    actuators, reactions, position, velocity, muscles = sensitivity
    x, y, torque = (_product(component, component, covariance) for component in np.moveaxis(reactions, -1, 0))
    own, place, rate, pull = (_product(one, one, covariance) for one in (actuators, position, velocity, muscles))
    return [own, x + y, torque, place, rate, pull]


def _squares_of_changes(sensitivity: list[np.ndarray], changes: Smoothed) -> list[np.ndarray]:
    """Return the sums of the squared changes of all quantities, in the order of `_squares`, due to changes (T, U, C) of
    the coordinates.
    """
    return _squares(sensitivity, products(changes.every, np.swapaxes(changes.every, 1, 2)))


def _product(a: np.ndarray, b: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the covariance (T, ...) of quantities with the derivatives `a` and `b` (3 U, T, ...)."""
    count, shape = len(b), b.shape[1:]
    first, second = (np.moveaxis(one, 0, 1).reshape(len(covariance), count, -1) for one in (a, b))
    return np.asarray(np.sum(first * products(covariance, second), axis=1).reshape(shape))


def _norm_bound(xx: np.ndarray, yy: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Return the bound of the norm of a Gaussian vector with these covariances.

    The squared norm is approximated by a multiple of a chi-square variable with the same mean and variance (Welch and
    Satterthwaite). This is exact for errors along a line and for errors that are equal in all directions.
    """
    mean, square = xx + yy, xx**2 + yy**2 + 2 * xy**2
    safe = np.where(mean > 0, mean, 1.0)
    freedoms = np.where(mean > 0, safe**2 / np.where(square > 0, square, 1.0), 1.0)
    return np.asarray(np.sqrt(np.where(mean > 0, square / safe, 0.0) * quantile(freedoms)))


@dataclass(frozen=True)
class _Other:
    """Another way to smooth the data, for comparison with that of the result.

    Attributes
    ----------
    name
        What differs from the result, for the description of the method.
    noise
        Function from noise (T, K, S) of the data to the changes (T, U, S) of the coordinates of the result.
    change
        Changes of the outcome, in the order of `_bounds`.
    """

    name: str
    noise: Callable[[np.ndarray], Smoothed]
    change: list[np.ndarray]

    @classmethod
    def of(cls, name: str, noise: Callable[[np.ndarray], Smoothed], outcome: _Outcome, base: _Outcome) -> _Other:
        """Return the comparison of a way of smoothing, given its outcome and the outcome `base` of the result."""
        one = outcome.minus(base)
        force, torque = np.linalg.norm(one.reactions[..., :2], axis=2), one.reactions[..., 2]
        return cls(name, noise, [one.actuators, force, torque, one.position, one.velocity, one.muscles])


def _other_cutoffs(response: _Response, data: NoisyData) -> list[_Other]:
    base = _outcome(response.result)
    return [
        _Other.of(f"{factor:g}", partial(data.path.smoothed, how=how), response(series), base)
        for factor, how, series in data.other_cutoffs()
    ]


def _other_coordinates(response: _Response) -> list[_Other]:
    """Return the smoothing of other quantities; none if the result smooths the measured quantities themselves.

    With other quantities, the coordinates of the result follow from the poses that fit the smoothed quantities best.
    """
    result, quantities = response.result, response.independent.quantities
    problem, fitted = result.problem, result.fitted
    names = problem.names.candidates()
    other = other_coordinates(problem.fitter, fitted.measured, fitted.q, names, response.independent)
    if other is None:
        return []
    times, values = fitted.measured.time, other.quantities.values(fitted.q)
    how = fixed(times, values, problem.spec.motion.smooth)
    if all(isinstance(one, NoSmoothing | QuinticSpline) for one in how):
        return []  # nothing is smoothed
    series = smoothed_each(times, values, how)
    base = _outcome(result)
    try:
        q = motion_of_series(problem.fitter, other, times, result.motion.q, series).q
        outcome = response(smoothed(times, quantities.values(q), QuinticSpline()))
    except RunError:  # no pose fits the smoothed quantities, and the effect of the choice is unknown
        outcome = _Outcome(*(np.full_like(part, np.nan) for part in base))
    noise = partial(NoisePath(result, other, how).smoothed_as, quantities)
    return [_Other.of(listed(other.names, "and", NAMED), noise, outcome, base)]


def _method(
    result: Inverse, deviation: np.ndarray, factors: list[str], coordinates: list[str], *, gaps: list[LongGap]
) -> str:
    measured = result.fitted.measured
    stated = ~np.isnan(measured.deviation)
    columns = zip(measured.names, deviation, measured.quantities.quantities, stated, strict=True)
    texts = [
        f"{name} {value:.3g} {quantity.unit}{' (stated)' if given else ''}" for name, value, quantity, given in columns
    ]
    loads = [
        f"{name}.{array}{'' if axis is None else '.' + 'xy'[axis]} {value:.3g} {LOAD_UNITS[array]}"
        for name, series in result.problem.loads.items()
        for (array, axis), value in series.deviation.items()
    ]
    of_loads = f"; noise of loads with the standard deviations {listed(loads, 'and')}" if loads else ""
    changed = [f"{listed(factors, 'and')} times the cutoff"] if factors else []
    changed += [f"smoothing of {coordinates[0]}"] if coordinates else []
    effects = [
        f", and the mean square change of the result with {change}, minus that caused by noise," for change in changed
    ]
    smooth = result.problem.spec.motion.smooth
    zero, most = ("third derivatives", "typical of") if isinstance(smooth, QuinticSpline) else (
        "accelerations", "at most those that the data before smoothing show there, or the largest ones of"
    )  # fmt: skip
    ends = "" if isinstance(smooth, NoSmoothing) else (
        f"; the {zero} at the ends of the record, which the smoothing takes for zero, are assumed to be {most} the "
        "record"
    )  # fmt: skip
    lines = listed([measured.names[column] for column in straight_columns(result)], "and", NAMED)
    ends += f"; the lines that fill gaps of {lines} are compared with cubic splines" if lines else ""
    unknown = "".join(f" Unknown (nan) in {gap}." for gap in told_gaps(result, gaps).values())
    return (
        f"Bounds that hold with a probability of {LEVEL:.0%} at each time: Gaussian noise, independent from sample "
        f"to sample, with the standard deviations {listed(texts, 'and', NAMED)}, passed through the linearised fit, "
        f"smoothing and dynamics{of_loads}{''.join(effects)}{' by root sum of squares' if effects else ''}"
        f"{'' if factors else '; no cutoff was varied'}"
        f"{'; artefacts of the markers, correlated in time' if result.problem.source.person else ''}{ends}.{unknown}"
    )
