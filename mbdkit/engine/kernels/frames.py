"""Kernels that evaluate the equations of a mechanism at many given states, for inverse dynamics.

The conventions are those of `mbdkit.engine.kernels.equations`: vectors of the caller have no entries for ground, and
only the independent rows of the constraints are returned.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.applied_forces import any_forces, applied_forces
from mbdkit.engine.kernels.bundle_types import RealCube, RealMatrix, RealVector
from mbdkit.engine.kernels.equations import load_equations
from mbdkit.engine.kernels.observe import reactions_of
from mbdkit.engine.kernels.system import (
    constraint_rate,
    constraint_rows,
    evaluate_positions,
    evaluate_powers,
    fold_values,
    prepare,
    solved_rows,
    unfold_multipliers,
)
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.native.functions import kernel


class Frames(NamedTuple):
    """Terms of the equations of motion at T states; n = 3 B coordinates, m independent rows of the constraints."""

    phi: RealMatrix  #: (T, m) constraint residuals Phi.
    rate: RealMatrix  #: (T, m) time derivatives of the residuals, Phi_q v + Phi_t.
    gamma: RealMatrix  #: (T, m) right-hand side of ``Phi_q a = gamma``.
    jacobian: RealCube  #: (T, m, n) Jacobian Phi_q.
    force: RealMatrix  #: (T, n) generalized applied forces Q, gravity included.

    @staticmethod
    def zeros(states: int, n: int, m: int) -> Frames:
        """Return arrays for T = `states`, filled with zeros."""
        rows = states, m
        return Frames(np.zeros(rows), np.zeros(rows), np.zeros(rows), np.zeros((*rows, n)), np.zeros((states, n)))


class Reactions(NamedTuple):
    """Constraint forces at T states; P is the number of pairs of constraint rows."""

    lam: RealCube  #: (T, P, 2) multipliers of all rows; redundant directions carry no force.
    #: (T, P, 3) force (x, y) and torque of each pair on its second body, at its joint point [N, N m].
    reactions: RealCube
    residual: RealCube  #: (T, P, 2) constraint residuals Phi of all rows.
    powers: RealMatrix  #: (T, 2) power of loads, drivers and active laws of the model, and the dissipated power [W].

    @staticmethod
    def zeros(states: int, pairs: int) -> Reactions:
        """Return arrays for T = `states`, filled with zeros."""
        two = (states, pairs, 2)
        return Reactions(np.zeros(two), np.zeros((states, pairs, 3)), np.zeros(two), np.zeros((states, 2)))


@kernel
def evaluate_frames(
    address: int, times: RealVector, q: RealMatrix, v: RealMatrix, with_forces: bool, out: Frames
) -> None:  # fmt: skip
    """Evaluate the states `q`, `v` (T, n) at `times` (T,), and write the results to `out`.

    The Jacobian in `out` must be zero on entry. The applied forces are written only if `with_forces` is true.
    """
    eq = load_equations(address)
    top, w = eq.top, eq.w
    n, ground = len(eq.q) - 3, len(top.mass) - 1
    for f in range(len(times)):
        for d in range(n):
            eq.q[d] = q[f, d]
            eq.v[d] = v[f, d]
        prepare(top, w, times[f], eq.q)
        solved_rows(top, w, eq.q, eq.v)
        evaluate_positions(top, w, eq.q)
        # only independent rows are returned, and the Jacobian has been folded by `solved_rows`
        fold_values(top, w.cs, w.phi)
        fold_values(top, w.cs, w.phi_t)
        for k in range(len(top.pairs)):
            for r in range(top.rows[k]):
                row = eq.solver.row_index[k, r] - n
                out.phi[f, row] = w.phi[k, r]
                out.gamma[f, row] = w.gamma[k, r]
                out.rate[f, row] = constraint_rate(top.pairs, w.jac, w.phi_t, eq.v, k, r)
                for side in range(2):
                    body = top.pairs[k, PAIR.first + side]
                    if body != ground:
                        for d in range(3):
                            out.jacobian[f, row, 3 * body + d] += w.jac[k, 6 * r + 3 * side + d]
        if with_forces:
            for d in range(n):
                out.force[f, d] = 0.0
            if any_forces(top):
                applied_forces(top, w, eq.q, eq.v)
                for d in range(n):
                    out.force[f, d] = w.force[d]
            # gravity is an acceleration for the solvers, and not part of the applied forces
            for b in range(ground):
                out.force[f, 3 * b] += top.mass[b, 0] * eq.gravity[0]
                out.force[f, 3 * b + 1] += top.mass[b, 1] * eq.gravity[1]


@kernel
def reactions_in_frames(
    address: int, times: RealVector, q: RealMatrix, v: RealMatrix, lam: RealMatrix, out: Reactions
) -> None:  # fmt: skip
    """Compute the constraint forces of the multipliers `lam` (T, m) of the independent rows, and write them to `out`.

    The other arguments are those of `evaluate_frames`.
    """
    eq = load_equations(address)
    top, w = eq.top, eq.w
    n = len(eq.q) - 3
    for f in range(len(times)):
        for d in range(n):
            eq.q[d] = q[f, d]
            eq.v[d] = v[f, d]
        multipliers = out.lam[f]
        for k in range(len(top.pairs)):
            for r in range(top.rows[k]):
                multipliers[k, r] = lam[f, eq.solver.row_index[k, r] - n]
        prepare(top, w, times[f], eq.q)
        unfold_multipliers(top, w.cs, multipliers)
        # reactions belong to the original rows, which `solved_rows` would combine
        constraint_rows(top, w, eq.q, eq.v)
        reactions_of(top, w, multipliers, out.reactions[f])
        applied_forces(top, w, eq.q, eq.v)
        out.powers[f, 0], out.powers[f, 1] = evaluate_powers(top, w, eq.q, eq.v, multipliers)
        for k in range(len(top.pairs)):
            for r in range(2):
                out.residual[f, k, r] = w.phi[k, r]
