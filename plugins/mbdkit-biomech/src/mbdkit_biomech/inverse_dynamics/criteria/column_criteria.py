"""Criteria of the verdict on measured motions: columns, each by itself, compared with the fitted mechanism, and
used for several quantities.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from mbdkit.base.text import listed
from mbdkit.engine.linear_systems import product
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem
from mbdkit_biomech.inverse_dynamics.criteria.doubt import ROUND_OFF, TO_DEVIATION, doubt, doubts
from mbdkit_biomech.inverse_dynamics.criteria.marker_distances import (
    changed_axes,
    exchanged_markers,
    far_apart,
    misplaced_marker,
    unlike_distances,
)
from mbdkit_biomech.inverse_dynamics.criteria.time_criteria import off_neighbours, uneven_times, unit_of_time
from mbdkit_biomech.inverse_dynamics.files.measured_table import cited
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Load, NoSmoothing, QuinticSpline

#: Limits for outliers.
#:
#: A sample is an outlier if its deviation from its neighbours exceeds both `SPIKE` times the robust standard deviation
#: of all such deviations, and `LEAST_SPIKE` times the range of the column. Gaussian noise exceeds 8 standard deviations
#: once in 1e15 samples.
SPIKE, LEAST_SPIKE = 8.0, 0.005

FROZEN = 8  #: Number of equal consecutive values that a noisy sensor does not produce.

#: A column counts as changing in a sequence of rows if its range in these rows is more than this many times the
#: smallest change of the column between two rows.
MOVING = 5.0

#: Change of an angle between two rows [rad] from which the number of turns is uncertain. If the true change exceeds pi,
#: the number is wrong.
TURN = 1.2

#: An angle without a unit looks like degrees if its magnitude exceeds `TURNS` [rad]. Angles that turn mostly in one
#: direction, such as that of a crank, are exceptions: their net change is at least `TURNING` times their total
#: variation.
TURNS, TURNING = 4 * np.pi, 0.8

#: Angles declared in degrees look like radians if the largest of their ranges lies between these two numbers of
#: degrees, and if all values are within a full turn when taken as radians.
#:
#: Taken as radians, the two numbers are 17 and 172 degrees.
SMALL_RANGES = (0.3, 3.0)

#: If no pose fits, a column is named whose range is at least this multiple of the median range of the columns.
ODD_RANGE = 3.0

#: A length without a unit looks like millimetres if its range is at least this multiple of the mechanism's size.
TRAVELS = 30.0

#: Root mean square residual of a column above which the fit counts as poor, in radians or relative to the longest link.
#:
#: For the links of a leg, this is 2 cm, the limit that OpenSim recommends for markers.
RESIDUAL = 0.05

#: The fit is poor for some time if residuals exceed both `SUDDEN` times their robust standard deviation, and
#: `LEAST_SUDDEN` in the units of `RESIDUAL`. Above `LEAST_SUDDEN`, a single marker may contradict the others.
SUDDEN, LEAST_SUDDEN = 10.0, 0.01

#: The stated noise is implausible if the root mean square difference of data and smoothed motion is more than this many
#: times as large.
#:
#: A low cutoff alone gives ratios of up to 5.
BEYOND_NOISE = 10.0


def column_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield doubts about the times and columns of a measured motion."""
    yield from doubts_before_fit(result.fitted.measured, result.problem.fitter.manifold.length)
    yield from doubts("time-unit", unit_of_time(result))
    yield from doubts("constant", _constants(result))
    yield from doubts("fit", _fit(result))
    yield from doubts("noise", _noise(result))


def doubts_before_fit(measured: Measured, length: float) -> Iterator[Finding]:
    """Yield those doubts about the times and columns of a measured motion that do not depend on the fitted motion.

    Parameters
    ----------
    length
        Longest link of the mechanism [m].
    """
    yield from doubts("units", (f"{sentence}." for sentence in measured.contradictions))
    yield from doubts("times", uneven_times(measured))
    yield from doubts("units", _radians(measured))
    for index, name in enumerate(measured.names):
        yield from _outliers(measured, index, name)
        yield from _units(measured, index, name, length)
    if sentence := unlike_distances(measured, length):
        yield doubt("units", sentence)


