"""Kernels that evaluate and solve the equations of motion for callers in Python.

Each kernel takes the address of a pinned `Equations` bundle. Vectors of the caller have no entries for ground: their
shape is (n,) with n = 3 B. Multipliers and constraint rows are (m,): only the independent rows, in the order of the
rows of the mechanism. The kernels copy these vectors into the padded arrays (3 (B + 1),) and (P, 2) of the engine.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_loaded, solve_system
from mbdkit.engine.kernels.applied_forces import any_forces, applied_forces, take_multipliers
from mbdkit.engine.kernels.bundle_types import (
    ComplexVector,
    IntMatrix,
    NumberVector,
    RealMatrix,
    RealVector,
    example_of,
)
from mbdkit.engine.kernels.engine_bundles import Scratch, Solver, Topology
from mbdkit.engine.kernels.lu import Factors, Pattern, factorize, solve_refined
from mbdkit.engine.kernels.misalignment import raise_misalignments
from mbdkit.engine.kernels.system import (
    NOT_FINITE,
    OK,
    constraint_rate,
    evaluate_positions,
    evaluate_powers,
    evaluate_tangents,
    fold_values,
    prepare,
    solved_rows,
    unfold_multipliers,
)
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.vectors import BEYOND
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import inlined, kernel

#: Classes of the terms of a `Matrix`: M; Phi_q and its transpose; C; K; d gamma/dv; d(Phi_q a - gamma)/dq.
#:
#: A `Matrix` has one coefficient for each class.
MASS, JACOBIAN, DAMPING, STIFFNESS, GAMMA_V, RESIDUAL_Q = range(6)


class Equations(NamedTuple):
    """The bundle of `mbdkit.engine.equations_of_motion.EquationsOfMotion`: a mechanism and its working arrays."""

    #: The mechanism, with its own gravity vector, which is zero if the caller supplies the right-hand side.
    top: Topology
    gravity: RealVector  #: (2,) gravity of the mechanism.
    w: Scratch
    solver: Solver
    q: RealVector  #: (3 (B + 1),) positions of the caller, ground last; `v` and `a` hold velocities and accelerations.
    v: RealVector
    a: RealVector
    lam: RealMatrix  #: (P, 2) multipliers of the caller.


class Matrix(NamedTuple):
    """A factorized sparse matrix of n + m unknowns: the sum of all terms, each times the coefficient of its class."""

    pattern: Pattern
    factors: Factors
    scatter: IntMatrix  #: (N, 3) index into ``Scratch.source``, index into the values of the matrix, class of the term.
    right: NumberVector
    solution: NumberVector
    correction: NumberVector


def new_equations(top: Topology, scratch: Scratch, solver: Solver) -> Equations:
    """Return the bundle of a mechanism with its working arrays and the current solver."""
    size, lam = len(scratch.force), np.zeros((len(top.pairs), 2))
    vectors = np.zeros(size), np.zeros(size), np.zeros(size)
    return Equations(top._replace(gravity=np.zeros(2)), top.gravity, scratch, solver, *vectors, lam)


def new_matrix(pattern: Pattern, factors: Factors, scatter: np.ndarray) -> Matrix:
    """Return a matrix with storage for its values and for the solution of linear systems with it."""
    vectors = (np.zeros(len(pattern.row_of), factors.a.dtype) for _ in range(3))
    return Matrix(pattern, factors, scatter, *vectors)


load_equations = bundle_loader(lambda: example_of(Equations))
load_real = bundle_loader(lambda: example_of(Matrix, np.float64))
load_complex = bundle_loader(lambda: example_of(Matrix, np.complex128))


@inlined
def _put(x, given):
    """Copy a vector (n,) of the caller to the beginning of `x` (3 (B + 1),); the entries of ground stay unchanged."""
    for d in range(len(given)):
        x[d] = given[d]


@inlined
def _put_rows(eq, x, given):
    """Copy rows (m,) of the caller to `x` (P, 2); rows that are not solved for become zero."""
    n = len(eq.q) - 3
    for k in range(len(eq.top.pairs)):
        x[k, 0] = x[k, 1] = 0.0
        for r in range(eq.top.rows[k]):
            x[k, r] = given[eq.solver.row_index[k, r] - n]


@inlined
def _take(x, out):
    """Copy the beginning of `x` to the caller's `out` (n,); return whether it is finite."""
    finite = True
    for d in range(len(out)):
        out[d] = x[d]
        finite = finite and abs(x[d]) < np.inf
    return finite


