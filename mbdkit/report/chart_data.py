"""A chart as JSON data for the page, which `templates/charts.js` passes to plotly.js."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from mbdkit.figures.page_model import Axis, Figure
from mbdkit.figures.palette import color_key, color_number, line_styles

DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
"""Dashes that distinguish lines of the same colour."""
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x")

Numbers = list[float | None]


def charts_data(charts: Iterable[Figure]) -> dict[str, Any]:
    """Return the JSON data of charts: `figures` by name, and the `columns` of numbers that their lines refer to.

    Lines over the same times share a column.
    """
    columns: dict[tuple[float | None, ...], int] = {}

    figures = {}
    for chart in charts:
        figures[chart.name] = data = chart_data(chart)
        for line in data["lines"]:
            line |= {key: columns.setdefault(tuple(line[key]), len(columns)) for key in ("x", "y")}
    return {"figures": figures, "columns": list(columns)}


def chart_data(chart: Figure) -> dict[str, Any]:
    """Return the JSON data of a chart."""
    return {
        "name": chart.name,
        "x": _axis_data(chart.x),
        "y": _axis_data(chart.y),
        "equal": chart.equal,
        "bands": [{"label": band.label, "low": band.low, "high": band.high} for band in chart.bands],
        "marks": [{"label": mark.label, "x": mark.x} for mark in chart.marks],
        "guides": [
            {"label": guide.label, "x": _numbers(guide.x, chart.x), "y": _numbers(guide.y, chart.y)}
            for guide in chart.guides
        ],
        "lines": [
            {
                "label": line.label,
                "x": _numbers(line.x, chart.x),
                "y": _numbers(line.y, chart.y),
                "band": None if line.band is None else _outline(line.band, chart),
                "kind": line.kind,
                "color": color_key(color),
                "dash": DASHES[style % len(DASHES)],
                "symbol": SYMBOLS[color_number(color) % len(SYMBOLS)],
            }
            for line, (color, style) in zip(chart.lines, line_styles(chart), strict=True)
        ],
    }


def _outline(corners: np.ndarray, chart: Figure) -> dict[str, Numbers]:
    return {"x": _numbers(corners[:, 0], chart.x), "y": _numbers(corners[:, 1], chart.y)}


def _axis_data(axis: Axis) -> dict[str, Any]:
    return {"title": axis.title, "unit": axis.unit, "log": axis.log}


def _numbers(values: np.ndarray, axis: Axis) -> Numbers:
    """Return values rounded to seven digits; None for values that the axis cannot show."""
    return [
        float(f"{value:.7g}") if abs(value) < np.inf and (value > 0 or not axis.log) else None
        for value in np.asarray(values, dtype=np.float64).tolist()
    ]