def suspicious_columns(measured: Measured, length: float, *, no_pose: bool) -> list[str]:
    """Return sentences, without full stops, about columns and markers that may be the cause of an error.

    Wrong units may cause any error. If no pose fits the data, the cause may also be outliers or, if there are none, a
    column with a very large range.

    Parameters
    ----------
    length
        Longest link of the mechanism [m].
    no_pose
        Whether the error is that no pose fits the data.
    """
    doubts = list(measured.contradictions)
    doubts += [
        doubt.sentence.rstrip(".")
        for index, name in enumerate(measured.names)
        for doubt in (*_outliers(measured, index, name), *_units(measured, index, name, length))
        if no_pose or doubt.criterion == "units"
    ]
    if sentence := unlike_distances(measured, length) or (far_apart(measured, length) if no_pose else None):
        doubts.append(sentence.rstrip("."))
    if doubts or not no_pose:
        return doubts
    ranges = np.ptp(measured.values, axis=0) / np.abs(measured.quantities.sizes(length))
    axes = [getattr(quantity, "axis", None) for quantity in measured.quantities.quantities]
    usual = np.array([np.median([size for size, own in zip(ranges, axes, strict=True) if own == one]) for one in axes])
    worst = int(np.argmax(ranges / np.maximum(usual, np.finfo(float).tiny)))
    if not ranges[worst] > ODD_RANGE * usual[worst]:
        return []
    times = f"{ranges[worst] / usual[worst]:.3g} times the median range of the columns along the same axis"
    return [
        f"column of {measured.names[worst]}: its range of {_size(measured, worst, ranges[worst], length)} is {times}"
    ]


def _size(measured: Measured, index: int, size: float, length: float) -> str:
    """Return a size of values of a column, which is in rad or a share of the longest link `length`, with its unit."""
    if measured.quantities.is_angle[index]:
        return f"{size:.3g} rad"
    return f"{size * length:.3g} m ({size:.3g} times the longest link)"


def _radians(measured: Measured) -> Iterator[str]:
    """Yield a sentence if all angles that the spec declares in degrees look like radians.

    One small angle among larger ones, such as the tilt of a pelvis, is plausible.
    """
    columns = np.flatnonzero(measured.is_declared_in_degrees & measured.quantities.is_angle)
    if not columns.size:
        return
    numbers = np.degrees(measured.given[:, columns] / measured.quantities.scale[columns])
    span = np.nanmax(numbers, axis=0) - np.nanmin(numbers, axis=0)
    least, most = SMALL_RANGES
    if least <= span.max() <= most and np.nanmax(np.abs(numbers)) <= 2 * np.pi:
        names = listed([measured.names[index] for index in columns[:4]], "and")
        yield (
            f"the angles with `unit: deg` ({names}) change by at most {span.max():.3g} degrees during the motion "
            f"(doubtful below {most:g} if values are at most {2 * np.pi:.3g}): they look like radians; leave out "
            "`unit: deg`."
        )


def _outliers(measured: Measured, index: int, name: str) -> Iterator[Finding]:
    x = measured.values[:, index]
    if len(x) < 12 or np.ptp(x) == 0:
        return
    off = np.abs(off_neighbours(measured.time, x))
    limit = max(SPIKE * TO_DEVIATION * float(np.median(off)), LEAST_SPIKE * float(np.ptp(x)))
    if (rows := np.flatnonzero(off > limit) + 2).size:
        worst = int(np.argmax(off))
        yield doubt(
            "outliers",
            f"column of {name}: the value at t = {measured.time[worst + 2]:.6g} s is {off[worst]:.3g} "
            f"{measured.quantities.quantities[index].unit} off its neighbours (doubtful above {limit:.3g}); "
            f"{len(rows)} rows are suspicious: an outlier, a jump, exchanged columns, or gaps that were filled.",
        )


def _constants(result: Inverse) -> Iterator[str]:
    """Yield doubts about columns that are constant for some time while other columns change, unless the joints keep
    these quantities constant.
    """
    measured, fitted = result.fitted.measured, result.fitted.values
    has_more = len(measured.names) > result.problem.fitter.manifold.freedoms
    held = np.ptp(fitted, axis=0) <= ROUND_OFF * np.max(np.abs(fitted), axis=0, initial=1.0)
    quantum = [np.min(moved[moved > 0], initial=np.inf) for moved in np.abs(np.diff(measured.values, axis=0)).T]
    for index, name in enumerate(measured.names):
        if has_more and held[index]:
            continue
        x = measured.values[:, index]
        begin, end = _longest_constant(x)
        others = [
            np.ptp(measured.values[begin:end, other]) > MOVING * quantum[other]
            for other in range(len(measured.names))
            if other != index and np.isfinite(quantum[other])
        ]
        moves = [np.median(np.abs(x[end - begin :] - x[: begin - end]))] if end - begin < len(x) else [np.inf]
        if end - begin < FROZEN or not others or 2 * sum(others) < len(others) or moves[0] < MOVING * quantum[index]:
            continue
        yield (
            f"column of {name}: the value stays exactly {x[begin]:.6g} from t = {measured.time[begin]:.6g} to "
            f"{measured.time[end - 1]:.6g} s, {end - begin} rows, while others change (doubtful from {FROZEN} rows): a "
            "sensor that was lost, or a gap filled with a constant."
        )


