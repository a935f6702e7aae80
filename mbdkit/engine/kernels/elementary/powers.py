"""Powers x^y of numbers."""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import fast_two_sum, is_negative, leading_bits
from mbdkit.engine.kernels.elementary.exponentials import exponential
from mbdkit.engine.kernels.elementary.logarithms import is_positive_normal, logarithm_pair
from mbdkit.engine.native.arithmetic import any_of, below, lane_by_lane, where
from mbdkit.engine.native.functions import inlined, subkernel

_HUGE = 2.0**65  #: Exponent from which each power of a number other than 1 overflows or vanishes.


@inlined
def _positive_power(x, halvings, y):
    """Return ``(x / 2^halvings)^y`` for a positive normal number `x`, and `y` below 2^65 in absolute value."""
    logarithm, logarithm_low = logarithm_pair(x, halvings)
    high, first = leading_bits(y), leading_bits(logarithm)
    rest = (logarithm - first) + logarithm_low
    product, product_low = fast_two_sum(high * first, high * rest + (y - high) * (first + rest))
    return exponential(product, product_low)


@subkernel
def power(x, y):
    """Return x^y, the exponential of ``y log(x)``; the error is below 0.51 ulp, below 0.8 ulp for subnormal results.

    The logarithm has a relative error of 2^-68, and its product with `y` is computed with the rounding error. Signs,
    zeros, infinities and NaN are those of C (ISO/IEC 9899, F.10.4.4).
    """
    is_usual = is_positive_normal(x) & (abs(y) < _HUGE)
    result = x
    if any_of(is_usual):
        result = _positive_power(x, 0.0, y)
    if any_of(not is_usual):
        result = where(is_usual, result, _rare_power(x, y))
    return result


@lane_by_lane
def _rare_power(x, y):
    """Return x^y for bases that are not positive normal numbers, and for huge or infinite exponents and NaN."""
    if x == 1.0 or y == 0.0:
        return 1.0
    if x != x or y != y:
        return math.nan
    base, size = abs(x), abs(y)
    is_whole = below(size) == size
    if x < 0.0 and base < math.inf and not is_whole:
        return math.nan
    if base == 1.0:
        result = 1.0
    elif base == 0.0 or base == math.inf or size >= _HUGE:
        result = math.inf if (base > 1.0) == (y > 0.0) else 0.0
    elif is_positive_normal(base):
        result = _positive_power(base, 0.0, y)
    else:
        result = _positive_power(base * 2.0**54, 54.0, y)
    is_odd = is_whole and below(0.5 * size) != 0.5 * size
    return -result if is_odd and is_negative(x) else result
