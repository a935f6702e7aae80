"""The cost of runs at a given error, in studies with a reference, and the comparison of runs at equal cost."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from mbdkit.trust.criteria import KNOWN_POSITION
from mbdkit_report import Cell, Column, Table
from mbdkit_studies.results.point_selection import METHOD, OPERATIONS, grouped, value
from mbdkit_studies.store.study_point import StudyPoint, others_than, value_words
from mbdkit_studies.study import Study

ERROR = "end_error"  #: Column of the error: the largest distance of a body from the reference at the end [m].

#: Errors [m] in the table, the most relevant first.
#:
#: If none is in the range of the runs' errors, the table has the power of ten closest to the middle of this range, on a
#: logarithmic scale, if this power is in the range.
FAVOURITES = (1e-6, 1e-3, 1e-9, 1e-12)

MOST = 3  #: Largest number of errors in the table.

TIMED_ONCE = (
    'Each run was timed once, in parallel with other work, so that wall times are uncertain: "repeats: 5" in the study '
    "gives times that can be compared."
)
TIMED = "Wall times are the shortest of the repeated timings on this machine."


def wall_time(point: StudyPoint) -> float:
    """Return the shortest of the repeated timings of a run, or its single timing [s]; nan if the run is not
    complete.
    """
    least = value(point, "wall_min_s")
    return value(point, "wall_s") if math.isnan(least) else least


def is_timed(points: Iterable[StudyPoint]) -> bool:
    """Return whether any run was timed repeatedly; repeated timings are made while no other run is computed."""
    return any(not math.isnan(value(point, "wall_min_s")) for point in points)


def cost_at_error(study: Study) -> Table | None:
    """Return a table of the cost at which each sequence of runs reaches some errors.

    The runs of a sequence differ only in the value on their last numeric axis. The sequence that reaches the first
    error with the fewest operations comes first. The result is None if the study has no reference, if fewer than two
    sequences have two different errors, or if there is no power of ten in the range of the errors.
    """
    groups = _groups(study)
    if len(groups) < 2:
        return None
    errors = [float(error) for points in groups.values() for point in points if (error := value(point, ERROR)) > 0]
    if not (wanted := _targets(errors)):
        return None
    rows = []
    for name, points in groups.items():
        cells: list[Cell] = [name]
        results = [value(point, ERROR) for point in points]
        works = [sum(value(point, column) for column in OPERATIONS) for point in points]
        times = [wall_time(point) for point in points]
        for target in wanted:
            work = work_for(works, results, target)
            cells += [None, None] if math.isnan(work) else [round(work), at_equal_work(works, times, work)]
        rows.append((work_for(works, results, wanted[0]), tuple(cells)))
    rows.sort(key=lambda row: (math.isnan(row[0]), row[0]))
    columns = [Column("runs")]
    for target in wanted:
        columns += [Column(f"operations for {target:.0e} m"), Column(f"wall time for {target:.0e} m", "s")]
    note = (
        "Errors are those at the end, against the reference. Costs are interpolated between the runs of a row; a row "
        "whose cheapest run is more accurate has the cost of that run. Operations are evaluations of the right-hand "
        f"side, evaluations of Jacobians and factorizations. {TIMED if is_timed(study.points) else TIMED_ONCE}"
    )
    return Table("cost-at-error", "Cost at a given error", tuple(columns), tuple(cells for _, cells in rows), note)


def error_headlines(study: Study) -> list[tuple[str, str]]:
    """Return pairs of a name and a text about the errors against the reference; empty if no error is known.

    The first pair gives the range of the errors and the number of runs that stay near the reference. The second pair
    names the sequences of runs that need the fewest operations for a given error (see `cost_at_error`).
    """
    if not study.references:
        return []
    errors = np.array([value(point, ERROR) for point in study.points])
    if not (known := errors[np.isfinite(errors)]).size:
        return []
    text = f"{known.min():.2g} to {known.max():.2g} m at the end, against the reference"
    path = np.array([value(point, "trajectory_error") / value(point, "mechanism_size") for point in study.points])
    if np.any(np.isfinite(path)):
        count = int(np.sum(path <= KNOWN_POSITION.doubtful))
        limit = f"{KNOWN_POSITION.doubtful:.0%} of the mechanism's size"
        text += f"; {count} of {len(errors)} runs stay within {limit} of it"
    rows = [("errors", text)]
    if (table := cost_at_error(study)) is not None:
        target = table.columns[1].label.removeprefix("operations for ")
        reached = [row for row in table.rows if row[1] is not None][:3]
        if words := [f"{row[0]} ({row[1]})" for row in reached]:
            more = f", before {' and '.join(words[1:])}" if words[1:] else ""
            rows.append((f"fewest operations for an error of {target}", f"{words[0]}{more}"))
    return rows


def _groups(study: Study) -> dict[str, list[StudyPoint]]:
    """Return sequences of complete runs that differ only in their last numeric axis, such as the step.

    The keys are the families and the values on the other axes, in words. Sequences in which all errors are equal are
    left out.
    """

    def words(point: StudyPoint) -> list[str]:
        numbers = [key for key, label in point.axes.items() if key != METHOD and isinstance(label, int | float)]
        return [value_words(key, point) for key in others_than((numbers or [""])[-1], point)]

    groups = grouped([point for point in study.points if not math.isnan(value(point, ERROR))], words)
    return {name: points for name, points in groups.items() if len({value(point, ERROR) for point in points}) > 1}


def _targets(errors: list[float]) -> list[float]:
    """Return the errors of the table [m], which lie in the range of the errors of the runs."""
    if not errors:
        return []
    low, high = min(errors), max(errors)
    if inside := [target for target in FAVOURITES if low <= target <= high]:
        return inside[:MOST]
    middle = 10.0 ** round(0.5 * (math.log10(low) + math.log10(high)))
    return [middle] if low <= middle <= high else []


def at_equal_work(work: Sequence[float], result: Sequence[float], wanted: float) -> float:
    """Return the result at a given cost by log-log interpolation between neighbouring runs.

    Parameters
    ----------
    work
        (K,) costs of the runs, in any order; runs with costs that are not positive are ignored.
    result
        (K,) errors or misalignments of the runs; runs with values that are not finite or not positive are ignored.
    wanted
        Cost at which to interpolate.

    Returns
    -------
    float
        Interpolated result; nan if `wanted` lies outside the range of the costs, because nothing is extrapolated.
    """
    pairs = sorted((w, r) for w, r in zip(work, result, strict=True) if w > 0 and r > 0 and math.isfinite(r))
    if not pairs or not pairs[0][0] <= wanted <= pairs[-1][0]:
        return math.nan
    x, y = np.log(np.array(pairs)).T
    return float(np.exp(np.interp(math.log(wanted), x, y)))


def work_for(work: Sequence[float], result: Sequence[float], wanted: float) -> float:
    """Return the smallest cost from which on all results are at most `wanted`.

    Parameters
    ----------
    work
        (K,) costs of the runs, in any order; runs with costs that are not positive are ignored.
    result
        (K,) errors or misalignments of the runs; a value that is not finite counts as too large.
    wanted
        Result to reach.

    Returns
    -------
    float
        Cost, interpolated between two runs in logarithms where their results allow it; nan if the result of the most
        expensive run exceeds `wanted`, or if there are no runs.
    """
    pairs = sorted((w, r if math.isfinite(r) else math.inf) for w, r in zip(work, result, strict=True) if w > 0)
    last_bad = max((i for i, (_, r) in enumerate(pairs) if r > wanted), default=-1)
    if last_bad == len(pairs) - 1:
        return math.nan
    if last_bad < 0 or not math.isfinite(pairs[last_bad][1]) or pairs[last_bad + 1][1] <= 0:
        return pairs[last_bad + 1][0]
    (w0, r0), (w1, r1) = pairs[last_bad], pairs[last_bad + 1]
    return math.exp(math.log(w0) + math.log(wanted / r0) / math.log(r1 / r0) * math.log(w1 / w0))
