"""The plot `torques`: torques of joints, drivers, force elements and actuators over time."""

from __future__ import annotations

import numpy as np

from mbdkit.archive.headlines import ROUND_OFF
from mbdkit.archive.run import Run
from mbdkit.archive.run_views import Names
from mbdkit.base.errors import SpecError
from mbdkit_report.figures.curves import Bands
from mbdkit_report.figures.page_model import Axis, Figure
from mbdkit_report.plot.element_quantity import (
    MOST,
    ElementQuantity,
    element_chart,
    element_values,
    has_elements,
    picked,
    reaction_force,
    reaction_torque,
)


def charts(run: Run) -> list[Figure]:
    """Return the chart of the torques, if there are any."""
    return [chart(run)] if run.records("joints/reaction_torque") and _carried_by_any(run).elements else []


def chart(run: Run, *, joints: Names = None, elements: Names = None, most: int = MOST) -> Figure:
    """Return the chart of torques; the options are those of `RunPlots.torques`.

    Raises
    ------
    SpecError, UnknownNameError
        If nothing in the mechanism exerts a torque, or there is no such joint, or force element with a torque.
    """
    if joints is None and elements is None:
        if not (quantity := _carried_by_any(run)).elements:
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
    return torque_chart(few)


def torque_chart(torques: ElementQuantity) -> Figure:
    """Return the chart of some torques."""
    caption = (
        "Torque that the first body of each joint, driver or force element exerts on the second, about its point; "
        "positive counter-clockwise."
    )
    return element_chart("torques", "Torques", caption, Axis("torque", "N m"), torques)


def carried_torque(run: Run, force: ElementQuantity) -> ElementQuantity | None:
    """Return the torques of the joints that transmit any; None if all torques are rounding errors."""
    torque = reaction_torque(run)
    largest = np.nan_to_num(torque.data.peaks)
    size = float(np.max(largest, initial=0.0))
    if not size > ROUND_OFF * np.nanmax(force.data.peaks, initial=0.0):
        return None
    return torque.only(np.flatnonzero(largest > ROUND_OFF * size).tolist())


def _carried_by_any(run: Run) -> ElementQuantity:
    of_joints = carried_torque(run, reaction_force(run))
    of_elements = element_values(run, "N m", "torque") if has_elements(run) else None
    parts = [part for part in (of_joints, of_elements) if part is not None]
    return _joined(parts) if parts else reaction_torque(run).only([])


def _joined(parts: list[ElementQuantity]) -> ElementQuantity:
    """Return several quantities with the same times as a single one; errors that were not estimated are nan."""
    first, data = parts[0], [part.data for part in parts]
    low, high, peaks, times = (
        np.concatenate([getattr(one, name) for one in data], axis=-1) for name in ("low", "high", "peaks", "peak_times")
    )
    known = [np.full_like(part.data.high, np.nan) if part.errors is None else part.errors for part in parts]
    errors = None if all(part.errors is None for part in parts) else np.concatenate(known, axis=-1)
    names = [name for part in parts for name in part.elements]
    texts = [one for part in parts for one in part.largest_texts or [None] * len(part.elements)]
    together = Bands(first.data.time, low, high, peaks, times, first.data.exact)
    return ElementQuantity("torque", "N m", names, together, errors, first.known_until, texts)
