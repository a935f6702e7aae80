"""Smoothing of series over time, and their first and second derivatives.

The coefficients of Butterworth filters are rounded once, so that they are the same on every machine. Source: A. V.
Oppenheim and R. W. Schafer, Discrete-Time Signal Processing, 2010, section 7.2 (bilinear transformation).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import mpmath
import numpy as np
from scipy.interpolate import BSpline, make_smoothing_spline

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.engine.kernels.filters import filter_rows
from mbdkit.engine.linear_systems import SparseFactors, least_norms, products
from mbdkit_biomech.inverse_dynamics.files.measured_table import unit_of_time_as_cause
from mbdkit_biomech.inverse_dynamics.signals.interpolating_splines import Spline, interpolating_spline
from mbdkit_biomech.inverse_dynamics.signals.rounded_times import rounded_to
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import (
    Butterworth,
    NoSmoothing,
    OpenSimFilter,
    QuinticSpline,
    Smoothing,
    SmoothingSpline,
)

#: Times count as evenly spaced if no interval deviates from the mean interval by more than this fraction of the mean.
UNEVEN = 1e-3

KEY = "motion.smooth"

FEWEST = 6  #: Smallest number of samples for a quintic spline.


class Smoothed(NamedTuple):
    """Series (T, K) with their first and second time derivatives."""

    value: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray

    @property
    def every(self) -> np.ndarray:
        """(T, 3 K, ...) the series, followed by their rates and their accelerations."""
        return np.concatenate(self, axis=1)


def smoothed(time: np.ndarray, series: np.ndarray, how: Smoothing) -> Smoothed:
    """Smooth series and differentiate them.

    Parameters
    ----------
    time
        (T,) increasing times [s].
    series
        (T, K) the series.
    how
        The method of smoothing with its parameters.

    Raises
    ------
    SpecError
        If there are too few samples, if they are not evenly spaced although the filter requires this, if the cutoff is
        too high, or if cross-validation finds no parameter of the spline.
    """
    if len(time) < FEWEST:
        raise SpecError(f"derivatives need at least {FEWEST} samples, but the motion has {len(time)}", key="motion")
    if isinstance(how, NoSmoothing):
        return Smoothed(series, *local_derivatives(time, series))
    if isinstance(how, QuinticSpline):
        return _of_spline(quintic_spline(time, series), time)
    if isinstance(how, SmoothingSpline):
        if how.parameter is None:
            return _cross_validated_spline(time, series)
        return _smoothing_spline(time, series, how.parameter)
    if isinstance(how, Butterworth):
        return _of_spline(quintic_spline(time, _butterworth(time, series, how)), time)
    return _opensim(time, series, how)


def low_passed(time: np.ndarray, series: np.ndarray, how: Smoothing) -> np.ndarray:
    """Return series (T, K) filtered as the motion if `how` is a Butterworth filter, and otherwise unchanged."""
    return _butterworth(time, series, how) if isinstance(how, Butterworth) else series


def fixed(time: np.ndarray, series: np.ndarray, how: Smoothing) -> list[Smoothing]:
    """Return the smoothing of each series with fixed parameters.

    If cross-validation chooses the parameters, the result contains those that it chooses for `series`. With fixed
    parameters, the smoothing is linear in the data.
    """
    if not isinstance(how, SmoothingSpline) or how.parameter is not None:
        return [how] * series.shape[1]
    found = smoothed(time, series, how)
    # The smoothed series f minimizes the sum of (x - f)^2 + p * integral of f''^2. Its variation in the direction of f
    # vanishes, so that p = sum of (x - f) f / integral of f''^2, where f'' is linear between the rows.
    bend, step = found.acceleration, np.diff(time)[:, None]
    curvature = np.sum(step * (bend[:-1] ** 2 + bend[:-1] * bend[1:] + bend[1:] ** 2) / 3, axis=0)
    work = np.sum((series - found.value) * found.value, axis=0)
    parameter = np.divide(work, curvature, out=np.zeros_like(work), where=curvature > 0)
    return [SmoothingSpline(parameter=max(0.0, one)) for one in parameter.tolist()]


def with_cutoff(how: Smoothing, factor: float) -> Smoothing | None:
    """Return a smoothing with its cutoff multiplied by a factor; None if it has no fixed cutoff.

    The cutoff of a smoothing spline is the frequency at which the spline halves the amplitude. It is proportional to
    parameter^(-1/4).
    """
    if isinstance(how, Butterworth | OpenSimFilter):
        return how.model_copy(update={"cutoff": how.cutoff * factor})
    if isinstance(how, SmoothingSpline) and how.parameter:
        return how.model_copy(update={"parameter": how.parameter / factor**4})
    return None


def cutoff_of(time: np.ndarray, how: Smoothing) -> float:
    """Return the cutoff of a smoothing with fixed parameters [Hz]; infinite if nothing is smoothed.

    A smoothing spline multiplies an oscillation by ``1 / (1 + parameter * interval * omega^4)``. Its cutoff is the
    frequency at which this is 1/2.
    """
    if isinstance(how, Butterworth | OpenSimFilter):
        return how.cutoff
    if isinstance(how, SmoothingSpline) and how.parameter:
        interval = float((time[-1] - time[0]) / (len(time) - 1))
        return float((how.parameter * interval) ** -0.25 / (2 * np.pi))
    return math.inf


def smoothed_each(time: np.ndarray, series: np.ndarray, how: Sequence[Smoothing]) -> Smoothed:
    """Smooth each of the series (T, U, ...) by the smoothing given for it; see `smoothed`."""
    if not how:
        return Smoothed(series, series, series)
    shape = series[:, 0].shape
    parts = [smoothed(time, series[:, index].reshape(len(time), -1), one) for index, one in enumerate(how)]
    return Smoothed(*(np.stack([x.reshape(shape) for x in same], axis=1) for same in zip(*parts, strict=True)))


def quintic_spline(time: np.ndarray, series: np.ndarray) -> Spline:
    """Return the natural quintic spline through all samples: its third and fourth derivatives vanish at both ends."""
    zeros = np.zeros(series.shape[1:])
    ends = [(3, zeros), (4, zeros)]
    return interpolating_spline(time, series, 5, (ends, ends))


def spline_of_ends(time: np.ndarray) -> Spline:
    """Return the errors of natural quintic splines if the third derivative of the true function is 1 at the start
    (first column) or at the end (second column). The errors are quintic splines that vanish at all samples.
    """
    zeros = np.zeros(2)
    start, end = ([(3, -one), (4, zeros)] for one in np.eye(2))
    return interpolating_spline(time, np.zeros((len(time), 2)), 5, (start, end))


def _of_spline(spline: Spline | BSpline, time: np.ndarray) -> Smoothed:
    return Smoothed(spline(time), spline(time, 1), spline(time, 2))


def local_derivatives(time: np.ndarray, series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and second derivatives of local polynomials of degree four at each sample.

    Each polynomial passes through the sample, two samples before it and two after it; near the ends, through the first
    or last five samples. For evenly spaced samples, the derivatives are the central differences of fourth order, and
    one-sided differences at the ends.
    """
    count = len(time)
    begin = np.clip(np.arange(count) - 2, 0, count - 5)
    rows = begin[:, None] + np.arange(5)
    offset = time[rows] - time[:, None]
    unit = np.max(np.abs(offset), axis=1)
    powers = elementary.pow((offset / unit[:, None])[:, None, :], np.arange(5)[None, :, None])
    right = np.zeros((2, count, 5))
    right[0, :, 1], right[1, :, 2] = 1.0 / unit, 2.0 / unit**2
    near = series[rows] - series[:, None]  # differences avoid cancellation; the weights of a derivative sum to zero
    rate, acceleration = (products(least_norms(powers, one, 0.0)[:, None], near)[:, 0] for one in right)
    return rate, acceleration


