"""The equations of a mechanism one by one, for callers in Python: each kernel takes the address of a held `View`.

Vectors are those of the moving bodies alone, (n,) with n = 3 B, and multipliers and constraint rows are (m,), the
independent ones in the order of the mechanism's rows; ground, pairs of rows and redundant rows stay inside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.jit.bundle import bundle_loader
from mbdkit.engine.jit.decorators import inlined, kernel
from mbdkit.engine.kernels.constraints import constraint_positions
from mbdkit.engine.kernels.lu import Factors, Pattern, factorize, residual, substitute
from mbdkit.engine.kernels.system import (
    NOT_FINITE,
    OK,
    Scratch,
    Solver,
    Topology,
    applied,
    constraint_rows,
    evaluate_powers,
    evaluate_tangents,
    fold_values,
    independent_rows,
    prepare,
    solve_system,
    unfold_multipliers,
)
from mbdkit.engine.kernels.vectors import BEYOND
from mbdkit.engine.workspace import Workspace

MASS, JACOBIAN, DAMPING, STIFFNESS, GAMMA_V, RESIDUAL_Q = range(6)
"""Classes of the terms of a `Matrix`: M; Phi_q and its transpose; C; K; d gamma/dv; d(Phi_q a - gamma)/dq."""


class View(NamedTuple):
    """What the kernels of this file work on."""

    top: Topology
    """The mechanism; its gravity is this view's own, which is taken away for right sides of the caller's."""
    gravity: np.ndarray
    """(2,) the mechanism's gravity."""
    w: Scratch
    solver: Solver
    q: np.ndarray
    """(3 (B + 1),) the caller's positions, ground last."""
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    """(P, 2) the caller's multipliers."""


class Matrix(NamedTuple):
    """A sparse matrix of n + m unknowns, a sum of terms with the coefficients of their classes, and its factors."""

    pattern: Pattern
    factors: Factors
    scatter: np.ndarray
    """(N, 3) term of ``Scratch.source``, place among the values, class."""
    right: np.ndarray
    solution: np.ndarray
    correction: np.ndarray


def new_view(workspace: Workspace) -> View:
    """Return the view of a workspace with the solver that is in use now."""
    top, size = workspace.stepping_topology, workspace.mechanism.size
    own, lam = top._replace(gravity=np.zeros(2)), np.zeros((len(top.pairs), 2))
    vectors = np.zeros(size), np.zeros(size), np.zeros(size)
    return View(own, top.gravity, workspace.scratch, workspace.solver, *vectors, lam)


def new_matrix(pattern: Pattern, factors: Factors, scatter: np.ndarray) -> Matrix:
    """Return a matrix with room for its values and for the solutions of its systems."""
    vectors = (np.zeros(len(pattern.row_of), factors.a.dtype) for _ in range(3))
    return Matrix(pattern, factors, scatter, *vectors)


def example_workspace() -> Workspace:
    """Return a workspace of a single free body; the types of its arrays are those of every workspace."""
    from mbdkit.engine.compile_mechanism import compile_mechanism
    from mbdkit.mechanism.mechanism import Mechanism

    m = Mechanism()
    m.body("body", mass=1.0, inertia=1.0)
    return Workspace(compile_mechanism(m), 0.0, np.zeros(6), np.zeros(6))


def _example_matrix(dtype: type) -> Matrix:
    from mbdkit.engine.elimination_order import empty_pattern, new_factors

    pattern = empty_pattern()
    return new_matrix(pattern, new_factors(pattern, dtype), np.zeros((0, 3), dtype=np.int64))


load_view = bundle_loader(lambda: new_view(example_workspace()))
load_real = bundle_loader(lambda: _example_matrix(np.float64))
load_complex = bundle_loader(lambda: _example_matrix(np.complex128))


@inlined
def _put(x, given):
    """Copy the caller's vector (n,) into `x`, which goes on with the ground's coordinates."""
    for d in range(len(given)):
        x[d] = given[d]


@inlined
def _put_rows(h, x, given):
    """Copy the caller's rows (m,) into `x` (P, 2)."""
    n = len(h.q) - 3
    for k in range(len(h.top.pairs)):
        x[k, 0] = x[k, 1] = 0.0
        for r in range(h.top.rows[k]):
            x[k, r] = given[h.solver.row_index[k, r] - n]


@inlined
def _take(x, out):
    """Copy the beginning of `x` to the caller's `out` (n,); return whether it is finite."""
    finite = True
    for d in range(len(out)):
        out[d] = x[d]
        finite = finite and abs(x[d]) < np.inf
    return finite


