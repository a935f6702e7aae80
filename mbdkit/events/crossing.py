"""Zero crossings of a scalar within a step: detected on dense output, and located on states computed by the method
itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import count, groupby, pairwise

from mbdkit.base.frozen import dataclass

ACCURACY = 1e-13  #: Accuracy of the time of a crossing, relative to the larger of the time and 1 s.

#: A sign change between two points of a step may be at a pole if the scalar at the sign change is more than this many
#: times as large as at one of the points.
POLE = 100.0

#: It is at a pole if the scalar grows by this factor `GROWTH` as the distance decreases by `WIDER`.
WIDER, GROWTH = 30.0, 2.0

#: The extremum of a parabola through three points is examined if it is below this share of the middle one.
LOW = 0.1

#: Share of the step at whose distance from an end the scalar is evaluated if it has no finite value there.
BESIDE = 1e-9

#: Parameters n0 and kappa1 (relative to the first interval) of ITP; kappa2 is 2. Larger values of n0 leave more room to
#: interpolation, which then needs fewer evaluations for smooth functions.
SLACK, TRUNCATION = 8, 0.2

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
    when the scalar leaves zero with the opposite sign. If the sign at the start of the step differs from the last one
    before, because the state has jumped there, this is a crossing at the start. A scalar without a finite value at an
    end of the step, such as at a pole there, has the value close to this end instead.

    `before`: last non-zero sign of the scalar; 0 if there has been none. `shown`: points (position in the step, value)
    in increasing order; the ends are exact, the others from dense output. `dense`, `exact`: the scalar as a function of
    the position in the step, from dense output and from the method itself. `accuracy`: accuracy of the position of a
    crossing. Returns crossings in increasing order, and last non-zero sign so far; 0 if there has been none. Raises
    UndefinedError if the scalar has no finite value close to an end of the step, or where a crossing is located.
    """
    first, last = (0.0, _at_end(shown[0], BESIDE, exact)), (1.0, _at_end(shown[-1], 1.0 - BESIDE, exact))
    inner = [point for point in shown[1:-1] if math.isfinite(point[1])]
    if not math.isfinite(shown[0][1]) and abs(first[1]) > POLE * abs(next(iter([*inner, last]))[1]):
        before = sign(first[1])  # the scalar goes through infinity
    points = [first, last]
    full = _with_turns([first, *inner, last], dense)
    ends = _changes(before, points)
    if _changes(before, full) > ends:  # dense output shows a double crossing, which is verified on exact values
        verified = ((theta, exact(theta)) for theta in _summits(full[1:-1]))
        points = [first, *(point for point in verified if math.isfinite(point[1])), last]
    crossed = []
    now = before or sign(first[1])
    if sign(first[1]) == -now != 0:
        now = -now
        crossed.append(Crossing(0.0, now))
    for left, right in pairwise(points):
        new = sign(right[1])
        if new and now and new != now and (theta := _located(left, right, new, exact, accuracy)) is not None:
            crossed.append(Crossing(theta, new))
        now = new or now
    return crossed, now


def _at_end(end: Point, beside: float, exact: Scalar) -> float:
    """Return the value at an end of a step, or that at the position `beside` if it is not finite."""
    theta, value = end
    if math.isfinite(value):
        return value
    value = exact(beside)
    if not math.isfinite(value):
        raise UndefinedError(theta)
    return value


def _changes(before: int, points: Sequence[Point]) -> int:
    signs = [s for s in (before, *(sign(value) for _, value in points)) if s]
    return sum(a != b for a, b in pairwise(signs))


def _summits(points: Sequence[Point]) -> list[float]:
    """Return the position of the largest absolute value in each sequence of values with the same sign.

    The ends of longer sequences are left out: they may be close to a pole.
    """
    series = (list(group) for _, group in groupby((p for p in points if sign(p[1])), key=lambda p: sign(p[1])))
    return [max(group[1:-1] or group, key=lambda point: abs(point[1]))[0] for group in series]


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
        x = 0.5 * (a + b) - 0.5 * left / bend
        if a < x < c and x != b and sign(fb) * (fb + (left + bend * (x - a)) * (x - b)) < LOW * abs(fb):
            value = dense(x)
            if math.isfinite(value) and sign(value) == -sign(fb):
                more.append((x, value))
    return sorted({*points, *more}) if more else points


def _located(left: Point, right: Point, new: int, exact: Scalar, accuracy: float) -> float | None:
    """Return the position, between two points of a step, at which the scalar changes its sign to `new`.

    None if the scalar changes its sign at a pole, through infinity instead of zero.
    """
    (a, fa), (b, fb) = bracket_root(exact, left, right, accuracy)
    if min(abs(fa), abs(fb)) > POLE * min(abs(left[1]), abs(right[1])):
        # the point on the left or right may itself be close to the pole
        near, far = WIDER * accuracy, WIDER * WIDER * accuracy
        sides = [side for side in ((a - near, a - far), (b + near, b + far)) if left[0] < side[1] < right[0]]
        if sides and all(abs(exact(x)) > GROWTH * abs(exact(y)) for x, y in sides):
            return None
    return a if abs(fa) <= abs(fb) else b


def bracket_root(function: Scalar, left: Point, right: Point, accuracy: float) -> tuple[Point, Point]:
    """Return two points with a distance of at most `accuracy` between which a function changes its sign.

    The method is ITP: interpolation, truncation and projection (Oliveira and Takahashi 2020,
    https://doi.org/10.1145/3423597). It converges superlinearly to simple zeros, and needs only a few evaluations more
    than bisection for any function, such as one with a multiple zero, around which its values are rounding errors.

    `left`, `right`: points with a value of different sign; the value on the left may be zero. The sign changes to that
    of `right`: zeros count as the sign of `left`, so that the last zero is located if the function is zero for a while.
    `accuracy`: largest distance of the points; rounding errors of positions of about 1 limit it. Raises UndefinedError
    if the function has no finite value at a position and at two beside it.
    """
    (a, fa), (b, fb) = left, right
    new, width, whole = sign(fb), max(accuracy, _ROUNDING), b - a
    most = math.ceil(math.log2(max(whole / width, 1.0))) + SLACK
    is_tried = False  # whether the position to the right of a zero has been tried
    for k in count():
        if b - a <= width:
            return (a, fa), (b, fb)
        x = middle = 0.5 * (a + b)
        if fa != 0.0:
            root = a + (b - a) * (fa / (fa - fb))
            towards, shift = math.copysign(1.0, middle - root), TRUNCATION * (b - a) * ((b - a) / whole)
            radius = max(0.0, width * 2.0 ** (most - k - 1) - 0.5 * (b - a))
            if shift <= abs(middle - root):
                x = root + towards * shift
            if not abs(x - middle) <= radius:
                x = middle - towards * radius
        elif not is_tried:  # most functions are zero at one position only
            x, is_tried = a + width, True
        x, fx = _defined_beside(function, x if a < x < b else middle, a, b)
        if sign(fx) == new:
            b, fb = x, fx
        else:
            is_tried &= fa == 0.0
            a, fa = x, fx
    raise AssertionError


def _defined_beside(function: Scalar, x: float, a: float, b: float) -> Point:
    """Return the point at `x`, or one at a position half way to `a` or `b` if the value at `x` is not finite."""
    for position in (x, 0.5 * (a + x), 0.5 * (x + b)):
        value = function(position)
        if math.isfinite(value):
            return position, value
    raise UndefinedError(x)
