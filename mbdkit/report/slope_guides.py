"""Guides that show the slope of an order of convergence, in charts over the step on logarithmic axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbdkit.analysis.order import observed_order
from mbdkit.figures.page_model import Figure, Guide

_NEAR = 0.3
"""Largest distance of an observed order from a whole number for which a guide is drawn."""
_BELOW = 2.5
"""Factor by which a guide lies below its curve."""


def with_slope_guides(figure: Figure) -> Figure:
    """Return a chart with a guide for each whole order that a curve over the step has; other charts are unchanged.

    Parameters
    ----------
    figure
        Any chart; one over the step has ``step`` as the label of its x axis.
    """
    if not (figure.x.log and figure.y.log and figure.x.label == "step"):
        return figure
    found: dict[int, Guide] = {}
    for line in figure.lines:
        order = observed_order(line.x, line.y)
        whole = round(order.order) if order.found else 0
        if whole < 1 or abs(order.order - whole) > _NEAR:
            continue
        ends = np.array([min(order.steps), max(order.steps)])
        top = float(line.y[int(np.argmin(np.abs(line.x - ends[1])))]) / _BELOW
        guide = Guide(f"order {whole}", ends, top * (ends / ends[1]) ** whole)
        if whole not in found or guide.y[1] < found[whole].y[1]:
            found[whole] = guide
    return replace(figure, guides=(*figure.guides, *(found[order] for order in sorted(found))))
