"""Criteria of the verdict on the record and its smoothing: largest values of a result in long gaps or near ends of the
record, actuators whose values are mostly noise, a cutoff below frequencies that the motion contains, and stated
deviations that are much too large.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import periodogram

from mbdkit.base import elementary
from mbdkit.base.text import listed
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, reactions_of
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt, doubts
from mbdkit_biomech.inverse_dynamics.errors.ends_and_gaps import NAMED, long_gaps, longest_period, told_gaps
from mbdkit_biomech.inverse_dynamics.errors.error_bars import LOAD_UNITS, ResultBars
from mbdkit_biomech.inverse_dynamics.motion.smoothing import UNEVEN, cutoff_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import (
    Butterworth,
    NoSmoothing,
    OpenSimFilter,
    QuinticSpline,
    SmoothingSpline,
)

#: A largest value is doubtful if the part of its error bar due to the ends of the record exceeds this share of it, or
#: if the data before smoothing show values near an end that are larger by more than this share.
OF_ENDS = 0.1

#: An element is doubtful if a long gap may hide a change of its value of more than this share of its largest value.
OF_GAPS = 0.1


class _Peak(NamedTuple):
    """The largest value of an actuator or a joint.

    Attributes
    ----------
    label, value, unit
        Name of the element, its largest value and the unit.
    row
        Row of the largest value.
    of_ends
        Part of its error bar due to the ends of the record.
    likely
        (T,) values with the accelerations at both ends that the data before smoothing show.
    reached
        (T,) values that the data do not exclude where the error is unknown; otherwise, the values.
    hidden
        (T,) changes that long gaps may hide where the error is unknown; otherwise, 0. They are infinite without error
        bars.
    """

    label: str
    value: float
    unit: str
    row: int
    of_ends: float
    likely: np.ndarray
    reached: np.ndarray
    hidden: np.ndarray

    def told(self, time: np.ndarray) -> str:
        return f"{self.label} ({self.value:.4g} {self.unit} at t = {time[self.row]:.6g} s)"

    def wrong_by(self, rows: np.ndarray) -> str:
        most = float(np.max(self.hidden[rows]))
        return f"{self.label} (by up to {most:.2g} {self.unit})" if np.isfinite(most) else self.label


def record_doubts(result: Inverse, bars: ResultBars | None) -> Iterator[Finding]:
    """Yield doubts about actuators and joint forces whose values in long gaps, or largest values near the ends, are
    uncertain.
    """
    time, peaks = result.motion.time, _peaks(result, bars)
    for (start, end), gap in told_gaps(result, long_gaps(result)).items():
        rows = (time > start) & (time < end)
        if open_peaks := [peak for peak in peaks if np.any(peak.reached[rows] > peak.value)]:
            told = listed((peak.told(time) for peak in open_peaks), "and", NAMED)
            yield doubt(
                "gaps",
                f"the data do not determine the largest values of {told}, because of {gap}: its values are "
                "interpolated, and larger ones are possible. Fill it with measured values, or cut the motion with "
                "`time.start` or `time.end`.",
            )
        elif wrong := [peak for peak in peaks if np.any(peak.hidden[rows] > OF_GAPS * peak.value)]:
            told = listed((one.wrong_by(rows) for one in wrong), "and", NAMED)
            yield doubt(
                "gaps",
                f"errors are unknown because of {gap}: values of {told} may be wrong there (doubtful above {OF_GAPS:g} "
                "of the largest value). Do not use values in the gap, or fill it with measured values.",
            )
    yield from doubts("ends", _peaks_at_ends(result, peaks))


def _peaks_at_ends(result: Inverse, peaks: Sequence[_Peak]) -> Iterator[str]:
    time = result.motion.time
    cutoff = "" if isinstance(result.problem.spec.motion.smooth, QuinticSpline) else ", one period of the cutoff"
    for at_start in (True, False):
        half = slice(len(time) // 2) if at_start else slice(len(time) // 2, None)
        near = [one for one in peaks if one.of_ends > OF_ENDS * one.value and (one.row < len(time) // 2) == at_start]
        doubted = {one.label for one in near}
        lost = [(float(np.max(peak.likely[half])), peak) for peak in peaks if peak.label not in doubted]
        lost = [(most, one) for most, one in lost if most > (1 + OF_ENDS) * one.value]
        if not near and not lost:
            continue
        side, beyond = ("start", "before") if at_start else ("end", "after")
        more = f"record at least {longest_period(result):.2g} s more {beyond}"
        move = f"or move `time.{side}` if it cuts the data there."
        if near:
            worst, told = max(near, key=lambda one: one.of_ends / one.value), [one.told(time) for one in near]
            yield (
                f"the largest values of {listed(told, 'and', NAMED)} are so close to the {side} of the record that the "
                f"smoothing may change that of {worst.label} by {worst.of_ends:.2g} {worst.unit} (doubtful above "
                f"{OF_ENDS:g} of the value): {more} them{cutoff}, {move}"
            )
        if lost:
            (most, worst), told = max(lost, key=lambda pair: pair[0] / pair[1].value), [x.told(time) for _, x in lost]
            yield (
                f"the true largest values of {listed(told, 'and', NAMED)} may lie at the {side} of the record, where "
                f"the smoothing takes accelerations for zero: the data before smoothing show about {most:.2g} "
                f"{worst.unit} for {worst.label} there (doubtful above {1 + OF_ENDS:g} times the largest value): "
                f"{more} the motion{cutoff}, {move}"
            )


def _peaks(result: Inverse, bars: ResultBars | None) -> list[_Peak]:
    """Return the largest values of all joint forces and actuators that are not zero; residual actuators and reserves
    should be small and are left out.
    """
    actuators = np.abs(result.actuators[:, :, 0])
    forces = np.linalg.norm(reactions_of(result)[..., :2], axis=2)
    named = [(one.name, one.unit if one.kind == "actuator" else "") for one in result.problem.recorded_actuators]
    named += [(f"the force in {name}", "N") for name in result.problem.prepared.workspace.mechanism.joints]
    values = np.nan_to_num(np.hstack([actuators, forces]))
    of_ends, likely = np.zeros_like(values), values
    if bars is None:
        reached = values.copy()
        hidden = np.zeros_like(values)
        for gap in long_gaps(result):  # what the gap may hide is not estimated
            reached[gap.rows] = np.nextafter(values[gap.rows], np.inf)
            hidden[gap.rows] = np.inf
    else:
        of_ends, of_gaps, likely = np.hstack(bars.of_ends), np.hstack(bars.of_gaps), np.hstack(bars.likely)
        unknown = np.isnan(np.hstack([bars.actuators, bars.accuracy.reaction_error]))
        hidden = np.where(unknown, of_gaps, 0.0)
        reached = values + hidden
    rows, found = np.argmax(values, axis=0).tolist(), []
    for column, ((label, unit), row) in enumerate(zip(named, rows, strict=True)):
        if unit and values[row, column] > 0:
            value, end = float(values[row, column]), float(of_ends[row, column])
            found.append(_Peak(label, value, unit, row, end, likely[:, column], reached[:, column], hidden[:, column]))
    return found


#: The values of an actuator are mostly noise if the root mean square of their error bars exceeds `MOSTLY` times their
#: own root mean square, and `MOSTLY` times the share `OF_LARGEST` of the largest one of all actuators with the same
#: unit.
#:
#: Noise alone gives 1.96. In the packaged examples of walking, the ratio is at most 1.15.
MOSTLY, OF_LARGEST = 1.5, 0.1


def large_errors(result: Inverse, bars: ResultBars | None) -> Iterator[Finding]:
    """Yield a doubt about the actuators, except residual ones and reserves, whose values are mostly noise.

    The parts of errors due to the ends of the record are left out, because they have their own criterion.
    """
    if bars is None:
        return
    own = [(place, one) for place, one in enumerate(result.problem.recorded_actuators) if one.kind == "actuator"]
    values = np.sqrt(np.mean(result.actuators[:, :, 0] ** 2, axis=0))
    squares = bars.actuators**2 - bars.of_ends[0] ** 2
    told = []
    for place, one in own:
        known = squares[np.isfinite(squares[:, place]), place]
        error = float(np.sqrt(max(0.0, np.mean(known)))) if known.size else 0.0
        largest = max(values[other] for other, another in own if another.unit == one.unit)
        if error > MOSTLY * max(values[place], OF_LARGEST * largest):
            told.append(f"{one.name} ({values[place]:.3g} {one.unit}, with error bars of {error:.3g} {one.unit})")
    if told:
        is_smoothed = not isinstance(result.problem.spec.motion.smooth, NoSmoothing)
        cure = "use a lower cutoff" if is_smoothed else "smooth the motion with `motion.smooth`"
        yield doubt(
            "large-errors",
            f"values of actuators are mostly noise, according to their root mean squares: "
            f"{listed(told, 'and', NAMED)} (doubtful above {MOSTLY:g} times as much; noise alone gives 2): "
            f"{cure}, or check deviations that the spec states.",
        )


TINY = np.finfo(float).tiny

#: Limits for what the smoothing removes near the cutoff.
#:
#: White noise has the same power density at all frequencies. The cutoff is too low if the differences between data and
#: smoothed motion have more than `EXCESS` times the power density near the cutoff that they have at high frequencies,
#: and if what is removed there changes the acceleration by more than the share `REMOVED`. In 80 random data sets with
#: cutoffs of at least 2.5 times the highest frequency of the motion, the share is at most 0.02 where the ratio of the
#: densities exceeds `EXCESS`; in the example `walking`, it is 0.15 with the usual cutoff of 6 Hz.
EXCESS, REMOVED = 10.0, 0.2

#: The cutoff is examined if the record has at least so many rows and periods of the cutoff.
FEWEST_ROWS, FEWEST_PERIODS = 50, 1.0

FEWEST_HIGH = 8  #: Least number of high frequencies that give the level of the noise.


def cutoff_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield a doubt if a cutoff given in the spec removes a part of the motion (residual analysis; D. A. Winter,
    Biomechanics and Motor Control of Human Movement, 4th edition, Wiley 2009, section 3.4.4.3).
    """
    how, independent, time = result.problem.spec.motion.smooth, result.independent, result.motion.time
    fixed = isinstance(how, Butterworth | OpenSimFilter) or (isinstance(how, SmoothingSpline) and how.parameter)
    if independent is None or len(independent.intervals) != 1 or not fixed or len(time) < FEWEST_ROWS:
        return
    steps, cutoff = np.diff(time), cutoff_of(time, how)
    rate = float(1 / np.mean(steps))
    if np.ptp(steps) > 2 * UNEVEN / rate or cutoff * (time[-1] - time[0]) < FEWEST_PERIODS:
        return
    smooth = independent.quantities.values(result.motion.q)
    left = independent.quantities.values(result.fitted.q) - smooth
    frequency, removed = periodogram(left, rate, window="hann", axis=0)
    _, kept = periodogram(smooth, rate, window="hann", axis=0)
    near, high = (frequency > 0.5 * cutoff) & (frequency < 2 * cutoff), frequency >= 2.5 * cutoff
    if np.sum(high) < FEWEST_HIGH:
        return
    noise = np.median(removed[high], axis=0) / elementary.log(2)  # the median of exponentially distributed densities
    excess = np.mean(removed[near], axis=0) / np.maximum(noise, TINY)
    weight = (frequency**4 * (frequency < 2 * cutoff))[:, None]
    share = np.sqrt(
        np.sum(weight * np.maximum(0.0, removed - noise), axis=0) / np.maximum(np.sum(weight * kept, axis=0), TINY)
    )
    if (low := np.flatnonzero((excess > EXCESS) & (share > REMOVED))).size:
        texts = [f"{share[index]:.2g} of that of {independent.names[index]}" for index in low[:4]]
        yield doubt(
            "cutoff",
            f"the cutoff of {cutoff:.3g} Hz removes a part of the motion: the accelerations that it removes are "
            f"{listed(texts, 'and')} (doubtful above {REMOVED:g}), and noise does not explain them. Choose a higher "
            "cutoff.",
        )


