"""Functions whose graphs consist of quintic Bezier curves, each of which bends smoothly from one line to another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np

#: Largest number of iterations; bisection alone determines the parameter to the last bit in 55.
ITERATIONS = 80

#: Changes of the parameter, and differences of x, that count as rounding errors.
ROUNDING = 4 * np.finfo(float).eps

#: Parameters of the table from which Newton's method starts; it then usually takes two or three iterations.
GRID = np.linspace(0.0, 1.0, 129)


#: Number of Halley iterations after which the parameter of each of Millard's curves is accurate to 1e-12. The initial
#: value is the parameter on a straight line between the ends of the segment.
#:
#: A step of Newton's method follows.
HALLEY = 4

MORE_HALLEY = 6  #: Number of Halley iterations for weighted sums of the two coordinates of a curve.

#: A number or an array, or a symbol of either that `mbdkit.plugin.TracedLaw` follows through a formula.
Traced: TypeAlias = Any
#: First distinct control point of a segment, and the differences between consecutive distinct control points.
Points = Sequence[Traced]


class CurvePoint(NamedTuple):
    """A point of a graph, and the slope at this point."""

    x: float
    y: float
    slope: float


@dataclass(frozen=True)
class BezierCurve:
    """A function whose graph consists of quintic Bezier curves, and of straight lines on both sides.

    M. Millard et al., Journal of Biomechanical Engineering 135:021005, 2013, appendix.

    Attributes
    ----------
    x, y
        (S, 4) distinct control points of each segment; the two inner ones count twice.
    slopes
        Slopes of the straight lines on the left and on the right.
    """

    x: np.ndarray
    y: np.ndarray
    slopes: tuple[float, float]

    @classmethod
    def through(cls, corners: Sequence[CurvePoint], curviness: Sequence[float]) -> BezierCurve:
        """Return the curve that has given slopes at given points.

        Parameters
        ----------
        corners
            The points, in the order of x.
        curviness
            How closely each segment follows its two tangents, from 0 to 1.
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

    def value(self, x: Traced) -> Traced:
        """Return values at x, computed by a fixed sequence of operations that can be traced; see
        `mbdkit.expressions.recorded`.
        """
        plain, (first, last) = without_slopes(x), self._ends
        inside = np.where(plain < first, first, np.where(plain > last, last, x))
        begins = self.x[1:, 0].tolist()
        u = _reached(_chosen(self.x, begins, plain), inside, HALLEY)
        result = _bezier_of(_chosen(self.y, begins, plain), u)[0]
        below, above = (
            at_end + slope * (x - end)
            for end, at_end, slope in zip((first, last), (self.y[0, 0], self.y[-1, -1]), self.slopes, strict=True)
        )
        return np.where(plain < first, below, np.where(plain > last, above, result))

    def x_where(self, p: Traced, q: Traced, r: Traced) -> Traced:
        """Return the x at which ``p y + q x = r``, computed by a fixed sequence of operations that can be traced.

        Each segment of the left side is a Bezier curve with the same parameter as x and y. The left side must increase
        with x and reach r; p must not be negative, and q must be positive.
        """
        first, last = (q * x + p * y for x, y in ((self.x[0, 0], self.y[0, 0]), (self.x[-1, -1], self.y[-1, -1])))
        begins = [q * x + p * y for x, y in zip(self.x[1:, 0].tolist(), self.y[1:, 0].tolist(), strict=True)]
        xs, ys = (_chosen(points, begins, r) for points in (self.x, self.y))
        inside = np.where(r < first, first, np.where(r > last, last, r))
        u = _reached([q * x + p * y for x, y in zip(xs, ys, strict=True)], inside, MORE_HALLEY)
        below, above = (
            end + (r - at_end) / (q + p * slope)
            for end, at_end, slope in zip(self._ends, (first, last), self.slopes, strict=True)
        )
        return np.where(r < first, below, np.where(r > last, above, _bezier_of(xs, u)[0]))

    @property
    def _ends(self) -> tuple[float, float]:
        return float(self.x[0, 0]), float(self.x[-1, -1])

    def _near(self, segment: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return parameters close to those at which the segments reach x."""
        u = np.zeros_like(x)
        for index, table in enumerate(self._tables):
            own = segment == index
            u[own] = np.interp(x[own], table, GRID)
        return u

    @cached_property
    def _tables(self) -> list[np.ndarray]:
        """The x of each segment at the parameters of `GRID`."""
        return [_bezier(points, GRID)[0] for points in self.x]


def without_slopes(x: Traced) -> Traced:
    """Return a number without its derivatives, for comparisons and initial values of iterations; arrays are returned
    unchanged.
    """
    return getattr(x, "plain", x)


def _chosen(points: np.ndarray, begins: Sequence[Traced], x: Traced) -> Points:
    """Return the points of the segment in which x lies, from the control points (S, 4) of all segments.

    `begins` are the values (S - 1,) of x at which the segments after the first begin.
    """
    steps = np.column_stack([points[:, 0], np.diff(points, axis=1)]).tolist()
    results = list(steps[0])
    for begin, step in zip(begins, steps[1:], strict=True):
        results = [np.where(x >= begin, new, old) for new, old in zip(step, results, strict=True)]
    return results


def _bezier_of(points: Points, u: Traced) -> tuple[Traced, Traced, Traced]:
    """Return value, first and second derivative with respect to u of the curve."""
    start, a, b, c = points
    w = 1.0 - u
    uu, ww = u * u, w * w
    rises = b * (u * uu * (10.0 * ww + 5.0 * u * w + uu))
    value = start + a * (1.0 - w * ww * ww) + rises + c * (u * uu * uu)
    derivative = 5.0 * (a * (ww * ww) + b * (6.0 * uu * ww) + c * (uu * uu))
    return value, derivative, 20.0 * (b * (3.0 * u * w * (w - u)) + c * (u * uu) - a * (w * ww))


def _reached(points: Points, goal: Traced, iterations: int) -> Traced:
    """Return the parameter at which a segment reaches a value.

    Only the last step, by Newton's method, computes derivatives with respect to traced variables. The parameter is
    known before this step, so that the derivatives are those of the inverse function.
    """
    plain = without_slopes(goal)
    start, a, b, c = points
    u = (plain - start) / (a + b + c)
    for _ in range(iterations):
        value, slope, second = _bezier_of(points, u)
        gap = value - plain
        u = u - 2.0 * gap * slope / (2.0 * slope * slope - gap * second)
        u = np.minimum(np.maximum(u, 0.0), 1.0)
    value, slope, _ = _bezier_of(points, u)
    return u - (value - goal) / slope


def _bezier(points: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return value and derivative with respect to u of curves with control points (..., 4)."""
    a, b, c, d = np.moveaxis(points, -1, 0)
    w = 1.0 - u
    u2, w2 = u * u, w * w  # powers of NumPy depend on the processor
    u4, w4 = u2 * u2, w2 * w2
    value = a * w4 * w + b * (5 * u * w4 + 10 * u2 * w2 * w) + c * (10 * u2 * u * w2 + 5 * u4 * w) + d * u4 * u
    return value, 5 * ((b - a) * w4 + 6 * (c - b) * u2 * w2 + (d - c) * u4)


def _parameter(points: np.ndarray, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the parameters at which curves reach x, by Newton's method with a bracket; u is the initial value."""
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
