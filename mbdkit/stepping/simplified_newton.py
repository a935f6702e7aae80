"""The linear systems of simplified Newton, one for each eigenvalue; see `mbdkit.stepping.index1_collocation`."""

from __future__ import annotations

from mbdkit.engine.jit.decorators import inlined
from mbdkit.engine.kernels.lu import Factors, factorize, substitute
from mbdkit.engine.kernels.system import gather_values


@inlined
def one_of(factors, e):
    """Return the factors of eigenvalue `e` out of stacked ones."""
    return Factors(
        factors.a[e], factors.lower[e], factors.upper[e], factors.pivot[e], factors.reference[e], factors.work[e]
    )


@inlined
def factorize_all(source, scatter, rk, systems, h):
    """Gather and factorize the matrix of every eigenvalue; return the failed pivot position or -1."""
    pattern, real, cplx = systems.pattern, systems.real, systems.cplx
    for e in range(len(rk.mu_real)):
        gather_values(source, scatter, h * rk.mu_real[e], pattern.weight, real.a[e])
        failed = factorize(pattern, one_of(real, e))
        if failed >= 0:
            return failed
    for e in range(len(rk.mu_complex)):
        gather_values(source, scatter, h * rk.mu_complex[e], pattern.weight, cplx.a[e])
        failed = factorize(pattern, one_of(cplx, e))
        if failed >= 0:
            return failed
    return -1


@inlined
def _lift(mass, pairs, rows, row_index, jac, x, n3, b):
    """Write ``[M x, Phi_q x]`` into `b` (n,) for an acceleration `x` (3 (B + 1),) that vanishes on the ground."""
    for body in range(len(mass) - 1):
        for i in range(3):
            b[3 * body + i] = mass[body, i] * x[3 * body + i]
    for k in range(len(pairs)):
        first, second = 3 * pairs[k, 1], 3 * pairs[k, 2]
        for r in range(rows[k]):
            total = x[n3] * 0.0
            for i in range(3):
                total += jac[k, 6 * r + i] * x[first + i] + jac[k, 6 * r + 3 + i] * x[second + i]
            b[row_index[k, r]] = total


@inlined
def newton_changes(top, row_index, jac, rk, systems, defects, z_real, z_complex, change):
    """Solve the transformed systems for the change of every stage's accelerations; `defects` (s, 3 (B + 1))."""
    s, size = defects.shape
    n3 = size - 3
    pattern, x_real, x_complex = systems.pattern, systems.x_real, systems.x_complex
    change[:, :] = 0.0
    for e in range(len(rk.mu_real)):
        z_real[:] = 0.0
        for j in range(s):
            w = rk.t_real_inv[e, j]
            for d in range(n3):
                z_real[d] += w * defects[j, d]
        _lift(top.mass, top.pairs, top.rows, row_index, jac, z_real, n3, systems.b_real)
        substitute(pattern, one_of(systems.real, e), systems.b_real, x_real)
        for i in range(s):
            w = rk.t_real[i, e]
            for d in range(n3):
                change[i, d] -= w * x_real[d]
    for e in range(len(rk.mu_complex)):
        for d in range(n3):
            z_complex[d] = 0.0
        for j in range(s):
            z = rk.t_complex_inv[e, j]
            for d in range(n3):
                z_complex[d] += z * defects[j, d]
        _lift(top.mass, top.pairs, top.rows, row_index, jac, z_complex, n3, systems.b_complex)
        substitute(pattern, one_of(systems.cplx, e), systems.b_complex, x_complex)
        for i in range(s):
            z = rk.t_complex[i, e]
            for d in range(n3):
                change[i, d] -= 2.0 * (z.real * x_complex[d].real - z.imag * x_complex[d].imag)


@inlined
def filtered(top, row_index, jac, systems, z_real, z_complex, x):
    """Replace `x` (3 (B + 1),) by ``(1 - h mu f_v - h^2 mu^2 f_q)^-1 x`` for the first eigenvalue, or its real part."""
    n3 = len(x) - 3
    if len(systems.real.a) > 0:
        for d in range(n3):
            z_real[d] = x[d]
        _lift(top.mass, top.pairs, top.rows, row_index, jac, z_real, n3, systems.b_real)
        substitute(systems.pattern, one_of(systems.real, 0), systems.b_real, systems.x_real)
        for d in range(n3):
            x[d] = systems.x_real[d]
    else:
        for d in range(n3):
            z_complex[d] = x[d]
        _lift(top.mass, top.pairs, top.rows, row_index, jac, z_complex, n3, systems.b_complex)
        substitute(systems.pattern, one_of(systems.cplx, 0), systems.b_complex, systems.x_complex)
        for d in range(n3):
            x[d] = systems.x_complex[d].real
