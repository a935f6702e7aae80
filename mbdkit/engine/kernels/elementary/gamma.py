"""The gamma function and the logarithm of its absolute value.

For ``x >= 8``, Stirling's formula

    log(Gamma(x)) = (x - 1/2) log(x) - x + log(2 pi) / 2 + S(1/x)

is evaluated with unevaluated sums of two numbers; S, below 0.0105, is 1/x times a polynomial in 1/x^2. For smaller
arguments, ``Gamma(x) = Gamma(x + n) / (x (x + 1) ... (x + n - 1))``, where the product is an unevaluated sum of two
numbers as well. Near its zeros at 1 and 2, log(Gamma(1 + t)) is t times a polynomial in t. Below -20, log(Gamma(x))
follows from the reflection formula.

The polynomials are minimax fits of `mbdkit_builder.minimax`; the errors are below 2^-64 in S, 2^-57
relative to log(Gamma(1 + t)), and 2^-58 in sin(pi r) / r.
"""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import (
    fast_two_sum,
    leading_bits,
    power_of_two,
    product_of_pairs,
    quotient,
    scaled,
    two_product,
    two_sum,
    with_sign,
)
from mbdkit.engine.kernels.elementary.exponentials import exponential_of_pair
from mbdkit.engine.kernels.elementary.logarithms import log, logarithm_pair
from mbdkit.engine.kernels.elementary.polynomials import polynomial
from mbdkit.engine.native.arithmetic import below, lane_by_lane
from mbdkit.engine.native.functions import inlined, separate, subkernel

_LARGE = 8.0  #: Argument from which Stirling's formula is used.
_TWELFTH, _TWELFTH_LOW = 0.08333333333333333, 4.625929269271485e-18
_STIRLING = (
    0.0050260234656323115,
    -0.0018884665581442076,
    0.0008414355370783759,
    -0.0005952362993374949,
    0.0007936507887268874,
    -0.0027777777777729315,
)
_HALF_LOG_2PI, _HALF_LOG_2PI_LOW = 0.9189385332046728, -3.8782941580672414e-17
#: Derivatives of log(Gamma) at 1 and at 2, and what must be added to each.
_ONE, _TWO, _SLOPE_LOW = -0.5772156649015329, 0.42278433509846713, 4.942915152430645e-18
_NEAR_ONE = (
    -0.07047220711201263,
    0.0749531292036631,
    -0.07683584158938149,
    0.08327756193029347,
    -0.09095526912392297,
    0.10010027197401121,
    -0.11133425714589266,
    0.12550966508050979,
    -0.14404989680025013,
    0.1695571770088813,
    -0.20738555102862383,
    0.27058080842777366,
    -0.40068563438653143,
    0.8224670334241132,
)
_NEAR_TWO = (
    2.0731232594852153e-05,
    -4.533493790121859e-05,
    9.945318923388248e-05,
    -0.00022314834946149265,
    0.0005096695636229111,
    -0.001192753955628694,
    0.0028905103305811386,
    -0.007385551028551157,
    0.020580808427784796,
    -0.06735230105319819,
    0.3224670334241132,
)
#: Coefficients of ``(sin(pi r) / r - pi) / r^2`` as a polynomial in r^2.
_SINE = (
    7.669910242922593e-07,
    -2.1900817304525538e-05,
    0.0004662987798874178,
    -0.007370430299745173,
    0.08214588655080632,
    -0.599264529317679,
    2.550164039877268,
    -5.167712780049969,
)


@inlined
def _stirling(x, x_low):
    """Return log(Gamma(x + x_low)) for ``x >= 8`` as two numbers."""
    logarithm, logarithm_low = logarithm_pair(x, 0.0)
    factor, factor_low = two_sum(x, -0.5)
    factor_high, logarithm_high = leading_bits(factor), leading_bits(logarithm)
    product = factor_high * logarithm_high
    product_low = (
        factor_high * (logarithm - logarithm_high)
        + (factor - factor_high) * logarithm
        + (factor * logarithm_low + (factor_low + x_low) * logarithm)
    )
    w = 1.0 / x
    z = w * w
    small = (_HALF_LOG_2PI_LOW - 0.5 * x_low * w) + w * (_TWELFTH_LOW + z * polynomial(z, _STIRLING))
    total, first_error = two_sum(product, -x)
    total, second_error = two_sum(total, _HALF_LOG_2PI)
    total, third_error = two_sum(total, _TWELFTH / x)
    return fast_two_sum(total, (first_error + second_error + third_error) + (product_low + small))


