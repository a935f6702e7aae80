"""The plot `reactions`: reaction forces and torques of the joints over time."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.verdict import Axis, Figure, Mark
from mbdkit.plot.error_bands import UNKNOWN
from mbdkit.plot.joint_quantity import JointQuantity, draw_joints, joint_lines, reaction_force, reaction_torque
from mbdkit.plot.panel import Panel

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_ROUND_OFF = 1e-10
"""Torques [N m] below this share of the largest force [N], or of the largest torque, count as zero."""


def panels(run: Run) -> list[Panel]:
    """Return the panel of the forces and, if there are torques, that of the joints which carry them."""
    force = reaction_force(run)
    found = [Panel(partial(draw_joints, quantity=force))]
    if (torque := _carried(run, force)) is not None:
        found.append(Panel(partial(draw_joints, quantity=torque)))
    return found


def charts(run: Run) -> list[Figure]:
    """Return the chart of the reaction forces and, if there are torques, that of the joints which carry them."""
    if not (run.records("joints/reaction_force") and run.joint_names):
        return []
    force = reaction_force(run)
    caption = "Magnitude of the force that the first body of each joint exerts on the second."
    found = [_chart(force, "reactions", "Joint forces", caption)]
    if run.records("joints/reaction_torque") and (torque := _carried(run, force)) is not None:
        caption = "Torque that the first body of each joint exerts on the second, about the joint."
        found.append(_chart(torque, "torques", "Joint torques", caption))
    return found


def _chart(quantity: JointQuantity, name: str, title: str, caption: str) -> Figure:
    marks: tuple[Mark, ...] = ()
    if quantity.errors is not None:
        caption += " Bands show estimated errors; those narrower than a line are hidden by it."
    if math.isfinite(quantity.known_until):
        marks = (Mark(UNKNOWN, quantity.known_until),)
    axis = Axis(quantity.name.removeprefix("reaction "), quantity.unit)
    return Figure(name, title, caption, Axis("time", "s"), axis, joint_lines(quantity), marks=marks)


def _carried(run: Run, force: JointQuantity) -> JointQuantity | None:
    """Return the torques of the joints that carry any; None if there are none but rounding errors."""
    torque = reaction_torque(run)
    largest = np.nan_to_num(torque.data.peaks)
    size = float(np.max(largest, initial=0.0))
    if not size > _ROUND_OFF * np.nanmax(force.data.peaks, initial=0.0):
        return None
    return torque.only(np.flatnonzero(largest > _ROUND_OFF * size).tolist())
