"""Cosine and sine of an angle, and those of the angles of all bodies, for numbers, lanes and dual numbers."""

from __future__ import annotations

from mbdkit.engine.kernels.elementary import trigonometric
from mbdkit.engine.kernels.elementary.trigonometric import FAR
from mbdkit.engine.native.arithmetic import any_of, chain, is_dual, value_of
from mbdkit.engine.native.functions import inlined, overload, subkernel


def cosine_and_sine(x):
    """Return cosine and sine of `x` [rad], which may be a number, lanes or a dual number."""
    return trigonometric.cosine_and_sine(x)


@subkernel
def cosines_and_sines(q, cs):
    """Write cosine and sine of the angles of all bodies to the rows of `cs`, except for the last row (ground).

    The angles are every third number of `q`, beginning with the third.

    LLVM vectorizes the first loop, which has no branches.
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
    return trigonometric.cosine_and_sine_of_near(x)


def _of_any(of_number):
    def choose(x):
        if not is_dual(x):
            return lambda x: of_number(x)

        def of_dual(x):
            c, s = of_number(value_of(x))
            return chain(x, c, -s), chain(x, s, c)

        return of_dual

    return choose


overload(cosine_and_sine)(_of_any(trigonometric.cosine_and_sine))
overload(_near)(_of_any(trigonometric.cosine_and_sine_of_near))