def _longest_constant(x: np.ndarray) -> tuple[int, int]:
    """Return the first row of the longest sequence of equal values, and the row after the sequence."""
    changes = np.concatenate([[0], np.flatnonzero(np.diff(x) != 0) + 1, [len(x)]])
    longest = int(np.argmax(np.diff(changes)))
    return int(changes[longest]), int(changes[longest + 1])


def _units(measured: Measured, index: int, name: str, length: float) -> Iterator[Finding]:
    quantity, given = measured.quantities.quantities[index], measured.given[:, index]
    if quantity.unit == "m":
        travel = float(np.nanmax(given) - np.nanmin(given)) / quantity.scale
        if not measured.has_unit[index] and travel > TRAVELS * length:
            yield doubt(
                "units",
                f"column of {name}: the values have a range of {travel:.4g} m, {travel / length:.3g} times the longest "
                f"link (doubtful above {TRAVELS:g}), and no `unit`: they look like millimetres.",
            )
        return
    change = np.diff(measured.values[:, index]) / quantity.scale
    largest = float(np.nanmax(np.abs(given))) / quantity.scale
    turning = abs(np.sum(change)) >= TURNING * np.sum(np.abs(change))
    if not measured.has_unit[index] and largest > TURNS and not turning:
        yield doubt(
            "units",
            f"column of {name}: the values reach {largest:.4g} rad (doubtful above {TURNS:.4g} for an angle that "
            f"does not turn mostly in one direction), and no `unit` is given: they look like degrees; write `unit: "
            f"deg`.",
        )
    elif change.size and np.max(np.abs(change)) > TURN:
        at = int(np.argmax(np.abs(change)))
        yield doubt(
            "turns",
            f"column of {name}: the angle changes by {abs(change[at]):.3g} rad in the interval after t = "
            f"{measured.time[at]:.6g} s (doubtful above {TURN:g}), so that its turns are not certain: too few samples, "
            "a wrong unit, or an outlier.",
        )


def _fit(result: Inverse) -> Iterator[str]:
    measured, residual = result.fitted.measured, result.fitted.residual
    length = result.problem.fitter.manifold.length
    share = np.abs(residual) / measured.quantities.sizes(length)
    rms = np.sqrt(np.nanmean(share**2, axis=0))
    if np.any(rms > RESIDUAL):
        large = [index for index in np.argsort(-rms) if rms[index] > RESIDUAL][:4]
        worst, first = [measured.names[index] for index in large], large[0]
        limit = f"{RESIDUAL:g} {'rad' if measured.quantities.is_angle[first] else 'times the longest link'}"
        causes = "likely causes: exchanged or mirrored columns, wrong units, another frame, or wrong lengths."
        yield (
            f"the mechanism does not fit the data: the root mean square residual of {worst[0]} is "
            f"{_size(measured, first, rms[first], length)} (doubtful above {limit}); columns with large residuals: "
            f"{listed(worst, 'and')}; {_cause_of_misfit(result, share, causes)}"
        )
        return
    if np.any(rms > LEAST_SUDDEN) and (told := misplaced_marker(result, share)):
        yield told
        return
    usual = np.maximum(SUDDEN * TO_DEVIATION * np.nanmedian(share, axis=0), LEAST_SUDDEN)
    if (rows := np.flatnonzero(np.any(share > usual, axis=1))).size:
        columns = [name for name, one in zip(measured.names, (share > usual).T, strict=True) if np.any(one)][:4]
        yield (
            f"the mechanism does not fit {len(rows)} rows between t = {measured.time[rows[0]]:.6g} and "
            f"{measured.time[rows[-1]]:.6g} s, with residuals above {SUDDEN:g} times the usual ones, of "
            f"{listed(columns, 'and')}: " + _cause_of_misfit(result, share, "exchanged markers or outliers.")
        )