@inlined
def _take_rows(h, x, out):
    """Copy the rows `x` (P, 2) to the caller's `out` (m,); return whether they are finite."""
    n = len(h.q) - 3
    finite = True
    for k in range(len(h.top.pairs)):
        for r in range(h.top.rows[k]):
            out[h.solver.row_index[k, r] - n] = x[k, r]
            finite = finite and abs(x[k, r]) < np.inf
    return finite


@inlined
def _evaluate_constraints(h, t):
    prepare(h.top, h.w, t, h.q)
    constraint_rows(h.top, h.w, h.q, h.v)
    independent_rows(h.top, h.w.cs, h.w.jac, h.w.gamma, h.w.loose)
    constraint_positions(h.top.pairs, h.top.pair_parameters, h.q, h.w.cs, h.w.u, h.w.phi, h.w.phi_t)
    fold_values(h.top, h.w.cs, h.w.phi)
    fold_values(h.top, h.w.cs, h.w.phi_t)


@kernel
def solution_of(address, t, q, v, given, force, rows, x, mu):
    """Solve ``M x + Phi_q^T mu = force``, ``Phi_q x = rows`` at a state; return a status.

    The right side is that of the mechanism, Q and gamma, unless it is `given`.
    """
    h = load_view(address)
    top, w = h.top, h.w
    _put(h.q, q)
    _put(h.v, v)
    prepare(top, w, t, h.q)
    constraint_rows(top, w, h.q, h.v)
    independent_rows(top, w.cs, w.jac, w.gamma, w.loose)
    has_forces = given or len(top.springs) + len(top.loads) > 0
    top.gravity[0] = 0.0 if given else h.gravity[0]
    top.gravity[1] = 0.0 if given else h.gravity[1]
    if given:
        _put(w.force, force)
        _put_rows(h, w.gamma, rows)
    elif has_forces:
        applied(top, w, h.q, h.v)
    status = solve_system(top, w, h.solver, has_forces, h.a, h.lam, True)
    if status == OK:
        finite = _take(h.a, x)
        if not (_take_rows(h, h.lam, mu) and finite):
            status = NOT_FINITE
    return status


@kernel
def residual_of(address, t, q, v, a, lam, with_forces, out):
    """Write ``M a + Phi_q^T lam - Q``, or ``M a + Phi_q^T lam`` without forces, into `out` (n,); return a status."""
    h = load_view(address)
    top, w = h.top, h.w
    _put(h.q, q)
    _put(h.v, v)
    _put_rows(h, h.lam, lam)
    prepare(top, w, t, h.q)
    constraint_rows(top, w, h.q, h.v)
    independent_rows(top, w.cs, w.jac, w.gamma, w.loose)
    for d in range(len(h.q)):
        h.a[d] = 0.0
    if with_forces:
        if len(top.springs) + len(top.loads) > 0:
            applied(top, w, h.q, h.v)
            for d in range(len(q)):
                h.a[d] -= w.force[d]
        for b in range(len(top.mass) - 1):
            h.a[3 * b] -= top.mass[b, 0] * h.gravity[0]
            h.a[3 * b + 1] -= top.mass[b, 1] * h.gravity[1]
    for b in range(len(top.mass) - 1):
        for i in range(3):
            h.a[3 * b + i] += top.mass[b, i] * a[3 * b + i]
    for k in range(len(top.pairs)):
        first, second = 3 * top.pairs[k, 1], 3 * top.pairs[k, 2]
        for r in range(top.rows[k]):
            for i in range(3):
                h.a[first + i] += w.jac[k, 6 * r + i] * h.lam[k, r]
                h.a[second + i] += w.jac[k, 6 * r + 3 + i] * h.lam[k, r]
    finite = _take(h.a, out)
    h.a[len(h.a) - 3 :] = 0.0  # the ground, which stands still for everybody else
    if not finite:
        return NOT_FINITE
    return OK


@kernel
def rows_of(address, t, q, v, phi, rate, gamma):
    """Write Phi, ``Phi_q v + Phi_t`` and gamma, each (m,); leaves ``w.jac``; return a status."""
    h = load_view(address)
    _put(h.q, q)
    _put(h.v, v)
    _evaluate_constraints(h, t)
    finite = _take_rows(h, h.w.phi, phi)
    finite = _take_rows(h, h.w.gamma, gamma) and finite
    for k in range(len(h.top.pairs)):
        first, second = 3 * h.top.pairs[k, 1], 3 * h.top.pairs[k, 2]
        for r in range(h.top.rows[k]):
            total = h.w.phi_t[k, r]
            for i in range(3):
                total += h.w.jac[k, 6 * r + i] * h.v[first + i] + h.w.jac[k, 6 * r + 3 + i] * h.v[second + i]
            h.lam[k, r] = total
    if not (_take_rows(h, h.lam, rate) and finite):
        return NOT_FINITE
    return OK


