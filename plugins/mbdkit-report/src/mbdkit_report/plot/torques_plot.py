"""The plot `torques`: torques of joints, drivers, force elements and actuators over time."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.headlines import ROUND_OFF
from mbdkit.archive.run_views import Names
from mbdkit.base.errors import SpecError
from mbdkit_report.figures.curves import Bands
from mbdkit_report.figures.page_model import Axis, Figure
from mbdkit_report.plot.charts import Panel
from mbdkit_report.plot.element_quantity import (
    MOST,
    ElementQuantity,
    draw_elements,
    element_chart,
    element_values,
    has_elements,
    picked,
    reaction_force,
    reaction_torque,
)

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


def panels(run: Run) -> list[Panel]:
    """Return the panel of the torques of joints, drivers, force elements and actuators."""
    return [Panel(partial(draw_elements, quantity=_carried_by_any(run), what="torques"), height=2.7)]


def charts(run: Run) -> list[Figure]:
    """Return the chart of the torques, if there are any."""
    if not run.records("joints/reaction_torque"):
        return []
    return [chart(run)] if _carried_by_any(run).elements else []


def chart(run: Run, *, joints: Names = None, elements: Names = None, most: int = MOST) -> Figure:
    """Return the chart of torques.

    Parameters
    ----------
    joints
        Names of joints and drivers.
    elements
        Names of force elements and actuators. If neither `joints` nor `elements` are given, those with the largest
        torques are drawn.

    Raises
    ------
    SpecError
        If nothing in the mechanism exerts a torque.
    UnknownNameError
        If there is no such joint, or no such force element with a torque.
    """
    if joints is None and elements is None:
        quantity = _carried_by_any(run)
        if not quantity.elements:
            raise SpecError("no joint, driver or force element of this run exerts a torque, so there is none to draw")
        few = quantity.only(picked(quantity, None, "torque", most))
    else:
        parts = []
        if joints is not None:
            torque = reaction_torque(run)
            parts.append(torque.only(picked(torque, joints, "joint")))
        if elements is not None:
            torque = element_values(run, "N m", "torque")
            parts.append(torque.only(picked(torque, elements, "force element with a torque")))
        few = _joined(parts)
    caption = (
        "Torque that the first body of each joint, driver or force element exerts on the second, about its point; "
        "positive counter-clockwise."
    )
    return element_chart("torques", "Torques", caption, Axis("torque", "N m"), few)


def carried_torque(run: Run, force: ElementQuantity) -> ElementQuantity | None:
    """Return the torques of the joints that transmit any; None if all torques are rounding errors."""
    torque = reaction_torque(run)
    largest = np.nan_to_num(torque.data.peaks)
    size = float(np.max(largest, initial=0.0))
    if not size > ROUND_OFF * np.nanmax(force.data.peaks, initial=0.0):
        return None
    return torque.only(np.flatnonzero(largest > ROUND_OFF * size).tolist())


def _carried_by_any(run: Run) -> ElementQuantity:
    """Return the torques of the joints that transmit any, and of all force elements and actuators that exert one."""
    of_joints = carried_torque(run, reaction_force(run))
    of_elements = element_values(run, "N m", "torque") if has_elements(run) else None
    parts = [part for part in (of_joints, of_elements) if part is not None]
    return _joined(parts) if parts else reaction_torque(run).only([])


def _joined(parts: list[ElementQuantity]) -> ElementQuantity:
    """Return several quantities with the same times as a single one; errors that were not estimated are nan."""
    first = parts[0]
    low, high = (np.concatenate([getattr(part.data, side) for part in parts], axis=1) for side in ("low", "high"))
    peaks = np.concatenate([part.data.peaks for part in parts])
    errors = None
    if any(part.errors is not None for part in parts):
        unknown = [np.full(part.data.high.shape, np.nan) if part.errors is None else part.errors for part in parts]
        errors = np.concatenate(unknown, axis=1)
    peak_errors = None
    if any(part.peak_errors is not None for part in parts):
        peak_errors = np.concatenate(
            [np.full(len(part.elements), np.nan) if part.peak_errors is None else part.peak_errors for part in parts]
        )
    names = [name for part in parts for name in part.elements]
    data = Bands(first.data.time, low, high, peaks, first.data.exact)
    return ElementQuantity("torque", "N m", names, data, errors, first.known_until, peak_errors)
