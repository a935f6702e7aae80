"""Exponential functions exp and expm1, and the exponential of an unevaluated sum of two numbers.

exp and exponentials of pairs use a table (P. T. P. Tang, Table-driven implementation of the exponential function in
IEEE floating-point arithmetic, ACM Trans. Math. Softw. 15 (1989)): ``x = k ln(2) / 128 + r`` with ``|r| < 0.0028``, and
2^(k / 128) is a power of two times an entry of the table. The other terms of exp(r) are so small that their rounding
errors are below 0.01 ulp of the result.

expm1 and the hyperbolic functions reduce the argument to ``x = n ln(2) + r`` with ``|r| < 0.347``. The reduced argument
is split into a multiple `high` of 2^-25 and a rest `low`. Then ``1 + high + high^2 / 2`` is a double without rounding
error. The other terms of exp(r) are below 0.008 together; their rounding errors are below 0.02 ulp of the result.

In both reductions, ln(2) is the sum of a number whose product with the integer is exact, and a rest (W. J. Cody and
W. Waite, Software manual for the elementary functions, 1980). The polynomials for ``(exp(r) - 1 - r) / r^2``, and in
r^2 for the odd and the even part of ``exp(r) - 1 - r - r^2 / 2``, are minimax fits of `mbdkit_builder.minimax`; their
errors are below 2^-63 in exp(r).
"""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import (
    bits_of,
    from_bits,
    nearest_integer,
    number_of,
    power_of_two,
    scaled,
    two_sum,
)
from mbdkit.engine.kernels.elementary.tables import PARTS, PARTS_BITS, POWERS_OF_TWO, entry
from mbdkit.engine.native.arithmetic import any_of, where
from mbdkit.engine.native.functions import inlined, subkernel

#: ln(2) as the sum of a number of 42 bits, whose products with whole numbers below 2^11 are exact, and a rest.
LN2, LN2_LOW = 0.6931471805598903, 5.497923018708371e-14
_PER_LN2 = 1.4426950408889634  #: 1 / ln(2).
#: ln(2) / 128 as the sum of a number of 35 bits, whose products with whole numbers below 2^18 are exact, and a rest;
#: and its reciprocal.
_PART, _PART_LOW, _PER_PART = 0.005415212347998022, 1.2655086083325438e-13, 184.6649652337873
_LAST = PARTS - 1
_SHIFTER = 201326592.0  #: 1.5 * 2^27: sums with it are multiples of 2^-25.
_C2, _C3, _C4, _C5 = 0.4999999999999907, 0.16666666666666127, 0.04166667685080846, 0.00833333552333734
_Q0, _Q2, _Q4 = 0.16666666666666685, 0.008333333333315979, 0.00019841269898579418
_Q6, _Q8 = 2.755723295544484e-06, 2.51126276645195e-08
_Q1, _Q3, _Q5 = 0.041666666666666685, 0.0013888888888873322, 2.4801587349054862e-05
_Q7, _Q9 = 2.7557251996920417e-07, 2.092170128482318e-09
_MODERATE = 700.0  #: Absolute value up to which exp(x) is far from the limits of the normal numbers.
_LARGEST, _SMALLEST = 720.0, -760.0  #: Arguments beyond which exp(x) is infinite, or zero.


@inlined
def reduced(x):
    """Return the integer n and `r`, where ``x = n ln(2) + r``, and parts `high` and `low` with the sum r."""
    k = nearest_integer(x * _PER_LN2)
    n = number_of(k)
    first, rest = x - n * LN2, -n * LN2_LOW
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
def _terms(x, x_low):
    """Return k, 2^(i / 128) and a small `rest`, where ``exp(x + x_low)`` is 2^k times ``2^(i / 128) (1 + rest)``."""
    parts = nearest_integer(x * _PER_PART)
    n = number_of(parts)
    r = (x - n * _PART) + (x_low - n * _PART_LOW)
    i = parts & _LAST
    z = r * r
    rest = ((r + entry(POWERS_OF_TWO, 2 * i + 1)) + z * (_C2 + r * _C3)) + z * z * (_C4 + r * _C5)
    return parts >> PARTS_BITS, entry(POWERS_OF_TWO, 2 * i), rest


@inlined
def exponential_of_pair(x, x_low):
    """Return k and two numbers, where ``exp(x + x_low)`` is 2^k times their sum, for `x` from -760 to 720.

    The first number is between 1 and 2, and the second below 0.006. The relative error is below 2^-60.
    """
    k, power, rest = _terms(x, x_low)
    return k, power, power * rest


@inlined
def exponential(x, x_low):
    """Return exp(x + x_low) as a number, for any `x`."""
    k, power, rest = _terms(x, x_low)
    first = from_bits(bits_of(power) + (k << 52))
    result = first + first * rest
    is_far = abs(x) > _MODERATE
    if any_of(is_far):  # otherwise one sum of exponents replaces two products and two selections
        limit = where(x > _LARGEST, math.inf, where(x < _SMALLEST, 0.0, scaled(power + power * rest, k)))
        result = where(is_far, limit, result)
    return result


@subkernel
def exp(x):
    """Return e^x; the error is below 0.51 ulp, below 0.78 ulp for subnormal results."""
    return exponential(x, 0.0)


@subkernel
def expm1(x):
    """Return ``e^x - 1``; the error is below 0.65 ulp."""
    k, r, high, low = reduced(where(x > 710.0, 710.0, where(x < -60.0, -60.0, x)))
    even, odd = even_and_odd_parts(r, high, low)
    half = power_of_two(k - 1)
    total, first_error = two_sum(half * (1.0 + (high + 0.5 * high * high)), -0.5)
    total, second_error = two_sum(total, half * low)
    difference = total + ((first_error + second_error) + half * (even + odd))
    return where(abs(x) < 2.0**-54, x, 2.0 * difference)
