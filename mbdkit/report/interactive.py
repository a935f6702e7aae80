"""A figure of a verdict as the data of an interactive one, which `templates/charts.js` hands to plotly.js."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbdkit.analysis.verdict import Axis, Figure, Line
from mbdkit.plot.style import PALETTE

DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
"""Styles that tell lines of one colour apart."""
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x")


def figure_data(figure: Figure) -> dict[str, Any]:
    """Return a figure as a page draws it."""
    looks = styles(figure)
    return {
        "name": figure.name,
        "x": _axis_data(figure.x),
        "y": _axis_data(figure.y),
        "equal": figure.equal,
        "bands": [{"label": band.label, "low": band.low, "high": band.high} for band in figure.bands],
        "marks": [{"label": mark.label, "x": mark.x} for mark in figure.marks],
        "lines": [
            {
                "label": line.label,
                "x": _numbers(line.x, figure.x),
                "y": _numbers(line.y, figure.y),
                "kind": line.kind,
                "color": color,
                "dash": DASHES[style % len(DASHES)],
                "symbol": SYMBOLS[color % len(SYMBOLS)],
            }
            for line, (color, style) in zip(figure.lines, looks, strict=True)
        ],
    }


def styles(figure: Figure) -> list[tuple[int, int]]:
    """Return for each line of a figure the place of its colour in the palette and the number of its dashes.

    Lines of a group share a colour and differ in their dashes; a line without a group is one by itself. Where there are
    more groups than colours, the colours begin anew with the next dashes.
    """
    groups = {line.group or line.label: 0 for line in figure.lines}
    places = {group: place for place, group in enumerate(groups)}
    found = []
    for line in figure.lines:
        group = line.group or line.label
        found.append((places[group] % len(PALETTE), groups[group] + places[group] // len(PALETTE)))
        groups[group] += 1
    return found


def shown(line: Line, figure: Figure) -> np.ndarray:
    """Return which points (K,) of a line the axes of its figure can show."""
    seen: np.ndarray = np.isfinite(line.x) & np.isfinite(line.y)
    if figure.x.log:
        seen &= np.nan_to_num(line.x) > 0
    if figure.y.log:
        seen &= np.nan_to_num(line.y) > 0
    return seen


def axis_title(axis: Axis) -> str:
    """Return an axis' label with its unit."""
    return f"{axis.label} [{axis.unit}]" if axis.unit else axis.label


def _axis_data(axis: Axis) -> dict[str, Any]:
    return {"title": axis_title(axis), "unit": axis.unit, "log": axis.log}


def _numbers(values: np.ndarray, axis: Axis) -> list[float | None]:
    """Return numbers of seven digits; None for what the axis cannot show."""
    return [
        float(f"{value:.7g}") if abs(value) < np.inf and (value > 0 or not axis.log) else None
        for value in np.asarray(values, dtype=np.float64).tolist()
    ]
