"""Runge-Kutta methods on constrained mechanisms with dense matrices, for `mbdkit.EquationsOfMotion`.

Radau IIA on the equations of index 3, of index 2, and of Gear, Gupta and Leimkuhler (ggl), in second-order form:

    M a_i + Phi_q(q_i)^T lam_i = Q(t_i, q_i, v_i)           v_i = v_0 + h sum_j A_ij a_j
    q_i = q_0 + h c_i v_0 + h^2 sum_j (A A)_ij a_j - h sum_j A_ij M^-1 Phi_q(q_j)^T mu_j

with Phi(q_i) = 0 (index 3), or Phi_q v_i + Phi_t = 0 (index 2), or both (ggl); mu = 0 but for ggl. And the pairs of
Lobatto IIIA (a) and IIIB (a'), of which two stages make RATTLE (Jay, SIAM J. Numer. Anal. 33, 1996; Hairer, Lubich and
Wanner, Geometric Numerical Integration, VII.1.4):

    V_i = v_0 + h sum_j a'_ij a_j      Q_i = q_0 + h sum_j a_ij V_j      M a_j + Phi_q(Q_j)^T lam_j = F(t_j, Q_j, V_j)

with Phi(Q_i) = 0 for i = 2..s, q_1 = Q_s, v_1 = v_0 + h sum_j b_j a_j and Phi_q(q_1) v_1 + Phi_t = 0.

Every step is solved by Newton's method with the whole matrix of all stages, taken anew in every iteration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

import mbdkit

Array = NDArray[np.floating[Any]]


@dataclass
class State:
    """Positions, velocities and the method's own multipliers."""

    q: Array
    v: Array
    lam: Array


def _integrals(c: Array, ends: Array) -> Array:
    """Return the integrals from 0 to each of `ends` of the Lagrange polynomials of the nodes `c`."""
    found = np.empty((len(ends), len(c)))
    for j in range(len(c)):
        polynomial = np.poly1d([1.0])
        for other in np.delete(c, j):
            polynomial *= np.poly1d([1.0, -other]) / (c[j] - other)
        found[:, j] = np.polyint(polynomial)(ends)
    return found


def radau(s: int) -> tuple[Array, Array]:
    """Return a (s, s) and c (s,) of Radau IIA."""
    c = (1 + np.sort(legendre.legroots([0.0] * (s - 1) + [-1.0, 1.0]))) / 2
    c[-1] = 1.0
    return _integrals(c, c), c


def lobatto(s: int) -> tuple[Array, Array, Array, Array]:
    """Return a of IIIA and of IIIB (s, s), b and c (s,)."""
    inner = np.sort(legendre.legroots(legendre.legder([0.0] * (s - 1) + [1.0])))
    c = (1 + np.concatenate([[-1.0], inner, [1.0]])) / 2
    a = _integrals(c, c)
    b = a[-1]
    return a, b - (b[:, None] * a / b).T, b, c


def _newton(x: Array, system: Callable[[Array], tuple[Array, Array, Array]]) -> Array:
    """Solve a system given as residual, Jacobian and the scale of each unknown, until the change is round-off."""
    before = np.inf
    for _ in range(60):
        residual, jacobian, scale = system(x)
        row = np.max(np.abs(jacobian * scale), axis=1)
        dx = scale * np.linalg.solve(jacobian * scale / row[:, None], -residual / row)
        x = x + dx
        now = float(np.max(np.abs(dx) / (np.abs(scale) * (1 + np.max(np.abs(x / scale))))))
        if now < 1e-15 or (now < 1e-8 and now > before / 2):
            return x
        before = now
    raise mbdkit.StepError("newton-failed", f"the last change was {now:.1g}")


