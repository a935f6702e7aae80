"""Projection of positions and velocities onto the constraints with the smallest change in the mass metric.

Both projections solve the saddle point system of the index-1 equations with other right-hand sides, so that they reuse
its solver. They take a mechanism (`still`) without gravity, which the solver would otherwise add.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_system
from mbdkit.engine.kernels.constraints import constraint_positions
from mbdkit.engine.kernels.system import DIVERGED, OK, constraint_rate, fold_values, prepare, solved_rows
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.functions import subkernel

EPS = float(np.finfo(float).eps)

#: Residuals and changes below this many `EPS` times the largest coordinate (at least 1) count as zero. Lengths are in
#: units of the characteristic length of the mechanism if it is below 1 m, and otherwise in metres.
#:
#: A residual or a stage position is a sum of a few products, each rounded once.
FEW_ROUNDINGS = 4.0

#: Iterations after which a projection of positions counts as failed.
#:
#: Newton's method takes 3 to 6 from a state near the constraints; 20 leave room for a start far from them.
MOST_ITERATIONS = 20

#: A residual or change that no longer decreases counts as round-off only up to this relative size (a chosen value).
#:
#: Larger ones are never accepted, however ill-conditioned the equations are.
STAGNANT = 1e-9


@subkernel
def largest_size(top, q):
    """Return the largest absolute value in `q` (3 (B + 1),), at least 1; lengths in units of ``top.length``."""
    size, unit = 1.0, top.length[0]
    for b in range(len(q) // 3):
        size = max(size, abs(q[3 * b]) / unit, abs(q[3 * b + 1]) / unit, abs(q[3 * b + 2]))
    return size


@subkernel
def largest_residual(top, phi):
    """Return the largest absolute residual of the rows that are solved for; infinity if one is not finite."""
    worst = 0.0
    for k in range(len(phi)):
        for r in range(top.rows[k]):
            if not abs(phi[k, r]) < np.inf:
                return np.inf
            worst = max(worst, abs(phi[k, r]))
    return worst


@subkernel
def scaled_residual(top, phi):
    """Return the largest absolute residual of the rows that are solved for; infinity if one is not finite.

    Lengths are in units of ``top.length``, for comparison with `largest_size`.
    """
    worst = 0.0
    for k in range(len(phi)):
        for r in range(top.rows[k]):
            if not abs(phi[k, r]) < np.inf:
                return np.inf
            worst = max(worst, abs(phi[k, r]) / top.row_units[k, r])
    return worst


@subkernel
def position_rows(top, w, t, q):
    """Evaluate Phi and Phi_t of the rows that are solved for into ``w.phi`` and ``w.phi_t``; calls `prepare`."""
    prepare(top, w, t, q)
    constraint_positions(top.pairs, top.pair_parameters, q, w.cs, w.u, w.phi, w.phi_t)
    fold_values(top, w.cs, w.phi)
    fold_values(top, w.cs, w.phi_t)


@subkernel
def rate_rows(top, jac, phi_t, v, rate):
    """Write ``Phi_q v + Phi_t`` of the rows that are solved for into `rate` (P, 2), and 0 into the other rows."""
    for k in range(len(top.pairs)):
        for r in range(2):
            rate[k, r] = constraint_rate(top.pairs, jac, phi_t, v, k, r) if r < top.rows[k] else 0.0


@subkernel
def project_positions(still, w, solver, t, q, p, rest, x, lam):
    """Write the positions closest to `q` in the mass metric that satisfy the constraints at `t` into `p`.

    Solves ``M (p - q) + Phi_q(p)^T mu = 0``, ``Phi(t, p) = 0`` to rounding errors; returns a status. This is Newton's
    method without the derivative of ``Phi_q^T mu``: each iteration solves ``M x + Phi_q^T mu = M (q - p)``,
    ``Phi_q x = -Phi`` with the current Jacobian. The iteration ends at `FEW_ROUNDINGS`, or below `STAGNANT` if the
    residual no longer halves.

    Parameters
    ----------
    still
        The mechanism without gravity.
    q, p : (3 (B + 1),) arrays
        Given positions and projected positions; ground last.
    rest, x : (3 (B + 1),) arrays
        Velocities, all zero, and a work array.
    lam : (P, 2) array
        Work array.
    """
    copy(q, p)
    before = np.inf
    for m in range(MOST_ITERATIONS):
        position_rows(still, w, t, p)
        now = scaled_residual(still, w.phi)
        size = largest_size(still, p)
        # rounding errors of ill-conditioned joints can exceed the first limit; the iteration then stagnates
        if now <= FEW_ROUNDINGS * EPS * size or (m > 1 and now > 0.5 * before and now < STAGNANT * size):
            return OK
        if not now < np.inf:
            return DIVERGED
        before = now
        solved_rows(still, w, p, rest)
        for k in range(len(w.phi)):
            for r in range(2):
                w.gamma[k, r] = -w.phi[k, r]
        if m > 0:  # in the first iteration p = q, so that this right-hand side is zero
            for b in range(len(still.mass) - 1):
                for i in range(3):
                    w.force[3 * b + i] = still.mass[b, i] * (q[3 * b + i] - p[3 * b + i])
        status = solve_system(still, w, solver, m > 0, x, lam, False)
        if status != OK:
            return status
        for d in range(len(p) - 3):
            p[d] += x[d]
    return DIVERGED


@subkernel
def project_velocities(still, w, solver, t, q, v, x, lam):
    """Replace `v` by the closest velocities, in the mass metric, with ``Phi_q v + Phi_t = 0`` at `t`, `q`.

    The equations are linear, so one solution suffices in exact arithmetic. It is repeated, at most three times in
    total, until the residual is below `FEW_ROUNDINGS` or no longer halves. `x` and `lam` are work arrays. Returns a
    status.
    """
    before = np.inf
    position_rows(still, w, t, q)
    size = largest_size(still, v)
    for m in range(3):
        solved_rows(still, w, q, v)
        rate_rows(still, w.jac, w.phi_t, v, w.refinement)
        now = scaled_residual(still, w.refinement)
        # the second solution removes the rounding errors of the first, a third rarely more
        if now <= FEW_ROUNDINGS * EPS * size or (m > 1 and now > 0.5 * before):
            return OK
        before = now
        for k in range(len(w.gamma)):
            for r in range(2):
                w.gamma[k, r] = -w.refinement[k, r]
        status = solve_system(still, w, solver, False, x, lam, True)
        if status != OK:
            return status
        for d in range(len(v) - 3):
            v[d] += x[d]
    return OK


@subkernel
def mass_norm(mass, total, x, y):
    """Return ``sqrt((x - y)^T M (x - y) / total)`` for vectors (3 (B + 1),) and the diagonal `mass` (B + 1, 3) of M."""
    square = 0.0
    for b in range(len(mass) - 1):
        for i in range(3):
            change = x[3 * b + i] - y[3 * b + i]
            square += mass[b, i] * change * change
    return np.sqrt(square / total)
