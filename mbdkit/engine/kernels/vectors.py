"""Small loops over flat vectors; kernels have no use of NumPy's own, which would allocate."""

from __future__ import annotations

from mbdkit.engine.jit.decorators import subkernel


@subkernel
def copy(x, out):
    """Copy the vector `x` into the beginning of `out`."""
    for d in range(len(x)):
        out[d] = x[d]


BEYOND = 1e75
"""A coordinate or rate of this size counts as overflow: its energy could not be recorded as a finite number."""


@subkernel
def stays_finite(x, increment):
    """Return whether `x` plus `increment` stays below `BEYOND`."""
    finite = True
    for d in range(len(x)):
        finite = finite and abs(x[d] + increment[d]) < BEYOND
    return finite


@subkernel
def add_compensated(x, low, increment):
    """Add `increment` to `x`, whose rounding errors are carried in `low`."""
    for d in range(len(x)):
        y = increment[d] + low[d]
        new = x[d] + y
        low[d] = y - (new - x[d])
        x[d] = new
