"""Functions that differ between ordinary numbers, lanes and dual numbers.

Kernels are compiled for the types of their arguments. With arrays of lanes, which hold one number for each of several
runs, the same source advances these runs together (`mbdkit_builder.lane_types`). With arrays of dual numbers,
it computes derivatives as well (`mbdkit_builder.dual_types`). Python cannot branch on a condition of lanes:
code for lanes uses `where` and ``&``.

If Python interprets the kernels, these functions get ordinary numbers.
"""

from __future__ import annotations

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.native.functions import overload, placeholder, separate
from mbdkit.engine.native.levels import WIDTH

DIRECTIONS = 12  #: Number of derivatives of a dual number. More parameters are differentiated in several passes.


def is_lanes(kind):
    """Return whether a type is that of lanes, of truth values of lanes, or of an array of lanes."""
    return getattr(kind, "arithmetic", None) == "lanes"


def is_dual(kind):
    """Return whether a type is that of a dual number or of an array of dual numbers."""
    return getattr(kind, "arithmetic", None) == "dual"


def where(condition, x, y):
    """Return `x` where the condition holds, else `y`; both are evaluated."""
    return x if condition else y


def nearest(x):
    """Return the nearest whole number as a float, ties to even."""
    return float(np.rint(x))


def below(x):
    """Return the largest whole number not above `x`, as a float."""
    return float(np.floor(x))


@placeholder
def number_in(x, lane):
    """Return the number in one lane."""


@placeholder
def put_in(x, lane, number):
    """Return lanes with another number in one of them."""


def any_of(condition):
    """Return whether the condition holds; for lanes, whether it holds in at least one of them."""
    return bool(condition)


def is_refused(sound):
    """Return whether a kernel must stop because the condition `sound` does not hold.

    This is always false for lanes: the values of the failed lane become NaN (`usable`), and its run is repeated alone.
    """
    return not sound


def usable(x, sound):
    """Return `x`, with NaN in lanes in which the condition `sound` does not hold."""
    return x


def renewed(new, old, condition):
    """Return `new`, except in lanes in which the condition does not hold: there, return `old`."""
    return new


def put_in_place(values, place, x):
    """Store the number `x` at index `place` of `values` (N,), or each lane of `x` in its row of `values` (WIDTH, N)."""
    values[place] = x


def lane_by_lane(function):
    """Return a function that applies a function of numbers to each lane in turn; numbers are passed on.

    The function has one argument or two; it is compiled once and not copied into its callers.
    """
    separate(function)
    if function.__code__.co_argcount == 2:
        return _lane_by_lane_of_two(function)

    def apply(x):
        return function(x)

    def of_lanes(x):
        result = x
        for lane in range(WIDTH):
            result = put_in(result, lane, function(number_in(x, lane)))
        return result

    overload(apply)(lambda x: of_lanes if is_lanes(x) else apply)
    return apply


def _lane_by_lane_of_two(function):
    def apply(x, y):
        return function(x, y)

    def of_lanes(x, y):
        result = x
        for lane in range(WIDTH):
            result = put_in(result, lane, function(number_in(x, lane), number_in(y, lane)))
        return result

    overload(apply)(lambda x, y: of_lanes if is_lanes(x) else apply)
    return apply


def _compiled(function):
    if function is elementary.pow:
        return lambda x, y: lambda x, y: x**y
    ufunc = function.ufunc
    if ufunc.nin == 2:
        return lambda x, y: lambda x, y: ufunc(x, y)
    return lambda x: lambda x: ufunc(x)


_OF_EXPRESSIONS = "acos", "asin", "atan", "atan2", "cos", "exp", "log", "pow", "sin", "tan", "tanh"
for _name in _OF_EXPRESSIONS:
    overload(elementary.FUNCTIONS[_name])(_compiled(elementary.FUNCTIONS[_name]))


def value_of(x):
    """Return the value of a dual number; an ordinary number is returned unchanged."""
    return x


@placeholder
def with_value(x, value):
    """Return a dual number with another value and the same derivatives."""


@placeholder
def chain(x, value, slope):
    """Return the dual number with this value whose derivatives are `slope` times those of `x`."""


@placeholder
def larger_derivatives(x, y):
    """Return a dual number whose derivatives are the larger absolute values of those of `x` and `y`; its value is that
    of `x`.
    """


@placeholder
def largest_quotient(x, y):
    """Return the largest quotient of a derivative of `x` and the same derivative of `y`, none of which is negative.

    0 / 0 counts as 0. The result is infinite if a quotient is NaN.
    """
