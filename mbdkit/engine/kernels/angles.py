"""Cosine and sine of an angle, computed by one routine without branches for single runs and for vectorized runs.

The argument is reduced by multiples of pi/2 in two steps (Cody and Waite): pi/2 is split into two parts of 33 bits and
a remainder, so that the products with the number of quarter turns are exact. The result is a sum of two numbers. Sine
and cosine of this sum follow from polynomials of degree 13 and 14 with the coefficients of fdlibm (Sun Microsystems,
1993), which are accurate to 2^-58. The error is below 1 ulp for ``|x| < FAR``. For larger angles, the functions of the
C library are used.

A library function would be as accurate, but its branches prevent vectorization by LLVM, and its results differ between
platforms in the last bit.
"""

from __future__ import annotations

from mbdkit.engine.native.arithmetic import (
    any_of,
    below,
    chain,
    cosine_of_each,
    is_dual,
    nearest,
    sine_of_each,
    value_of,
    where,
)
from mbdkit.engine.native.functions import inlined, overload, subkernel

FAR = 1e5
"""Angle [rad] above which the reduction is not exact."""

_QUARTERS = 0.6366197723675814
"""2 / pi."""
_HALF_PI_1, _HALF_PI_2, _HALF_PI_3 = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21
"""pi / 2 as the sum of three numbers; the first two have 33 bits."""

_S1, _S2, _S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S4, _S5, _S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C4, _C5, _C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11


def cosine_and_sine(x):
    """Return cosine and sine of `x` [rad], which may be a number, lanes or a dual number."""
    return _cosine_and_sine(x)


@inlined
def _cosine_and_sine(x):
    c, s = _of_near(x)
    is_far = abs(x) >= FAR
    if any_of(is_far):
        s, c = where(is_far, sine_of_each(x), s), where(is_far, cosine_of_each(x), c)
    return c, s


@subkernel
def cosines_and_sines(q, cs):
    """Write cosine and sine of the angles of all bodies to the rows of `cs`, except for the last row (ground).

    The angles are every third number of `q`, beginning with the third.

    LLVM vectorizes the first loop, which calls no function of the C library.
    """
    is_far = _is_far(q[2])
    for b in range(len(cs) - 1):
        cs[b, 0], cs[b, 1] = _near(q[3 * b + 2])
        is_far = is_far | _is_far(q[3 * b + 2])
    if any_of(is_far):
        for b in range(len(cs) - 1):
            cs[b, 0], cs[b, 1] = cosine_and_sine(q[3 * b + 2])


@inlined
def _is_far(x):
    return abs(value_of(x)) >= FAR


def _near(x):
    """Return cosine and sine of an angle below `FAR`."""
    return _of_near(x)


@inlined
def _of_near(x):
    quarters = nearest(x * _QUARTERS)
    first = x - quarters * _HALF_PI_1
    step = quarters * _HALF_PI_2
    rest = first - step
    low = quarters * _HALF_PI_3 - ((first - rest) - step)
    y = rest - low  # the reduced angle is the sum of y and `tail`
    tail = (rest - y) - low
    z = y * y
    cube = z * y
    sine_terms = _S2 + z * (_S3 + z * (_S4 + z * (_S5 + z * _S6)))
    sine = y - ((z * (0.5 * tail - cube * sine_terms) - tail) - cube * _S1)
    cosine_terms = z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * (_C5 + z * _C6)))))
    half = 0.5 * z
    near_one = 1.0 - half
    cosine = near_one + (((1.0 - near_one) - half) + (z * cosine_terms - y * tail))
    quadrant = quarters - 4.0 * below(0.25 * quarters)  # 0, 1, 2 or 3
    is_odd = (quadrant == 1.0) | (quadrant == 3.0)
    s, c = where(is_odd, cosine, sine), where(is_odd, sine, cosine)
    s = where(quadrant >= 2.0, -s, s)
    c = where((quadrant == 1.0) | (quadrant == 2.0), -c, c)
    return c, s


def _of_any(of_number):
    """Return a function that chooses, by the type of the argument, the form for numbers or for dual numbers."""

    def choose(x):
        if not is_dual(x):
            return lambda x: of_number(x)

        def of_dual(x):
            c, s = of_number(value_of(x))
            return chain(x, c, -s), chain(x, s, c)

        return of_dual

    return choose


overload(cosine_and_sine)(_of_any(_cosine_and_sine))
overload(_near)(_of_any(_of_near))
