"""The plot `reactions`: reaction forces and torques of the joints over time."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.verdict import Axis, Figure, Mark
from mbdkit.plot.joint_quantity import draw_joints, joint_lines, reaction_force, reaction_torque
from mbdkit.plot.panel import Panel

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_ROUND_OFF = 1e-10
"""Torques [N m] below this share of the largest force [N], or of the largest torque, count as zero."""


def panels(run: Run) -> list[Panel]:
    """Return the panel of the forces and, if there are torques, that of the joints which carry them."""
    force = reaction_force(run)
    torque = reaction_torque(run)
    largest = np.nan_to_num(torque.data.peaks)
    size = float(np.max(largest, initial=0.0))
    found = [Panel(partial(draw_joints, quantity=force))]
    if size > _ROUND_OFF * np.nanmax(force.data.peaks, initial=0.0):
        carrying = np.flatnonzero(largest > _ROUND_OFF * size).tolist()
        found.append(Panel(partial(draw_joints, quantity=torque.only(carrying))))
    return found


def charts(run: Run) -> list[Figure]:
    """Return the chart of the reaction forces."""
    if not (run.records("joints/reaction_force") and run.joint_names):
        return []
    caption = "Magnitude of the force that the first body of each joint exerts on the second."
    force = reaction_force(run)
    marks: tuple[Mark, ...] = ()
    if math.isfinite(force.known_until):
        marks = (Mark("errors unknown afterwards", force.known_until),)
    lines = joint_lines(force)
    return [Figure("reactions", "Joint forces", caption, Axis("time", "s"), Axis("force", "N"), lines, marks=marks)]
