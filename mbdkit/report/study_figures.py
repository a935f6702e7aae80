"""General charts of a study: misalignment, error and cost against its axes and against each other."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.verdict import Axis, Figure, Line
from mbdkit.studies.point_selection import METHOD, value

if TYPE_CHECKING:
    from mbdkit.studies.study import Study, StudyPoint

_DECADE = 8.0
"""Ratio of largest to smallest value from which an axis is logarithmic."""
_UNITS = {"time.step": "s", "time.end": "s", "time.start": "s"}


@dataclass(frozen=True)
class _Measure:
    """A column of the index that is drawn, with its title and axis."""

    column: str
    title: str
    axis: Axis

    def of(self, points: Sequence[StudyPoint]) -> np.ndarray:
        return np.array([value(point, self.column) for point in points])


_COST = _Measure("rhs_evaluations", "Cost", Axis("right-side evaluations", log=True))
_MEASURES = (
    _Measure("misalignment_max", "Misalignment", Axis("largest misalignment", "m", log=True)),
    _Measure("end_error", "Error", Axis("error at the end", "m", log=True)),
)


def study_figures(study: Study) -> tuple[Figure, ...]:
    """Return charts of every family of a study: each measure against each numeric axis and against the cost."""
    figures: list[Figure] = []
    for name, title in study.families.items():
        points = study.family(name)
        for measure in _MEASURES:
            if not np.any(measure.of(points) > 0):
                continue
            for key in study.axes(name):
                figures += _against_axis(measure, key, points, name, title)
            figures += _against_cost(measure, points, name, title)
        for key in study.axes(name):
            figures += _against_axis(_COST, key, points, name, title)
    return tuple(figures)


def _against_axis(measure: _Measure, key: str, points: Sequence[StudyPoint], family: str, title: str) -> list[Figure]:
    """Return the chart of a measure over an axis; none if its values are not numeric."""
    labels = [point.axes[key] for point in points]
    if not all(isinstance(label, int | float) for label in labels) or len(set(labels)) < 2:
        return []
    values = np.array(labels, dtype=float)
    log = bool(np.all(values > 0) and values.max() / values.min() >= _DECADE)
    lines = []
    for label, group, chosen in _lines(points, key):
        x = np.array([float(point.axes[key]) for point in chosen])
        order = np.argsort(x)
        lines.append(Line(label, x[order], measure.of(chosen)[order], "both", group))
    return [
        Figure(
            _slug(family, measure.title, "over", key),
            f"{measure.title} against {key}",
            f"{measure.axis.label.capitalize()} of each run{_of(family, title)}.",
            Axis(key, _UNITS.get(key, ""), log),
            measure.axis,
            tuple(lines),
        )
    ]


def _against_cost(measure: _Measure, points: Sequence[StudyPoint], family: str, title: str) -> list[Figure]:
    """Return the chart of a measure over the number of evaluations; none if that is the same for all runs."""
    if len(np.unique(_COST.of(points))) < 2:
        return []
    numbers = [
        key
        for key in points[0].axes
        if key != METHOD and all(isinstance(point.axes[key], int | float) for point in points)
    ]
    lines = []
    for label, group, chosen in _lines(points, numbers[-1] if numbers else ""):
        x = _COST.of(chosen)
        order = np.argsort(x)
        lines.append(Line(label, x[order], measure.of(chosen)[order], "both", group))
    return [
        Figure(
            _slug(family, measure.title, "over-cost"),
            f"{measure.title} against cost",
            f"{measure.axis.label.capitalize()} over the right-side evaluations of each run{_of(family, title)}; "
            "lower left is better.",
            _COST.axis,
            measure.axis,
            tuple(lines),
        )
    ]


def _lines(points: Sequence[StudyPoint], along: str) -> list[tuple[str, str, list[StudyPoint]]]:
    """Return label, method and points of each group of runs that differ along one axis only."""
    found: dict[tuple[str, str], list[StudyPoint]] = {}
    for point in points:
        label = ", ".join(str(other) for key, other in point.axes.items() if key != along)
        found.setdefault((label, str(point.axes.get(METHOD, label))), []).append(point)
    return [(label, group, chosen) for (label, group), chosen in found.items()]


def _of(family: str, title: str) -> str:
    return f" of {title or family}" if family else ""


def _slug(*words: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", "-".join(filter(None, words)).lower()).strip("-")