def _smoothing_spline(time: np.ndarray, series: np.ndarray, parameter: float) -> Smoothed:
    """Return the smoothing splines of all series x (T, K), by one factorization of a banded matrix.

    The second derivative of the spline is linear between the samples. Its values c at the inner samples satisfy
    ``(R + parameter Q^T Q) c = Q^T x``, where R contains the integrals of products of hat functions, and Q^T x are the
    changes of the slope between consecutive samples. The smoothed series is ``x - parameter Q c`` (Reinsch, Smoothing
    by spline functions, Numerische Mathematik 10, 1967, 177-183).
    """
    unit = float((time[-1] - time[0]) / (len(time) - 1))  # intervals of about 1 keep the matrix well scaled
    step, weight = np.diff(time) / unit, parameter / unit**3
    before, after = 1.0 / step[:-1], 1.0 / step[1:]
    middle = -(before + after)  # row i of Q^T has `before`, `middle` and `after` at i, i + 1 and i + 2
    diagonals = (
        (step[:-1] + step[1:]) / 3 + weight * (before**2 + middle**2 + after**2),
        step[1:-1] / 6 + weight * (middle[:-1] * before[1:] + after[:-1] * middle[1:]),
        weight * after[:-2] * before[2:],
    )
    row, column = (
        np.concatenate([np.arange(len(one)) + shift * below for below, one in enumerate(diagonals)]) for shift in (1, 0)
    )
    off, value = len(middle), np.concatenate(diagonals)
    factors = SparseFactors(
        np.concatenate([row, column[off:]]),
        np.concatenate([column, row[off:]]),
        np.concatenate([value, value[off:]]),
        np.arange(off),
        0.0,  # the matrix is positive definite
    )
    bend = np.zeros_like(series)
    right = before[:, None] * series[:-2] + middle[:, None] * series[1:-1] + after[:, None] * series[2:]
    bend[1:-1] = factors.solve(right.T).T
    value = series.copy()
    value[:-2] -= weight * before[:, None] * bend[1:-1]
    value[1:-1] -= weight * middle[:, None] * bend[1:-1]
    value[2:] -= weight * after[:, None] * bend[1:-1]
    slope, length = np.diff(value, axis=0) / step[:, None], step[:, None]
    rate = np.empty_like(value)
    rate[:-1] = slope - length * (2 * bend[:-1] + bend[1:]) / 6
    rate[-1] = slope[-1] + length[-1] * (bend[-2] + 2 * bend[-1]) / 6
    return Smoothed(value, rate / unit, bend / unit**2)