@kernel
def tangents_of(address, t, q, v, a, lam):
    """Evaluate every term of a `Matrix` into ``w.source``; return a status."""
    h = load_view(address)
    _put(h.q, q)
    _put(h.v, v)
    _put(h.a, a)
    _put_rows(h, h.lam, lam)
    prepare(h.top, h.w, t, h.q)
    unfold_multipliers(h.top, h.w.cs, h.lam)
    evaluate_tangents(h.top, h.w, t, h.q, h.v, h.a, h.lam)
    finite = True
    for i in range(len(h.w.source)):
        finite = finite and abs(h.w.source[i]) < np.inf
    if not finite:
        return NOT_FINITE
    return OK


@kernel
def powers_of(address, t, q, v, lam):
    """Return the power of loads and drivers under the multipliers `lam`, and the power dissipated [W]."""
    h = load_view(address)
    _put(h.q, q)
    _put(h.v, v)
    _put_rows(h, h.lam, lam)
    prepare(h.top, h.w, t, h.q)
    unfold_multipliers(h.top, h.w.cs, h.lam)
    applied(h.top, h.w, h.q, h.v)
    return evaluate_powers(h.top, h.w, h.q, h.v, h.lam)


@kernel
def pair_multipliers_of(address, t, q, lam, out):
    """Write the multipliers of the pairs' own rows, redundant ones included, into `out` (P, 2)."""
    h = load_view(address)
    _put(h.q, q)
    _put_rows(h, out, lam)
    prepare(h.top, h.w, t, h.q)
    unfold_multipliers(h.top, h.w.cs, out)


@kernel
def arrive_at(address, t, q, v, worst):
    """Raise `worst` (P,) by the squared misalignments of a state; return whether it stays finite."""
    h = load_view(address)
    finite = True
    for d in range(len(q)):
        finite = finite and abs(q[d]) < BEYOND and abs(v[d]) < BEYOND
    _put(h.q, q)
    prepare(h.top, h.w, t, h.q)
    constraint_positions(h.top.pairs, h.top.pair_parameters, h.q, h.w.cs, h.w.u, h.w.phi, h.w.phi_t)
    for k in range(len(worst)):
        worst[k] = max(worst[k], h.w.phi[k, 0] * h.w.phi[k, 0] + h.w.phi[k, 1] * h.w.phi[k, 1])
    return finite


@inlined
def _factorize(source, m, coefficients):
    values = m.factors.a
    values[:] = 0.0
    for e in range(len(m.scatter)):
        values[m.scatter[e, 1]] += coefficients[m.scatter[e, 2]] * source[m.scatter[e, 0]]
    for x in range(len(values)):
        values[x] *= m.pattern.weight[x]
    return factorize(m.pattern, m.factors)


@inlined
def _solve(m, force, rows, x, mu):
    n = len(force)
    for i in range(n):
        m.right[i] = force[i]
    for i in range(len(rows)):
        m.right[n + i] = rows[i]
    substitute(m.pattern, m.factors, m.right, m.solution)
    residual(m.pattern, m.factors, m.right, m.solution, m.correction)
    substitute(m.pattern, m.factors, m.correction, m.correction)
    for i in range(len(m.solution)):
        m.solution[i] += m.correction[i]
    worst = residual(m.pattern, m.factors, m.right, m.solution, m.correction)
    for i in range(n):
        x[i] = m.solution[i]
    for i in range(len(rows)):
        mu[i] = m.solution[n + i]
    return worst


@kernel
def factorize_real(source, matrix, coefficients):
    """Factorize the sum of the terms in `source` with `coefficients` (6,); return the failed pivot or -1."""
    return _factorize(source, load_real(matrix), coefficients)


@kernel
def factorize_complex(source, matrix, coefficients):
    """Factorize as `factorize_real` does, with complex coefficients."""
    return _factorize(source, load_complex(matrix), coefficients)


@kernel
def solve_real(matrix, force, rows, x, mu):
    """Solve a factorized system with one step of refinement; return the largest residual that is left, relative."""
    return _solve(load_real(matrix), force, rows, x, mu)


@kernel
def solve_complex(matrix, force, rows, x, mu):
    """Solve as `solve_real` does, with complex numbers."""
    return _solve(load_complex(matrix), force, rows, x, mu)
