"""The error function and its complement.

Below 1/2, ``erf(x) = x + x (2 / sqrt(pi) - 1 + z P(z))`` with ``z = x^2``. Above it, with ``r = 1 / (1 + 2 x)``,

    erfc(x) = exp(-x^2) r G(r),

where x^2 is computed with its rounding error, and G lies between 1.15 and 1.29 (the idea is that of M. M. Shepherd and
J. G. Laframboise, Chebyshev approximation of (1 + 2 x) exp(x^2) erfc(x), Math. Comp. 36 (1981)). G is a polynomial in
``r - c`` in each of three intervals, whose first coefficient is an unevaluated sum of two numbers.

The polynomials are minimax fits of `mbdkit_builder.minimax`; the errors are below 2^-63 in erf(x) / x, and
below 2^-57 in G.
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

#: 2 / sqrt(pi) - 1 as an unevaluated sum of two numbers.
_SLOPE, _SLOPE_LOW = 0.1283791670955126, -1.2420116002463032e-17
#: Coefficients of P, from the last to the first.
_NEAR = (
    -1.4762186453006475e-07,
    1.6387463110043244e-06,
    -1.4923782351345302e-05,
    0.00012055306433485978,
    -0.0008548326818152541,
    0.005223977624772601,
    -0.02686617064513894,
    0.1128379167095522,
    -0.37612638903183754,
)
_A, _A_LOW, _A_REST = (
    1.2654778937343008,
    6.519252340558459e-17,
    (
        108.97512141142997,
        460.8277172742249,
        -366.474797649818,
        205.0619150444697,
        -89.52353656530615,
        21.195569445312266,
        9.502052243123948,
        -17.181763321807846,
        14.084719047201613,
        -7.949988260459961,
        2.625852746541334,
        0.6080998538753055,
        -1.8356040492780443,
        1.6698918772869273,
        -0.7826641080974343,
        -0.3035544496447425,
    ),
)
_B, _B_LOW, _B_REST = (
    1.2816669013052489,
    -1.2919159437241185e-17,
    (
        -417569.36644602683,
        -18558.839982954607,
        54545.32977679353,
        -23439.721531831074,
        5907.095649462366,
        -21.226437059257517,
        -861.9825465275626,
        490.32651589488387,
        -138.59367629805024,
        -4.913580828725182,
        28.001149143397512,
        -14.967754869925333,
        2.428293539954549,
        2.3313368208388194,
        -2.0399517456880734,
        0.21100360273779212,
    ),
)
#: G at r = 13/32, 7/32 and 5/64, and the other coefficients for x below 1.25, below 3 and above it.
_C, _C_LOW, _C_REST = (
    1.207131342698586,
    1.0219773026215e-16,
    (
        459968875.2601255,
        -99044104.42829773,
        -10287719.124570563,
        6946639.582215978,
        -784222.0155272529,
        -217769.62452042746,
        86678.18932580187,
        -3568.949702375376,
        -4954.752731178201,
        1179.327386012004,
        167.71897430989148,
        -131.39919613831947,
        5.880675794048187,
        14.075000752308638,
        -2.816501082158963,
        -2.202109012573134,
        0.8592771221579341,
    ),
)


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
    """Return the error function; the error is below 0.85 ulp."""
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
    """Return ``1 - erf(x)``; the error is below 0.85 ulp."""
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
