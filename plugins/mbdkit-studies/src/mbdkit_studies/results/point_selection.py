"""Selects points of a study by their axis labels, and returns their values; nan for missing ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from mbdkit_studies.spec.method_claims import METHOD as METHOD
from mbdkit_studies.store.study_point import StudyPoint
from mbdkit_studies.study import Study

MODEL, STEP = "model", "time.step"
#: Suffix of the family in which an added method has tolerances in place of the steps of another family.
IN_TOLERANCES = "-tolerances"
OPERATIONS = ("rhs_evaluations", "jacobian_evaluations", "factorizations")
"""Counters whose sum is the cost of a run in operations."""


class Points:
    """A selection of points of a study."""

    def __init__(self, points: Iterable[StudyPoint]):
        self.points = tuple(points)

    def __iter__(self) -> Iterator[StudyPoint]:
        return iter(self.points)

    def __len__(self) -> int:
        return len(self.points)

    def at(self, axes: dict[str, int | float | str]) -> Points:
        """Return the points that have the given labels on the given axes."""
        return Points(point for point in self.points if axes.items() <= point.axes.items())

    def labels(self, axis: str) -> list[int | float | str]:
        """Return the labels that occur on an axis, in the order of the study."""
        return list(dict.fromkeys(point.axes[axis] for point in self.points if axis in point.axes))

    def value(self, column: str) -> float:
        """Return a value of a single selected point; nan if its run is not complete, or if not exactly one point is
        selected.
        """
        return value(self.points[0], column) if len(self.points) == 1 else math.nan

    def along(self, axis: str, column: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the labels (K,) on a numeric axis, ascending, and a value of each point; nan for runs that are not
        complete. Points that lack the axis are left out.
        """
        pairs = sorted((float(point.axes[axis]), value(point, column)) for point in self.points if axis in point.axes)
        return np.array([label for label, _ in pairs]), np.array([number for _, number in pairs])


def value(point: StudyPoint, column: str) -> float:
    """Return a value of a point; nan if its run is not complete."""
    return float(point.values.get(column, math.nan)) if point.status == "complete" else math.nan


def grouped(points: Iterable[StudyPoint], words: Callable[[StudyPoint], Iterable[str]]) -> dict[str, list[StudyPoint]]:
    """Return the points with the same family and the same words, by these as one line."""
    groups: dict[str, list[StudyPoint]] = {}
    for point in points:
        groups.setdefault(", ".join(filter(None, [point.family, *words(point)])), []).append(point)
    return groups


def family(study: Study, name: str) -> Points:
    """Return the points of a family, and those that added methods have in its place with tolerances instead of steps.

    The selection is empty if the study has no such family.
    """
    return Points(point for point in study.points if point.family in (name, name + IN_TOLERANCES))