#: A stated deviation is too large if it exceeds this many times the noise seen in the residuals, and if the
#: residuals that all deviations lead to expect exceed this many times the actual ones.
LARGE = 5.0

#: Columns are not examined if the correlation of consecutive residuals exceeds this number.
#:
#: Such data were smoothed before, and their residuals do not show the noise of the measurement. The correlation is
#: below 0.1 for independent noise, and 0.77 to 0.93 in the example `walking`, whose data are filtered.
CORRELATED = 0.5


def large_deviations(result: Inverse, bars: ResultBars | None) -> Iterator[str]:
    """Yield sentences on stated deviations that are much larger than the noise of the data, or than the data."""
    if bars is None:
        return
    if told := [*_above_noise(result, bars)]:
        yield (
            f"stated deviations are more than {LARGE:g} times the noise seen in the data, so that error bars are too "
            f"wide: {listed(told, 'and', NAMED)}. Check their units."
        )
    if told := [*_above_values(result, bars)]:
        yield f"stated deviations exceed the data themselves: {listed(told, 'and', NAMED)}. Check their units."


def _above_noise(result: Inverse, bars: ResultBars) -> Iterator[str]:
    measured, noise = result.fitted.measured, bars.noise
    left = measured.raw - measured.quantities.values(result.motion.q)
    correlation = np.nanmean(left[1:] * left[:-1], axis=0) / np.maximum(np.nanmean(left**2, axis=0), TINY)
    for index in np.flatnonzero((noise.excess > LARGE) & (correlation < CORRELATED)).tolist():
        if (stated := float(measured.deviation[index])) > LARGE * noise.seen[index]:
            unit = measured.quantities.quantities[index].unit
            yield f"{measured.names[index]} {stated:.3g} {unit} (seen {noise.seen[index]:.2g} {unit})"


