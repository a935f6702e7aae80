"""General verdict for studies without one of their own: extremes of misalignment, and observed orders."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.order import observed_order
from mbdkit.analysis.verdict import MARGIN, Cell, Column, Table, Verdict
from mbdkit.errors import MbdkitError
from mbdkit.mechanism.size import mechanism_size
from mbdkit.studies.axis_words import point_words, value_words
from mbdkit.studies.point_selection import STEP, Points, value
from mbdkit.trust.criteria import ROUND_OFF

if TYPE_CHECKING:
    from mbdkit.studies.study import Study, StudyPoint


def general_verdict(study: Study) -> Verdict:
    """Return the general verdict: extremes of misalignment, and observed orders if the step is varied."""
    complete = [point for point in study.points if point.status == "complete"]
    failed = len(study.failures)
    sentences = [
        f"{len(complete)} of {len(study.points)} runs are complete" + (f", {failed} failed." if failed else "."),
        _extremes(complete),
    ]
    tables = tuple(table for table in (_orders(study),) if table.rows)
    return Verdict("general", study.spec.title or "Study", " ".join(filter(None, sentences)), tables=tables)


def _extremes(points: list[StudyPoint]) -> str:
    """Return a sentence on the smallest and largest misalignment; of rounding errors, only that they are so small."""
    known = [point for point in points if np.isfinite(value(point, "misalignment_max"))]
    if len(known) < 2:
        return ""
    noise = [point for point in known if value(point, "misalignment_max") <= round_off(point)]
    others = [point for point in known if point not in noise]
    ranked = sorted(others, key=lambda point: value(point, "misalignment_max"))
    if not ranked:
        most = max(value(point, "misalignment_max") for point in known)
        return f"The joints stay closed to rounding errors in all runs: {most:.1e} m at most."
    least, most = (value(point, "misalignment_max") for point in (ranked[0], ranked[-1]))
    largest = f"largest with {point_words(ranked[-1])} ({most:.1e} m)"
    if noise:
        few = point_words(noise[0]) if len(noise) == 1 else f"{len(noise)} runs"
        return f"The joint misalignment is {largest}, and a rounding error with {few}."
    if most <= MARGIN * least:
        return f"The joint misalignment is the same in all runs: {most:.1e} m."
    return f"The joint misalignment is smallest with {point_words(ranked[0])} ({least:.1e} m) and {largest}."


def round_off(point: StudyPoint) -> float:
    """Return the misalignment below which there are only rounding errors in a run [m]; 0 if its model is unknown."""
    try:
        mechanism = point.spec.mechanism()
    except MbdkitError:
        return 0.0
    start = np.array([(*body.position, body.angle) for body in mechanism.bodies.values()])
    return ROUND_OFF * mechanism_size(mechanism, start.reshape(-1, 3))


def _orders(study: Study) -> Table:
    """Return the observed orders of each sequence of points that differ only in the step."""
    lines: dict[str, list[StudyPoint]] = {}
    for point in study.points:
        if STEP in point.axes:
            others = [value_words(key, point) for key in point.axes if not key.startswith(("time.", "output."))]
            lines.setdefault(", ".join(filter(None, [point.family, *others])), []).append(point)
    rows: list[tuple[Cell, ...]] = []
    for name, points in lines.items():
        orders = []
        noise = max(map(round_off, points))
        for column in ("end_error", "misalignment_max"):
            steps, values = Points(points).along(STEP, column)
            found = observed_order(steps, np.where(values > noise, values, np.nan))
            orders.append(found.order if found.found else np.nan)
        if np.any(np.isfinite(orders)):
            rows.append((name, *orders))
    columns = (Column("runs"), Column("order of the error"), Column("order of the misalignment"))
    return Table("order", "Observed orders", columns, tuple(rows))
