"""Solution of the index-1 system of a whole mechanism: accelerations and multipliers.

    [ M      Phi_q^T ] [ a      ]   [ Q     ]
    [ Phi_q  0       ] [ lambda ] = [ gamma ]

Two solvers exist. The Schur complement (`mbdkit.engine.kernels.schur`) eliminates the accelerations and is used by
default. Sparse LU with numerical pivoting (`mbdkit.engine.kernels.lu`) solves the whole system if the Schur complement
is too dense, badly scaled or has lost accuracy.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.applied_forces import any_forces, applied_forces, take_multipliers
from mbdkit.engine.kernels.friction_kernels import (
    add_unit,
    begin_frictions,
    change_frictions,
    newton_step,
    note_response,
    take_reactions,
)
from mbdkit.engine.kernels.lu import factorize, solve_refined
from mbdkit.engine.kernels.schur import factor as schur_factor
from mbdkit.engine.kernels.schur import solve as schur_solve
from mbdkit.engine.kernels.system import NOT_FINITE, OK, REPIVOT, gather_values, solved_rows, unfold_multipliers
from mbdkit.engine.kernels.table_rows import PAIR, SPARE, SPRING
from mbdkit.engine.kernels.vectors import copy, fill_rows
from mbdkit.engine.native.arithmetic import any_of, renewed
from mbdkit.engine.native.calls import call_entry
from mbdkit.engine.native.functions import inlined, overload, subkernel

#: Differences between the friction in a joint and the value of its law, relative to the friction, up to this size count
#: as zero.
SETTLED = 4.0 * np.finfo(float).eps
NEARLY_SETTLED = 1e-11  #: Relative differences up to this size count as round-off if they no longer decrease.
MOST_PASSES = 30  #: Largest number of Newton steps for the friction in joints; three are usual.
#: Largest accepted residual of the pivoted system, relative to the largest row sum; above it, new pivots are chosen.
KKT_TOLERANCE = 1e-9


@subkernel
def free_accelerations(top, has_forces, force, acc):
    """Write the accelerations ``M^-1 Q`` of the unconstrained bodies, gravity included, into `acc` (3 (B + 1),)."""
    gravity, weight = top.gravity, top.weight
    for b in range(len(top.mass) - 1):
        acc[3 * b] = gravity[0]
        acc[3 * b + 1] = gravity[1]
        acc[3 * b + 2] = 0.0
        if has_forces:
            for i in range(3):
                acc[3 * b + i] += weight[b, i] * force[3 * b + i]


@subkernel
def joint_right_side(top, w, acc, lam):
    """Write ``Phi_q a - gamma``, the right-hand side of the Schur complement, into `lam` (P, 2)."""
    pairs, rows, jac, gamma = top.pairs, top.rows, w.jac, w.gamma
    for k in range(len(pairs)):
        a, b = 3 * pairs[k, PAIR.first], 3 * pairs[k, PAIR.second]
        r0, r1 = -gamma[k, 0], -gamma[k, 1]
        for i in range(3):
            r0 += jac[k, i] * acc[a + i] + jac[k, 3 + i] * acc[b + i]
            r1 += jac[k, 6 + i] * acc[a + i] + jac[k, 9 + i] * acc[b + i]
        lam[k, 0] = r0
        lam[k, 1] = r1 if rows[k] == 2 else 0.0


@subkernel
def apply_multipliers(top, w, lam, acc, wanted):
    """Subtract ``M^-1 Phi_q^T lambda`` from the accelerations `acc` (3 (B + 1),); in lanes, only where `wanted`."""
    pairs, jac, weight = top.pairs, w.jac, top.weight
    for k in range(len(pairs)):
        a, b = pairs[k, PAIR.first], pairs[k, PAIR.second]
        l0, l1 = lam[k, 0], lam[k, 1]
        for i in range(3):
            x, y = acc[3 * a + i], weight[a, i] * (jac[k, i] * l0 + jac[k, 6 + i] * l1)
            acc[3 * a + i] = renewed(x - y, x, wanted)
            x, y = acc[3 * b + i], weight[b, i] * (jac[k, 3 + i] * l0 + jac[k, 9 + i] * l1)
            acc[3 * b + i] = renewed(x - y, x, wanted)


@inlined
def refine_multipliers(top, w, schur, acc, lam, wanted):
    """Do one step of iterative refinement of ``Phi_q a = gamma`` with the factors of the Schur complement.

    The residual ``Phi_q a - gamma`` is the right-hand side of a correction of the multipliers; `acc` and `lam` are
    corrected in place, in lanes only where `wanted`.
    """
    joint_right_side(top, w, acc, w.refinement)
    schur_solve(schur, w.refinement)
    apply_multipliers(top, w, w.refinement, acc, wanted)
    for k in range(len(lam)):
        for r in range(2):
            lam[k, r] = renewed(lam[k, r] + w.refinement[k, r], lam[k, r], wanted)


@subkernel
def pivoted_accelerations(top, w, solver, has_forces, acc, lam):
    """Solve the whole index-1 system by pivoted sparse LU with one step of refinement; return a status.

    Returns REPIVOT if no pivots have been chosen yet, a pivot has become too small, or the residual is above
    `KKT_TOLERANCE`; `acc` and `lam` are then unchanged.
    """
    pattern, factors = solver.pattern, solver.factors
    if len(pattern.row_of) != len(w.right):  # the pattern is still empty: no pivots have been chosen yet
        return REPIVOT
    # with rate 0 the terms are those of the index-1 matrix
    gather_values(w.source, solver.scatter, 0.0, 0.0, pattern.weight, factors.a)
    solver.failed[0] = factorize(pattern, factors)
    if solver.failed[0] >= 0:
        return REPIVOT
    return substitute_by_pivots(top, w, solver, has_forces, acc, lam)


@subkernel
def substitute_by_pivots(top, w, solver, has_forces, acc, lam):
    """Solve the index-1 system with the existing pivoted factors; return a status as `pivoted_accelerations` does."""
    n3 = 3 * (len(top.mass) - 1)
    row_index, right, solution = solver.row_index, w.right, w.solution
    for b in range(len(top.mass) - 1):
        right[3 * b] = top.mass[b, 0] * top.gravity[0]
        right[3 * b + 1] = top.mass[b, 1] * top.gravity[1]
        right[3 * b + 2] = 0.0
    if has_forces:
        for i in range(n3):
            right[i] += w.force[i]
    for k in range(len(top.pairs)):
        for r in range(top.rows[k]):
            right[row_index[k, r]] = w.gamma[k, r]
    if not solve_refined(solver.pattern, solver.factors, right, solution, w.correction) < KKT_TOLERANCE:
        return REPIVOT
    for i in range(n3):
        acc[i] = solution[i]
    for k in range(len(top.pairs)):
        for r in range(top.rows[k]):
            lam[k, r] = solution[row_index[k, r]]
    return OK


@inlined
def solve_accelerations(top, w, solver, q, v, acc, lam, refine):
    """Solve for accelerations and multipliers at a position for which `prepare` was called; return a status.

    With `refine`, one step of iterative refinement reduces the residual of ``Phi_q a = gamma`` to rounding errors; in
    lanes, `refine` may be a mask.
    """
    solved_rows(top, w, q, v)
    status = solve_loaded(top, w, solver, q, v, acc, lam, refine)
    unfold_multipliers(top, w.cs, lam)
    return status


@inlined
def solve_loaded(top, w, solver, q, v, acc, lam, refine):
    """Solve the index-1 system with the applied forces, for ``w.jac`` and ``w.gamma`` of the independent rows.

    The multipliers `lam` are those of the rows that are solved for; they are not unfolded. Returns a status.
    """
    if len(top.frictions) > 0:  # the first pass is without friction, so that the result depends on the state only
        fill_rows(lam, 0.0)
        take_multipliers(top, w, lam)
    has_forces = any_forces(top)
    if has_forces:
        applied_forces(top, w, q, v)
    status = solve_system(top, w, solver, has_forces, acc, lam, refine)
    if len(top.frictions) > 0 and status == OK:
        status = settle_friction(top, w, solver, v, acc, lam, refine)
    if status == OK:
        status = add_reactions(w, solver, q, v, acc, lam)
    return status


@inlined
def _add_by_address(w, solver, q, v, acc, lam):
    """Add the accelerations and multipliers due to reactions of elements, by their own function; return its status."""
    exchanged = w.reacting
    if exchanged.acts[0] == 0:
        return OK
    # the function has only an engine and its own bundle; state and solution are passed in arrays of the engine
    copy(q, exchanged.q)
    copy(v, exchanged.v)
    copy(acc, exchanged.acc)
    for k in range(len(lam)):
        copy(lam[k], exchanged.lam[k])
    status = call_entry(exchanged.add_forces[0], exchanged.engine[0], exchanged.elements[0], w.time[0], 0.0, 0.0)
    copy(exchanged.acc, acc)
    for k in range(len(lam)):
        copy(exchanged.lam[k], lam[k])
    return status


@inlined
def _no_reactions(w, solver, q, v, acc, lam):
    """Return OK: runs with reactions of elements are neither vectorized nor differentiated by parameters."""
    return OK


def add_reactions(w, solver, q, v, acc, lam):
    """Add what reactions of elements cause to a solution of the index-1 system; return a status."""
    return _add_by_address(w, solver, q, v, acc, lam)


@overload(add_reactions)
def _add_reactions(w, solver, q, v, acc, lam):
    add = _add_by_address if "pivoted" in solver.bundle.fields else _no_reactions
    return lambda w, solver, q, v, acc, lam: add(w, solver, q, v, acc, lam)


@inlined
def _substitute(top, w, solver, acc, lam, refine):
    """Solve the index-1 system for the present forces with the factors of the last solution; return a status."""
    if solver.pivoted[0] != 0:
        return substitute_by_pivots(top, w, solver, True, acc, lam)
    substitute_by_schur(top, w, solver.schur, True, acc, lam, refine)
    return OK


@inlined
def settle_by_newton(top, w, solver, v, acc, lam, refine):
    """Change accelerations and multipliers until they agree with the friction in joints that they cause.

    With frictions T in the joints, the multipliers are an affine function of T, and the law of each joint requires
    ``T = F(lam(T))``. Newton's method begins without friction and uses the same factors in all solutions. If there is
    no solution that continues the one without friction, the law is stored in ``w.faulty``, and NOT_FINITE is returned:
    the joint locks itself.
    """
    count = len(top.frictions)
    if not begin_frictions(top, w, v, lam):
        return OK
    # multipliers are affine in the frictions: one solution with the same factors gives a column of their matrix
    for f in range(count):
        scale = add_unit(top, w, f, 1.0)
        status = _substitute(top, w, solver, acc, lam, refine)
        if status != OK:
            return status
        note_response(top, w, f, lam, scale)
        add_unit(top, w, f, -1.0)
    before, worst = np.inf, 0
    # the laws are piecewise smooth in the reactions, so that Newton's method ends in two or three steps
    for _ in range(MOST_PASSES):
        rest, worst = newton_step(top, w, v)
        if rest <= SETTLED or (rest >= before and rest <= NEARLY_SETTLED):
            return OK
        if not rest < np.inf:
            break
        before = rest
        change_frictions(top, w)
        status = _substitute(top, w, solver, acc, lam, refine)
        if status != OK:
            return status
        take_reactions(top, w, lam)
    w.faulty[0] = top.springs[top.frictions[worst], SPRING.law]
    return NOT_FINITE


@inlined
def _not_settled(top, w, solver, v, acc, lam, refine):
    """Return OK: runs with friction in joints are not vectorized."""
    return OK


def settle_friction(top, w, solver, v, acc, lam, refine):
    """Solve for accelerations and multipliers together with the friction in joints; see `settle_by_newton`."""
    return settle_by_newton(top, w, solver, v, acc, lam, refine)


@overload(settle_friction)
def _settle_friction(top, w, solver, v, acc, lam, refine):
    if "numbers" in solver.bundle.fields:  # a solver of dual numbers; see `mbdkit.engine.kernels.dual_system`
        return None
    settle = settle_by_newton if "pivoted" in solver.bundle.fields else _not_settled
    return lambda top, w, solver, v, acc, lam, refine: settle(top, w, solver, v, acc, lam, refine)


@inlined
def schur_accelerations(top, w, schur, has_forces, acc, lam, refine):
    """Solve the index-1 system by the Schur complement; return the result of `mbdkit.engine.kernels.schur.factor`.

    ``a = a_free - M^-1 Phi_q^T lambda``, and so ``S lambda = Phi_q a_free - gamma``.
    """
    failed = schur_factor(top, w.jac, schur)
    if failed < 0:
        substitute_by_schur(top, w, schur, has_forces, acc, lam, refine)
    return failed


@inlined
def substitute_by_schur(top, w, schur, has_forces, acc, lam, refine):
    """Solve the index-1 system with the factors of the Schur complement."""
    free_accelerations(top, has_forces, w.force, acc)
    joint_right_side(top, w, acc, lam)
    schur_solve(schur, lam)
    apply_multipliers(top, w, lam, acc, True)
    if any_of(refine):
        refine_multipliers(top, w, schur, acc, lam, refine)


@inlined
def by_pivots_or_schur(top, w, solver, has_forces, acc, lam, refine):
    """Solve the index-1 system with ``w.force``, ``w.jac`` and ``w.gamma`` of the independent rows; return a status.

    The pivoted solver refines in any case; `refine` applies to the Schur complement only.
    """
    for i in range(3):  # ground stays at rest, even if an earlier solution was not finite
        acc[len(acc) - 3 + i] = 0.0
    if solver.pivoted[0] != 0:
        status = pivoted_accelerations(top, w, solver, has_forces, acc, lam)
    else:
        solver.failed[0] = schur_accelerations(top, w, solver.schur, has_forces, acc, lam, refine)
        status = OK if solver.failed[0] < 0 else REPIVOT
    return status


@inlined
def _by_schur(top, w, solver, has_forces, acc, lam, refine):
    """Solve the index-1 system by the Schur complement, and return OK; lanes in which it loses accuracy become NaN."""
    for i in range(3):
        acc[len(acc) - 3 + i] = 0.0
    schur_accelerations(top, w, solver.schur, has_forces, acc, lam, refine)
    return OK


def solve_system(top, w, solver, has_forces, acc, lam, refine):
    """Solve the index-1 system with ``w.force``, ``w.jac`` and ``w.gamma`` of the independent rows; return a status.

    The pivoted solver refines in any case; `refine` applies to the Schur complement only. In lanes, there is no pivoted
    solver: accelerations become NaN in a lane that would need it.
    """
    return by_pivots_or_schur(top, w, solver, has_forces, acc, lam, refine)


@overload(solve_system)
def _solve_system(top, w, solver, has_forces, acc, lam, refine):
    if "numbers" in solver.bundle.fields:  # a solver of dual numbers; see `mbdkit.engine.kernels.dual_system`
        return None
    solve = by_pivots_or_schur if "pivoted" in solver.bundle.fields else _by_schur
    return lambda top, w, solver, has_forces, acc, lam, refine: solve(top, w, solver, has_forces, acc, lam, refine)


@inlined
def transferred(top, w, solver, i, lam):
    """Write the multipliers that cause the same accelerations as a unit multiplier of redundant direction `i`.

    Must be called right after `solve_accelerations`, whose factors and ``w.loose`` it uses. `lam` (P, 2) receives the
    multipliers. Overwrites ``w.gamma`` or the vectors of the pivoted system.
    """
    n3 = 3 * (len(top.mass) - 1)
    a, b = top.pairs[top.spare[i, SPARE.pair], PAIR.first], top.pairs[top.spare[i, SPARE.pair], PAIR.second]
    lam[:, :] = 0.0
    if solver.pivoted[0] != 0:
        right, solution, correction = w.right, w.solution, w.correction
        right[:] = 0.0
        for d in range(3):
            if 3 * a < n3:  # ground has no rows in the pivoted system
                right[3 * a + d] = w.loose[i, d]
            if 3 * b < n3:
                right[3 * b + d] = w.loose[i, 3 + d]
        solve_refined(solver.pattern, solver.factors, right, solution, correction)
        for k in range(len(top.pairs)):
            for r in range(top.rows[k]):
                lam[k, r] = solution[solver.row_index[k, r]]
    else:
        w.push[:] = 0.0
        w.gamma[:, :] = 0.0
        for d in range(3):
            w.push[3 * a + d] = top.weight[a, d] * w.loose[i, d]
            w.push[3 * b + d] = top.weight[b, d] * w.loose[i, 3 + d]
        for _ in range(2):  # the second pass removes the rounding errors of the first
            refine_multipliers(top, w, solver.schur, w.push, lam, True)
    unfold_multipliers(top, w.cs, lam)
