"""Simplified Newton on all stages at once: one linear system for each eigenvalue of the tableau's matrix.

With one tangent for all stages, the eigenvectors of A decouple the stages (Butcher 1976, Bickart 1977). Only one of
each pair of conjugate eigenvalues is solved for; the other contributes the conjugate, hence the factor 2 below.
"""

from __future__ import annotations

from mbdkit.engine.jit.decorators import inlined
from mbdkit.engine.kernels.lu import Factors, factorize, substitute


@inlined
def leading(rk):
    """Return the size of the eigenvalue whose system filters the estimates of the local error."""
    return rk.mu_real[0] if len(rk.mu_real) > 0 else abs(rk.mu_complex[0])


@inlined
def one_of(factors, e):
    """Return the factors of eigenvalue `e` out of stacked ones."""
    return Factors(
        factors.a[e], factors.lower[e], factors.upper[e], factors.pivot[e], factors.reference[e], factors.work[e]
    )


@inlined
def _gather(source, systems, rate, row_rate, values):
    """Fill the scaled values of the matrix of an eigenvalue from the terms in `source`.

    `rate` is ``h mu``, the factor of damping, and its square that of stiffness; `row_rate` that of -gamma_v.
    """
    scatter, weight = systems.scatter, systems.pattern.weight
    level = rate * rate
    values[:] = 0.0
    for e in range(len(scatter.one)):
        values[scatter.one[e, 1]] += source[scatter.one[e, 0]]
    for e in range(len(scatter.rate)):
        values[scatter.rate[e, 1]] += rate * source[scatter.rate[e, 0]]
    for e in range(len(scatter.minus_rate)):
        values[scatter.minus_rate[e, 1]] -= row_rate * source[scatter.minus_rate[e, 0]]
    for e in range(len(scatter.level)):
        values[scatter.level[e, 1]] += level * source[scatter.level[e, 0]]
    for x in range(len(values)):
        values[x] *= weight[x]


@inlined
def factorize_all(source, rk, systems, h, row_share):
    """Gather and factorize the matrix of every eigenvalue; return the failed pivot position or -1.

    ``row_share h mu`` is the factor of -gamma_v: 1 for rows ``Phi_q a - gamma``, 1/2 for rows ``Phi_q v + Phi_t``.
    """
    pattern, real, cplx = systems.pattern, systems.real, systems.cplx
    for e in range(len(rk.mu_real)):
        rate = h * rk.mu_real[e]
        _gather(source, systems, rate, row_share * rate, real.a[e])
        failed = factorize(pattern, one_of(real, e))
        if failed >= 0:
            return failed
    for e in range(len(rk.mu_complex)):
        z = h * rk.mu_complex[e]
        _gather(source, systems, z, row_share * z, cplx.a[e])
        failed = factorize(pattern, one_of(cplx, e))
        if failed >= 0:
            return failed
    return -1


@inlined
def newton_changes(c, m, h, right_side):
    """Solve the transformed systems for the change of every stage, from ``m.residual`` into ``m.change``.

    `right_side` writes the right side of a system; see `mbdkit.stepping.collocation_stages.StageKernels`.
    """
    rk, systems, residual, change = m.rk, m.systems, m.residual, m.change
    pattern, z_real, z_complex = systems.pattern, systems.z_real, systems.z_complex
    s, width = residual.shape
    change[:, :] = 0.0
    for e in range(len(rk.mu_real)):
        for d in range(width):
            z_real[d] = 0.0
        for j in range(s):
            w = rk.t_real_inv[e, j]
            for d in range(width):
                z_real[d] += w * residual[j, d]
        right_side(c, m, h * rk.mu_real[e], z_real, systems.b_real)
        substitute(pattern, one_of(systems.real, e), systems.b_real, systems.x_real)
        for i in range(s):
            w = rk.t_real[i, e]
            for d in range(width):
                change[i, d] -= w * systems.x_real[d]
    for e in range(len(rk.mu_complex)):
        for d in range(width):
            z_complex[d] = 0.0
        for j in range(s):
            z = rk.t_complex_inv[e, j]
            for d in range(width):
                z_complex[d] += z * residual[j, d]
        right_side(c, m, h * rk.mu_complex[e], z_complex, systems.b_complex)
        substitute(pattern, one_of(systems.cplx, e), systems.b_complex, systems.x_complex)
        for i in range(s):
            z = rk.t_complex[i, e]
            for d in range(width):
                x = systems.x_complex[d]
                change[i, d] -= 2.0 * (z.real * x.real - z.imag * x.imag)


@inlined
def filter_estimate(c, m, estimate_side, x):
    """Replace the estimate `x` (3 (B + 1),) by the solution of the first eigenvalue's system, or its real part.

    For index 1 this is ``(1 - h mu f_v - h^2 mu^2 f_q)^-1 x``, which keeps the estimate bounded for stiff forces
    (Hairer and Wanner 1996, IV.8).
    """
    systems = m.systems
    n3 = len(x) - 3
    if len(systems.real.a) > 0:
        z, b = systems.z_real, systems.b_real
        for d in range(n3):
            z[d] = x[d]
        for d in range(n3, len(z)):  # the ground does not move
            z[d] = 0.0
        estimate_side(c, m, z, b)
        substitute(systems.pattern, one_of(systems.real, 0), b, systems.x_real)
        for d in range(n3):
            x[d] = systems.x_real[d]
    else:
        zc, bc = systems.z_complex, systems.b_complex
        for d in range(n3):
            zc[d] = x[d]
        for d in range(n3, len(zc)):
            zc[d] = 0.0
        estimate_side(c, m, zc, bc)
        substitute(systems.pattern, one_of(systems.cplx, 0), bc, systems.x_complex)
        for d in range(n3):
            x[d] = systems.x_complex[d].real
