"""The plot `drift`: misalignment of the joints, of their velocities and of their angles over time."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.run_views import Gap, Names
from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit_report.figures.page_model import Axis, Figure
from mbdkit_report.figures.quantity_text import length
from mbdkit_report.plot.charts import Panel
from mbdkit_report.plot.element_quantity import (
    MOST,
    ElementQuantity,
    angle_misalignment,
    draw_elements,
    element_chart,
    joint_misalignment,
    picked,
    value_text,
    velocity_misalignment,
)

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_READ = {"position": joint_misalignment, "velocity": velocity_misalignment, "angle": angle_misalignment}


def panels(run: Run) -> list[Panel]:
    """Return panels of the misalignments of positions and velocities and, if there are any, of angles."""
    found = [joint_misalignment(run), velocity_misalignment(run)]
    angle = angle_misalignment(run)
    if not angle.zero:
        found.append(angle)
    title = ""
    if run.joint_names:
        # The title states the largest value over all steps, which may not be among the recorded rows.
        largest = {name: joint.misalignment_max for name, joint in run.joints.items()}
        worst = max(largest, key=lambda name: np.nan_to_num(largest[name], nan=np.inf))
        title = f"misalignment: largest over every step {value_text(largest[worst], 'm')} ({worst})"
    return [
        Panel(
            partial(draw_elements, quantity=_without_zeros(quantity), what="joints", log=True, title=title * (not row))
        )
        for row, quantity in enumerate(found)
    ]


def charts(run: Run) -> list[Figure]:
    """Return a chart of positions, and of each other kind of misalignment that is not zero everywhere."""
    if not (run.records("joints/misalignment") and run.joint_names):
        return []
    return [chart(run), *(chart(run, gap=gap) for gap in ("velocity", "angle") if not _READ[gap](run).zero)]


def chart(run: Run, *, joints: Names = None, gap: Gap = "position", most: int = MOST) -> Figure:
    """Return the chart of one kind of misalignment of some joints.

    Raises
    ------
    SpecError
        If there is no such kind of misalignment, or the mechanism has no joints.
    UnknownNameError
        If there is no such joint.
    """
    if gap not in _READ:
        raise SpecError(f"the misalignment should be {listed(_READ, 'or')}, not {gap!r}")
    quantity = _READ[gap](run)
    if not quantity.elements:
        raise SpecError("the mechanism of this run has no joints, so that there is no misalignment to draw")
    text = {
        "position": f"Distance between the two points of each joint. {_remark(quantity)}",
        "velocity": "Relative velocity of the two points of each joint.",
        "angle": "Error of each prescribed angle.",
    }[gap]
    axis = Axis(quantity.name, quantity.unit, log=not quantity.zero)
    few = quantity.only(picked(quantity, joints, "joint", most))
    title = quantity.name.capitalize() + " of the joints"
    return element_chart(quantity.name.replace(" ", "-"), title, text, axis, few)


def _remark(quantity: ElementQuantity) -> str:
    """Return a sentence on the largest misalignment."""
    worst, most = quantity.largest
    if quantity.zero:
        return "All joints stay closed exactly."
    return f"The largest misalignment is {length(most)}, of joint {quantity.elements[worst]}."


def _without_zeros(quantity: ElementQuantity) -> ElementQuantity:
    """Return the quantity without the joints whose values are all zero, such as joints that do not constrain an angle;
    unchanged if this applies to all joints.
    """
    columns = quantity.nonzero_columns
    return quantity.only(columns) if columns else quantity
