"""Sums and products without rounding error, and access to the bits of a double.

Notation: `hi` and `lo` are an unevaluated sum of two doubles, of which the first is the rounded sum. All functions
take numbers or lanes, and do not branch.

Sources: T. J. Dekker, A floating-point technique for extending the available precision, Numer. Math. 18 (1971);
D. E. Knuth, The Art of Computer Programming, vol. 2, section 4.2.2.
"""

from __future__ import annotations

import math
import struct

from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.functions import inlined, overload, placeholder

_SPLITTER = 134217729.0  #: 2^27 + 1: the product with it splits a double into two halves of 26 bits (Veltkamp).
#: 1.5 * 2^52, and its bits: the last bits of a sum with it are the nearest integer of the other term.
_MAGIC, _MAGIC_BITS = 6755399441055744.0, 0x4338000000000000
_LEADING = -(2**27)
_SIGN, _REST = -(2**63), 2**63 - 1


@placeholder
def bits_of(x):
    """Return the 64 bits of `x` as a signed integer."""
    return struct.unpack("<q", struct.pack("<d", x))[0]


@placeholder
def from_bits(bits):
    """Return the number with these 64 bits."""
    return struct.unpack("<d", struct.pack("<Q", int(bits) & (2**64 - 1)))[0]


def square_root(x):
    """Return the square root of `x`; NaN if it is negative."""
    return math.sqrt(x) if x >= 0.0 else math.nan


@overload(square_root)
def _square_root(x):
    return lambda x: math.sqrt(x)


@inlined
def two_sum(x, y):
    """Return the rounded sum of two numbers and its error."""
    total = x + y
    part = total - x
    return total, (x - (total - part)) + (y - part)


@inlined
def fast_two_sum(x, y):
    """Return the rounded sum of two numbers and its error; `x` is zero or not smaller in absolute value than `y`."""
    total = x + y
    return total, y - (total - x)


@inlined
def halves(x):
    """Return two numbers of at most 26 bits whose sum is `x`, for ``|x| < 2^996``."""
    product = _SPLITTER * x
    high = product - (product - x)
    return high, x - high


@inlined
def leading_bits(x):
    """Return `x` without its last 27 bits, a number of 26 bits."""
    return from_bits(bits_of(x) & _LEADING)


@inlined
def two_product(x, y):
    """Return the rounded product of two numbers and its error.

    Both are below 2^996 in absolute value, and the product is zero or above 2^-969, so that the error is a double.
    """
    product = x * y
    x_high, x_low = halves(x)
    y_high, y_low = halves(y)
    return product, ((x_high * y_high - product) + x_high * y_low + x_low * y_high) + x_low * y_low


@inlined
def sum_of_pairs(x, x_low, y, y_low):
    """Return the sum of two unevaluated sums of numbers, with a relative error of about 2^-104."""
    total, error = two_sum(x, y)
    return fast_two_sum(total, error + (x_low + y_low))


@inlined
def product_of_pairs(x, x_low, y, y_low):
    """Return the product of two unevaluated sums of numbers, with a relative error of about 2^-102."""
    product, error = two_product(x, y)
    return fast_two_sum(product, error + (x * y_low + x_low * y))


@inlined
def quotient_of_pairs(x, x_low, y, y_low):
    """Return the quotient of two unevaluated sums of numbers, with a relative error of about 2^-101."""
    quotient = x / y
    product, error = two_product(quotient, y)
    rest = ((x - product) - error) + (x_low - quotient * y_low)
    return fast_two_sum(quotient, rest / y)


@inlined
def quotient(x, x_low, y, y_low):
    """Return the quotient of two pairs of numbers as a number of 26 bits and a rest, with a relative error of 2^-76.

    As the first number is short, its products with the halves of `y` are exact.
    """
    reciprocal = 1.0 / y
    first = leading_bits(x * reciprocal)
    y_high = leading_bits(y)
    rest = ((x - first * y_high) - first * (y - y_high)) + (x_low - first * y_low)
    return first, rest * reciprocal


@inlined
def square_of(x):
    """Return the square of ``|x| < 2^500`` as two numbers."""
    high = leading_bits(x)
    low = x - high
    return high * high, low * (x + high)


@inlined
def root_of_pair(x, x_low):
    """Return the square root of an unevaluated sum of numbers, with a relative error of about 2^-101."""
    root = square_root(x)
    high, _ = halves(root)
    rest = (x - high * high) + x_low  # the difference is exact
    return fast_two_sum(high, rest / where(root == 0.0, 1.0, root + high))


@inlined
def nearest_integer(x):
    """Return the nearest whole number as an integer, ties to even, for ``|x| < 2^51``; else, any integer."""
    return bits_of(x + _MAGIC) - _MAGIC_BITS


@inlined
def number_of(integer):
    """Return an integer below 2^51 in absolute value as a number."""
    return from_bits(integer + _MAGIC_BITS) - _MAGIC


@inlined
def power_of_two(k):
    """Return 2^k for an integer from -1022 to 1023."""
    return from_bits((k + 1023) << 52)


@inlined
def scaled(x, k):
    """Return ``x * 2^k``, rounded once, for ``1/2 <= |x| <= 2`` and an integer `k` from -2040 to 2046."""
    half = k >> 1
    return x * power_of_two(half) * power_of_two(k - half)


@inlined
def with_sign(x, y):
    """Return `x` with the sign of `y`."""
    return from_bits((bits_of(x) & _REST) | (bits_of(y) & _SIGN))


@inlined
def is_negative(x):
    """Return whether the sign bit of `x` is set, as in -0.0."""
    return bits_of(x) < 0
