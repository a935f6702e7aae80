"""Functions whose graphs consist of quintic Bezier curves, each of which bends smoothly from one line to another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

ITERATIONS = 80
"""Bisection alone finds the parameter to the last bit in 55."""

ROUNDING = 4 * np.finfo(float).eps
"""Changes of the parameter, and distances of x, that are rounding errors."""

GRID = np.linspace(0.0, 1.0, 129)
"""Parameters of the table from which Newton's method starts; two or three iterations are usual then."""


class Corner(NamedTuple):
    """A point of a graph and the slope there."""

    x: float
    y: float
    slope: float


@dataclass(frozen=True)
class BezierCurve:
    """A function that is continued by straight lines on both sides.

    M. Millard et al., Journal of Biomechanical Engineering 135:021005, 2013, appendix.

    Attributes
    ----------
    x, y
        (S, 4) different control points of each segment; the inner two count twice.
    slopes
        Slopes of the straight lines.
    """

    x: np.ndarray
    y: np.ndarray
    slopes: tuple[float, float]

    @classmethod
    def through(cls, corners: Sequence[Corner], curviness: Sequence[float]) -> BezierCurve:
        """Return the curve that has given slopes at given points.

        Parameters
        ----------
        corners
            The points, in the order of x.
        curviness
            How closely each segment follows its two tangents, 0 to 1.
        """
        x, y = [], []
        for (a, b), own in zip(pairwise(corners), curviness, strict=True):
            c = 0.1 + 0.8 * own
            across = (b.y - a.y - b.x * b.slope + a.x * a.slope) / (a.slope - b.slope)
            meet = (across - b.x) * b.slope + b.y
            x.append([a.x, a.x + c * (across - a.x), b.x + c * (across - b.x), b.x])
            y.append([a.y, a.y + c * (meet - a.y), b.y + c * (meet - b.y), b.y])
        return cls(np.array(x), np.array(y), (corners[0].slope, corners[-1].slope))

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values and slopes at x."""
        x = np.asarray(x, dtype=float)
        first, last = self.x[0, 0], self.x[-1, -1]
        inside = np.clip(x, first, last)
        segment = np.clip(np.searchsorted(self.x[:, 0], inside, side="right") - 1, 0, len(self.x) - 1)
        u = _parameter(self.x[segment], inside, self._near(segment, inside))
        (_, dx), (value, dy) = _bezier(self.x[segment], u), _bezier(self.y[segment], u)
        slope = dy / np.where(dx > 0, dx, 1.0)
        for beyond, own, end, at_end in (
            (x < first, self.slopes[0], first, self.y[0, 0]),
            (x > last, self.slopes[1], last, self.y[-1, -1]),
        ):
            value = np.where(beyond, at_end + own * (x - end), value)
            slope = np.where(beyond, own, slope)
        return value, slope

    def _near(self, segment: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return parameters close to those at which segments reach x."""
        u = np.zeros_like(x)
        for index, table in enumerate(self._tables):
            own = segment == index
            u[own] = np.interp(x[own], table, GRID)
        return u

    @cached_property
    def _tables(self) -> list[np.ndarray]:
        """The x of each segment at the parameters of `GRID`."""
        return [_bezier(points, GRID)[0] for points in self.x]


def _bezier(points: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return value and derivative by u of curves with control points (..., 4)."""
    a, b, c, d = np.moveaxis(points, -1, 0)
    w = 1.0 - u
    value = a * w**5 + b * (5 * u * w**4 + 10 * u**2 * w**3) + c * (10 * u**3 * w**2 + 5 * u**4 * w) + d * u**5
    derivative = 5 * ((b - a) * w**4 + 6 * (c - b) * u**2 * w**2 + (d - c) * u**4)
    return value, derivative


def _parameter(points: np.ndarray, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the parameters at which curves reach x, by Newton's method within a bracket that starts from u."""
    low, high = np.zeros_like(x), np.ones_like(x)
    for _ in range(ITERATIONS):
        value, slope = _bezier(points, u)
        left = value - x
        low, high = np.where(left < 0, u, low), np.where(left > 0, u, high)
        new = u - left / np.where(slope > 0, slope, 1.0)
        new = np.where((new >= low) & (new <= high) & (slope > 0), new, 0.5 * (low + high))
        if np.all((np.abs(new - u) <= ROUNDING) | (np.abs(left) <= ROUNDING)):
            return np.asarray(np.where(left == 0, u, new))
        u = np.where(left == 0, u, new)
    return u
