"""A comparison beyond the paper: the same methods in body coordinates and in joint coordinates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mbdkit_paper.paper.published_results import METHODS
from mbdkit_report.analysis.verdict import Answer, Cell, Claim, Table, columns_of
from mbdkit_report.figures.quantity_text import least_most
from mbdkit_studies.point_selection import METHOD, MODEL, STEP, family, value

if TYPE_CHECKING:
    from mbdkit_studies.study import Study

COORDINATES = "coordinates"
BODIES, JOINTS = "bodies", "joints"
ROUND_OFF = 1e-12
"""Misalignment [m] of rods of 20 m counts as round-off below this."""
FAR = 1e3
"""Misalignment does not measure the accuracy of a method if an error is more than this many times larger."""


def coordinates(study: Study) -> tuple[Claim, Table]:
    """Compare misalignments and errors of methods in body coordinates and in joint coordinates."""
    rows: list[tuple[Cell, ...]] = []
    errors: dict[tuple[object, ...], dict[str, float]] = {}
    drift: dict[str, dict[str, list[float]]] = {BODIES: {}, JOINTS: {}}
    for point in family(study, "coordinates"):
        label, method = str(point.axes[COORDINATES]), str(point.axes[METHOD])
        apart, error = value(point, "misalignment_max"), value(point, "end_error")
        rows.append((point.axes[MODEL], method, label, point.axes[STEP], apart, error))
        if method not in METHODS:  # it was added
            continue
        drift[label].setdefault(method, []).append(apart)
        errors.setdefault((method, point.axes[MODEL], point.axes[STEP]), {})[label] = error
    pairs = [pair for pair in errors.values() if len(pair) == 2]
    closed = max((max(found) for found in drift[JOINTS].values()), default=math.nan)
    ratios = [pair[JOINTS] / pair[BODIES] for pair in pairs]
    ends = [pair[JOINTS] for pair in pairs]
    answer, between = Answer.OPEN, least_most(ratios)
    if ratios and not math.isnan(sum(ratios)):
        far = max(ends) > FAR * closed
        answer = Answer.NO if closed < ROUND_OFF and far else Answer.YES
    apart_by = ", ".join(f"{max(found):.1e} m ({method})" for method, found in drift[BODIES].items())
    left = "round-off" if closed < ROUND_OFF else f"at most {closed:.1e} m"
    spread = f"{min(ends, default=math.nan):.1e} m to {max(ends, default=math.nan):.1e} m"
    claim = Claim(
        "coordinates",
        "The misalignment of the joints measures the accuracy of a method.",
        "the paper ranks methods by the misalignment of the joints",
        f"the largest misalignments are {apart_by} in coordinates of the bodies, and {left} with all "
        f"methods in coordinates of the joints; the errors at 15 s in coordinates of the joints are {spread}, "
        f"{between} times the errors in coordinates of the bodies",
        answer,
        f"Misalignment depends on the choice of coordinates: in coordinates of the joints, it is {left} with every "
        f"method and no longer ranks the methods, although their errors at 15 s are {spread}.",
    )
    columns = columns_of("pendulum; method; coordinates of; step [s]; largest misalignment [m]; error at 15 s [m]")
    note = "Rods of 20 m. In the coordinates of the joints, positions follow from the angles of the rods."
    return claim, Table("coordinates", "Misalignment and error by choice of coordinates", columns, tuple(rows), note)