@inlined
def _take_rows(eq, x, out):
    """Copy the rows `x` (P, 2) to the caller's `out` (m,); return whether they are finite."""
    n = len(eq.q) - 3
    finite = True
    for k in range(len(eq.top.pairs)):
        for r in range(eq.top.rows[k]):
            out[eq.solver.row_index[k, r] - n] = x[k, r]
            finite = finite and abs(x[k, r]) < np.inf
    return finite


@inlined
def _evaluate_rows(eq, t, q, v):
    """Copy a state into the bundle, and evaluate there the Jacobian and gamma of the rows that are solved for."""
    _put(eq.q, q)
    _put(eq.v, v)
    prepare(eq.top, eq.w, t, eq.q)
    solved_rows(eq.top, eq.w, eq.q, eq.v)


@kernel
def solution_of(
    address: int, t: float, q: RealVector, v: RealVector, given: bool, force: RealVector, rows: RealVector,
    x: RealVector, mu: RealVector,
) -> int:  # fmt: skip
    """Solve ``M x + Phi_q^T mu = force``, ``Phi_q x = rows`` at a state; return a status.

    If `given` is false, the right-hand side is that of the mechanism, Q and gamma, and `force` and `rows` are ignored.
    If it is true, gravity is set to zero, because the solver would otherwise add it to `force`.
    """
    eq = load_equations(address)
    top, w = eq.top, eq.w
    _evaluate_rows(eq, t, q, v)
    top.gravity[0] = 0.0 if given else eq.gravity[0]
    top.gravity[1] = 0.0 if given else eq.gravity[1]
    if given:
        _put(w.force, force)
        _put_rows(eq, w.gamma, rows)
        status = solve_system(top, w, eq.solver, True, eq.a, eq.lam, True)
    else:
        status = solve_loaded(top, w, eq.solver, eq.q, eq.v, eq.a, eq.lam, True)
    if status == OK:
        finite = _take(eq.a, x)
        if not (_take_rows(eq, eq.lam, mu) and finite):
            status = NOT_FINITE
    return status


@kernel
def residual_of(
    address: int, t: float, q: RealVector, v: RealVector, a: RealVector, lam: RealVector, with_forces: bool,
    out: RealVector,
) -> int:  # fmt: skip
    """Write ``M a + Phi_q^T lam - Q``, or ``M a + Phi_q^T lam`` without forces, into `out` (n,); return a status."""
    eq = load_equations(address)
    top, w = eq.top, eq.w
    _put(eq.q, q)
    _put(eq.v, v)
    _put_rows(eq, eq.lam, lam)
    prepare(top, w, t, eq.q)
    solved_rows(top, w, eq.q, eq.v)
    # `eq.a` serves as the accumulator of the residual. Gravity is not part of ``w.force`` and is subtracted separately.
    for d in range(len(eq.q)):
        eq.a[d] = 0.0
    if with_forces:
        if any_forces(top):
            take_multipliers(top, w, eq.lam)
            applied_forces(top, w, eq.q, eq.v)
            for d in range(len(q)):
                eq.a[d] -= w.force[d]
        for b in range(len(top.mass) - 1):
            eq.a[3 * b] -= top.mass[b, 0] * eq.gravity[0]
            eq.a[3 * b + 1] -= top.mass[b, 1] * eq.gravity[1]
    for b in range(len(top.mass) - 1):
        for i in range(3):
            eq.a[3 * b + i] += top.mass[b, i] * a[3 * b + i]
    for k in range(len(top.pairs)):
        first, second = 3 * top.pairs[k, PAIR.first], 3 * top.pairs[k, PAIR.second]
        for r in range(top.rows[k]):
            for i in range(3):
                eq.a[first + i] += w.jac[k, 6 * r + i] * eq.lam[k, r]
                eq.a[second + i] += w.jac[k, 6 * r + 3 + i] * eq.lam[k, r]
    finite = _take(eq.a, out)
    eq.a[len(eq.a) - 3 :] = 0.0  # remove the reactions on ground: other kernels rely on zero accelerations there
    if not finite:
        return NOT_FINITE
    return OK


@kernel
def rows_of(
    address: int, t: float, q: RealVector, v: RealVector, phi: RealVector, rate: RealVector, gamma: RealVector
) -> int:  # fmt: skip
    """Write Phi, ``Phi_q v + Phi_t`` and gamma, each (m,), and leave the Jacobian in ``w.jac``; return a status."""
    eq = load_equations(address)
    top, w = eq.top, eq.w
    _evaluate_rows(eq, t, q, v)
    evaluate_positions(top, w, eq.q)
    fold_values(top, w.cs, w.phi)
    fold_values(top, w.cs, w.phi_t)
    finite = _take_rows(eq, w.phi, phi)
    finite = _take_rows(eq, w.gamma, gamma) and finite
    for k in range(len(top.pairs)):
        for r in range(top.rows[k]):
            eq.lam[k, r] = constraint_rate(top.pairs, w.jac, w.phi_t, eq.v, k, r)
    if not (_take_rows(eq, eq.lam, rate) and finite):
        return NOT_FINITE
    return OK


