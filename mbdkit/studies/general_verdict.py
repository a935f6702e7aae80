"""General verdict for studies without one of their own: extremes of misalignment, and observed orders."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbdkit.analysis.order import observed_order
from mbdkit.analysis.verdict import Cell, Column, Table, Verdict
from mbdkit.studies.point_selection import STEP, Points, value

if TYPE_CHECKING:
    from mbdkit.studies.study import Study, StudyPoint


def general_verdict(study: Study) -> Verdict:
    """Return the general verdict: extremes of misalignment, and observed orders if the step is varied."""
    complete = [point for point in study.points if point.status == "complete"]
    failed = len(study.failures)
    sentences = [
        f"{len(complete)} of {len(study.points)} runs are complete" + (f", {failed} failed." if failed else ".")
    ]
    ranked = sorted((value(point, "misalignment_max"), point.number, point.label) for point in complete)
    ranked = [entry for entry in ranked if entry[0] == entry[0]]
    if len(ranked) > 1:
        (least, _, best), (most, _, worst) = ranked[0], ranked[-1]
        sentences.append(
            f"The joint misalignment is smallest with {best} ({least:.1e} m) and largest with {worst} ({most:.1e} m)."
        )
    tables = tuple(table for table in (_orders(study),) if table.rows)
    return Verdict("general", study.spec.title or "Study", " ".join(sentences), tables=tables)


def _orders(study: Study) -> Table:
    """Return the observed orders of each sequence of points that differ only in the step."""
    lines: dict[str, list[StudyPoint]] = {}
    for point in study.points:
        if STEP in point.axes:
            others = [str(label) for key, label in point.axes.items() if not key.startswith(("time.", "output."))]
            lines.setdefault(", ".join(filter(None, [point.family, *others])), []).append(point)
    rows: list[tuple[Cell, ...]] = []
    for name, points in lines.items():
        line = Points(points)
        error = observed_order(*line.along(STEP, "end_error"))
        drift = observed_order(*line.along(STEP, "misalignment_max"))
        if error.found or drift.found:
            rows.append((name, error.order, drift.order))
    columns = (Column("runs"), Column("order of the error"), Column("order of the misalignment"))
    return Table("order", "Observed orders", columns, tuple(rows))