def _cross_validated_spline(time: np.ndarray, series: np.ndarray) -> Smoothed:
    unit = float((time[-1] - time[0]) / (len(time) - 1))  # SciPy's solution needs intervals of about 1
    scaled = (time - time[0]) / unit
    columns = []
    for x in series.T:
        try:
            columns.append(_of_spline(make_smoothing_spline(scaled, x), scaled))
        except (ValueError, np.linalg.LinAlgError):
            raise SpecError(
                "cross-validation finds no parameter of the spline for these data; give `parameter`", key=KEY
            ) from None
    value, rate, acceleration = (np.column_stack(same) for same in zip(*columns, strict=True))
    return Smoothed(value, rate / unit, acceleration / unit**2)


def _interval(time: np.ndarray) -> float:
    steps = np.diff(time)
    mean = float((time[-1] - time[0]) / (len(time) - 1))
    worst = int(np.argmax(np.abs(steps - mean)))
    if abs(steps[worst] - mean) > UNEVEN * mean:
        cure = (
            "if rows are missing, add them with the time and empty cells, and give `motion.gaps`; if the sampling is "
            "uneven, use `spline`, `quintic` or `opensim`, which resamples"
        )
        if (grid := rounded_to(time)) is not None:
            cure = f"the times are even apart from rounding to {grid:g} s: write them with more digits"
        raise SpecError(
            f"this filter needs evenly spaced samples, but the interval after t = {time[worst]:.6g} s is "
            f"{steps[worst]:.6g} s, and {mean:.6g} s on average; {cure}",
            key=KEY,
        )
    return mean


def _check_cutoff(given: float, once: float, interval: float) -> None:
    """Raise SpecError if the cutoff is too high for the sampling rate.

    Parameters
    ----------
    given
        Cutoff given in the spec [Hz].
    once
        Cutoff of a single pass of the filter, for which the passes together have the cutoff `given` [Hz].
    interval
        Interval between samples [s].
    """
    highest = 0.5 / interval * given / once
    if given >= highest:
        raise SpecError(
            f"{given:g} Hz is too high: with {1 / interval:.6g} samples per second, it should be below {highest:.4g} "
            f"Hz{unit_of_time_as_cause(interval)}",
            key=f"{KEY}.cutoff",
        )


def _butterworth(time: np.ndarray, series: np.ndarray, how: Butterworth) -> np.ndarray:
    interval = _interval(time)
    # Each of the two passes has an attenuation of 1.5 dB at the given cutoff, so that both have 3 dB.
    once = single_cutoff(how.cutoff, how.order)
    _check_cutoff(how.cutoff, once, interval)
    b, a = butterworth_coefficients(how.order, once, 1.0 / interval)
    duration = 2.0 / how.cutoff if how.padding is None else how.padding
    padding = min(int(np.ceil(duration / interval)), len(time) - 1)
    return filtered_both_ways(b, a, series, padding)