def _above_values(result: Inverse, bars: ResultBars) -> Iterator[str]:
    """Yield columns whose noise cannot be seen, and loads, which are not smoothed, whose deviations exceed the values.

    Angles and coordinates are compared with their ranges, forces and torques with their root mean squares, and points
    of application with the longest link.
    """
    measured, size = result.fitted.measured, result.problem.fitter.manifold.length
    spans = np.nanmax(measured.raw, axis=0) - np.nanmin(measured.raw, axis=0)
    for index, stated in enumerate(measured.deviation.tolist()):
        if np.isnan(bars.noise.seen[index]) and stated > spans[index] > 0:
            unit = measured.quantities.quantities[index].unit
            yield f"{measured.names[index]} {stated:.3g} {unit} (range {spans[index]:.2g} {unit})"
    for name, series in result.problem.loads.items():
        for (array, axis), stated in series.deviation.items():
            label = f"{name}.{array}{'' if axis is None else '.' + 'xy'[axis]} {stated:.3g} {LOAD_UNITS[array]}"
            values = getattr(series, array)[series.acts]
            rms = float(np.sqrt(np.mean(np.sum(values.reshape(len(values), -1) ** 2, axis=1)))) if len(values) else 0.0
            if array == "point" and stated > size:
                yield f"{label} (longest link {size:.2g} m)"
            elif array != "point" and stated > rms > 0:
                yield f"{label} (root mean square {rms:.2g} {LOAD_UNITS[array]})"
