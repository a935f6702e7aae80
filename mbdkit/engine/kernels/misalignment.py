"""Misalignment of a pair of constraint rows: the Euclidean norm of its residual Phi.

The largest misalignment over all steps is stored as a square, which saves a square root per pair and step. The recorder
adds the squares of the pairs of a joint and takes the root at the end of a run.
"""

from __future__ import annotations

from mbdkit.engine.kernels.system import evaluate_positions, prepare
from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.functions import inlined, subkernel


def squared_misalignment(x, y):
    """Return the squared misalignment of a pair from the residuals of its two rows, which may be arrays."""
    return x * x + y * y


_squared = inlined(squared_misalignment)


@subkernel
def raise_misalignments(top, w, t, q, worst):
    """Update `worst` (P,), the largest squared misalignment of each pair [m^2, rad^2], with the position `q` at `t`."""
    prepare(top, w, t, q)
    evaluate_positions(top, w, q)
    for k in range(len(worst)):
        square = _squared(w.phi[k, 0], w.phi[k, 1])
        worst[k] = where(square > worst[k], square, worst[k])
