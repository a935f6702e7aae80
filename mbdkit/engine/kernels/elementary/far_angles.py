"""Reduction of large angles by multiples of pi/2, with integers.

The method is that of M. H. Payne and R. N. Hanek, Radian reduction for trigonometric functions, ACM SIGNUM Newsletter
18 (1983): of the product of the angle and 2/pi, only those digits are computed that influence the result modulo 4.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.elementary.exact_sums import (
    bits_of,
    fast_two_sum,
    number_of,
    power_of_two,
    product_of_pairs,
    two_sum,
)
from mbdkit.engine.native.functions import inlined, separate

_BITS, _MASK = 28, 2**28 - 1  #: Bits of a digit; sums of three products of digits fit into 64 bits.

#: Digits of 2/pi after the binary point, after three zeros.
_TWO_OVER_PI = np.array([
    0, 0, 0, 170891318, 240010261, 44024437, 131200308, 232525238, 43358524, 70845471, 240214955, 233552982, 28779630,
    61088989, 48236105, 49193117, 26352894, 31371723, 19507006, 243802975, 86948676, 139368903, 2536543, 132387737,
    30816643, 87269193, 210001803, 199201411, 186644631, 268296281, 135261999, 18396576, 174923629, 57142514,
    130746807, 83125238, 111042538, 47665787, 180874213, 253211600, 121239434, 86584998, 201023409, 33084880,
    139854640, 74434486, 195817679, 197265839, 70655401,
])  # fmt: skip

_HALF_PI, _HALF_PI_LOW = 1.5707963267948966, 6.123233995736766e-17

#: Digits that are computed: one before the binary point, the others behind it. A double may be as close as 2^-61 to a
#: multiple of pi/2; the error of about 2^-138 of the last digit leaves 77 bits for the reduced angle.
_DIGITS = 7


@separate
def far_angle(x):
    """Return an angle [rad] of at least 2^16 without its multiple of pi/2, as a pair, and the multiple modulo 4.

    The reduced angle is at most pi/4 in absolute value. The argument is positive and finite.
    """
    bits = bits_of(x)
    mantissa = (bits & (2**52 - 1)) | 2**52
    shift = (bits >> 52) - 1075 + 3 * _BITS
    first, shift = shift // _BITS, shift % _BITS
    low = (mantissa & _MASK) << shift
    middle = ((mantissa >> _BITS) << shift) + (low >> _BITS)
    low, middle, high = low & _MASK, middle & _MASK, middle >> _BITS
    carry = quarters = d1 = d2 = d3 = d4 = d5 = d6 = 0
    # Digit n of the product has the place value 2^(-28 n). The digits move up by one variable in each pass, so that in
    # the end `quarters` holds the one before the point, and d1 to d6 the others.
    for n in range(_DIGITS - 1, -1, -1):
        place = first - 1 + n
        digit = low * _TWO_OVER_PI[place] + middle * _TWO_OVER_PI[place + 1] + high * _TWO_OVER_PI[place + 2] + carry
        d6, d5, d4, d3, d2, d1, quarters = d5, d4, d3, d2, d1, quarters, digit & _MASK
        carry = digit >> _BITS
    if d1 >= 2 ** (_BITS - 1):
        quarters, d1 = quarters + 1, d1 - 2**_BITS
    fraction, error = two_sum(_part(d1, 1), _part(d2, 2))
    fraction, rest = two_sum(fraction, _part(d3, 3))
    error += rest
    fraction, rest = two_sum(fraction, _part(d4, 4))
    error += rest
    fraction, rest = two_sum(fraction, _part(d5, 5))
    error += rest
    fraction, error = fast_two_sum(fraction, error + _part(d6, 6))
    angle, tail = product_of_pairs(fraction, error, _HALF_PI, _HALF_PI_LOW)
    return angle, tail, number_of(quarters & 3)


@inlined
def _part(digit, place):
    return number_of(digit) * power_of_two(-_BITS * place)
