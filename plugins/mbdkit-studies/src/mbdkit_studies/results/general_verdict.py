"""General verdict for studies without a verdict function: extremes of misalignment, costs, and observed orders."""

from __future__ import annotations

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.mechanism.size import mechanism_size
from mbdkit.trust.criteria import ROUND_OFF
from mbdkit_report import Cell, Column, Range, Table, Verdict, observed_order
from mbdkit_studies.results.cost_at_error import cost_at_error
from mbdkit_studies.results.point_selection import STEP, Points, grouped, value
from mbdkit_studies.statistics.sample_groups import measured
from mbdkit_studies.store.study_point import StudyPoint, point_words, value_words
from mbdkit_studies.study import Study

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
