"""Solution of the index-1 system with the Jacobians of two positions, for callers in Python.

    [ M                  Phi_q(t, q)^T ] [ x  ]   [ force                                          ]
    [ Phi_q(end, q_end)  0             ] [ mu ] = [ -(Phi_q(end, q_end) v_end + Phi_t(end, q_end)) / h ]

The matrix is not symmetric, so that it is solved by sparse LU, with pivots that are chosen in advance.
"""

from __future__ import annotations

from mbdkit.engine.kernels.bundle_types import RealVector
from mbdkit.engine.kernels.equations import _evaluate_rows, _solve, load_equations, load_real
from mbdkit.engine.kernels.lu import factorize
from mbdkit.engine.kernels.system import constraint_rate, evaluate_positions, fold_values
from mbdkit.engine.native.functions import kernel


@kernel
def accelerations_between(
    address: int, matrix: int, upper: int, t: float, q: RealVector, force: RealVector, end: float, q_end: RealVector,
    v_end: RealVector, h: float, x: RealVector, mu: RealVector,
) -> float:  # fmt: skip
    """Write the solution into `x` (n,) and `mu` (m,); return the largest relative residual, or the failed pivot.

    A pivot at position k that has become too small is returned as ``-1 - k``. `address` and `matrix` are those of
    bundles of `mbdkit.engine.kernels.equations`; the first `upper` terms of the matrix are those of the rows of
    coordinates.
    """
    eq, m = load_equations(address), load_real(matrix)
    top, w, n = eq.top, eq.w, len(q)
    values = m.factors.a
    values[:] = 0.0
    _evaluate_rows(eq, t, q, v_end)  # of which the velocity has no influence on the Jacobian
    for e in range(upper):
        values[m.scatter[e, 1]] += w.source[m.scatter[e, 0]]
    _evaluate_rows(eq, end, q_end, v_end)
    for e in range(upper, len(m.scatter)):
        values[m.scatter[e, 1]] += w.source[m.scatter[e, 0]]
    evaluate_positions(top, w, eq.q)
    fold_values(top, w.cs, w.phi_t)
    for k in range(len(top.pairs)):
        for r in range(top.rows[k]):
            mu[eq.solver.row_index[k, r] - n] = -constraint_rate(top.pairs, w.jac, w.phi_t, eq.v, k, r) / h
    for i in range(len(values)):
        values[i] *= m.pattern.weight[i]
    failed = factorize(m.pattern, m.factors)
    if failed >= 0:
        return -1.0 - failed
    return _solve(m, force, mu, x, mu)
