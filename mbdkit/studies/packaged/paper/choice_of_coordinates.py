"""A comparison beyond the paper: the same method in body coordinates and in joint coordinates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mbdkit.analysis.verdict import Answer, Cell, Claim, Table, columns_of
from mbdkit.figures.quantity_text import least_most
from mbdkit.studies.point_selection import MODEL, STEP, family, value

if TYPE_CHECKING:
    from mbdkit.studies.study import Study

COORDINATES = "coordinates"
BODIES, JOINTS = "bodies", "joints"
ROUND_OFF = 1e-12
"""Misalignment [m] of rods of 20 m counts as round-off below this."""
FAR = 1e3
"""Misalignment gives no indication of the error if the error is more than this many times larger."""


def coordinates(study: Study) -> tuple[Claim, Table]:
    """Compare misalignment and error of RK-Gill in body coordinates and in joint coordinates."""
    rows: list[tuple[Cell, ...]] = []
    errors: dict[tuple[object, object], dict[str, float]] = {}
    drift: dict[str, list[float]] = {BODIES: [], JOINTS: []}
    for point in family(study, "coordinates"):
        label = str(point.axes[COORDINATES])
        apart, error = value(point, "misalignment_max"), value(point, "end_error")
        rows.append((point.axes[MODEL], label, point.axes[STEP], apart, error))
        drift[label].append(apart)
        errors.setdefault((point.axes[MODEL], point.axes[STEP]), {})[label] = error
    pairs = [pair for pair in errors.values() if len(pair) == 2]
    largest = {label: max(found, default=math.nan) for label, found in drift.items()}
    ratios = [pair[JOINTS] / pair[BODIES] for pair in pairs]
    answer, between = Answer.OPEN, least_most(ratios)
    if ratios and not math.isnan(sum(ratios)):
        far = min(pair[JOINTS] for pair in pairs) > FAR * largest[JOINTS]
        answer = Answer.NO if largest[JOINTS] < ROUND_OFF and far else Answer.YES
    closed = "round-off" if largest[JOINTS] < ROUND_OFF else f"{largest[JOINTS]:.1e} m"
    claim = Claim(
        "coordinates",
        "The misalignment of the joints measures the accuracy of a method.",
        "the paper ranks methods by the misalignment of the joints",
        f"the largest misalignment is {largest[BODIES]:.1e} m in coordinates of the bodies and {closed} in coordinates "
        f"of the joints; the errors at 15 s in coordinates of the joints are {between} times those in coordinates of "
        "the bodies",
        answer,
        "Misalignment depends on the choice of coordinates: if RK-Gill integrates those of the joints instead of those "
        f"of the bodies, the largest misalignment falls from {largest[BODIES]:.1e} m to {closed}, while "
        f"the error of the positions is {between} times as large.",
    )
    columns = columns_of("pendulum; coordinates of; step [s]; largest misalignment [m]; error at 15 s [m]")
    note = "RK-Gill on rods of 20 m. In the coordinates of the joints, positions follow from the angles of the rods."
    return claim, Table("coordinates", "Misalignment and error by choice of coordinates", columns, tuple(rows), note)
