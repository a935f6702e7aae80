"""The linear systems of simplified Newton, one for each eigenvalue of a tableau; see `mbdkit.integrators.implicit`."""

from __future__ import annotations

from mbdkit.engine.cache import inlined
from mbdkit.engine.lu import Factors, factorize, substitute
from mbdkit.engine.system import gather_values


@inlined
def one_of(factors, e):
    """Return the factors of eigenvalue `e` out of stacked ones."""
    return Factors(
        factors.a[e], factors.lower[e], factors.upper[e], factors.pivot[e], factors.reference[e], factors.work[e]
    )


@inlined
def row_factor(rate, baumgarte):
    """Return what the lower rows of a stage matrix are divided by, for ``rate = h mu`` and Baumgarte's alpha, beta.

    The terms -2 alpha (Phi_q v + Phi_t) - beta^2 Phi of the stabilized gamma add (2 alpha rate + beta^2 rate^2) Phi_q to
    the lower rows, and alpha rate^2 times -gamma_v, because d(Phi_q v + Phi_t)/dq is -gamma_v / 2.
    """
    return 1.0 + 2.0 * baumgarte[0] * rate + baumgarte[1] * baumgarte[1] * rate * rate


@inlined
def factorize_all(source, scatter, pattern, real, cplx, mu_real, mu_complex, h, baumgarte):
    """Gather and factorize the matrix of every eigenvalue; return the failed pivot position or -1."""
    for e in range(len(mu_real)):
        rate = h * mu_real[e]
        lower = row_factor(rate, baumgarte)
        gather_values(
            source, scatter, rate, rate * (1.0 + baumgarte[0] * rate) / lower, rate * rate / lower,
            pattern.weight, real.a[e],
        )  # fmt: skip
        failed = factorize(pattern, one_of(real, e))
        if failed >= 0:
            return failed
    for e in range(len(mu_complex)):
        rate = h * mu_complex[e]
        lower = row_factor(rate, baumgarte)
        gather_values(
            source, scatter, rate, rate * (1.0 + baumgarte[0] * rate) / lower, rate * rate / lower,
            pattern.weight, cplx.a[e],
        )  # fmt: skip
        failed = factorize(pattern, one_of(cplx, e))
        if failed >= 0:
            return failed
    return -1


@inlined
def _lift(mass, pairs, rows, row_index, jac, x, n3, lower, b):
    """Write ``[M x, Phi_q x / lower]`` into `b` (n,) for an acceleration `x` (3 (B + 1),) that vanishes on the ground."""
    for body in range(len(mass) - 1):
        for i in range(3):
            b[3 * body + i] = mass[body, i] * x[3 * body + i]
    for k in range(len(pairs)):
        first, second = 3 * pairs[k, 1], 3 * pairs[k, 2]
        for r in range(rows[k]):
            total = x[n3] * 0.0
            for i in range(3):
                total += jac[k, 6 * r + i] * x[first + i] + jac[k, 6 * r + 3 + i] * x[second + i]
            b[row_index[k, r]] = total / lower


@inlined
def newton_changes(
    top, row_index, jac, pattern, real, cplx, t_real, t_real_inv, mu_real, t_complex, t_complex_inv, mu_complex, h,
    defects, z_real, z_complex, b_real, x_real, b_complex, x_complex, change,
):  # fmt: skip
    """Solve the transformed systems for the change of every stage's accelerations; `defects` (s, 3 (B + 1))."""
    s, size = defects.shape
    n3 = size - 3
    change[:, :] = 0.0
    for e in range(len(real.a)):
        z_real[:] = 0.0
        for j in range(s):
            w = t_real_inv[e, j]
            for d in range(n3):
                z_real[d] += w * defects[j, d]
        _lift(top.mass, top.pairs, top.rows, row_index, jac, z_real, n3, row_factor(h * mu_real[e], top.baumgarte), b_real)
        substitute(pattern, one_of(real, e), b_real, x_real)
        for i in range(s):
            w = t_real[i, e]
            for d in range(n3):
                change[i, d] -= w * x_real[d]
    for e in range(len(cplx.a)):
        for d in range(n3):
            z_complex[d] = 0.0
        for j in range(s):
            z = t_complex_inv[e, j]
            for d in range(n3):
                z_complex[d] += z * defects[j, d]
        lower = row_factor(h * mu_complex[e], top.baumgarte)
        _lift(top.mass, top.pairs, top.rows, row_index, jac, z_complex, n3, lower, b_complex)
        substitute(pattern, one_of(cplx, e), b_complex, x_complex)
        for i in range(s):
            z = t_complex[i, e]
            for d in range(n3):
                change[i, d] -= 2.0 * (z.real * x_complex[d].real - z.imag * x_complex[d].imag)


@inlined
def filtered(
    top, row_index, jac, pattern, real, cplx, mu_real, mu_complex, h,
    z_real, z_complex, b_real, x_real, b_complex, x_complex, x,
):  # fmt: skip
    """Replace `x` (3 (B + 1),) by ``(1 - h mu f_v - h^2 mu^2 f_q)^-1 x`` for the first eigenvalue, or its real part."""
    n3 = len(x) - 3
    if len(mu_real) > 0:
        for d in range(n3):
            z_real[d] = x[d]
        _lift(top.mass, top.pairs, top.rows, row_index, jac, z_real, n3, row_factor(h * mu_real[0], top.baumgarte), b_real)
        substitute(pattern, one_of(real, 0), b_real, x_real)
        for d in range(n3):
            x[d] = x_real[d]
    else:
        for d in range(n3):
            z_complex[d] = x[d]
        lower = row_factor(h * mu_complex[0], top.baumgarte)
        _lift(top.mass, top.pairs, top.rows, row_index, jac, z_complex, n3, lower, b_complex)
        substitute(pattern, one_of(cplx, 0), b_complex, x_complex)
        for d in range(n3):
            x[d] = x_complex[d].real
