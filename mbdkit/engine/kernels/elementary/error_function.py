"""The error function and its complement.

Below 1/2, ``erf(x) = x + x (2 / sqrt(pi) - 1 + z P(z))`` with ``z = x^2``. Above it, with ``r = 1 / (1 + 2 x)``,

    erfc(x) = exp(-x^2) r G(r),

where x^2 is computed with its rounding error, and G lies between 1.15 and 1.29 (the idea is that of M. M. Shepherd and
J. G. Laframboise, Chebyshev approximation of (1 + 2 x) exp(x^2) erfc(x), Math. Comp. 36 (1981)). G is a polynomial in
``r - c`` in each of three intervals, whose first coefficient is an unevaluated sum of two numbers.

The polynomials minimize the largest errors of erf(x) / x (2^-63) and of G (2^-58). They are fitted by
``python -m mbdkit_builder.minimax erf erfc``.
"""

from __future__ import annotations

from mbdkit.engine.kernels.elementary.exact_sums import (
    fast_two_sum,
    leading_bits,
    quotient,
    scaled,
    square_of,
    two_sum,
    with_sign,
)
from mbdkit.engine.kernels.elementary.exponentials import exponential_of_pair
from mbdkit.engine.kernels.elementary.polynomials import polynomial
from mbdkit.engine.native.arithmetic import lane_by_lane
from mbdkit.engine.native.functions import inlined, subkernel

_SLOPE, _SLOPE_LOW = 0.1283791670955126, -1.2420116002463032e-17
"""2 / sqrt(pi) - 1 as an unevaluated sum of two numbers."""
_NEAR = (
    -1.4759141646319305e-07,
    1.6387148353593876e-06,
    -1.4923768967943778e-05,
    0.00012055306132236283,
    -0.0008548326814311497,
    0.0052239776247451995,
    -0.026866170645137945,
    0.11283791670955219,
    -0.37612638903183754,
)
"""Coefficients of P, from the last to the first."""
_A, _A_LOW, _A_REST = (
    1.2654778937343008,
    6.519252340558459e-17,
    (
        144.37968577041877,
        464.56726494928756,
        -368.13508791315786,
        204.89107590640705,
        -89.492950917112,
        21.198573158715003,
        9.501764667037689,
        -17.181789503741086,
        14.084720522958603,
        -7.9499881407880935,
        2.625852742519195,
        0.6080998535995528,
        -1.8356040492729868,
        1.669891877287204,
        -0.7826641080974361,
        -0.30355444964474254,
    ),
)
_B, _B_LOW, _B_REST = (
    1.2816669013052489,
    -1.2919159437241185e-17,
    (
        -419892.2693506646,
        -17543.726074341812,
        54666.69823646785,
        -23454.449247063625,
        5905.652066281304,
        -21.143581276814313,
        -861.97510003348,
        490.3262864857323,
        -138.59369567009148,
        -4.913580493552797,
        28.001149169363895,
        -14.967754870200649,
        2.4282935399378243,
        2.3313368208389593,
        -2.0399517456880694,
        0.2110036027377921,
    ),
)
_C, _C_LOW, _C_REST = (
    1.207131342698586,
    1.0219773026215e-16,
    (
        453109722.5333127,
        -98790739.76992287,
        -10177577.467808075,
        6942809.398650117,
        -784947.5920754629,
        -217746.0069290178,
        86680.71175026141,
        -3569.026042681451,
        -4954.757687210368,
        1179.3275241896042,
        167.7189797821446,
        -131.3991962763665,
        5.8806757908608525,
        14.075000752377711,
        -2.8165010821581014,
        -2.202109012573147,
        0.859277122157934,
    ),
)
"""G at r = 13/32, 7/32 and 5/64, and the other coefficients for x below 1.25, below 3 and above it."""


@inlined
def _far(x):
    """Return k and two numbers, where erfc(x) is 2^k times their sum, for x from 1/2 to 28."""
    total, error = two_sum(1.0, 2.0 * x)
    r = 1.0 / total
    if x < 1.25:
        u = r - 0.40625
        first, rest = _A, _A_LOW + u * polynomial(u, _A_REST)
    elif x < 3.0:
        u = r - 0.21875
        first, rest = _B, _B_LOW + u * polynomial(u, _B_REST)
    else:
        u = r - 0.078125
        first, rest = _C, _C_LOW + u * polynomial(u, _C_REST)
    square, square_low = square_of(x)
    square, square_low = fast_two_sum(square, square_low)
    k, near_one, small = exponential_of_pair(-square, -square_low)
    near_one, small = fast_two_sum(near_one, small)
    first, rest = fast_two_sum(first, rest)
    near_one_high, first_high = leading_bits(near_one), leading_bits(first)
    product = near_one_high * first_high
    product_low = near_one_high * (first - first_high) + (near_one - near_one_high) * first
    high, low = quotient(product, product_low + (near_one * rest + small * first), total, error)
    return k, high, low


@subkernel
def erf(x):
    """Return the error function; the error is below 0.8 ulp."""
    return _erf(x)


@lane_by_lane
def _erf(x):
    size = abs(x)
    if size < 0.5:
        z = x * x
        return x + x * (_SLOPE + z * polynomial(z, _NEAR))
    if size >= 6.0:
        return with_sign(1.0, x)
    if not size >= 0.5:
        return x
    k, high, low = _far(size)
    total, error = two_sum(1.0, -scaled(high, k))
    result = total + (error - scaled(low, k))
    return result if x > 0.0 else -result


@subkernel
def erfc(x):
    """Return ``1 - erf(x)``; the error is below 0.8 ulp."""
    return _erfc(x)


@lane_by_lane
def _erfc(x):
    size = abs(x)
    if size < 0.5:
        z = x * x
        product = x * (_SLOPE + z * polynomial(z, _NEAR))
        total, error = two_sum(1.0, -x)
        return total + (error - product)
    if x >= 28.0:
        return 0.0
    if x <= -6.0:
        return 2.0
    if not size >= 0.5:
        return x
    k, high, low = _far(size)
    if x > 0.0:
        return scaled(high + low, k)
    return 2.0 - scaled(high + low, k)
