"""Partitioned Lobatto IIIA-IIIB pairs for constrained mechanisms; with two stages this is RATTLE (Jay 1996).

With a the tableau of IIIA, a' that of IIIB, and their common weights b and nodes c,

    V_i = v_0 + h sum_j a'_ij a_j      Q_i = q_0 + h sum_j a_ij V_j      M a_j + Phi_q(Q_j)^T lam_j = F(t_j, Q_j, V_j)

and Phi(t_i, Q_i) = 0 for i = 2..s, which determines the multipliers of the stages before the last. The step ends at
q_1 = Q_s and v_1 = v_0 + h sum_j b_j a_j, and the multiplier of the last stage makes Phi_q(q_1) v_1 + Phi_t = 0.

The last column of a' and the first row of a are zero, so the first s - 1 accelerations are solved for, and the last
one follows. Because Q_(i+1) depends on a_j by h^2 B_ij, B = (a a') without its first row and last column, each
iteration takes

    M a_j + Phi_q(Q_j)^T lam_j = F_j,        Phi_q(Q_j) (a_j - a_j before) = -sum_i (B^-1)_ji Phi(Q_(i+1)) / h^2

an index-1 system for each stage. The contraction is O(h); it diverges if forces are stiff relative to the step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_loaded
from mbdkit.engine.kernels.applied_forces import applied_forces, take_multipliers
from mbdkit.engine.kernels.bundle_types import RECORD, STATE
from mbdkit.engine.kernels.projection import position_rows, rate_rows
from mbdkit.engine.kernels.system import NOT_FINITE, OK, evaluate_powers, prepare, solved_rows, unfold_multipliers
from mbdkit.engine.kernels.vectors import copy, stays_finite
from mbdkit.engine.linear_systems import inverse_of, product
from mbdkit.engine.native.bundle import PinnedBundle, bundle_loader
from mbdkit.engine.native.functions import entry, subkernel
from mbdkit.integrators.run.run_state import FACTORIZATIONS, RHS, load_run_state
from mbdkit.integrators.stages.collocation_stages import StageKernels
from mbdkit.integrators.stages.collocation_step import keep_stages
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.integrators.stages.convergence import (
    NEGLIGIBLE_CHANGE,
    PATIENCE,
    TOLERANCE,
    IterationLimit,
    describe_divergence,
    moves_by_roundings,
    new_limit,
    relative_to_state,
)
from mbdkit.integrators.stages.stage_iteration import iterate
from mbdkit.integrators.stages.stage_polynomials import stage_states
from mbdkit.methods.lobatto_pair import coefficients

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.integrators.run.step_control import Control
    from mbdkit.methods.kinds import LobattoPair

MOST_PAST = 3  #: Number of previous steps from which each stage is extrapolated by a polynomial in time.


class PairCoefficients(NamedTuple):
    """A Lobatto IIIA-IIIB pair of s stages in second-order form."""

    a: np.ndarray  #: (s, s) a', the tableau of IIIB: weights of accelerations in the velocities of the stages.
    a2: np.ndarray  #: (s, s) a a': weights of accelerations in their positions.
    inverse: np.ndarray  #: (s - 1, s - 1) B^-1.
    b: np.ndarray
    c: np.ndarray


class PastSteps(NamedTuple):
    """Accelerations of previous steps, from which those of the next step are extrapolated."""

    acc: np.ndarray  #: (MOST_PAST, s, 3 (B + 1)), newest first.
    begin: np.ndarray  #: (1,) start time of the newest step [s].
    size: np.ndarray  #: (1,) size of the newest step [s].
    known: np.ndarray  #: (1,) number of consecutive steps of that size that are stored.


class PairStages(NamedTuple):
    """A pair of s stages for one mechanism."""

    rk: PairCoefficients
    limit: Annotated[IterationLimit, RECORD]
    tolerance: np.ndarray  #: (1,) predicted change of positions, relative to their size, at which the iteration ends.
    acc: np.ndarray  #: (s, 3 (B + 1)) accelerations of the stages.
    lam: np.ndarray  #: (s, P, 2) multipliers of the independent rows at the stages.
    past: Annotated[PastSteps, STATE]
    q_stage: np.ndarray
    v_stage: np.ndarray
    gap: np.ndarray  #: (s - 1, P, 2) constraint residuals Phi of the stages after the first.
    change: np.ndarray  #: (s - 1, 3 (B + 1)) change of accelerations.
    spread: np.ndarray  #: (s, 3 (B + 1)) scratch.
    pairs: np.ndarray  #: (P, 2) scratch.
    power: np.ndarray  #: (s, 2) powers of the stages.


def _example() -> PairStages:
    from mbdkit.engine.workspace import example_workspace
    from mbdkit.methods.kinds import LobattoPair

    return new_pair(LobattoPair(2), example_workspace())


load_pair = bundle_loader(_example)


@subkernel
def _predict(m, t, h):
    """Extrapolate the accelerations of previous steps for each stage separately; without previous steps, use zero.

    Only the newest step is used if the step size has changed, or if the same step is tried again.
    """
    past = m.past
    known = past.known[0]
    if t == past.begin[0] or past.size[0] != h:
        known = min(known, 1)
    elif not abs(past.begin[0] + h - t) <= 1e-6 * abs(h):  # the newest step does not end at t
        known = 0
    x0, x1, x2 = past.acc[0], past.acc[1], past.acc[2]
    for i in range(len(m.rk.c)):
        for d in range(m.acc.shape[1]):
            if known >= 3:
                m.acc[i, d] = 3.0 * (x0[i, d] - x1[i, d]) + x2[i, d]
            elif known == 2:
                m.acc[i, d] = 2.0 * x0[i, d] - x1[i, d]
            elif known == 1:
                m.acc[i, d] = x0[i, d]
            else:
                m.acc[i, d] = 0.0
    m.acc[len(m.rk.c) - 1, :] = 0.0  # the last stage is computed when the others are known


@subkernel
def _keep(m, t, h):
    """Store the accelerations of a step for the next ones; a repeated attempt replaces the previous one."""
    past = m.past
    if past.known[0] > 0 and t == past.begin[0]:
        past.known[0] = max(past.known[0] - 1, 0) if past.size[0] == h else 0
    else:
        for k in range(MOST_PAST - 1, 0, -1):
            for i in range(len(m.rk.c)):
                copy(past.acc[k - 1, i], past.acc[k, i])
        if past.size[0] != h:
            past.known[0] = 0
    for i in range(len(m.rk.c)):
        copy(m.acc[i], past.acc[0, i])
    past.begin[0], past.size[0] = t, h
    past.known[0] = min(past.known[0] + 1, MOST_PAST)


@subkernel
def _no_tangents(c, m, t, h, at_start, wanted):
    return OK


@subkernel
def _changes(c, m, t, h, before):
    """Write the change of the accelerations of the stages before the last by one iteration; return a status."""
    top, w = c.top, c.w
    s = len(m.rk.c)
    for i in range(1, s):
        position_rows(top, w, t + m.rk.c[i] * h, m.q_stage[i])
        for k in range(len(top.pairs)):
            m.gap[i - 1, k, 0], m.gap[i - 1, k, 1] = w.phi[k, 0], w.phi[k, 1]
    for j in range(s - 1):
        prepare(top, w, t + m.rk.c[j] * h, m.q_stage[j])
        solved_rows(top, w, m.q_stage[j], m.v_stage[j])
        w.gamma[:, :] = 0.0
        rate_rows(top, w.jac, w.gamma, m.acc[j], m.pairs)
        for k in range(len(top.pairs)):
            for r in range(top.rows[k]):
                total = m.pairs[k, r]
                for i in range(s - 1):
                    total -= m.rk.inverse[j, i] / (h * h) * m.gap[i, k, r]
                w.gamma[k, r] = total
        is_refined = before < np.inf
        q, v = m.q_stage[j], m.v_stage[j]
        status = solve_loaded(top, w, c.solver, q, v, m.change[j], m.lam[j], is_refined)
        if status != OK:
            return status
        for d in range(len(c.q) - 3):
            m.change[j, d] -= m.acc[j, d]
    c.counts[RHS] += s - 1
    c.counts[FACTORIZATIONS] += s - 1
    return OK


@subkernel
def _move(c, m, h, active):
    for j in range(len(m.rk.c) - 1):
        for d in range(len(c.q) - 3):
            m.acc[j, d] += m.change[j, d]
    stage_states(c, m, h)


@subkernel
def _sizes(c, m, h):
    """Return the relative change of the positions, which has to converge."""
    s = len(m.rk.c)
    for i in range(s):
        for d in range(len(c.q) - 3):
            total = 0.0
            for j in range(s - 1):
                total += h * h * m.rk.a2[i, j] * m.change[j, d]
            m.spread[i, d] = total
    now = relative_to_state(m.spread, c.from_q, len(c.top.mass) - 1)
    return now, now


@subkernel
def _is_small(now):
    """Return whether a stalled change is small enough to count as idle.

    Larger changes do not count, because a contraction of O(h) can be slow without being stalled.
    """
    return now <= NEGLIGIBLE_CHANGE


@subkernel
def _round_off(c, m, h, now, moved, idle):
    """Return whether a change that no longer shrinks is round-off."""
    return moves_by_roundings(now) or (now <= NEGLIGIBLE_CHANGE and idle >= PATIENCE)


_KERNELS = StageKernels(_no_tangents, _changes, _move, _sizes, _is_small, _round_off)


@subkernel
def _finish(c, m, t, h):
    """Solve for the last stage, whose multiplier makes the velocities satisfy their constraints; return a status."""
    top, w = c.top, c.w
    s = len(m.rk.c)
    end, known = m.q_stage[s - 1], m.spread[0]
    copy(c.from_v, known)
    for j in range(s - 1):
        for d in range(len(c.q) - 3):
            known[d] += h * m.rk.b[j] * m.acc[j, d]
    position_rows(top, w, t + h, end)
    solved_rows(top, w, end, m.v_stage[s - 1])
    rate_rows(top, w.jac, w.phi_t, known, w.gamma)
    for k in range(len(top.pairs)):
        for r in range(2):
            w.gamma[k, r] = -w.gamma[k, r] / (h * m.rk.b[s - 1])
    c.counts[RHS] += 1
    c.counts[FACTORIZATIONS] += 1
    return solve_loaded(top, w, c.solver, end, m.v_stage[s - 1], m.acc[s - 1], m.lam[s - 1], True)


@entry
def attempt(run, method, t, h, want_error):
    """Try a step from the base state; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_pair(method)
    top, w = c.top, c.w
    s = len(m.rk.c)
    n3 = len(c.q) - 3
    _predict(m, t, h)
    stage_states(c, m, h)
    status = iterate(c, m, t, h, (m.limit, m.tolerance[0]), (False, False, False, True), _KERNELS)
    if status == OK:
        status = _finish(c, m, t, h)
    if status != OK:
        m.past.known[0] = 0
        return status
    _keep(m, t, h)
    c.gain[0] = c.gain[1] = 0.0
    c.dq[:] = 0.0
    c.dv[:] = 0.0
    for j in range(s):
        w1, w2 = h * m.rk.b[j], h * h * m.rk.a2[s - 1, j]
        for d in range(n3):
            c.dv[d] += w1 * m.acc[j, d]
            c.dq[d] += w2 * m.acc[j, d]
        if c.has_power[0] != 0 or j == s - 1:
            prepare(top, w, t + m.rk.c[j] * h, m.q_stage[j])
            for k in range(len(top.pairs)):
                c.own_lam[k, 0], c.own_lam[k, 1] = m.lam[j, k, 0], m.lam[j, k, 1]
            unfold_multipliers(top, w.cs, c.own_lam)
        if c.has_power[0] != 0:
            take_multipliers(top, w, c.own_lam)
            applied_forces(top, w, m.q_stage[j], m.v_stage[j])
            m.power[j, 0], m.power[j, 1] = evaluate_powers(top, w, m.q_stage[j], m.v_stage[j], c.own_lam)
            c.gain[0] += w1 * m.power[j, 0]
            c.gain[1] += w1 * m.power[j, 1]
    for d in range(n3):
        c.dq[d] += h * c.from_v[d] + h * c.v_low[d]
    if not (stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv)):
        return NOT_FINITE
    return OK


