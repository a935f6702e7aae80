"""Where a scalar crosses zero within a step: found where dense output shows it, located on the method's own states."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from scipy.optimize import brentq

ACCURACY = 1e-13
"""Accuracy of the time of a crossing, relative to the time and to 1 s."""

POLE = 100.0
"""A change of sign where the scalar is larger by this factor than at both ends is a pole, not a zero."""

_ROUNDING = 2.0**-52

Scalar = Callable[[float], float]
Point = tuple[float, float]


class UndefinedError(Exception):
    """The scalar has no value; carries the place."""

    def __init__(self, theta: float):
        super().__init__(theta)
        self.theta = theta


@dataclass(frozen=True)
class Crossing:
    """A change of sign: its place in the step, from 0 to 1, and 1 where the scalar rises, -1 where it falls."""

    theta: float
    direction: int


def sign(value: float) -> int:
    """Return 1, 0 or -1."""
    return (value > 0) - (value < 0)


def crossings(
    before: int, shown: Sequence[Point], dense: Scalar, exact: Scalar, accuracy: float
) -> tuple[list[Crossing], int]:
    """Return the crossings within a step, in order, and the sign with which the next step begins.

    A zero that is touched is no crossing; one that is met exactly counts where the other side is reached.

    Parameters
    ----------
    before
        Sign that the scalar had last, 0 if it had none so far.
    shown
        Points (place, value) of the scalar by increasing place, those of the ends exact, others by dense output.
    dense, exact
        The scalar at a place by dense output, and by the method itself.
    accuracy
        How well a place is to be known.

    Raises
    ------
    UndefinedError
        Where the scalar has no value at a place that matters.
    """
    for place, value in (shown[0], shown[-1]):
        if not math.isfinite(value):
            raise UndefinedError(place)
    points = [shown[0], shown[-1]]
    full = _with_turns([point for point in shown if math.isfinite(point[1])], dense)
    ends = _changes(before, points)
    if _changes(before, full) > ends:  # there and back again, if the method agrees
        points = [shown[0], *((place, _defined(exact, place)) for place, _ in full[1:-1]), shown[-1]]
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
    """Return how often the sign changes, zeros left out."""
    signs = [s for s in (before, *(sign(value) for _, value in points)) if s]
    return sum(a != b for a, b in pairwise(signs))


def _with_turns(points: list[Point], dense: Scalar) -> list[Point]:
    """Return the points with those added where parabolas through three of them have turned to the other side."""
    more = []
    for (a, fa), (b, fb), (c, fc) in zip(points, points[1:], points[2:], strict=False):
        if not sign(fa) == sign(fb) == sign(fc) != 0:
            continue
        left, right = (fb - fa) / (b - a), (fc - fb) / (c - b)
        bend = (right - left) / (c - a)
        if bend == 0.0:
            continue
        place = 0.5 * (a + b) - 0.5 * left / bend
        if a < place < c and place != b and sign(fb) * (fb + (left + bend * (place - a)) * (place - b)) < 0.1 * abs(fb):
            value = dense(place)
            if math.isfinite(value) and sign(value) == -sign(fb):
                more.append((place, value))
    return sorted({*points, *more}) if more else points


def _located(left: Point, right: Point, new: int, exact: Scalar, accuracy: float) -> float | None:
    """Return where the sign turns to `new` between two points; None at a pole."""
    (a, fa), (b, fb) = left, right
    if sign(fa) != -new:  # it stood at zero: the last place where it did
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

    theta = float(brentq(function, a, b, xtol=max(accuracy, _ROUNDING), rtol=4 * _ROUNDING))
    return None if abs(function(theta)) > POLE * max(smallest) else theta


def _defined(scalar: Scalar, place: float) -> float:
    value = scalar(place)
    if not math.isfinite(value):
        raise UndefinedError(place)
    return value