def _opensim(time: np.ndarray, series: np.ndarray, how: OpenSimFilter) -> Smoothed:
    """Filter as OpenSim does (Storage::pad, Storage::lowpassIIR, Signal::LowpassIIR)."""
    times, padded = (_extended(one, len(time) // 2) for one in (time, series))
    interval = float(np.min(np.diff(times)))
    even = times[0] + interval * np.arange(int(np.floor((times[-1] - times[0]) / interval + 1e-6)) + 1)
    if len(even) != len(times) or np.max(np.abs(even - times)) > 1e-9 * interval * len(times):
        padded = quintic_spline(times, padded)(np.minimum(even, times[-1]))
    _check_cutoff(how.cutoff, how.cutoff, interval)
    b, a = butterworth_coefficients(3, how.cutoff, 1.0 / interval)
    for _ in range(2):  # forward, and backward on the reversed series
        # the first three rows are those of the input, as in OpenSim
        later = filtered(b, a, padded[3:], state_after(b, a, padded[:3]))
        padded = np.concatenate([padded[:3], later])[::-1]
    return _of_spline(quintic_spline(even, padded), time)


DIGITS = 50


@lru_cache(maxsize=64)
def single_cutoff(cutoff: float, order: int) -> float:
    """Return the cutoff of a filter that has an attenuation of 1.5 dB at `cutoff`, so that two passes have 3 dB."""
    with mpmath.workdps(DIGITS):
        return float(cutoff / (mpmath.sqrt(2) - 1) ** (mpmath.mpf(1) / (2 * order)))


@lru_cache(maxsize=64)
def butterworth_coefficients(order: int, cutoff: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients b and a (order + 1,) of a low-pass filter, with ``a[0] = 1``.

    Parameters
    ----------
    cutoff
        Frequency with an attenuation of 3 dB, below half of `rate`.
    rate
        Samples per unit of time.
    """
    with mpmath.workdps(DIGITS):
        width = mpmath.tan(mpmath.pi * mpmath.mpf(cutoff) / mpmath.mpf(rate))
        poles = [width * mpmath.expjpi(mpmath.mpf(2 * k + order + 1) / (2 * order)) for k in range(order)]
        a = [mpmath.mpc(1)]
        for pole in poles:
            z = (1 + pole) / (1 - pole)
            a = [x - z * before for x, before in zip([*a, 0], [0, *a], strict=True)]
        gain = width**order / mpmath.re(mpmath.fprod(1 - pole for pole in poles))
        b = [gain * mpmath.binomial(order, k) for k in range(order + 1)]
        return np.array(b, dtype=float), np.array([mpmath.re(x) for x in a], dtype=float)


def filtered(b: np.ndarray, a: np.ndarray, series: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Return filtered series (T, K), given the state (N, K) of the filter before the first row."""
    out: np.ndarray = np.array(series, dtype=float, order="C")
    filter_rows(b, a, np.array(state, dtype=float, order="C"), out)
    return out


def _extended(series: np.ndarray, padding: int) -> np.ndarray:
    """Return series (T, ...) with `padding` rows more at both ends, point-symmetric to the first and the last row."""
    before, after = 2 * series[0] - series[padding:0:-1], 2 * series[-1] - series[-2 : -padding - 2 : -1]
    return np.concatenate([before, series, after])


def filtered_both_ways(b: np.ndarray, a: np.ndarray, series: np.ndarray, padding: int) -> np.ndarray:
    """Return series (T, K) filtered forward and backward.

    They are extended at both ends by `padding` rows, and each pass begins in the steady state of a constant series.
    """
    out = _extended(series, padding)
    steady = _steady_state(tuple(b.tolist()), tuple(a.tolist()))[:, None]
    for _ in range(2):
        out = filtered(b, a, out, steady * out[0])[::-1]
    return out[padding : len(out) - padding]


def state_after(b: np.ndarray, a: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the state (N, K) of a filter after the last N rows (N, K), which are both its input and its output."""
    order = len(rows)
    state = np.zeros_like(rows)
    for i in range(order):
        for j in range(order - i):
            state[i] += (b[i + j + 1] - a[i + j + 1]) * rows[order - 1 - j]
    return state


@lru_cache(maxsize=64)
def _steady_state(b: tuple[float, ...], a: tuple[float, ...]) -> np.ndarray:
    """Return the state (N,) of a filter whose input has always been 1."""
    with mpmath.workdps(DIGITS):
        output = mpmath.fsum(b) / mpmath.fsum(a)
        rest = [x - output * y for x, y in zip(b, a, strict=True)]
        return np.array([mpmath.fsum(rest[i:]) for i in range(1, len(rest))], dtype=float)
