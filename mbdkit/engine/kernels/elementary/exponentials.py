"""Exponential functions exp and expm1, and the exponential of an unevaluated sum of two numbers.

The argument is reduced to ``x = n ln(2) + r`` with ``|r| < 0.347`` (Cody and Waite), where ln(2) is the sum of a number
of 42 bits and a rest, so that the first part of the reduction is exact. The reduced argument is split into a multiple
`high` of 2^-25 and a rest `low`. Then ``1 + high + high^2 / 2`` is a double without rounding error. The other terms of
exp(r) are below 0.008 together; their rounding errors are below 0.02 ulp of the result.

The polynomials in r^2 for the odd and the even part of ``exp(r) - 1 - r - r^2 / 2`` are minimax fits of
`mbdkit_builder.minimax`; their errors are below 2^-63.
"""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import (
    nearest_integer,
    number_of,
    power_of_two,
    scaled,
    two_sum,
)
from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.functions import inlined, subkernel

LN2, LN2_LOW = 0.6931471805598903, 5.497923018708371e-14
"""ln(2) as the sum of a number of 42 bits, whose products with whole numbers below 2^11 are exact, and a rest."""
_PER_LN2 = 1.4426950408889634
"""1 / ln(2)."""
_SHIFTER = 201326592.0
"""1.5 * 2^27: sums with it are multiples of 2^-25."""
_Q0, _Q2, _Q4 = 0.16666666666666685, 0.008333333333315979, 0.00019841269898579418
_Q6, _Q8 = 2.755723295544484e-06, 2.51126276645195e-08
_Q1, _Q3, _Q5 = 0.041666666666666685, 0.0013888888888873322, 2.4801587349054862e-05
_Q7, _Q9 = 2.7557251996920417e-07, 2.092170128482318e-09
_LARGEST, _SMALLEST = 720.0, -760.0
"""Arguments beyond which exp(x) is infinite, or zero."""


@inlined
def reduced(x, x_low):
    """Return the integer n and `r`, where ``x + x_low = n ln(2) + r``, and parts `high` and `low` with the sum r."""
    k = nearest_integer(x * _PER_LN2)
    n = number_of(k)
    first, rest = x - n * LN2, x_low - n * LN2_LOW
    high = (first + _SHIFTER) - _SHIFTER
    return k, first + rest, high, (first - high) + rest


@inlined
def even_and_odd_parts(r, high, low):
    """Return what cosh and sinh of ``r = high + low`` have beside ``1 + high^2 / 2`` and ``high + low``."""
    z = r * r
    w = z * z
    even = w * ((_Q1 + z * _Q3) + w * ((_Q5 + z * _Q7) + w * _Q9))
    odd = r * z * ((_Q0 + z * _Q2) + w * ((_Q4 + z * _Q6) + w * _Q8))
    return even + low * (high + 0.5 * low), odd


@inlined
def exponential_of_pair(x, x_low):
    """Return k and two numbers, where ``exp(x + x_low)`` is 2^k times their sum, for `x` from -760 to 720.

    The first number is between 0.7 and 1.42, and the second below 0.008. The relative error is below 2^-60.
    """
    k, r, high, low = reduced(x, x_low)
    even, odd = even_and_odd_parts(r, high, low)
    return k, 1.0 + (high + 0.5 * high * high), low + (even + odd)


@inlined
def exponential(x, x_low):
    """Return exp(x + x_low) as a number, for any `x`."""
    k, near_one, rest = exponential_of_pair(x, x_low)
    return where(x > _LARGEST, math.inf, where(x < _SMALLEST, 0.0, scaled(near_one + rest, k)))


@subkernel
def exp(x):
    """Return e^x; the error is below 0.53 ulp, below 0.78 ulp for subnormal results."""
    return exponential(x, 0.0)


@subkernel
def expm1(x):
    """Return ``e^x - 1``; the error is below 0.65 ulp."""
    k, r, high, low = reduced(where(x > 710.0, 710.0, where(x < -60.0, -60.0, x)), 0.0)
    even, odd = even_and_odd_parts(r, high, low)
    half = power_of_two(k - 1)
    total, first_error = two_sum(half * (1.0 + (high + 0.5 * high * high)), -0.5)
    total, second_error = two_sum(total, half * low)
    difference = total + ((first_error + second_error) + half * (even + odd))
    return where(abs(x) < 2.0**-54, x, 2.0 * difference)