@entry
def keep(run, method, t, h, unused):
    """Store the stages of the last attempt as quadrature nodes; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_pair(method)
    stage_states(c, m, h)
    keep_stages(c, m, t, h)
    return OK


def new_pair(method: LobattoPair, workspace: Workspace) -> PairStages:
    """Return the bundle of a pair for a mechanism."""
    a, bar, b, c = (np.array(x, dtype=float) for x in coefficients(method.stages))
    a2 = product(a, bar)
    s, size, pairs = method.stages, workspace.mechanism.size, len(workspace.mechanism.topology.pairs)
    acc, q_stage, v_stage, spread = (np.zeros((s, size)) for _ in range(4))
    past = PastSteps(np.zeros((MOST_PAST, s, size)), np.zeros(1), np.zeros(1), np.zeros(1, dtype=np.int64))
    return PairStages(
        rk=PairCoefficients(bar, a2, inverse_of(a2[1:, :-1]), b, c),
        limit=new_limit(method.max_iterations),
        tolerance=np.array([method.tolerance if method.tolerance is not None else TOLERANCE]),
        acc=acc, lam=np.zeros((s, pairs, 2)), past=past,
        q_stage=q_stage, v_stage=v_stage, gap=np.zeros((s - 1, pairs, 2)),
        change=np.zeros((s - 1, size)), spread=spread, pairs=np.zeros((pairs, 2)), power=np.zeros((s, 2)),
    )  # fmt: skip


class CompiledLobattoPair(CompiledMethod):
    """Lobatto IIIA-IIIB pairs."""

    attempt, keep = attempt, keep
    carries_stages = True
    carries_multipliers = True
    hint = "a smaller time.step may help, or radau-iia for stiff forces"

    def __init__(self, method: LobattoPair, workspace: Workspace, control: Control | None = None):
        super().__init__(workspace)
        workspace.mechanism.refuse_states("a Lobatto pair")
        self.bundle = new_pair(method, workspace)
        self.stages = method.stages
        self.pinned = PinnedBundle(self.bundle)
        if method.max_iterations is None:
            self.limit = self.bundle.limit

    def forget(self) -> None:
        """Discard the stored accelerations, so that the next step does not extrapolate them."""
        self.bundle.past.known[0] = 0

    def describe_divergence(self, report: np.ndarray) -> str:
        """Return the largest change of an acceleration, and its location, as text."""
        return describe_divergence(self.workspace, report)