def radau_step(p: mbdkit.EquationsOfMotion, t: float, z: State, h: float, stages: int, formulation: str) -> State:
    """Take one step of Radau IIA on ``index-3``, ``index-2`` or ``ggl``."""
    a, c = radau(stages)
    n, m, s, a2 = p.n, p.m, stages, a @ a
    both = formulation == "ggl"
    mass = np.diag(p.mass)

    def states(x: Array) -> tuple[Array, Array, Array, Array, Array, list[Array]]:
        acc, lam = x[: s * n].reshape(s, n), x[s * n : s * (n + m)].reshape(s, m)
        mu = x[s * (n + m) :].reshape(s, m) if both else np.zeros((s, m))
        q = z.q + h * np.outer(c, z.v) + h**2 * a2 @ acc
        v = z.v + h * a @ acc
        for _ in range(20 if both else 0):  # the correction is along the gradients at the corrected state
            push = np.array([p.constraint_forces(t + c[i] * h, q[i], mu[i]) / p.mass for i in range(s)])
            before, q = q, z.q + h * np.outer(c, z.v) + h**2 * a2 @ acc - h * a @ push
            if np.max(np.abs(q - before)) < 1e-17:
                break
        return acc, lam, mu, q, v, [p.constraint_jacobian(t + c[i] * h, q[i]).toarray() for i in range(s)]

    def system(x: Array) -> tuple[Array, Array, Array]:
        acc, lam, _, q, v, jac = states(x)
        size = len(x)
        residual, matrix = np.zeros(size), np.zeros((size, size))
        at = [slice(i * n, (i + 1) * n) for i in range(s)]
        to = [slice(s * n + i * m, s * n + (i + 1) * m) for i in range(s)]
        on = [slice(s * (n + m) + i * m, s * (n + m) + (i + 1) * m) for i in range(s)]
        for i in range(s):
            ti = t + c[i] * h
            tangents = p.tangents(ti, q[i], v[i], acc[i], lam[i])
            k, d, g = tangents.stiffness.toarray(), tangents.damping.toarray(), -0.5 * tangents.gamma_v.toarray()
            residual[at[i]] = p.residual(ti, q[i], v[i], acc[i], lam[i])
            phi, rate = p.constraints(ti, q[i]), p.constraint_rates(ti, q[i], v[i])
            residual[to[i]] = phi if formulation == "index-3" else rate
            matrix[at[i], at[i]] += mass
            matrix[at[i], to[i]] = jac[i].T
            if both:
                residual[on[i]] = phi
            for j in range(s):
                dv, dq = h * a[i, j], h**2 * a2[i, j]
                matrix[at[i], at[j]] += dv * d + dq * k
                matrix[to[i], at[j]] += dq * jac[i] if formulation == "index-3" else dv * jac[i] + dq * g
                if both:
                    push = -h * a[i, j] * jac[j].T / p.mass[:, None]
                    matrix[at[i], on[j]] += k @ push
                    matrix[to[i], on[j]] += g @ push
                    matrix[on[i], at[j]] += dq * jac[i]
                    matrix[on[i], on[j]] += jac[i] @ push
        scale = np.ones(size)
        scale[s * n : s * (n + m)] = np.max(p.mass)
        scale[s * (n + m) :] = h * np.max(p.mass)
        return residual, matrix, scale

    first, lam = p.accelerations(t, z.q, z.v)
    x = np.concatenate([np.tile(first, s), np.tile(lam, s), np.zeros(s * m if both else 0)])
    _, lam, _, q, v, _ = states(x := _newton(x, system))
    return State(q[-1], v[-1], lam[-1])


def lobatto_step(p: mbdkit.EquationsOfMotion, t: float, z: State, h: float, stages: int) -> State:
    """Take one step of the pair of Lobatto IIIA and IIIB."""
    a, bar, b, c = lobatto(stages)
    n, m, s, a2 = p.n, p.m, stages - 1, a @ bar
    mass = np.diag(p.mass)

    def states(x: Array) -> tuple[Array, Array, Array, Array]:
        acc, lam = x[: s * n].reshape(s, n), x[s * n :].reshape(s, m)
        v = z.v + h * bar[:, :s] @ acc
        return acc, lam, z.q + h * np.outer(c, z.v) + h**2 * a2[:, :s] @ acc, v

    def system(x: Array) -> tuple[Array, Array, Array]:
        acc, lam, q, v = states(x)
        residual, matrix = np.zeros(len(x)), np.zeros((len(x), len(x)))
        for i in range(s):
            at, to = slice(i * n, (i + 1) * n), slice(s * n + i * m, s * n + (i + 1) * m)
            ti = t + c[i] * h
            tangents = p.tangents(ti, q[i], v[i], acc[i], lam[i])
            k, d = tangents.stiffness.toarray(), tangents.damping.toarray()
            residual[at] = p.residual(ti, q[i], v[i], acc[i], lam[i])
            residual[to] = p.constraints(t + c[i + 1] * h, q[i + 1])
            matrix[at, at] += mass
            matrix[at, to] = p.constraint_jacobian(ti, q[i]).toarray().T
            later = p.constraint_jacobian(t + c[i + 1] * h, q[i + 1]).toarray()
            for j in range(s):
                matrix[at, j * n : (j + 1) * n] += h * bar[i, j] * d + h**2 * a2[i, j] * k
                matrix[to, j * n : (j + 1) * n] += h**2 * a2[i + 1, j] * later
        scale = np.ones(len(x))
        scale[s * n :] = np.max(p.mass)
        return residual, matrix, scale

    first, lam = p.accelerations(t, z.q, z.v)
    acc, _, q, v = states(_newton(np.concatenate([np.tile(first, s), np.tile(lam, s)]), system))
    end, q1 = t + h, q[-1]
    known = z.v + h * b[:s] @ acc
    force = p.forces(end, q1, v[-1])
    # M a + Phi_q^T lam = Q and Phi_q (known + h b_s a) + Phi_t = 0
    last, lam_end = p.solve(end, q1, force, -p.constraint_rates(end, q1, known) / (h * b[-1]))
    return State(q1, known + h * b[-1] * last, lam_end)


def integrate(
    p: mbdkit.EquationsOfMotion,
    h: float,
    steps: int,
    step: Callable[[mbdkit.EquationsOfMotion, float, State, float], State],
) -> State:
    """Take `steps` steps of size `h` from the start of a problem."""
    z = State(p.q0, p.v0, p.accelerations(p.t0, p.q0, p.v0)[1])
    for k in range(steps):
        z = step(p, p.t0 + k * h, z, h)
    return z