def _cause_of_misfit(result: Inverse, share: np.ndarray, otherwise: str) -> str:
    """Return a sentence on two markers that are probably exchanged where residuals `share` (T, K) are largest, on
    wrong axes of all markers, or on one marker that contradicts the others.
    """
    row, problem = int(np.argmax(np.nansum(share**2, axis=1))), result.problem
    told = exchanged_markers(problem.fitter, result.fitted.measured, row, result.fitted.q[row]) or changed_axes(problem)
    return f"{told}." if told else misplaced_marker(result, share) or otherwise


def _noise(result: Inverse) -> Iterator[str]:
    if isinstance(result.problem.spec.motion.smooth, NoSmoothing | QuinticSpline):
        return
    measured = result.fitted.measured
    left = measured.raw - measured.quantities.values(result.motion.q)
    ratio = np.sqrt(np.nanmean(left**2, axis=0)) / measured.deviation
    told = [f"{name} {one:.3g}" for name, one in zip(measured.names, ratio, strict=True) if one > BEYOND_NOISE]
    if told:
        yield (
            f"data and smoothed motion differ by more than {BEYOND_NOISE:g} times the stated noise: "
            f"{listed(told, 'and')} times. The cutoff is too low, the deviation has another unit, or the columns are "
            "wrong."
        )


#: The mechanism ties two quantities if, along its free directions, the part of the gradient of one that is independent
#: of the gradient of the other is below this share.
TIED = 1e-6


def shared_columns(problem: InverseProblem) -> Iterator[Finding]:
    """Yield a doubt for each column that is used for several quantities or components of loads.

    Quantities that the mechanism ties to each other, such as the angles of two welded bodies, may share a column.
    """
    motion, names = problem.spec.motion, problem.measured.names
    used: dict[tuple[str, str], list[str]] = {}
    for name, one in (motion.columns or {}).items():
        used.setdefault((motion.file or "", one.column), []).append(name)
    for key, sharing in used.items():
        places = [names.index(name) for name in sharing]
        if len(places) > 1 and all(_tied(problem, *pair) for pair in combinations(places, 2)):
            used[key] = sharing[:1]
    for name, load in problem.spec.loads.items():
        table = f"loads.{name}" if load.data is not None else load.file or motion.file or ""
        for heading, place in _columns(load):
            used.setdefault((table, heading), []).append(f"loads.{name}.{place}")
    for (_, heading), sharing in used.items():
        if len(sharing) > 1:
            yield doubt(
                "shared-column",
                f"column '{cited(heading)}' is used for {listed(sharing, 'and')}: is another column meant? If not, as "
                "in symmetric motions, write `accept: [shared-column]`.",
            )


def _columns(load: Load) -> Iterator[tuple[str, str]]:
    """Yield the heading and the place of each column of a load with forces or torques.

    Columns with a scale are left out, because several loads may share the force of one plate.
    """
    places = {f"force[{axis}]": one for axis, one in enumerate(load.force or ())} | {"torque": load.torque}
    for place, column in places.items():
        if column is not None and not isinstance(column, float) and abs(column.scale) == 1.0:
            yield column.column, place


def equal_columns(problem: InverseProblem) -> Iterator[str]:
    """Yield a remark on columns of the motion with other headings but equal values that are not constant."""
    measured, motion = problem.measured, problem.spec.motion
    if motion.is_run:
        return
    heading = {name: name if motion.columns is None else motion.columns[name].column for name in measured.names}
    equal = [
        f"{a} and {b}"
        for (i, a), (j, b) in combinations(enumerate(measured.names), 2)
        if heading[a] != heading[b]
        and np.array_equal(measured.given[:, i], measured.given[:, j], equal_nan=True)
        and np.nanmin(measured.given[:, i]) < np.nanmax(measured.given[:, i])
        and not _tied(problem, i, j)
    ]
    if equal:
        yield f"columns have exactly the same values: {listed(equal)}. Is one a copy of the other?"


def _tied(problem: InverseProblem, first: int, second: int) -> bool:
    manifold, pose = problem.fitter.manifold, problem.prepared.equations.q0[None]
    free = manifold.directions_at(problem.measured.time[:1], pose).free[0]
    slopes = product(problem.measured.quantities.jacobian(pose)[0] * manifold.scale, free)
    a, b = slopes[first], slopes[second]
    off = b - a * np.sum(a * b) / max(float(np.sum(a * a)), np.finfo(float).tiny)
    return bool(np.sum(off**2) <= TIED**2 * np.sum(b**2))
