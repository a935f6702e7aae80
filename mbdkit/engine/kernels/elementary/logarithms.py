"""Logarithms: log, log1p, log2, log10, and the logarithm as an unevaluated sum of two numbers.

The argument is ``2^n m`` with m between sqrt(1/2) and sqrt(2). With ``f = m - 1``, which is exact, and
``s = f / (2 + f)``,

    log(1 + f) = f - f^2 / 2 + s (f^2 / 2 + R(s^2)),    R(s^2) = 2 atanh(s) / s - 2.

`f` is split into a multiple of 2^-26 and a rest, so that the first two terms are a double without rounding error, plus
terms below 2^-26. The third term is below 0.025; its rounding errors are below 0.12 ulp of the result.

`logarithm_pair` computes ``2 s (1 + s^2 / 3 + s^4 / 5 + ...)`` with `s` as an unevaluated sum of two numbers.

The polynomials ``R(z) / z`` and ``(3 atanh(s) / s - 3 - z) / z^2``, with ``z = s^2``, are minimax fits of
`mbdkit_builder.minimax`; the errors are below 2^-68 in log(m), and below 2^-72 relative to log(m).
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
from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.functions import inlined, subkernel

_MANTISSA, _ROOT_BITS = 0x000FFFFFFFFFFFFF, 0x3FE6A09E667F3BCD
"""The bits of a double without sign and exponent, and the bits of sqrt(1/2)."""
_ABOVE_ROOT = 0x3FF0000000000000 - _ROOT_BITS
_SMALLEST_NORMAL = 2.0**-1022
_SHIFTER = 100663296.0
"""1.5 * 2^26: sums with it are multiples of 2^-26."""
_R0, _R1, _R2, _R3 = 0.6666666666666665, 0.4000000000001262, 0.2857142856746014, 0.22222222851817883
_R4, _R5, _R6, _R7 = 0.1818176147328622, 0.1538764015094572, 0.13238960081123344, 0.13343941841674883
_S0, _S1, _S2, _S3 = 0.5999999999999996, 0.428571428571688, 0.3333333332602946, 0.27272728339204605
_S4, _S5, _S6, _S7 = 0.23076833007854541, 0.2000456446009209, 0.17510437376725446, 0.17998396244888273
_S0_HIGH, _S0_LOW = 0.5999999940395355, 5.960464122267695e-09
_TWO_THIRDS, _TWO_THIRDS_HIGH, _TWO_THIRDS_LOW = 0.6666666666666666, 0.6666666716337204, -4.967053731282552e-09
_PER_LN2, _PER_LN2_HIGH, _PER_LN2_LOW = 1.4426950408889634, 1.4426950514316559, -1.0542692476429138e-08
_PER_LN10, _PER_LN10_HIGH, _PER_LN10_LOW = 0.4342944819032518, 0.4342944845557213, -2.6524694553078553e-09
"""Factors, and each as a sum of a number of 26 bits and a rest."""
_LOG10_2, _LOG10_2_LOW = 0.30102999566395283, 2.8363394551044964e-14
"""Decimal logarithm of 2 as the sum of a number of 42 bits and a rest."""


@inlined
def _split(x):
    """Return the exponent n as a number, and m, where ``x = 2^n m`` for positive finite numbers."""
    is_subnormal = x < _SMALLEST_NORMAL
    bits = bits_of(where(is_subnormal, x * 2.0**54, x)) + _ABOVE_ROOT
    n = number_of((bits >> 52) - 1023)
    return where(is_subnormal, n - 54.0, n), from_bits((bits & _MANTISSA) + _ROOT_BITS)


@inlined
def _terms(f):
    """Return three numbers whose sum is log(1 + f): the leading terms without rounding error, and a small one."""
    high = (f + _SHIFTER) - _SHIFTER
    low = f - high
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    first, second = (_R0 + z * _R1) + w * (_R2 + z * _R3), (_R4 + z * _R5) + w * (_R6 + z * _R7)
    r = z * (first + w * w * second)
    return high - 0.5 * high * high, low, s * (0.5 * f * f + r) - 0.5 * low * (f + high)


@inlined
def _sum(n, high, low, small):
    """Return ``n ln(2)`` plus the sum of the others."""
    total, first_error = fast_two_sum(n * LN2, high)
    total, second_error = two_sum(total, low)
    return total + ((second_error + (first_error + n * LN2_LOW)) + small)


@inlined
def _with_limits(x, result):
    """Return the result, or what the logarithm is at zero, infinity and for numbers without a logarithm."""
    result = where(x < math.inf, result, x)
    return where(x > 0.0, result, where(x == 0.0, -math.inf, math.nan))


@subkernel
def log(x):
    """Return the natural logarithm; the error is below 0.7 ulp."""
    n, m = _split(x)
    high, low, small = _terms(m - 1.0)
    return _with_limits(x, _sum(n, high, low, small))


@inlined
def _times(high, low, small, factor, factor_high, factor_low):
    """Return the product of a sum of three numbers and a factor as two numbers."""
    total, error = two_sum(high, low)
    first = leading_bits(total)
    rest = (total - first) + (error + small)
    return first * factor_high, first * factor_low + rest * factor


@subkernel
def log2(x):
    """Return the logarithm to base 2, which is exact for powers of 2; the error is below 0.8 ulp."""
    n, m = _split(x)
    high, low, small = _terms(m - 1.0)
    product, rest = _times(high, low, small, _PER_LN2, _PER_LN2_HIGH, _PER_LN2_LOW)
    total, error = two_sum(n, product)
    return _with_limits(x, total + (error + rest))


@subkernel
def log10(x):
    """Return the decimal logarithm, which is exact for powers of 10; the error is below 0.7 ulp."""
    n, m = _split(x)
    high, low, small = _terms(m - 1.0)
    product, rest = _times(high, low, small, _PER_LN10, _PER_LN10_HIGH, _PER_LN10_LOW)
    total, error = two_sum(n * _LOG10_2, product)
    return _with_limits(x, total + (error + (n * _LOG10_2_LOW + rest)))


@inlined
def logarithm_of_one_and(t, t_low, doublings):
    """Return ``log(1 + t + t_low) + doublings * ln(2)`` for finite `t` above -1; the error is below 0.7 ulp.

    `t_low` is the rounding error of `t`, or zero.
    """
    total, error = two_sum(1.0, t)
    total = where(total > 0.0, total, 1.0)  # Python does not divide by zero
    n, m = _split(total)
    is_near = n == 0.0
    high, low, small = _terms(where(is_near, t, m - 1.0))
    correction = where(is_near, t_low, error + t_low) / total
    return _sum(n + doublings, high, low, small + correction)


@subkernel
def log1p(x):
    """Return log(1 + x); the error is below 0.7 ulp."""
    result = where(abs(x) < 2.0**-54, x, logarithm_of_one_and(x, 0.0, 0.0))
    result = where(x < math.inf, result, x)
    return where(x > -1.0, result, where(x == -1.0, -math.inf, math.nan))


@inlined
def logarithm_pair(x):
    """Return log(x) of a positive number as two numbers, with a relative error of about 2^-67."""
    n, m = _split(x)
    f = m - 1.0
    total, error = fast_two_sum(2.0, f)
    reciprocal = 1.0 / total
    s = f * reciprocal
    s_high = leading_bits(s)  # f / (2 + f) is the sum of s_high and s_low
    total_high = leading_bits(total)
    s_low = (((f - s_high * total_high) - s_high * (total - total_high)) - s_high * error) * reciprocal
    square, square_low = s_high * s_high, s_low * (s_high + s_high + s_low)  # z = square + square_low
    z = s * s
    w = z * z
    first, second = (_S1 + z * _S2) + w * (_S3 + z * _S4), (_S5 + z * _S6) + w * _S7
    series = z * w * (first + w * w * second)
    z_high = leading_bits(z)
    w_high = z_high * z_high
    w_first = leading_bits(w_high)
    w_rest = (w_high - w_first) + ((square - z_high) + square_low) * (z + z_high)
    quartic = w_first * _S0_HIGH
    # log(m) = 2/3 s (3 + z + 3/5 z^2 + ...); the first part of the factor need not be close, but short
    factor_high = leading_bits(3.0 + (z + (quartic + series)))
    small = square_low + ((w_first * _S0_LOW + series) + w_rest * _S0)
    factor_low = (((3.0 - factor_high) + square) + quartic) + small
    product = s_high * factor_high
    product_low = s_high * factor_low + s_low * (factor_high + factor_low)
    first = leading_bits(product)
    rest = (product - first) + product_low
    total, error = two_sum(n * LN2, first * _TWO_THIRDS_HIGH)
    small = first * _TWO_THIRDS_LOW + rest * _TWO_THIRDS
    return fast_two_sum(total, error + (n * LN2_LOW + small))
