"""Hyperbolic functions and their inverses.

With ``x = n ln(2) + r``, exp(x) and exp(-x) are sums of the same even and odd parts of exp(r), weighted by powers of
two (`mbdkit.engine.kernels.elementary.exponentials`). Their leading terms are exact; the sum or difference of these
terms is computed with its rounding error.

The inverse functions are logarithms of ``1 + t``, where `t` is an unevaluated sum of two numbers.
"""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import (
    fast_two_sum,
    power_of_two,
    quotient,
    root_of_pair,
    square_of,
    two_sum,
    with_sign,
)
from mbdkit.engine.kernels.elementary.exponentials import even_and_odd_parts, reduced
from mbdkit.engine.kernels.elementary.logarithms import logarithm_of_one_and
from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.functions import inlined, subkernel

_LARGE = 2.0**28  #: Above it, asinh(x) and acosh(x) are log(2 x) but for a relative error of 2^-61.
_SMALL = 2.0**-28  #: Below it, the odd functions are `x` but for a relative error of 2^-57.


@inlined
def _parts(x):
    """Return cosh and sinh of ``x >= 0``, each as two numbers, divided by 4."""
    k, r, high, low = reduced(x)
    even, odd = even_and_odd_parts(r, high, low)
    growing = power_of_two(k - 3)
    decaying = 0.015625 * power_of_two(3 - k)
    near_one = 1.0 + 0.5 * high * high
    up, down = growing * (near_one + high), decaying * (near_one - high)
    both, difference = growing + decaying, growing - decaying
    cosine, error = two_sum(up, down)
    sine, first_error = two_sum(up, -down)
    sine, second_error = two_sum(sine, both * low)
    cosine_low = error + (both * even + difference * (low + odd))
    sine_low = (first_error + second_error) + (difference * even + both * odd)
    return cosine, cosine_low, sine, sine_low


@subkernel
def cosh(x):
    """Return the hyperbolic cosine; the error is below 0.53 ulp."""
    size = abs(x)
    cosine, low, _, _ = _parts(where(size > 711.0, 711.0, size))
    return 4.0 * (cosine + low)


@subkernel
def sinh(x):
    """Return the hyperbolic sine; the error is below 0.65 ulp."""
    size = abs(x)
    _, _, sine, low = _parts(where(size > 711.0, 711.0, size))
    return where(size < _SMALL, x, with_sign(4.0 * (sine + low), x))


@subkernel
def tanh(x):
    """Return the hyperbolic tangent; the error is below 0.6 ulp. Close to 1, it is not monotone in the last bit."""
    size = abs(x)
    cosine, cosine_low, sine, sine_low = _parts(where(size > 22.0, 22.0, size))
    sine, sine_low = fast_two_sum(sine, sine_low)
    cosine, cosine_low = fast_two_sum(cosine, cosine_low)
    first, rest = quotient(sine, sine_low, cosine, cosine_low)
    return where(size < _SMALL, x, with_sign(first + rest, x))


@subkernel
def asinh(x):
    """Return the inverse hyperbolic sine; the error is below 0.75 ulp."""
    size = abs(x)
    is_large = size > _LARGE
    moderate = where(is_large, 1.0, size)
    square, square_low = square_of(moderate)
    total, error = two_sum(1.0, square)
    total, error = fast_two_sum(total, error + square_low)
    root, root_low = root_of_pair(total, error)
    t, t_low = two_sum(moderate, root - 1.0)
    large, large_low = two_sum(size, -1.0)
    t, t_low = where(is_large, large, t), where(is_large, large_low, t_low + root_low)
    result = logarithm_of_one_and(t, t_low, where(is_large, 1.0, 0.0))
    result = where(size < _SMALL, size, where(size < math.inf, result, size))
    return with_sign(result, x)


@subkernel
def acosh(x):
    """Return the inverse hyperbolic cosine; the error is below 0.75 ulp."""
    is_large = x > _LARGE
    moderate = where(is_large | (x < 1.0), 1.0, x)
    excess = moderate - 1.0
    square, square_low = square_of(excess)
    total, error = two_sum(2.0 * excess, square)
    total, error = fast_two_sum(total, error + square_low)
    root, root_low = root_of_pair(total, error)
    large, large_low = two_sum(x, -1.0)
    t, t_low = two_sum(excess, root)
    t, t_low = where(is_large, large, t), where(is_large, large_low, t_low + root_low)
    result = logarithm_of_one_and(t, t_low, where(is_large, 1.0, 0.0))
    return where(x >= 1.0, where(x < math.inf, result, x), math.nan)


@subkernel
def atanh(x):
    """Return the inverse hyperbolic tangent; the error is below 0.75 ulp."""
    size = abs(x)
    inside = where(size < 1.0, size, 0.0)
    difference, error = two_sum(1.0, -inside)
    first, rest = quotient(2.0 * inside, 0.0, difference, error)
    t, t_low = fast_two_sum(first, rest)
    result = 0.5 * logarithm_of_one_and(t, t_low, 0.0)
    result = where(size < 1.0, result, where(size == 1.0, math.inf, math.nan))
    return where(size < _SMALL, x, with_sign(result, x))
