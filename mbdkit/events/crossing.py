"""Zero crossings of a scalar within a step: detected on dense output, and located on states computed by the method
itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

ACCURACY = 1e-13
"""Accuracy of the time of a crossing, relative to the larger of the time and 1 s."""

POLE = 100.0
"""A sign change between two points of a step counts as a pole if the scalar at the sign change is more than this many
times as large as at both points.
"""

LOW = 0.1
"""The extremum of a parabola through three points is examined if it is below this share of the middle one."""

_ROUNDING = 2.0**-52

Scalar = Callable[[float], float]
Point = tuple[float, float]


class UndefinedError(Exception):
    """The scalar has no finite value at the position `theta` in the step."""

    def __init__(self, theta: float):
        super().__init__(theta)
        self.theta = theta


@dataclass(frozen=True)
class Crossing:
    """A sign change: its position in the step, from 0 to 1, and its direction, 1 for rising and -1 for falling."""

    theta: float
    direction: int


def sign(value: float) -> int:
    """Return 1, 0 or -1."""
    return (value > 0) - (value < 0)


def crossings(
    before: int, shown: Sequence[Point], dense: Scalar, exact: Scalar, accuracy: float
) -> tuple[list[Crossing], int]:
    """Return the crossings within a step, in order, and the sign at the start of the next step.

    Only sign changes count. Touching zero is not a crossing. If the scalar is exactly zero, the crossing is counted
    when the scalar leaves zero with the opposite sign.

    Parameters
    ----------
    before
        Last non-zero sign of the scalar; 0 if there has been none.
    shown
        Points (position in the step, value) in increasing order; the ends are exact, the others from dense output.
    dense, exact
        The scalar as a function of the position in the step, from dense output and from the method itself.
    accuracy
        Accuracy of the position of a crossing.

    Returns
    -------
    found : list of Crossing
        Crossings in increasing order.
    sign : int
        Last non-zero sign so far; 0 if there has been none.

    Raises
    ------
    UndefinedError
        If the scalar has no finite value at an end of the step or where a crossing is located.
    """
    for place, value in (shown[0], shown[-1]):
        if not math.isfinite(value):
            raise UndefinedError(place)
    points = [shown[0], shown[-1]]
    full = _with_turns([point for point in shown if math.isfinite(point[1])], dense)
    ends = _changes(before, points)
    if _changes(before, full) > ends:  # dense output shows a double crossing, which is verified on exact values
        points = [shown[0], *((place, _defined(exact, place)) for place in _summits(full[1:-1])), shown[-1]]
    found = []
    now = before or sign(shown[0][1])
    for left, right in pairwise(points):
        new = sign(right[1])
        if new and now and new != now:
            theta = _located(left, right, new, exact, accuracy)
            if theta is not None:
                found.append(Crossing(theta, new))
        now = new or now
    return found, now


def _changes(before: int, points: Sequence[Point]) -> int:
    """Return the number of sign changes, ignoring zeros."""
    signs = [s for s in (before, *(sign(value) for _, value in points)) if s]
    return sum(a != b for a, b in pairwise(signs))


def _summits(points: Sequence[Point]) -> list[float]:
    """Return the position of the largest absolute value in each sequence of values with the same sign."""
    series = groupby((point for point in points if sign(point[1])), key=lambda point: sign(point[1]))
    return [max(group, key=lambda point: abs(point[1]))[0] for _, group in series]


def _with_turns(points: list[Point], dense: Scalar) -> list[Point]:
    """Add points near extrema of parabolas through three points if the scalar changes sign there.

    This detects double crossings between points of equal sign.
    """
    more = []
    for (a, fa), (b, fb), (c, fc) in zip(points, points[1:], points[2:], strict=False):
        if not sign(fa) == sign(fb) == sign(fc) != 0:
            continue
        left, right = (fb - fa) / (b - a), (fc - fb) / (c - b)
        bend = (right - left) / (c - a)
        if bend == 0.0:
            continue
        place = 0.5 * (a + b) - 0.5 * left / bend
        if a < place < c and place != b and sign(fb) * (fb + (left + bend * (place - a)) * (place - b)) < LOW * abs(fb):
            value = dense(place)
            if math.isfinite(value) and sign(value) == -sign(fb):
                more.append((place, value))
    return sorted({*points, *more}) if more else points


def _located(left: Point, right: Point, new: int, exact: Scalar, accuracy: float) -> float | None:
    """Return the position, between two points of a step, at which the scalar changes its sign to `new`.

    None if the scalar changes its sign at a pole, through infinity instead of zero.
    """
    (a, fa), (b, fb) = left, right
    if sign(fa) != -new:  # the left value is zero, so bisect for the last zero
        while b - a > max(accuracy, _ROUNDING):
            middle = 0.5 * (a + b)
            if sign(_defined(exact, middle)) == new:
                b = middle
            else:
                a = middle
        return a
    ends = {a: fa, b: fb}
    smallest = abs(fa), abs(fb)

    def function(place: float) -> float:
        return ends[place] if place in ends else _defined(exact, place)

    from scipy.optimize import brentq  # loaded only if an event is located

    theta = float(brentq(function, a, b, xtol=max(accuracy, _ROUNDING), rtol=4 * _ROUNDING))
    return None if abs(function(theta)) > POLE * max(smallest) else theta


def _defined(scalar: Scalar, place: float) -> float:
    value = scalar(place)
    if not math.isfinite(value):
        raise UndefinedError(place)
    return value
