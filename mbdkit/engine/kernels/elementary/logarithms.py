"""Logarithms: log, log1p, log2, log10, and the logarithm as an unevaluated sum of two numbers.

The argument is ``2^n m`` with m between 0.705 and 1.41. A table (P. T. P. Tang, Table-driven implementation of the
logarithm function in IEEE floating-point arithmetic, ACM Trans. Math. Softw. 16 (1990)) gives a number c of 10 bits for
which ``r = c m - 1`` is below 0.0043 in absolute value, and ``-log(c)``:

    log(x) = n ln(2) - log(c) + log(1 + r),    log(1 + r) = r - r^2 / 2 + r^3 R(r).

Around 1, n and log(c) are zero. As c is short, r is the sum of two numbers without rounding error: the product of c and
the leading bits of m, less 1, and that of c and the other bits. The square of the first number, of 27 bits, is exact,
and so is its sum with the first part of ``n ln(2) - log(c)``, a multiple of 2^-42. The polynomial R is a minimax fit of
`mbdkit_builder.minimax`; the error is below 2^-70 relative to r.
"""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import (
    bits_of,
    fast_two_sum,
    from_bits,
    leading_bits,
    number_of,
    two_sum,
)
from mbdkit.engine.kernels.elementary.exponentials import LN2, LN2_LOW
from mbdkit.engine.kernels.elementary.tables import INTERVAL, LEAST_BITS, LOGARITHMS, PARTS, entry
from mbdkit.engine.native.arithmetic import any_of, lane_by_lane, where
from mbdkit.engine.native.functions import inlined, subkernel

_EXPONENT = -(2**52)
_LAST = PARTS - 1
_HALF_UNIT, _LEADING = 2**27, -(2**28)
_SMALLEST_NORMAL_BITS, _INFINITY_BITS = 2**52, 2047 << 52
_R0, _R1, _R2 = 0.33333333333333337, -0.2500000000000001, 0.19999999997926782
_R3, _R4, _R5 = -0.16666666662750626, 0.14286017974349802, -0.12500363579916982
_PER_LN2, _PER_LN2_HIGH, _PER_LN2_LOW = 1.4426950408889634, 1.4426950514316559, -1.0542692476429138e-08
#: Factors, and each as a sum of a number of 26 bits and a rest.
_PER_LN10, _PER_LN10_HIGH, _PER_LN10_LOW = 0.4342944819032518, 0.4342944845557213, -2.6524694553078553e-09


@inlined
def is_positive_normal(x):
    """Return whether `x` is positive, finite and not subnormal, by integers, of whose comparisons LLVM makes one."""
    bits = bits_of(x)
    return (bits >= _SMALLEST_NORMAL_BITS) & (bits < _INFINITY_BITS)


@inlined
def logarithm_pair(x, halvings):
    """Return ``log(x / 2^halvings)`` of a positive normal number as two numbers, with a relative error of 2^-68."""
    x_bits = bits_of(x)
    bits = x_bits - LEAST_BITS
    n = number_of(bits >> 52) - halvings
    place = 3 * ((bits >> INTERVAL) & _LAST)
    # With a mask of the lower bits instead, LLVM takes the instruction BZHI with an index in a register of 8 bits, and
    # each call waits for the one before, which had that register last: pow took 21 ns instead of 12.
    m_bits = x_bits - (bits & _EXPONENT)
    m_high = from_bits((m_bits + _HALF_UNIT) & _LEADING)
    c = entry(LOGARITHMS, place)
    r_high, r_low = m_high * c - 1.0, (from_bits(m_bits) - m_high) * c
    r = r_high + r_low
    z = r * r
    series = (r * z) * ((_R0 + r * _R1) + z * ((_R2 + r * _R3) + z * (_R4 + r * _R5)))
    small = (n * LN2_LOW + entry(LOGARITHMS, place + 2)) + (series - 0.5 * r_low * (r_high + r))
    total, first_error = fast_two_sum((n * LN2 + entry(LOGARITHMS, place + 1)) + r_high, r_low)
    total, second_error = fast_two_sum(total, -0.5 * r_high * r_high)
    return fast_two_sum(total, (first_error + second_error) + small)


@inlined
def _limit(x):
    """Return what the logarithm is at zero, infinity, for negative numbers and for NaN."""
    if x > 0.0:
        return x
    return -math.inf if x == 0.0 else math.nan


@lane_by_lane
def _rare_log(x):
    """Return log(x) of numbers that are not positive normal numbers."""
    return logarithm_pair(x * 2.0**54, 54.0)[0] if 0.0 < x < 1.0 else _limit(x)


@subkernel
def log(x):
    """Return the natural logarithm; the error is below 0.51 ulp."""
    result, _ = logarithm_pair(x, 0.0)
    is_usual = is_positive_normal(x)
    if any_of(not is_usual):
        result = where(is_usual, result, _rare_log(x))
    return result


@inlined
def _times(logarithm, rest, factor, factor_high, factor_low):
    first = leading_bits(logarithm)
    return first * factor_high + (first * factor_low + ((logarithm - first) + rest) * factor)


@inlined
def _log2(x, halvings):
    logarithm, rest = logarithm_pair(x, halvings)
    return _times(logarithm, rest, _PER_LN2, _PER_LN2_HIGH, _PER_LN2_LOW)


@lane_by_lane
def _rare_log2(x):
    return _log2(x * 2.0**54, 54.0) if 0.0 < x < 1.0 else _limit(x)


@subkernel
def log2(x):
    """Return the logarithm to base 2, which is exact for powers of 2; the error is below 0.51 ulp."""
    result, is_usual = _log2(x, 0.0), is_positive_normal(x)
    if any_of(not is_usual):
        result = where(is_usual, result, _rare_log2(x))
    return result


@inlined
def _log10(x, halvings):
    logarithm, rest = logarithm_pair(x, halvings)
    return _times(logarithm, rest, _PER_LN10, _PER_LN10_HIGH, _PER_LN10_LOW)


@lane_by_lane
def _rare_log10(x):
    return _log10(x * 2.0**54, 54.0) if 0.0 < x < 1.0 else _limit(x)


@subkernel
def log10(x):
    """Return the decimal logarithm, which is exact for powers of 10; the error is below 0.51 ulp."""
    result, is_usual = _log10(x, 0.0), is_positive_normal(x)
    if any_of(not is_usual):
        result = where(is_usual, result, _rare_log10(x))
    return result


@inlined
def logarithm_of_one_and(t, t_low, doublings):
    """Return ``log(1 + t + t_low) + doublings * ln(2)`` for finite `t` above -1; the error is below 0.7 ulp.

    `t_low` is the rounding error of `t`, or zero.
    """
    total, error = two_sum(1.0, t)
    total = where(total > 0.0, total, 1.0)  # Python does not divide by zero
    logarithm, logarithm_low = logarithm_pair(total, 0.0)
    high, first_error = two_sum(doublings * LN2, logarithm)
    return high + (first_error + (doublings * LN2_LOW + logarithm_low + (error + t_low) / total))


@subkernel
def log1p(x):
    """Return log(1 + x); the error is below 0.7 ulp."""
    result = where(abs(x) < 2.0**-54, x, logarithm_of_one_and(x, 0.0, 0.0))
    result = where(x < math.inf, result, x)
    return where(x > -1.0, result, where(x == -1.0, -math.inf, math.nan))
