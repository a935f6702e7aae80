"""Angles from their sine, cosine or tangent.

Arctangents are angles of vectors (x, y). The smaller of both components divided by the larger one is the tangent of an
angle below pi/4. One of the angles with the tangents 0, 1/2 and 1 is subtracted, such that the tangent t of the rest is
at most 1/4; its numerator is exact. The arctangent of t is ``t + t^3 p(t^2)``.

The arcsine of s is ``s + s^3 p(s^2)`` for ``|s| <= 1/2``. Beyond, it follows from the sine of half the complementary
angle, ``sin^2(a/2) = (1 - cos a)/2``, where the difference is exact.

The polynomials are minimax fits of `mbdkit_builder.minimax`; the relative errors of arctangent and arcsine
are below 2^-63.7 and 2^-60. Quotients, roots, and the angles that are added to them are pairs of numbers, so that the
error of a result is close to half a unit in the last place (ulp).
"""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import (
    fast_two_sum,
    halves,
    is_negative,
    root_of_pair,
    sum_of_pairs,
    with_sign,
)
from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.functions import inlined, subkernel

_HALF_PI, _HALF_PI_LOW = 1.5707963267948966, 6.123233995736766e-17
_PI, _PI_LOW = 3.141592653589793, 1.2246467991473532e-16
_ANGLE_OF_HALF, _ANGLE_OF_HALF_LOW = 0.4636476090008061, 2.2698777452961687e-17  #: The angle with tangent 1/2.
_ANGLE_OF_ONE, _ANGLE_OF_ONE_LOW = 0.7853981633974483, 3.061616997868383e-17

_A1, _A2, _A3 = -0.3333333333333332, 0.19999999999991547, -0.142857142838249
_A4, _A5, _A6 = 0.11111110904362967, -0.09090896286225378, 0.07691827649899566
_A7, _A8, _A9 = -0.06655525597672476, 0.0572490158739552, -0.04000099861044129

_B1, _B2, _B3 = 0.1666666666666676, 0.0749999999997085, 0.04464285717458627
_B4, _B5, _B6 = 0.030381942708345013, 0.02237221498513825, 0.017351611876956358
_B7, _B8, _B9 = 0.013980823931283764, 0.011398872625785346, 0.010780532196586475
_B10, _B11, _B12 = 0.0037051622697561112, 0.021710896272830217, -0.021004478960653848
_B13 = 0.03263231876761984


@inlined
def _first_angle(x, y):
    """Return the angle [rad] of a vector with components that are not negative, as a pair of numbers.

    The larger component is between 2^-900 and 2^990.
    """
    is_steep = y > x
    above, under = where(is_steep, x, y), where(is_steep, y, x)
    is_near_half, is_near_one = above >= 0.25 * under, above >= 0.75 * under
    tangent = where(is_near_one, 1.0, where(is_near_half, 0.5, 0.0))
    angle = where(is_near_one, _ANGLE_OF_ONE, where(is_near_half, _ANGLE_OF_HALF, 0.0))
    angle_low = where(is_near_one, _ANGLE_OF_ONE_LOW, where(is_near_half, _ANGLE_OF_HALF_LOW, 0.0))
    divisor, divisor_low = fast_two_sum(under, tangent * above)
    dividend = above - tangent * under
    t, inverse = dividend / divisor, 1.0 / divisor
    high, _ = halves(t)
    first, second = halves(divisor)
    rest = ((dividend - high * first) - high * second) - high * divisor_low
    # If t is tiny, the quotient is the angle, correctly rounded, and these products may not be exact.
    is_tiny = abs(t) < 2.0**-30
    t_low = where(is_tiny, 0.0, rest * inverse)
    z = t * t
    square = z * z
    fourth = square * square
    low_terms = (_A1 + z * _A2) + square * (_A3 + z * _A4)
    high_terms = (_A5 + z * _A6) + square * (_A7 + z * _A8)
    t_low += z * t * (low_terms + fourth * (high_terms + fourth * _A9))
    turn = where(is_steep, -1.0, 1.0)
    base, base_low = where(is_steep, _HALF_PI, 0.0), where(is_steep, _HALF_PI_LOW, 0.0)
    base, base_low = sum_of_pairs(base, base_low, turn * angle, turn * angle_low)
    return sum_of_pairs(base, base_low, turn * where(is_tiny, t, high), turn * t_low)


