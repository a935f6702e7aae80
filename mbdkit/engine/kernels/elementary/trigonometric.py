"""Sine, cosine and tangent.

Angles below `FAR` are reduced by multiples of pi/2 in three steps (W. J. Cody and W. Waite, Software manual for the
elementary functions, 1980): pi/2 is split into two parts of 37 bits and a remainder, so that the first two products
with the number of quarter turns are exact. The result is the sum of a number and a small `tail`, with an error of 2^-64
of its value, even for the doubles that are closest to multiples of pi/2. Larger angles are reduced with integers.

The polynomials of sine and cosine are minimax fits of `mbdkit_builder.minimax` on [-pi/4, pi/4]; their
relative errors are below 2^-57.8 and 2^-63.9. Sine and cosine have errors below 0.8 units in the last place (ulp), of
which the rounding of the square of the reduced angle makes a quarter; the tangent, a quotient of pairs of numbers, has
errors below 0.6 ulp.
"""

from __future__ import annotations

import math

from mbdkit.engine.kernels.elementary.exact_sums import (
    fast_two_sum,
    product_of_pairs,
    quotient_of_pairs,
    sum_of_pairs,
)
from mbdkit.engine.kernels.elementary.far_angles import far_angle
from mbdkit.engine.native.arithmetic import any_of, below, lane_by_lane, nearest, where
from mbdkit.engine.native.functions import inlined, subkernel

FAR = 1e5  #: Angle [rad] from which the product with the first part of pi/2 may be rounded.

_QUARTERS = 0.6366197723675814  #: 2 / pi.
#: pi / 2 as the sum of three numbers; the first two have 37 bits.
_HALF_PI_1, _HALF_PI_2, _HALF_PI_3 = 1.5707963267923333, 2.5633441515839558e-12, 1.0562999066987428e-23

_S1, _S2, _S3 = -0.1666666666666663, 0.008333333333321842, -0.0001984126982938497
_S4, _S5, _S6 = 2.7557313556779458e-06, -2.5050738527842927e-08, 1.5895737937634123e-10
_C1, _C2, _C3 = 0.041666666666666595, -0.001388888888887334, 2.480158728899977e-05
_C4, _C5, _C6 = -2.755731421616073e-07, 2.0875705254007084e-09, -1.1358740933903117e-11


@inlined
def near_angle(x):
    """Return an angle [rad] below `FAR` without its multiple of pi/2, as a pair, and the multiple modulo 4."""
    quarters = nearest(x * _QUARTERS)
    first = x - quarters * _HALF_PI_1
    step = quarters * _HALF_PI_2
    rest = first - step
    low = quarters * _HALF_PI_3 - ((first - rest) - step)
    y = rest - low
    return y, (rest - y) - low, quarters - 4.0 * below(0.25 * quarters)


@inlined
def _sine_terms(z, square):
    return (_S2 + z * _S3) + square * ((_S4 + z * _S5) + square * _S6)


@inlined
def _cosine_terms(z, square):
    return (_C1 + z * _C2) + square * ((_C3 + z * _C4) + square * (_C5 + z * _C6))


@inlined
def cosine_and_sine_of_reduced(y, tail, quadrant):
    """Return cosine and sine of ``y + tail + quadrant * pi/2`` [rad], where ``|y| <= pi/4``."""
    z = y * y
    square = z * z
    half = 0.5 * z
    near_one = 1.0 - half
    sine = y + (tail * near_one + z * y * (_S1 + z * _sine_terms(z, square)))
    cosine = near_one + (((1.0 - near_one) - half) + (square * _cosine_terms(z, square) - y * tail))
    # Selections by a single comparison need no branch at any level of processors, unlike those by two.
    is_odd = abs(quadrant - 2.0) == 1.0
    s, c = where(is_odd, cosine, sine), where(is_odd, sine, cosine)
    s = where(quadrant >= 2.0, -s, s)
    c = where(abs(quadrant - 1.5) < 1.0, -c, c)
    return c, s


@inlined
def cosine_and_sine_of_near(x):
    """Return cosine and sine of an angle [rad] below `FAR`."""
    y, tail, quadrant = near_angle(x)
    c, s = cosine_and_sine_of_reduced(y, tail, quadrant)
    return c, where(abs(x) < 2.0**-26, x, s)  # which keeps the sign of zero


@inlined
def _far_angle(x):
    is_finite = abs(x) < math.inf
    y, tail, quadrant = far_angle(where(is_finite, abs(x), FAR))
    return y + where(is_finite, 0.0, math.nan), tail, quadrant


@lane_by_lane
def _far_cosine(x):
    y, tail, quadrant = _far_angle(x)
    return cosine_and_sine_of_reduced(y, tail, quadrant)[0]


@lane_by_lane
def _far_sine(x):
    y, tail, quadrant = _far_angle(x)
    s = cosine_and_sine_of_reduced(y, tail, quadrant)[1]
    return -s if x < 0.0 else s


@inlined
def cosine_and_sine(x):
    """Return cosine and sine of an angle [rad]."""
    c, s = cosine_and_sine_of_near(x)
    is_far = abs(x) >= FAR
    if any_of(is_far):
        c, s = where(is_far, _far_cosine(x), c), where(is_far, _far_sine(x), s)
    return c, s


@subkernel
def cos(x):
    """Return the cosine of an angle [rad]."""
    return cosine_and_sine(x)[0]


@subkernel
def sin(x):
    """Return the sine of an angle [rad]."""
    return cosine_and_sine(x)[1]


@inlined
def _tangent_of_reduced(y, tail, quadrant):
    """Return the tangent of ``y + tail + quadrant * pi/2`` [rad], the quotient of sine and cosine as pairs."""
    z, z_low = product_of_pairs(y, tail, y, tail)
    square = z * z
    cube, cube_low = product_of_pairs(z, z_low, y, tail)
    factor, factor_low = fast_two_sum(_S1, z * _sine_terms(z, square))
    cubic, cubic_low = product_of_pairs(cube, cube_low, factor, factor_low)
    s, s_low = sum_of_pairs(y, tail, cubic, cubic_low)
    c, c_low = fast_two_sum(1.0, -0.5 * z)
    c, c_low = sum_of_pairs(c, c_low - 0.5 * z_low, square * _cosine_terms(z, square), 0.0)
    is_odd = abs(quadrant - 2.0) == 1.0
    above, above_low = where(is_odd, -c, s), where(is_odd, -c_low, s_low)
    under, under_low = where(is_odd, s, c), where(is_odd, s_low, c_low)
    return quotient_of_pairs(above, above_low, under, under_low)[0]


@lane_by_lane
def _far_tangent(x):
    y, tail, quadrant = _far_angle(x)
    t = _tangent_of_reduced(y, tail, quadrant)
    return -t if x < 0.0 else t


@subkernel
def tan(x):
    """Return the tangent of an angle [rad]."""
    y, tail, quadrant = near_angle(x)
    t = _tangent_of_reduced(y, tail, quadrant)
    is_far = abs(x) >= FAR
    if any_of(is_far):
        t = where(is_far, _far_tangent(x), t)
    return where(abs(x) < 2.0**-27, x, t)
