"""Parts of a record that do not determine the motion: its two ends, and long gaps.

Near an end, a smoothed coordinate depends on how the smoothing continues the record. Filters continue it by odd
reflection, and smoothing splines end with a vanishing second derivative. Both are wrong unless the acceleration at the
end vanishes. The response of the smoothing to parabolas shows what an acceleration of 1 at an end changes in each
frame. To estimate the acceleration at an end, a cubic polynomial is fitted to the coordinates before smoothing over one
period of the cutoff. The acceleration is assumed to be at most the largest one of the record or, if this is larger, the
magnitude of the estimate plus the bound of its noise. Accelerations of several coordinates are assumed to be correlated
at an end as they are over the record.

The natural quintic spline through all samples ends with a vanishing third derivative instead, which is wrong by an
error of first order in the interval. The third derivative at an end is estimated by its root mean square over the
record, minus the part that noise causes. Other end conditions, such as those of splines without knots beside the ends,
are exact to higher order, but amplify noise in the accelerations at both ends eight times as much.

A gap longer than half a period of the cutoff can hide an oscillation that the smoothing would preserve. Its values
are then unknown in the gap. How much the motion may deviate there is estimated by smooth curves that vanish, with
their rates, at the samples beside the gap, and whose largest acceleration is that of the record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.base.text import listed
from mbdkit.engine.linear_systems import product, products, pseudoinverses, symmetric_eigenvectors
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.errors.noise import CUBIC, NoisePath, NoisyData
from mbdkit_biomech.inverse_dynamics.motion.measured import bridged
from mbdkit_biomech.inverse_dynamics.motion.smoothing import Smoothed, cutoff_of, fixed, smoothed_each, spline_of_ends
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import NoSmoothing, QuinticSpline, Smoothing

NAMED = 4  #: Largest number of columns, actuators and joints that are named.

#: Number of samples of noise used to estimate its effect on accelerations and third derivatives at the ends.
DRAWS = 20

#: Remainders of columns below this share of the largest column count as zero in fits of polynomials.
NEGLIGIBLE = 1e-12

#: Ratio of the bound of a Gaussian variable, with a probability of 95 %, to its root mean square.
END_FACTOR = 1.96

FEWEST_AT_END = 8  #: The acceleration at an end is estimated from at least this number of samples.

#: After this number of intervals, the effect of the ends of a quintic spline has decayed to a few parts in a thousand.
DECAY = 8


@dataclass(frozen=True)
class LongGap:
    """A gap that is longer than the smoothing can bridge.

    Attributes
    ----------
    column
        Index of the observed quantity.
    rows
        Rows without a value.
    start, end
        Times of the samples on both sides [s].
    longest
        Largest length of a gap that the smoothing can bridge [s]; 0 if nothing is smoothed.
    """

    column: int
    rows: slice
    start: float
    end: float
    longest: float


def long_gaps(result: Inverse) -> list[LongGap]:
    """Return the interpolated gaps that are longer than half a period of the highest cutoff of the smoothed
    coordinates.
    """
    interpolated, time, independent = result.fitted.interpolated, result.motion.time, result.independent
    if independent is None or not independent.names or not np.any(interpolated):
        return []
    longest = 0.5 / max(_cutoffs(result))
    gaps = []
    for column, missing in enumerate(interpolated.T):
        borders = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]])))
        for first, last in borders.reshape(-1, 2).tolist():
            start, end = float(time[first - 1]), float(time[last])
            if end - start > longest * (1 + 1e-9):
                gaps.append(LongGap(column, slice(first, last), start, end, longest))
    return gaps


def longest_period(result: Inverse) -> float:
    """Return the time [s] after which the effect of the ends has decayed to a few parts in a thousand: one period of
    the lowest cutoff of the smoothed coordinates, or `DECAY` intervals without cutoff.
    """
    time = result.motion.time
    return 1 / min(_cutoffs(result)) or DECAY * float(time[-1] - time[0]) / (len(time) - 1)


def _cutoffs(result: Inverse) -> list[float]:
    """Return the cutoff of the smoothing of each coordinate [Hz]; infinite if nothing is smoothed."""
    assert result.independent is not None
    time, series = result.motion.time, result.independent.quantities.values(result.fitted.q)
    return [cutoff_of(time, one) for one in fixed(time, series, result.problem.spec.motion.smooth)]


def changes_in_gaps(result: Inverse, path: NoisePath, gaps: Sequence[LongGap]) -> Smoothed:
    """Return changes (T, U, 2 G) of the coordinates and their derivatives that G gaps may hide.

    Each gap has an even and an odd change, whose accelerations vanish at different times.
    """
    time, measured, motion = result.motion.time, result.fitted.measured, result.motion
    jacobian, curvature = measured.quantities.jacobian(motion.q), measured.quantities.curvature(motion.q, motion.v)
    acceleration = np.abs(products(jacobian, motion.a) + curvature)
    changes = np.zeros((len(time), path.columns, 2 * len(gaps)))
    for number, gap in enumerate(gaps):
        # rows with the amplified noise of the filling
        near = (time > gap.start - gap.longest) & (time < gap.end + gap.longest)
        largest = np.max(acceleration[~near if not np.all(near) else near, gap.column])
        length = gap.end - gap.start
        place = (time[gap.rows] - gap.start) / length
        # the largest second derivative of s^2 (1 - s)^2, and of its product with 1 - 2 s, is 2, at both ends
        even = 0.5 * largest * (place * (1 - place) * length) ** 2
        changes[gap.rows, gap.column, 2 * number : 2 * number + 2] = np.stack([even, even * (1 - 2 * place)], axis=1)
    return path.smoothed(changes)


def changes_of_lines(result: Inverse, path: NoisePath) -> Smoothed:
    """Return changes (T, U, 1) of the coordinates and their derivatives that are `END_FACTOR` times those of cubic
    splines in place of the straight lines that fill gaps; (T, U, 0) without such gaps.
    """
    measured, missing, columns = result.fitted.measured, result.fitted.interpolated, straight_columns(result)
    changes = np.zeros((*missing.shape, min(1, len(columns))))
    for column in columns:
        values, gaps = measured.values[:, column], missing[:, column]
        changes[:, column, 0] = END_FACTOR * (bridged(measured.time, values, gaps, CUBIC) - values)
    return path.smoothed(changes)


def straight_columns(result: Inverse) -> list[int]:
    """Return the indices of the columns whose gaps straight lines fill."""
    motion, names = result.problem.spec.motion, result.fitted.measured.names
    columns = np.flatnonzero(np.any(result.fitted.interpolated, axis=0)).tolist()
    given = [(column, motion.gaps_of(names[column])) for column in columns]
    return [column for column, gaps in given if gaps is not None and gaps.interpolation == "linear"]


def changes_at_ends(data: NoisyData) -> Smoothed:
    """Return changes (T, U, 2 U) of the coordinates and their derivatives by what the smoothing takes for zero at the
    ends, each the effect of one of U independent combinations of the coordinates at one end: bounds of the
    accelerations or, for quintic splines, typical third derivatives.
    """
    time, how, path, series = data.time, data.how, data.path, data.series
    if isinstance(how[0], QuinticSpline):
        third, spline = _third_derivatives(time, series, path, data.deviation), spline_of_ends(time)
        return Smoothed(*(np.kron(spline(time, order)[:, None], third) for order in range(3)))
    blocks = path.samples(data.deviation, DRAWS, np.random.default_rng(0))
    noise = np.concatenate([path.smoothed(block, [NoSmoothing()] * len(how)).value for block in blocks], axis=2)
    scatter = np.sqrt(np.mean(_end_accelerations(time, noise, how) ** 2, axis=2))
    bounds = np.abs(_end_accelerations(time, data.coordinates[:, :, None], how)[:, :, 0]) + END_FACTOR * scatter
    largest = np.maximum(np.max(np.abs(series.acceleration), axis=0), bounds)
    size, wrong = largest[:, :, None] * _correlation_root(series.acceleration), _response_to_ends(time, how)
    return Smoothed(*(np.concatenate(list(part[..., None] * size[:, None]), axis=2) for part in wrong))


def likely_at_ends(data: NoisyData) -> Smoothed:
    """Return the smoothed coordinates with the accelerations at both ends that the coordinates before smoothing show,
    in place of zero; for quintic splines, the smoothed coordinates themselves.
    """
    if isinstance(data.how[0], QuinticSpline):
        return data.series
    estimate = _end_accelerations(data.time, data.coordinates[:, :, None], data.how)
    parts = zip(data.series, _response_to_ends(data.time, data.how), strict=True)
    return Smoothed(*(part - np.sum(by * estimate[:, None, :, 0], axis=0) for part, by in parts))


def _response_to_ends(time: np.ndarray, how: Sequence[Smoothing]) -> list[np.ndarray]:
    """Return the errors (2, T, U) of the coordinates, their rates and accelerations that the smoothing makes because of
    an acceleration of 1 at the start, or at the end.
    """
    from_middle = time - 0.5 * (time[0] + time[-1])
    exact = [np.repeat(one[:, None], len(how), axis=1) for one in
             (0.5 * from_middle**2, from_middle, np.ones_like(time))]  # fmt: skip
    side = np.stack([from_middle < 0, from_middle >= 0])[:, :, None]
    return [(part - true) * side for part, true in zip(smoothed_each(time, exact[0], how), exact, strict=True)]


def _end_accelerations(time: np.ndarray, coordinates: np.ndarray, how: Sequence[Smoothing]) -> np.ndarray:
    """Return estimates (2, U, S) of the accelerations at the start and at the end, from S samples of the coordinates
    before smoothing (T, U, S): those of the cubic polynomials that fit them best over one period of the cutoff.
    """
    interval = float(time[-1] - time[0]) / (len(time) - 1)
    values = np.zeros((2, *coordinates.shape[1:]))
    for index, smoothing in enumerate(how):
        count = min(len(time), max(FEWEST_AT_END, int(np.ceil(1 / (cutoff_of(time, smoothing) * interval))) + 1))
        for side, (rows, end) in enumerate(((slice(count), time[0]), (slice(-count, None), time[-1]))):
            cubic = np.vander((time[rows] - end) / (count * interval), 4, increasing=True)[None]
            second = 2 * pseudoinverses(cubic, NEGLIGIBLE)[0, 2] / (count * interval) ** 2
            values[side, index] = product(second, coordinates[rows, index])
    return values


def _correlation_root(acceleration: np.ndarray) -> np.ndarray:
    """Return a root (U, U) of the matrix of the correlations of accelerations (T, U)."""
    length = np.linalg.norm(acceleration, axis=0)
    unit = acceleration / np.where(length > 0, length, 1.0)
    square, direction = symmetric_eigenvectors(product(unit.T, unit))
    return np.asarray(direction * np.sqrt(np.maximum(0.0, square)))


def _third_derivatives(time: np.ndarray, series: Smoothed, path: NoisePath, deviation: np.ndarray) -> np.ndarray:
    """Return bounds (U, U) of the third derivatives at an end: `END_FACTOR` times a root of the matrix of their mean
    products over the record, minus that of noise.
    """

    def mean_products(acceleration: np.ndarray) -> np.ndarray:
        slope = np.diff(acceleration, axis=0) / np.diff(time)[:, None, None]  # (T - 1, U, S)
        return np.asarray(np.sum(products(slope, np.swapaxes(slope, 1, 2)), axis=0)) / len(slope)

    blocks = path.samples(deviation, DRAWS, np.random.default_rng(0))
    noise = sum(mean_products(path.smoothed(block).acceleration) for block in blocks) / DRAWS
    square, direction = symmetric_eigenvectors(mean_products(series.acceleration[:, :, None]) - noise)
    return np.asarray(END_FACTOR * direction * np.sqrt(np.maximum(0.0, square)))


def told_gaps(result: Inverse, gaps: Sequence[LongGap]) -> dict[tuple[float, float], str]:
    """Return phrases on gaps, their lengths and the largest length that the smoothing can bridge, by start and end."""
    columns: dict[tuple[float, float], list[str]] = {}
    for gap in gaps:
        columns.setdefault((gap.start, gap.end), []).append(result.fitted.measured.names[gap.column])
    most = f"half a period of the cutoff, {gaps[0].longest:.3g} s" if gaps and gaps[0].longest else "0, without cutoff"
    return {
        (start, end): f"the gap of {listed(names[:NAMED], 'and' if len(names) <= NAMED else '')}"
        f"{f' and {len(names) - NAMED} more columns' if len(names) > NAMED else ''} from {start:.6g} to {end:.6g} s, "
        f"whose length of {end - start:.3g} s exceeds {most}"
        for (start, end), names in columns.items()
    }