@kernel
def tangents_of(
    address: int, t: float, q: RealVector, v: RealVector, a: RealVector, lam: RealVector
) -> int:  # fmt: skip
    """Evaluate all terms of a `Matrix` at a state and write them to ``w.source``; return a status."""
    eq = load_equations(address)
    _put(eq.q, q)
    _put(eq.v, v)
    _put(eq.a, a)
    _put_rows(eq, eq.lam, lam)
    prepare(eq.top, eq.w, t, eq.q)
    unfold_multipliers(eq.top, eq.w.cs, eq.lam)
    evaluate_tangents(eq.top, eq.w, t, eq.q, eq.v, eq.a, eq.lam)
    finite = True
    for i in range(len(eq.w.source)):
        finite = finite and abs(eq.w.source[i]) < np.inf
    if not finite:
        return NOT_FINITE
    return OK


@kernel
def powers_of(address: int, t: float, q: RealVector, v: RealVector, lam: RealVector) -> tuple[float, float]:
    """Return the power of loads, drivers and active laws, and the dissipated power [W], for multipliers `lam` (m,)."""
    eq = load_equations(address)
    _put(eq.q, q)
    _put(eq.v, v)
    _put_rows(eq, eq.lam, lam)
    prepare(eq.top, eq.w, t, eq.q)
    unfold_multipliers(eq.top, eq.w.cs, eq.lam)
    take_multipliers(eq.top, eq.w, eq.lam)
    applied_forces(eq.top, eq.w, eq.q, eq.v)
    return evaluate_powers(eq.top, eq.w, eq.q, eq.v, eq.lam)


@kernel
def pair_multipliers_of(address: int, t: float, q: RealVector, lam: RealVector, out: RealMatrix) -> None:
    """Convert the multipliers `lam` (m,) of the independent rows to those of all rows, `out` (P, 2).

    The multipliers of redundant directions are zero.
    """
    eq = load_equations(address)
    _put(eq.q, q)
    _put_rows(eq, out, lam)
    prepare(eq.top, eq.w, t, eq.q)
    unfold_multipliers(eq.top, eq.w.cs, out)


@kernel
def arrive_at(address: int, t: float, q: RealVector, v: RealVector, worst: RealVector) -> bool:
    """Update the largest squared misalignments `worst` (P,) with those of a state; return whether it is finite.

    A coordinate or rate of `BEYOND` or more counts as not finite.
    """
    eq = load_equations(address)
    finite = True
    for d in range(len(q)):
        finite = finite and abs(q[d]) < BEYOND and abs(v[d]) < BEYOND
    _put(eq.q, q)
    raise_misalignments(eq.top, eq.w, t, eq.q, worst)
    return finite


@inlined
def _factorize(source, m, coefficients):
    # Several terms contribute to the same entry, so the values are summed before the scaling that equilibrates them.
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
    worst = solve_refined(m.pattern, m.factors, m.right, m.solution, m.correction)
    for i in range(n):
        x[i] = m.solution[i]
    for i in range(len(rows)):
        mu[i] = m.solution[n + i]
    return worst


@kernel
def factorize_real(source: RealVector, matrix: int, coefficients: RealVector) -> int:
    """Factorize the sum of the terms in `source` with `coefficients` (6,), one per class.

    Returns the position of the pivot that became too small, or -1; see `mbdkit.engine.kernels.lu.factorize`.
    """
    return _factorize(source, load_real(matrix), coefficients)


@kernel
def factorize_complex(source: RealVector, matrix: int, coefficients: ComplexVector) -> int:
    """Factorize a matrix with complex coefficients; see `factorize_real`."""
    return _factorize(source, load_complex(matrix), coefficients)


@kernel
def solve_real(
    matrix: int, force: RealVector, rows: RealVector, x: RealVector, mu: RealVector
) -> float:  # fmt: skip
    """Solve a factorized system with one step of refinement; return the largest relative residual."""
    return _solve(load_real(matrix), force, rows, x, mu)


@kernel
def solve_complex(
    matrix: int, force: ComplexVector, rows: ComplexVector, x: ComplexVector, mu: ComplexVector
) -> float:  # fmt: skip
    """Solve a factorized complex system; see `solve_real`."""
    return _solve(load_complex(matrix), force, rows, x, mu)
