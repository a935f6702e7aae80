"""The points of a study as the verdicts read them: chosen by their place on the axes, with nan for what is missing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mbdkit.studies.study import Study, StudyPoint


MODEL, METHOD, STEP = "model", "integrator", "time.step"


class Points:
    """Some points of a study.

    Parameters
    ----------
    points
        The points.
    """

    def __init__(self, points: Iterable[StudyPoint]):
        self.points = tuple(points)

    def __iter__(self) -> Iterator[StudyPoint]:
        return iter(self.points)

    def __len__(self) -> int:
        return len(self.points)

    def at(self, axes: dict[str, int | float | str]) -> Points:
        """Return the points at these labels on these axes."""
        return Points(
            point for point in self.points if all(point.axes.get(key) == label for key, label in axes.items())
        )

    def labels(self, axis: str) -> list[int | float | str]:
        """Return the labels that occur on an axis, in the order of the study."""
        return list(dict.fromkeys(point.axes[axis] for point in self.points if axis in point.axes))

    def value(self, column: str) -> float:
        """Return a number of the one point here; nan if it is not complete, or there is none."""
        return value(self.points[0], column) if len(self.points) == 1 else math.nan

    def along(self, axis: str, column: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the labels (K,) on an axis of numbers, ascending, and a number of each point; nan if not complete."""
        pairs = sorted((float(point.axes[axis]), value(point, column)) for point in self.points)
        return np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])


def value(point: StudyPoint, column: str) -> float:
    """Return a number of a point; nan if its run is not complete."""
    return float(point.values.get(column, math.nan)) if point.status == "complete" else math.nan


def family(study: Study, name: str) -> Points:
    """Return the points of a family; none where the study has no such family."""
    return Points(point for point in study.points if point.family == name)
