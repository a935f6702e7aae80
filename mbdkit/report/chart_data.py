"""A chart as JSON data for the page, which `templates/charts.js` passes to plotly.js."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbdkit.analysis.verdict import Axis, Figure
from mbdkit.plot.chart_images import axis_title, line_styles

DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
"""Dashes that distinguish lines of the same colour."""
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x")


def chart_data(chart: Figure) -> dict[str, Any]:
    """Return the JSON data of a chart."""
    return {
        "name": chart.name,
        "x": _axis_data(chart.x),
        "y": _axis_data(chart.y),
        "equal": chart.equal,
        "bands": [{"label": band.label, "low": band.low, "high": band.high} for band in chart.bands],
        "marks": [{"label": mark.label, "x": mark.x} for mark in chart.marks],
        "lines": [
            {
                "label": line.label,
                "x": _numbers(line.x, chart.x),
                "y": _numbers(line.y, chart.y),
                "band": None if line.band is None else _outline(line.band, chart),
                "kind": line.kind,
                "color": color,
                "dash": DASHES[style % len(DASHES)],
                "symbol": SYMBOLS[color % len(SYMBOLS)],
            }
            for line, (color, style) in zip(chart.lines, line_styles(chart), strict=True)
        ],
    }


def _outline(corners: np.ndarray, chart: Figure) -> dict[str, list[float | None]]:
    return {"x": _numbers(corners[:, 0], chart.x), "y": _numbers(corners[:, 1], chart.y)}


def _axis_data(axis: Axis) -> dict[str, Any]:
    return {"title": axis_title(axis), "unit": axis.unit, "log": axis.log}


def _numbers(values: np.ndarray, axis: Axis) -> list[float | None]:
    """Return values rounded to seven digits; None for values that the axis cannot show."""
    return [
        float(f"{value:.7g}") if abs(value) < np.inf and (value > 0 or not axis.log) else None
        for value in np.asarray(values, dtype=np.float64).tolist()
    ]
