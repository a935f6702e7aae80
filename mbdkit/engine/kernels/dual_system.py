"""The index-1 system of dual numbers: one system for the values, and one with the same factors for each derivative.

With the solution a, lambda of the values, differentiation of ``M a + Phi_q^T lambda = Q``, ``Phi_q a = gamma`` gives

    M a_p + Phi_q^T lambda_p = (Q - M a - Phi_q^T lambda)_p,    Phi_q a_p = (gamma - Phi_q a)_p

where the derivatives on the right are those of M, Phi_q, Q and gamma at constant a and lambda. The values are computed
as in a run, with the same working arrays and pivots, and are bitwise identical.

Friction in joints T satisfies ``T = F(lambda(T))``. Its values are those of a run, too. Its derivatives follow from
Newton's method of dual numbers, which begins with these values and therefore changes derivatives only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import by_pivots_or_schur, settle_by_newton, settle_friction, solve_system
from mbdkit.engine.kernels.bundle_types import IntMatrix
from mbdkit.engine.kernels.engine_bundles import Engine
from mbdkit.engine.kernels.friction_kernels import add_friction, change_frictions, newton_step, take_reactions
from mbdkit.engine.kernels.lu import Factors, substitute
from mbdkit.engine.kernels.schur import solve as schur_solve
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.native.arithmetic import value_of, with_value
from mbdkit.engine.native.functions import inlined, overload, subkernel
from mbdkit.engine.native.number_arrays import new_duals

#: Steps of Newton's method for the derivatives of the friction in joints.
#:
#: The error of its matrix, about 1e-6 due to differences, is the factor by which each step reduces their error.
PASSES = 3


class DualSolver(NamedTuple):
    """Solver of the index-1 system of dual numbers. Arrays are dual unless stated otherwise."""

    numbers: Engine  #: Mechanism, working arrays and solver of the values.
    factors: Factors  #: Factors of the pivoted system of the values, with a dual work array.
    row_index: IntMatrix  #: Numbers: as in `mbdkit.engine.kernels.engine_bundles.Solver`.
    v: np.ndarray  #: (3 (B + 1),) velocities and accelerations; numbers.
    acc: np.ndarray
    lam: np.ndarray  #: (P, 2) multipliers; numbers.
    lack: np.ndarray  #: (3 (B + 1),) residual of the equations of motion, then change of the accelerations.
    rows: np.ndarray  #: (P, 2) residual of the constraint rows, then change of the multipliers.
    right: np.ndarray  #: (n,) right side of the pivoted system, then its solution.


def new_dual_solver(numbers: Engine, row_index: np.ndarray) -> DualSolver:
    """Return the solver of dual numbers that belongs to the mechanism, working arrays and solver of their values."""
    top, factors = numbers.top, numbers.solver.factors
    size, unknowns = 3 * len(top.mass), len(numbers.w.right)
    return DualSolver(
        numbers=numbers._replace(top=top._replace(gravity=top.gravity.copy())),
        factors=factors._replace(work=new_duals(len(factors.work))),
        row_index=row_index,
        v=np.zeros(size),
        acc=np.zeros(size),
        lam=np.zeros((len(top.pairs), 2)),
        lack=new_duals(size),
        rows=new_duals(len(top.pairs), 2),
        right=new_duals(unknowns),
    )


@subkernel
def _take_values(top, w, n, has_forces):
    """Copy the values of the system into the working arrays of numbers `n`."""
    for i in range(2):
        n.top.gravity[i] = value_of(top.gravity[i])
    for k in range(len(top.pairs)):
        for c in range(12):
            n.w.jac[k, c] = value_of(w.jac[k, c])
        for r in range(2):
            n.w.gamma[k, r] = value_of(w.gamma[k, r])
    if has_forces:
        for d in range(len(n.w.force)):
            n.w.force[d] = value_of(w.force[d])


@subkernel
def _residual(top, w, has_forces, acc, lam, lack, rows):
    """Write ``Q - M a - Phi_q^T lambda`` into `lack` and ``gamma - Phi_q a`` into `rows`."""
    mass, pairs, jac = top.mass, top.pairs, w.jac
    for b in range(len(mass)):
        for i in range(3):
            d = 3 * b + i
            pull = top.gravity[i] - acc[d] if i < 2 else -acc[d]
            lack[d] = mass[b, i] * pull + w.force[d] if has_forces else mass[b, i] * pull
    for k in range(len(pairs)):
        a, b = 3 * pairs[k, PAIR.first], 3 * pairs[k, PAIR.second]
        l0, l1, r0, r1 = lam[k, 0], lam[k, 1], w.gamma[k, 0], w.gamma[k, 1]
        for i in range(3):
            lack[a + i] -= jac[k, i] * l0 + jac[k, 6 + i] * l1
            lack[b + i] -= jac[k, 3 + i] * l0 + jac[k, 9 + i] * l1
            r0 -= jac[k, i] * acc[a + i] + jac[k, 3 + i] * acc[b + i]
            r1 -= jac[k, 6 + i] * acc[a + i] + jac[k, 9 + i] * acc[b + i]
        rows[k, 0] = r0 if top.rows[k] > 0 else r0 * 0.0
        rows[k, 1] = r1 if top.rows[k] > 1 else r1 * 0.0


@subkernel
def _by_schur(n, lack, rows):
    """Replace the residuals by the changes of accelerations and multipliers that remove them."""
    pairs, jac, weight = n.top.pairs, n.w.jac, n.top.weight
    for b in range(len(weight)):
        for i in range(3):
            lack[3 * b + i] = weight[b, i] * lack[3 * b + i]
    for k in range(len(pairs)):
        a, b = 3 * pairs[k, PAIR.first], 3 * pairs[k, PAIR.second]
        r0, r1 = rows[k, 0] * -1.0, rows[k, 1] * -1.0
        for i in range(3):
            r0 += jac[k, i] * lack[a + i] + jac[k, 3 + i] * lack[b + i]
            r1 += jac[k, 6 + i] * lack[a + i] + jac[k, 9 + i] * lack[b + i]
        rows[k, 0] = r0
        rows[k, 1] = r1 if n.top.rows[k] == 2 else r1 * 0.0
    schur_solve(n.solver.schur, rows)
    for k in range(len(pairs)):
        a, b = pairs[k, PAIR.first], pairs[k, PAIR.second]
        l0, l1 = rows[k, 0], rows[k, 1]
        for i in range(3):
            lack[3 * a + i] -= weight[a, i] * (jac[k, i] * l0 + jac[k, 6 + i] * l1)
            lack[3 * b + i] -= weight[b, i] * (jac[k, 3 + i] * l0 + jac[k, 9 + i] * l1)


@subkernel
def _by_pivots(n, factors, row_index, right, lack, rows):
    """Replace the residuals by the changes that remove them, with the factors of the pivoted system."""
    n3 = len(lack) - 3
    for d in range(n3):
        right[d] = lack[d]
    for k in range(len(rows)):
        for r in range(n.top.rows[k]):
            right[row_index[k, r]] = rows[k, r]
    substitute(n.solver.pattern, factors, right, right)
    for d in range(n3):
        lack[d] = right[d]
    for k in range(len(rows)):
        for r in range(n.top.rows[k]):
            rows[k, r] = right[row_index[k, r]]


@inlined
def _with_derivatives(top, w, solver, has_forces, acc, lam, refine):
    """Solve for accelerations and multipliers with their derivatives; return a status.

    The derivatives are refined once if the values are refined: always by the pivoted solver, otherwise with `refine`.
    """
    n = solver.numbers
    _take_values(top, w, n, has_forces)
    status = by_pivots_or_schur(n.top, n.w, n.solver, has_forces, solver.acc, solver.lam, refine)
    if status != OK:
        return status
    for d in range(len(acc)):
        acc[d] = solver.acc[d]
    for k in range(len(lam)):
        for r in range(2):
            lam[k, r] = solver.lam[k, r] if r < top.rows[k] else 0.0
    _change_derivatives(top, w, solver, has_forces, acc, lam, refine)
    return OK


@subkernel
def _change_derivatives(top, w, solver, has_forces, acc, lam, refine):
    """Change the derivatives of accelerations and multipliers so that they satisfy the system, whose values do."""
    n = solver.numbers
    pivoted = n.solver.pivoted[0] != 0
    # with the values as accelerations, the residual has no value but all derivatives; the second pass refines them
    for _ in range(2 if refine or pivoted else 1):
        _residual(top, w, has_forces, acc, lam, solver.lack, solver.rows)
        if pivoted:
            _by_pivots(n, solver.factors, solver.row_index, solver.right, solver.lack, solver.rows)
        else:
            _by_schur(n, solver.lack, solver.rows)
        for d in range(len(acc) - 3):
            # the value stays the one of a run without derivatives, to the bit
            acc[d] = with_value(acc[d] + solver.lack[d], solver.acc[d])
        for k in range(len(lam)):
            for r in range(top.rows[k]):
                lam[k, r] = with_value(lam[k, r] + solver.rows[k, r], solver.lam[k, r])


@subkernel
def _begin_frictions(top, w, n, acc, lam, solver):
    """Begin with the values of accelerations, multipliers and friction that `settle_by_newton` has found."""
    count = len(top.frictions)
    for d in range(len(acc)):
        acc[d] = with_value(acc[d], solver.acc[d])
    for k in range(len(lam)):
        for r in range(top.rows[k]):
            lam[k, r] = with_value(lam[k, r], solver.lam[k, r])
    for f in range(count):
        scale = n.w.friction[f, count + 2]
        w.friction[f, count + 1] = n.w.friction[f, count + 1]
        w.friction[f, count + 2] = scale if scale > 0.0 else 1.0  # at rest, only derivatives differ from 0
        add_friction(top, w, f, w.friction[f, count + 1])
    for i in range(len(top.reactions)):
        for j in range(count):
            w.response[i, j] = n.w.response[i, j]


@inlined
def _settle(top, w, solver, v, acc, lam, refine):
    """Change accelerations and multipliers until they agree with the friction in joints; return a status."""
    n = solver.numbers
    for d in range(len(v)):
        solver.v[d] = value_of(v[d])
    for f in range(len(top.frictions)):
        k = top.frictions[f]
        n.w.s[k, 0] = value_of(w.s[k, 0])
        for i in range(6):
            n.w.grad[k, i] = value_of(w.grad[k, i])
    status = settle_by_newton(n.top, n.w, n.solver, solver.v, solver.acc, solver.lam, refine)
    if status != OK:
        return status
    _begin_frictions(top, w, n, acc, lam, solver)
    for left in range(PASSES, -1, -1):
        _change_derivatives(top, w, solver, True, acc, lam, refine)
        take_reactions(top, w, lam)
        newton_step(top, w, v)  # which leaves the friction in ``w.tension``
        if left > 0:
            change_frictions(top, w)
    return OK


@overload(solve_system)
def _solve_system(top, w, solver, has_forces, acc, lam, refine):
    if "numbers" not in solver.bundle.fields:
        return None
    return lambda top, w, solver, has_forces, acc, lam, refine: _with_derivatives(
        top, w, solver, has_forces, acc, lam, refine
    )


@overload(settle_friction)
def _settle_friction(top, w, solver, v, acc, lam, refine):
    if "numbers" not in solver.bundle.fields:
        return None
    return lambda top, w, solver, v, acc, lam, refine: _settle(top, w, solver, v, acc, lam, refine)
