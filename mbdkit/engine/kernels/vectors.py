"""Loops over flat vectors, used in kernels instead of NumPy expressions because those would allocate."""

from __future__ import annotations

from mbdkit.engine.native.arithmetic import renewed
from mbdkit.engine.native.functions import inlined, subkernel


@subkernel
def copy(x, out):
    """Copy the vector `x` into the beginning of `out`."""
    for d in range(len(x)):
        out[d] = x[d]


@inlined
def fill(out, value):
    """Set all elements of the vector `out`."""
    for d in range(len(out)):
        out[d] = value


@inlined
def fill_rows(out, value):
    """Set all elements of the matrix `out`."""
    for i in range(len(out)):
        fill(out[i], value)


#: Coordinates and rates of this size or above count as overflow, because energies computed from them may not be finite.
BEYOND = 1e75


@subkernel
def stays_finite(x, increment):
    """Return whether `x` plus `increment` stays below `BEYOND`."""
    finite = True
    for d in range(len(x)):
        finite = finite & (abs(x[d] + increment[d]) < BEYOND)
    return finite


@subkernel
def add_compensated(x, low, increment, wanted):
    """Add `increment` to `x` in place by compensated (Kahan) summation; in lanes, only where `wanted`.

    `low` carries the rounding error of `x`.

    The sum of `x` and `low` is accurate beyond double precision over many small steps. The order of the operations
    matters: reassociation would make ``y - (new - x)`` vanish.
    """
    for d in range(len(x)):
        y = increment[d] + low[d]
        new = x[d] + y
        low[d] = renewed(y - (new - x[d]), low[d], wanted)
        x[d] = renewed(new, x[d], wanted)
