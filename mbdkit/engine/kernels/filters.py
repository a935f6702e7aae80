"""Digital filters of series."""

from __future__ import annotations

from mbdkit.engine.kernels.bundle_types import RealMatrix, RealVector
from mbdkit.engine.native.functions import kernel


@kernel
def filter_rows(b: RealVector, a: RealVector, state: RealMatrix, series: RealMatrix) -> None:
    """Replace K series (T, K) by ``y[t] = sum of b[i] x[t - i] - sum of a[i] y[t - i]``, with ``a[0] = 1``.

    Parameters
    ----------
    b, a
        (N + 1,) coefficients.
    state
        (N, K) sums of the terms of earlier rows in the next N rows (transposed direct form II); overwritten.
    """
    order, count = state.shape
    for t in range(len(series)):
        row = series[t]
        for k in range(count):
            x = row[k]
            y = b[0] * x + state[0, k]
            for i in range(1, order):
                state[i - 1, k] = b[i] * x - a[i] * y + state[i, k]
            state[order - 1, k] = b[order] * x - a[order] * y
            row[k] = y
