"""Results of the methods that were added to a study, beside those of its own methods."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.trust.criteria import ROUND_OFF
from mbdkit_report.analysis.order import observed_order
from mbdkit_report.analysis.verdict import Cell, Table, Verdict, columns_of
from mbdkit_studies.cost_at_error import ERROR, wall_time
from mbdkit_studies.general_verdict import size_at_start
from mbdkit_studies.point_selection import IN_TOLERANCES, STEP, Points, value

if TYPE_CHECKING:
    from mbdkit_studies.study import Study
    from mbdkit_studies.study_point import StudyPoint

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
    """Return a verdict with a table of the added methods of the study, if there are any, and a sentence on each."""
    if not study.spec.added:
        return verdict
    rows: list[tuple[Cell, ...]] = []
    sentences = [verdict.sentence]
    for method in study.spec.added:
        points = [point for point in study.points if method in point.axes.values()]
        groups: dict[str, list[StudyPoint]] = {}
        for point in points:
            words = [label for label in point.axes.values() if isinstance(label, str) and label != method]
            groups.setdefault(", ".join(filter(None, [point.family, *words])), []).append(point)
        places = {point.number: place for point in points if (place := _place(study, point, method)) is not None}
        of_method = [_row(method, name, group, places) for name, group in groups.items()]
        rows += of_method
        sentences.append(_sentence(method, points, places, [row[8] for row in of_method]))
    table = Table("added", "Added methods", COLUMNS, tuple(rows), NOTE, headline=True)
    return replace(verdict, sentence=" ".join(filter(None, sentences)), tables=(*verdict.tables, table))


def _place(study: Study, point: StudyPoint, method: str) -> tuple[int, int] | None:
    """Return the place of a run by misalignment, and the number of complete runs that differ only in the method.

    Misalignments near rounding errors share a place. The result is None if the run is not complete, or is the only one.
    """
    others = {key: label for key, label in point.axes.items() if label != method}
    rivals = Points(study.family(point.family)).at(others)
    floor = ROUND_OFF * size_at_start(point)
    found = [max(drift, floor) for rival in rivals if math.isfinite(drift := value(rival, DRIFT))]
    mine = max(value(point, DRIFT), floor)
    if math.isnan(value(point, DRIFT)) or len(found) < 2:
        return None
    return 1 + sum(drift < mine for drift in found), len(found)


def _row(method: str, name: str, points: Sequence[StudyPoint], places: dict[int, tuple[int, int]]) -> tuple[Cell, ...]:
    complete = [point for point in points if point.status == "complete"]
    ranges: list[Cell] = []
    orders: list[Cell] = []
    varied = {key for point in points for key, label in point.axes.items() if not isinstance(label, str)}
    only_step = all(key.startswith(("time.", "output.")) for key in varied)
    for column in (DRIFT, ERROR):
        known = [found for point in complete if math.isfinite(found := value(point, column))]
        ranges += [min(known, default=None), max(known, default=None)]
        steps, values = Points(points if only_step else []).along(STEP, column)
        order = observed_order(steps, values)
        orders.append(order.order if order.found else None)
    ranked = [places[point.number] for point in points if point.number in places]
    between = sorted({place for place, _ in ranked})
    of = max((count for _, count in ranked), default=0)
    place = f"{' to '.join(map(str, dict.fromkeys((between[0], between[-1]))))} of {of}" if ranked else None
    costs = [[value(point, "rhs_evaluations"), wall_time(point)] for point in complete]
    means = np.mean(costs, axis=0).tolist() if costs else [None, None]
    counted = f"{len(complete)} of {len(points)}"
    return (method, name, counted, *ranges[:2], place, *ranges[2:], *reversed(orders), *means)


def _sentence(
    method: str, points: Sequence[StudyPoint], places: dict[int, tuple[int, int]], orders: Sequence[Cell]
) -> str:
    """Return a sentence on the runs of an added method."""
    complete = [drift for point in points if math.isfinite(drift := value(point, DRIFT))]
    told = f"Added, {method}: {len(complete)} of {len(points)} runs are complete"
    if complete:
        told += f", with misalignments of {min(complete):.1e} to {max(complete):.1e} m"
    known = [float(order) for order in orders if isinstance(order, float)]
    if known:
        ends = dict.fromkeys((f"{min(known):.2f}", f"{max(known):.2f}"))
        told += f"; the observed order of its error is {' to '.join(ends)}"
    if places:
        first = sum(place == 1 for place, _ in places.values())
        told += f"; no other method has a smaller misalignment in {first} of {len(places)} comparisons"
    if any(point.family.endswith(IN_TOLERANCES) for point in points):
        told += "; it has tolerances in place of steps"
    return told + "."
