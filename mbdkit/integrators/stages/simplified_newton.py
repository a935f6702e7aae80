"""Simplified Newton on all stages at once: one linear system for each eigenvalue of the tableau's matrix.

With one tangent for all stages, the eigenvectors of A decouple the stages (Butcher 1976, Bickart 1977). Only one of
each pair of conjugate eigenvalues is solved for; the other contributes the conjugate, hence the factor 2 below.
"""

from __future__ import annotations

from mbdkit.engine.kernels.lu import Factors, factorize, substitute
from mbdkit.engine.kernels.system import OK, REPIVOT_STAGES, gather_values
from mbdkit.engine.kernels.vectors import fill_rows
from mbdkit.engine.native.calls import call_entry
from mbdkit.engine.native.functions import inlined, overload
from mbdkit.integrators.run.run_state import FACTORIZATIONS, JACOBIANS


@inlined
def leading(rk):
    """Return the size of the eigenvalue whose system filters the estimates of the local error."""
    return rk.mu_real[0] if len(rk.mu_real) > 0 else abs(rk.mu_complex[0])


@inlined
def one_of(factors, e):
    """Return the factors of the matrix of eigenvalue number `e` from stacked arrays."""
    return Factors(
        factors.a[e], factors.lower[e], factors.upper[e], factors.pivot[e], factors.reference[e], factors.work[e]
    )


@inlined
def factorize_all(c, m, h, row_share):
    """Gather and factorize the matrix of every eigenvalue from the terms in ``c.w.source``; return a status.

    The factor of -gamma_v is ``row_share h mu``. `row_share` is 1 for rows ``Phi_q a - gamma``, 1/2 for rows
    ``Phi_q v + Phi_t``.
    """
    rk, systems, source = m.rk, m.systems, c.w.source
    pattern, scatter, real, cplx = systems.pattern, systems.scatter, systems.real, systems.cplx
    c.counts[JACOBIANS] += 1
    c.counts[FACTORIZATIONS] += len(rk.mu_real) + len(rk.mu_complex)
    failed = -1
    for e in range(len(rk.mu_real)):
        if failed < 0:
            rate = h * rk.mu_real[e]
            gather_values(source, scatter, rate, row_share * rate, pattern.weight, real.a[e])
            failed = factorize(pattern, one_of(real, e))
    for e in range(len(rk.mu_complex)):
        if failed < 0:
            z = h * rk.mu_complex[e]
            gather_values(source, scatter, z, row_share * z, pattern.weight, cplx.a[e])
            failed = factorize(pattern, one_of(cplx, e))
    if failed >= 0:
        c.solver.failed[0] = failed
        return REPIVOT_STAGES
    return OK


@inlined
def _transformed(weights, residual, z):
    """Write the residual transformed to an eigenvector, ``sum_j weights[j] residual[j]``, into `z`."""
    s, width = len(residual), len(residual[0])
    for d in range(width):
        z[d] = 0.0
    for j in range(s):
        w = weights[j]
        for d in range(width):
            z[d] += w * residual[j, d]


@inlined
def _constrain_by_address(c, solver, e):
    reacting = c.w.reacting
    if reacting.acts[0] != 0:
        call_entry(reacting.constrain[0], reacting.run[0], reacting.stages[0], float(e), 0.0, 0.0)


@inlined
def _no_constraints(c, solver, e):
    """Do nothing: runs with reactions of elements are neither vectorized nor differentiated by parameters."""


def constrain_solution(c, solver, e):
    """Let the solution for eigenvalue number `e` satisfy the constraints of reacting elements; see `Reacting`.

    Numbers of complex eigenvalues are -1, -2, ...
    """
    _constrain_by_address(c, solver, e)


@overload(constrain_solution)
def _constrain_solution(c, solver, e):
    constrain = _constrain_by_address if "pivoted" in solver.bundle.fields else _no_constraints
    return lambda c, solver, e: constrain(c, solver, e)


@inlined
def newton_changes(c, m, h, right_side):
    """Solve the transformed systems for the change of every stage, from ``m.residual`` into ``m.change``.

    `right_side` writes the right-hand side of a system; see
    `mbdkit.integrators.stages.collocation_stages.StageKernels`.
    """
    rk, systems, residual, change = m.rk, m.systems, m.residual, m.change
    pattern = systems.pattern
    s, width = len(residual), len(residual[0])
    fill_rows(change, 0.0)
    for e in range(len(rk.mu_real)):
        _transformed(rk.t_real_inv[e], residual, systems.z_real)
        right_side(c, m, rk.t_real_inv[e], h * rk.mu_real[e], systems.z_real, systems.b_real)
        substitute(pattern, one_of(systems.real, e), systems.b_real, systems.x_real)
        constrain_solution(c, c.solver, e)
        for i in range(s):
            w = rk.t_real[i, e]
            for d in range(width):
                change[i, d] -= w * systems.x_real[d]
    for e in range(len(rk.mu_complex)):
        _transformed(rk.t_complex_inv[e], residual, systems.z_complex)
        right_side(c, m, rk.t_complex_inv[e], h * rk.mu_complex[e], systems.z_complex, systems.b_complex)
        substitute(pattern, one_of(systems.cplx, e), systems.b_complex, systems.x_complex)
        constrain_solution(c, c.solver, -1 - e)
        for i in range(s):
            z = rk.t_complex[i, e]
            for d in range(width):
                x = systems.x_complex[d]
                change[i, d] -= 2.0 * (z.real * x.real - z.imag * x.imag)


@inlined
def _filter(c, m, estimate_side, factors, e, z, b, solution, x):
    """Replace `x` (3 (B + 1),) by the solution of the system with these `factors`; if complex, by its real part."""
    n3 = len(x) - 3
    for d in range(n3):
        z[d] = x[d]
    for d in range(n3, len(z)):  # the ground does not move
        z[d] = 0.0
    estimate_side(c, m, z, b)
    substitute(m.systems.pattern, factors, b, solution)
    constrain_solution(c, c.solver, e)
    for d in range(n3):
        x[d] = solution[d].real


@inlined
def filter_estimate(c, m, estimate_side, x):
    """Replace the estimate `x` (3 (B + 1),) by the (real part of the) solution of the system of the first eigenvalue.

    For index 1 this is ``(1 - h mu f_v - h^2 mu^2 f_q)^-1 x``, which keeps the estimate bounded for stiff forces
    (Hairer and Wanner 1996, IV.8).
    """
    y = m.systems
    if len(y.real.a) > 0:
        _filter(c, m, estimate_side, one_of(y.real, 0), 0, y.z_real, y.b_real, y.x_real, x)
    else:
        _filter(c, m, estimate_side, one_of(y.cplx, 0), -1, y.z_complex, y.b_complex, y.x_complex, x)
