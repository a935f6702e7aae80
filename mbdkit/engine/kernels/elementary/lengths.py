"""Length of a vector, and remainder of a division."""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import (
    bits_of,
    fast_two_sum,
    power_of_two,
    root_of_pair,
    two_product,
    with_sign,
)
from mbdkit.engine.native.arithmetic import lane_by_lane, where
from mbdkit.engine.native.functions import inlined, subkernel

_STEP = 10  #: Binary digits of a quotient per division of integers of 63 bits.


@subkernel
def hypot(x, y):
    """Return ``sqrt(x^2 + y^2)`` without overflow of the squares, computed with pairs of numbers."""
    x, y = abs(x), abs(y)
    larger, smaller = where(x < y, y, x), where(x < y, x, y)
    factor = where(larger > 2.0**500, 2.0**-600, where(larger < 2.0**-400, 2.0**700, 1.0))
    inverse = where(larger > 2.0**500, 2.0**600, where(larger < 2.0**-400, 2.0**-700, 1.0))
    a, b = larger * factor, smaller * factor
    a = where(a == math.inf, 0.0, a)
    b = where(b < 2.0**-80 * a, 0.0, b)
    first, first_low = two_product(a, a)
    second, second_low = two_product(b, b)
    total, error = fast_two_sum(first, second)
    root, low = root_of_pair(total, error + (first_low + second_low))
    length = (root + low) * inverse
    return where((x == math.inf) | (y == math.inf), math.inf, length)


@subkernel
def fmod(x, y):
    """Return the remainder of ``x / y`` with the sign of `x`, which is exact; NaN if `x` is infinite or `y` is zero."""
    return _remainder(x, y)


@lane_by_lane
def _remainder(x, y):
    size, divisor = abs(x), abs(y)
    if x != x or y != y or size == math.inf or divisor == 0.0:
        return x + y + math.nan
    if size < divisor:
        return x
    rest, exponent = _integer(size)
    modulus, lowest = _integer(divisor)
    digits = exponent - lowest
    rest %= modulus
    while digits > 0 and rest != 0:
        step = min(digits, _STEP)
        rest = (rest << step) % modulus
        digits -= step
    half = lowest >> 1
    return with_sign(float(rest) * power_of_two(half) * power_of_two(lowest - half), x)


@inlined
def _integer(x):
    """Return a positive number as an integer below 2^53 times a power of two, and the exponent of this power."""
    bits = bits_of(x)
    exponent = bits >> 52
    if exponent == 0:
        return bits, -1074
    return (bits & (2**52 - 1)) | 2**52, exponent - 1075
