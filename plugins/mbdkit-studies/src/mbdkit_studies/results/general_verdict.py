"""Results of any study: the general verdict on one without a verdict function, with extremes of misalignment, costs and
observed orders, and those of added methods beside those of its own methods.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.mechanism.size import mechanism_size
from mbdkit.trust.criteria import ROUND_OFF
from mbdkit_report import Cell, Column, Figure, Range, Table, Verdict, columns_of, observed_order
from mbdkit_studies.results.cost_at_error import ERROR, cost_at_error, wall_time
from mbdkit_studies.results.point_selection import IN_TOLERANCES, STEP, Points, grouped, value
from mbdkit_studies.statistics.sample_groups import measured
from mbdkit_studies.store.study_point import StudyPoint, point_words, value_words
from mbdkit_studies.study import Study

ADDED = "added"  #: Name of the table of added methods.

DRIFT = "misalignment_max"

COLUMNS = columns_of(
    "method; runs; complete; misalignment, least [m]; largest [m]; place; error, least [m]; largest [m]; "
    "order of the error; order of the misalignment; evaluations; time [s]"
)
NOTE = (
    "Errors are those at the end, in families with a reference. Place: by misalignment, among all methods at the same "
    "values of the other axes; misalignments near rounding errors are equal. Orders are observed where only the step "
    "varies. Evaluations and times are means of the complete runs; times are those of this machine."
)


def with_added_methods(verdict: Verdict, study: Study) -> Verdict:
    """Return a verdict with a table of the added methods of the study, if there are any.

    The verdict on a study with a sample is unchanged, because such a study may have too many runs to compare.
    """
    rows: list[tuple[Cell, ...]] = []
    for method, points, places in _added(study):

        def words(point: StudyPoint, method: str = method) -> list[str]:
            return [label for label in point.axes.values() if isinstance(label, str) and label != method]

        rows += [_row(method, name, group, places) for name, group in grouped(points, words).items()]
    if not rows:
        return verdict
    table = Table(ADDED, "Added methods", COLUMNS, tuple(rows), NOTE, headline=True)
    return replace(verdict, tables=(*verdict.tables, table))


def added_texts(study: Study) -> list[tuple[str, str]]:
    """Return pairs of a name and a text about the results of each added method."""
    verdict = with_added_methods(Verdict("", "", ""), study)
    orders = {row[:2]: row[8] for table in verdict.tables for row in table.rows}
    return [
        (f"added: {method}", _text(points, places, [order for (name, _), order in orders.items() if name == method]))
        for method, points, places in _added(study)
    ]


def with_emphasis(figure: Figure, methods: Sequence[str]) -> Figure:
    """Return a figure in which the lines of added methods are emphasized."""
    lines = (
        replace(line, is_emphasized=True) if line.group in methods or line.label in methods else line
        for line in figure.lines
    )
    return replace(figure, lines=tuple(lines))


def _added(study: Study) -> Iterator[tuple[str, list[StudyPoint], dict[int, tuple[int, int]]]]:
    """Yield each added method with its runs and their places; nothing for a study with a sample."""
    for method in () if study.spec.has_table else study.spec.added:
        points = [point for point in study.points if method in point.axes.values()]
        yield method, points, _places(study, points, method)


def _places(study: Study, points: Sequence[StudyPoint], method: str) -> dict[int, tuple[int, int]]:
    """Return the place of complete runs of a method by misalignment, and the number of runs that differ only in the
    method, by the number of the point.

    Misalignments near rounding errors share a place. Runs that no other can be compared with are left out.
    """
    key = next((key for point in points for key, label in point.axes.items() if label == method), "")

    def group(point: StudyPoint) -> tuple[object, ...]:
        return (point.family, *(item for item in point.axes.items() if item[0] != key))

    results: dict[tuple[object, ...], list[float]] = {}
    for point in study.points:
        if math.isfinite(drift := value(point, DRIFT)):
            results.setdefault(group(point), []).append(drift)
    places = {}
    for point in points:
        rivals = results.get(group(point), [])
        if math.isfinite(mine := value(point, DRIFT)) and len(rivals) > 1:
            floor = ROUND_OFF * size_at_start(point)
            places[point.number] = 1 + sum(max(drift, floor) < max(mine, floor) for drift in rivals), len(rivals)
    return places


def _row(method: str, name: str, points: Sequence[StudyPoint], places: dict[int, tuple[int, int]]) -> tuple[Cell, ...]:
    complete = [point for point in points if point.status == "complete"]
    ranges: list[Cell] = []
    orders: list[Cell] = []
    varied = {key for point in points for key, label in point.axes.items() if not isinstance(label, str)}
    only_step = all(key.startswith(("time.", "output.")) for key in varied)
    for column in (DRIFT, ERROR):
        known = [result for point in complete if math.isfinite(result := value(point, column))]
        ranges += [min(known, default=None), max(known, default=None)]
        steps, values = Points(points if only_step else []).along(STEP, column)
        order = observed_order(steps, values)
        orders.append(order.order if order.found else None)
    ranked = [places[point.number] for point in points if point.number in places]
    between = sorted({place for place, _ in ranked})
    of = max((count for _, count in ranked), default=0)
    text = f"{' to '.join(map(str, dict.fromkeys((between[0], between[-1]))))} of {of}" if ranked else None
    costs = [[value(point, "rhs_evaluations"), wall_time(point)] for point in complete]
    means = np.mean(costs, axis=0).tolist() if costs else [None, None]
    counted = f"{len(complete)} of {len(points)}"
    return (method, name, counted, *ranges[:2], text, *ranges[2:], *reversed(orders), *means)


def _text(points: Sequence[StudyPoint], places: dict[int, tuple[int, int]], orders: Sequence[Cell]) -> str:
    """Return a text on the runs of an added method."""
    complete = [drift for point in points if math.isfinite(drift := value(point, DRIFT))]
    text = f"{len(complete)} of {len(points)} runs are complete"
    if complete:
        text += f", with a misalignment of {_between(complete, '.1e')} m"
    if known := [float(order) for order in orders if isinstance(order, float)]:
        text += f"; the observed order of its error is {_between(known, '.2f')}"
    if places:
        first = sum(place == 1 for place, _ in places.values())
        text += f"; no other method has a smaller misalignment in {first} of {len(places)} comparisons"
    if any(point.family.endswith(IN_TOLERANCES) for point in points):
        text += "; it has tolerances in place of steps"
    return text


def _between(values: Sequence[float], form: str) -> str:
    return " to ".join(dict.fromkeys(format(end, form) for end in (min(values), max(values))))


#: Errors below this many units of round-off of the mechanism's size are not used to determine an order.
_ROUNDINGS = 4.0


def general_verdict(study: Study) -> Verdict:
    """Return the general verdict.

    It has the number of complete runs, the extremes of misalignment, the cost at given errors if the study has a
    reference, and observed orders if the step is varied. The verdict on a study with a sample or a table of members has
    only the number of complete runs and the largest misalignment.
    """
    failed = len(study.failures)
    count = list(study.statuses()).count("complete")
    sentences = [f"{count} of {len(study.points)} runs are complete" + (f", {failed} failed." if failed else ".")]
    tables: list[Table | None] = []
    if study.spec.has_table:  # many runs, whose specs are not read
        largest = measured(study, "misalignment_max", range(len(study.points)), with_bad=True)
        if np.any(np.isfinite(largest)):
            sentences.append(f"The joint misalignment is at most {np.nanmax(largest):.1e} m.")
    else:
        sentences.append(_extremes([point for point in study.points if point.status == "complete"]))
        tables = [cost_at_error(study), _orders(study)]
    known = tuple(table for table in tables if table is not None and table.rows)
    return Verdict("general", study.spec.title or "Study", " ".join(filter(None, sentences)), tables=known)


def _extremes(points: list[StudyPoint]) -> str:
    """Return a sentence on the smallest and largest misalignment; values at round-off level are not ranked."""
    measured = [(value(point, "misalignment_max"), point.number, point) for point in points]
    ranked = sorted(entry for entry in measured if np.isfinite(entry[0]))
    if len(ranked) < 2:
        return ""
    (least, _, best), (most, _, worst) = ranked[0], ranked[-1]
    small = [entry for entry in ranked if entry[0] <= ROUND_OFF * size_at_start(entry[-1])]
    if len(small) == len(ranked):
        return f"The joints stay closed to rounding errors in all runs: {most:.1e} m at most."
    if most <= Range.MARGIN * least:
        return f"The joint misalignment is the same in all runs: {most:.1e} m."
    largest = f"largest with {point_words(worst)} ({most:.1e} m)"
    if len(small) > 1:
        few = f"at most {small[-1][0]:.1e} m, near rounding errors, in {len(small)} runs"
        return f"The joint misalignment is {largest}, and {few}."
    return f"The joint misalignment is smallest with {point_words(best)} ({least:.1e} m) and {largest}."


def size_at_start(point: StudyPoint) -> float:
    """Return the size of the mechanism of a run [m]; 0 if its model is not available."""
    try:
        mechanism = point.spec.mechanism()
    except MbdkitError:
        return 0.0
    start = np.array([(*body.position, body.angle) for body in mechanism.bodies.values()])
    return mechanism_size(mechanism, start.reshape(-1, 3))


def _orders(study: Study) -> Table:
    """Return a table of the observed orders of each sequence of points that differ only in the step."""
    lines = grouped(
        [point for point in study.points if STEP in point.axes],
        lambda point: [value_words(key, point) for key in point.axes if not key.startswith(("time.", "output."))],
    )
    rows: list[tuple[Cell, ...]] = []
    for name, points in lines.items():
        orders = []
        noise = _ROUNDINGS * np.finfo(float).eps * max(map(size_at_start, points))
        for column in ("end_error", "misalignment_max"):
            steps, values = Points(points).along(STEP, column)
            estimate = observed_order(steps, np.where(values > noise, values, np.nan))
            orders.append(estimate.order if estimate.found else np.nan)
        if np.any(np.isfinite(orders)):
            rows.append((name, *orders))
    columns = (Column("runs"), Column("order of the error"), Column("order of the misalignment"))
    return Table("order", "Observed orders", columns, tuple(rows))