@subkernel
def atan2(y, x):
    """Return the angle [rad] of the vector (x, y) from the first axis, from -pi to pi."""
    across, along = abs(y), abs(x)
    larger = where(across > along, across, along)
    # Scaling by a power of two avoids overflow and numbers whose errors are not doubles. Infinite components become 1
    # beside 0, or beside 1 if both are infinite; two zeros become (1, 0).
    factor = where(larger > 2.0**990, 2.0**-64, where(larger < 2.0**-900, 2.0**200, 1.0))
    across, along = across * factor, along * factor
    is_infinite = larger == math.inf
    across = where(is_infinite, where(abs(y) == math.inf, 1.0, 0.0), across)
    along = where(is_infinite, where(abs(x) == math.inf, 1.0, 0.0), where(larger == 0.0, 1.0, along))
    angle, low = _first_angle(along, across)
    is_left = is_negative(x)
    side = where(is_left, -1.0, 1.0)
    base, base_low = where(is_left, _PI, 0.0), where(is_left, _PI_LOW, 0.0)
    angle, _ = sum_of_pairs(base, base_low, side * angle, side * low)
    return where((x != x) | (y != y), x + y, with_sign(angle, y))


@subkernel
def atan(x):
    """Return the angle [rad] with a tangent, from -pi/2 to pi/2."""
    size = abs(x)
    angle, _ = _first_angle(1.0, where(size > 2.0**60, 2.0**60, size))
    return with_sign(angle, x)


@inlined
def _half_arcsine(x):
    """Return the arcsine of `x` if ``|x| <= 1/2``; else that of ``sqrt((1 - |x|)/2)``, half the arccosine of ``|x|``.

    The result is a pair of numbers that are not negative; the third value is whether ``|x| <= 1/2``.
    """
    size = abs(x)
    is_small = size <= 0.5
    half = 0.5 * (1.0 - size)
    z = where(is_small, x * x, half)
    root, root_low = root_of_pair(half, 0.0)
    s, low = where(is_small, size, root), where(is_small, 0.0, root_low)
    square = z * z
    fourth = square * square
    low_terms = (_B1 + z * _B2) + square * (_B3 + z * _B4)
    middle_terms = (_B5 + z * _B6) + square * (_B7 + z * _B8)
    high_terms = (_B9 + z * _B10) + square * (_B11 + z * _B12)
    terms = low_terms + fourth * (middle_terms + fourth * (high_terms + fourth * _B13))
    return s, low + s * z * terms, is_small


@subkernel
def asin(x):
    """Return the angle [rad] with a sine, from -pi/2 to pi/2; NaN if ``|x| > 1``."""
    angle, low, is_small = _half_arcsine(x)
    factor = where(is_small, 1.0, -2.0)
    base, base_low = where(is_small, 0.0, _HALF_PI), where(is_small, 0.0, _HALF_PI_LOW)
    return with_sign(sum_of_pairs(base, base_low, factor * angle, factor * low)[0], x)


@subkernel
def acos(x):
    """Return the angle [rad] with a cosine, from 0 to pi; NaN if ``|x| > 1``."""
    angle, low, is_small = _half_arcsine(x)
    is_left = x < 0.0
    factor = where(is_small, where(is_left, 1.0, -1.0), where(is_left, -2.0, 2.0))
    base = where(is_small, _HALF_PI, where(is_left, _PI, 0.0))
    base_low = where(is_small, _HALF_PI_LOW, where(is_left, _PI_LOW, 0.0))
    return sum_of_pairs(base, base_low, factor * angle, factor * low)[0]
