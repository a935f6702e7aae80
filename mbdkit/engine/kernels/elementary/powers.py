"""Powers x^y of numbers."""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import fast_two_sum, is_negative, leading_bits
from mbdkit.engine.kernels.elementary.exponentials import exponential
from mbdkit.engine.kernels.elementary.logarithms import logarithm_pair
from mbdkit.engine.native.arithmetic import below, where
from mbdkit.engine.native.functions import subkernel


@subkernel
def power(x, y):
    """Return x^y, the exponential of ``y log(x)``; the error is below 0.55 ulp, below 0.8 ulp for subnormal results.

    The logarithm has a relative error of 2^-67, and its product with `y` is computed with the rounding error. Signs,
    zeros, infinities and NaN are those of C (ISO/IEC 9899, F.10.4.4).
    """
    base, size = abs(x), abs(y)
    logarithm, logarithm_low = logarithm_pair(base)
    exponent = where(size > 2.0**65, where(y > 0.0, 2.0**65, -(2.0**65)), y)
    high, first = leading_bits(exponent), leading_bits(logarithm)
    rest = (logarithm - first) + logarithm_low
    product, product_low = fast_two_sum(high * first, high * rest + (exponent - high) * (first + rest))
    result = exponential(product, product_low)

    is_limit = (base == 0.0) | (base == math.inf) | ((size == math.inf) & (base != 1.0))
    is_large = ((base > 1.0) & (y > 0.0)) | ((base < 1.0) & (y < 0.0))
    result = where(is_limit, where(is_large, math.inf, 0.0), result)
    is_whole = below(size) == size
    is_odd = is_whole & (below(0.5 * size) != 0.5 * size)
    result = where(is_negative(x), where(is_odd, -result, result), result)
    result = where((x < 0.0) & (base < math.inf) & (size < math.inf) & (below(size) != size), math.nan, result)
    result = where((x != x) | (y != y), math.nan, result)
    return where((x == 1.0) | (y == 0.0), 1.0, result)