@separate
def _shifted(x, scale):
    """Return ``x + n >= 8`` and ``scale * x (x + 1) ... (x + n - 1)``, each as two numbers."""
    product, product_low = scale, 0.0
    shift = 0.0
    total, error = x, 0.0
    while total < _LARGE:
        product, product_low = product_of_pairs(product, product_low, total, error)
        shift += 1.0
        total, error = two_sum(x, shift)
    return total, error, product, product_low


@subkernel
def tgamma(x):
    """Return the gamma function, which is NaN for negative integers; the error is below 0.7 ulp.

    For results below 2^-1022, it is below 0.8 ulp.
    """
    return _tgamma(x)


@lane_by_lane
def _tgamma(x):
    if not x > -math.inf:
        return math.nan
    if abs(x) < 2.0**-60:
        return 1.0 / x if x != 0.0 else with_sign(math.inf, x)
    if x > 172.0:
        return math.inf
    if x < 0.0 and below(x) == x:
        return math.nan
    if x < -184.0:
        return 0.0 if 2.0 * below(0.5 * below(x)) == below(x) else -0.0
    if x >= _LARGE:
        logarithm, logarithm_low = _stirling(x, 0.0)
        k, near_one, small = exponential_of_pair(logarithm, logarithm_low)
        return scaled(near_one + small, k)
    scale = -300 if x < -100.0 else 0  # keeps the product below the largest double
    total, error, product, product_low = _shifted(x, power_of_two(scale))
    logarithm, logarithm_low = _stirling(total, error)
    k, near_one, small = exponential_of_pair(logarithm, logarithm_low)
    near_one, small = fast_two_sum(near_one, small)
    first, rest = quotient(near_one, small, product, product_low)
    return (first + rest) * power_of_two(k + scale)


@inlined
def _near_zero(t, slope, coefficients):
    product, error = two_product(t, slope)
    return product + (error + t * (_SLOPE_LOW + t * polynomial(t, coefficients)))


@separate
def _reflected(x):
    """Return log|Gamma(-x)| for ``x > 20``."""
    rest = abs(x - below(x + 0.5))
    z = rest * rest
    sine = rest * (math.pi + z * polynomial(z, _SINE))
    if sine == 0.0:
        return math.inf
    logarithm, logarithm_low = _stirling(x, 0.0)
    other, other_low = logarithm_pair(x * sine / math.pi, 0.0)
    total, error = two_sum(-logarithm, -other)
    return total + (error - (logarithm_low + other_low))


@inlined
def _of_huge(x):
    """Return ``x (log(x) - 1)``, which does not overflow before log(Gamma(x))."""
    logarithm, logarithm_low = logarithm_pair(x, 0.0)
    factor, error = fast_two_sum(logarithm, -1.0)
    high, first = leading_bits(x), leading_bits(factor)
    return high * first + (high * ((factor - first) + (error + logarithm_low)) + (x - high) * factor)


@subkernel
def lgamma(x):
    """Return the logarithm of the absolute value of the gamma function.

    The error is below 0.9 ulp for ``x > 0``, and for negative `x` below 0.9 ulp or 2^-57, whichever is larger.
    """
    return _lgamma(x)


@lane_by_lane
def _lgamma(x):
    if abs(x) == math.inf:
        return math.inf
    if x != x:
        return x
    if x > 1e300:
        return _of_huge(x)
    if x >= _LARGE:
        logarithm, logarithm_low = _stirling(x, 0.0)
        return logarithm + logarithm_low
    if abs(x - 1.0) <= 0.06:
        return _near_zero(x - 1.0, _ONE, _NEAR_ONE)
    if abs(x - 2.0) <= 0.1:
        return _near_zero(x - 2.0, _TWO, _NEAR_TWO)
    if x <= 0.0 and below(x) == x:
        return math.inf
    if x < -20.0:
        return _reflected(-x)
    if abs(x) < 2.0**-60:
        return -log(abs(x))
    total, error, product, product_low = _shifted(x, 1.0)
    logarithm, logarithm_low = _stirling(total, error)
    other, other_low = logarithm_pair(abs(product), 0.0)
    total, error = two_sum(logarithm, -other)
    return total + (error + (logarithm_low - (other_low + product_low / product)))
