"""The plot `drift`: misalignment of the joints, of their velocities and of their angles over time."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.verdict import Axis, Figure
from mbdkit.plot.joint_quantity import (
    JointQuantity,
    angle_misalignment,
    draw_joints,
    joint_lines,
    joint_misalignment,
    value_text,
    velocity_misalignment,
)
from mbdkit.plot.panel import Panel
from mbdkit.plot.quantity_text import length

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


def panels(run: Run) -> list[Panel]:
    """Return panels of the misalignments of positions, velocities and, where an angle is off, angles."""
    found = [joint_misalignment(run), velocity_misalignment(run)]
    angle = angle_misalignment(run)
    if not angle.zero:
        found.append(angle)
    title = ""
    if run.joint_names:
        # The title states the largest value of every step, which the recorded rows need not contain.
        largest = {name: joint.misalignment_max for name, joint in run.joints.items()}
        worst = max(largest, key=lambda name: np.nan_to_num(largest[name], nan=np.inf))
        title = f"misalignment: largest over every step {value_text(largest[worst], 'm')} ({worst})"
    return [
        Panel(partial(draw_joints, quantity=_without_zeros(quantity), log=True, title="" if row else title))
        for row, quantity in enumerate(found)
    ]


def charts(run: Run) -> list[Figure]:
    """Return a chart of each kind of misalignment that is not zero everywhere, that of positions always."""
    if not (run.records("joints/misalignment") and run.joint_names):
        return []
    position = joint_misalignment(run)
    worst, most = position.largest
    remark = (
        "All joints stay closed exactly."
        if position.zero
        else f"The largest misalignment is {length(most)}, of joint {position.joints[worst]}."
    )
    found = [_chart(position, "misalignment", f"Distance between the two points of each joint. {remark}")]
    for quantity, name, text in (
        (velocity_misalignment(run), "velocity-misalignment", "Relative velocity of the two points of each joint."),
        (angle_misalignment(run), "angle-misalignment", "Error of each prescribed angle."),
    ):
        if not quantity.zero:
            found.append(_chart(quantity, name, text))
    return found


def _without_zeros(quantity: JointQuantity) -> JointQuantity:
    """Return the quantity without joints to which it does not apply; they are recorded as zero."""
    columns = quantity.nonzero_columns
    return quantity.only(columns) if columns else quantity


def _chart(quantity: JointQuantity, name: str, caption: str) -> Figure:
    title = quantity.name.capitalize() + " of the joints"
    axis = Axis(quantity.name, quantity.unit, log=True)
    return Figure(name, title, caption, Axis("time", "s"), axis, joint_lines(quantity))
