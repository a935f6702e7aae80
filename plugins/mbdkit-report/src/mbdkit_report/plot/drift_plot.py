"""The plot `drift`: misalignment of the joints, of their velocities and of their angles over time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.archive.run_views import Gap, Names
from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit_report.figures.page_model import Axis, Figure
from mbdkit_report.figures.quantity_text import length
from mbdkit_report.plot.element_quantity import GAPS, MOST, element_chart, misalignment, picked, value_text


def charts(run: Run) -> list[Figure]:
    """Return a chart of positions, and of each other kind of misalignment that is not zero everywhere."""
    if not (run.records("joints/misalignment") and run.joint_names):
        return []
    return [chart(run, gap=gap) for gap in GAPS if gap == "position" or not misalignment(run, gap).zero]


def chart(run: Run, *, joints: Names = None, gap: Gap = "position", most: int = MOST) -> Figure:
    """Return the chart of one kind of misalignment of some joints; the options are those of `RunPlots.drift`.

    Raises
    ------
    SpecError, UnknownNameError
        If there is no such kind of misalignment or joint, or the mechanism has no joints.
    """
    if gap not in GAPS:
        raise SpecError(f"the misalignment should be {listed(GAPS, 'or')}, not {gap!r}")
    if not (quantity := misalignment(run, gap)).elements:
        raise SpecError("the mechanism of this run has no joints, so that there is no misalignment to draw")
    column, most_of_all = quantity.largest
    remark = f"The largest misalignment is {length(most_of_all)}, of joint {quantity.elements[column]}."
    remark = "All joints stay closed exactly." if quantity.zero else remark
    text = {
        "position": f"Distance between the two points of each joint. {remark}",
        "velocity": "Relative velocity of the two points of each joint.",
        "angle": "Error of each prescribed angle.",
    }[gap]
    axis = Axis(quantity.name, quantity.unit, log=not quantity.zero)
    few = quantity.only(picked(quantity, joints, "joint", most))
    title = quantity.name.capitalize() + " of the joints"
    chart = element_chart(quantity.name.replace(" ", "-"), title, text, axis, few)
    if gap != "position":
        return chart
    # the largest value over all steps may not be among the recorded rows
    largest = {name: joint.misalignment_max for name, joint in run.joints.items()}
    worst = max(largest, key=lambda name: np.nan_to_num(largest[name], nan=np.inf))
    headline = f"misalignment: largest over every step {value_text(largest[worst], 'm')} ({worst})"
    return replace(chart, headline=(headline, ""))
