"""Partitioned Lobatto IIIA-IIIB pairs for constrained mechanisms, of which two stages make RATTLE, in compiled code.

With a the tableau of IIIA, a' that of IIIB, and their common weights b and nodes c,

    V_i = v_0 + h sum_j a'_ij a_j      Q_i = q_0 + h sum_j a_ij V_j      M a_j + Phi_q(Q_j)^T lam_j = F(t_j, Q_j, V_j)

and Phi(t_i, Q_i) = 0 for i = 2..s, which determines the multipliers of the stages before the last. The step ends at
q_1 = Q_s and v_1 = v_0 + h sum_j b_j a_j, and the multiplier of the last stage makes Phi_q(q_1) v_1 + Phi_t = 0.

The last column of a' is zero, and the first row of a: so the first s - 1 accelerations are solved for, and the last one
follows. As Q_(i+1) depends on a_j by h^2 B_ij, B = (a a') without its first row and last column, each iteration takes

    M a_j + Phi_q(Q_j)^T lam_j = F_j,        Phi_q(Q_j) (a_j - a_j before) = -sum_i (B^-1)_ji Phi(Q_(i+1)) / h^2

an index-1 system a stage. Its contraction is O(h); forces that are stiff against the step make it diverge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.jit.bundle import PinnedBundle, bundle_loader
from mbdkit.engine.jit.decorators import entry, subkernel
from mbdkit.engine.kernels.projection import position_rows, rate_rows
from mbdkit.engine.kernels.system import (
    DIVERGED,
    NOT_FINITE,
    OK,
    applied_forces,
    evaluate_powers,
    prepare,
    solve_system,
    solved_rows,
    unfold_multipliers,
)
from mbdkit.engine.kernels.vectors import copy, stays_finite
from mbdkit.methods.lobatto import coefficients
from mbdkit.stepping.collocation import report_divergence, stage_divergence
from mbdkit.stepping.compiled_method import Family
from mbdkit.stepping.position_convergence import (
    IDLE,
    IDLE_RATIO,
    ROUND_OFF,
    RUNAWAY,
    STAGNANT,
    is_settled,
    relative_sizes,
)
from mbdkit.stepping.run_state import FACTORIZATIONS, ITERATIONS, RHS, load_common
from mbdkit.stepping.stages import stage_states

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.methods.kinds import LobattoPair

MOST_PAST = 3
"""Steps whose stages are carried on to the next by the polynomial through them."""


class Pair(NamedTuple):
    """A pair of s stages, and its room."""

    bar: np.ndarray
    a2: np.ndarray
    """(s, s) a' and a a': weights of accelerations in velocities and positions of the stages."""
    inverse: np.ndarray
    """(s - 1, s - 1) B^-1."""
    b: np.ndarray
    c: np.ndarray
    choice: np.ndarray
    """(1,) the most iterations in one step."""
    tolerance: np.ndarray
    """(1,) expected change of positions, relative to their size, at which the iteration ends."""
    acc: np.ndarray
    """(s, 3 (B + 1)) accelerations of the stages."""
    lam: np.ndarray
    """(s, P, 2) multipliers of the stages, of the rows that are solved for."""
    past: np.ndarray
    """(MOST_PAST, s, 3 (B + 1)) accelerations of the steps before, newest first."""
    begun: np.ndarray
    """(3,) when the newest of them began, its size, and how many there are in steps of that size."""
    q_stage: np.ndarray
    v_stage: np.ndarray
    gap: np.ndarray
    """(s - 1, P, 2) Phi of the stages after the first."""
    change: np.ndarray
    """(s, 3 (B + 1)) change of accelerations."""
    spread: np.ndarray
    """(s, 3 (B + 1)) scratch."""
    pairs: np.ndarray
    """(P, 2) scratch."""
    power: np.ndarray
    """(s, 2) powers of the stages."""


def _example() -> Pair:
    from mbdkit.engine.example_workspace import example_workspace
    from mbdkit.methods.kinds import LobattoPair

    return new_pair(LobattoPair(2), example_workspace())


load_pair = bundle_loader(_example)


@subkernel
def _predict(m, t, h):
    """Begin with the accelerations of the steps before carried on stage by stage, or with none."""
    known = int(m.begun[2])
    if t == m.begun[0] or m.begun[1] != h:
        known = min(known, 1)
    elif not abs(m.begun[0] + h - t) <= 1e-6 * abs(h):
        known = 0
    x0, x1, x2 = m.past[0], m.past[1], m.past[2]
    for i in range(len(m.c)):
        for d in range(m.acc.shape[1]):
            if known >= 3:
                m.acc[i, d] = 3.0 * (x0[i, d] - x1[i, d]) + x2[i, d]
            elif known == 2:
                m.acc[i, d] = 2.0 * x0[i, d] - x1[i, d]
            elif known == 1:
                m.acc[i, d] = x0[i, d]
            else:
                m.acc[i, d] = 0.0


@subkernel
def _keep(m, t, h):
    """Keep the accelerations of a step for the next ones; an attempt at the same step takes the place of the last."""
    if m.begun[2] > 0.0 and t == m.begun[0]:
        m.begun[2] = max(m.begun[2] - 1.0, 0.0) if m.begun[1] == h else 0.0
    else:
        for k in range(MOST_PAST - 1, 0, -1):
            for i in range(len(m.c)):
                copy(m.past[k - 1, i], m.past[k, i])
        if m.begun[1] != h:
            m.begun[2] = 0.0
    for i in range(len(m.c)):
        copy(m.acc[i], m.past[0, i])
    m.begun[0], m.begun[1] = t, h
    m.begun[2] = min(m.begun[2] + 1.0, MOST_PAST)


@subkernel
def _iterate(c, m, t, h):
    """Solve for the stages before the last; return a status."""
    top, w = c.top, c.w
    s = len(m.c)
    bodies = len(top.mass) - 1
    has_forces = len(top.springs) + len(top.loads) > 0
    _predict(m, t, h)
    n = idle = 0
    before = np.inf
    while True:
        m.acc[s - 1, :] = 0.0
        stage_states(h, m.bar, m.a2, m.c, c.from_q, c.from_v, m.acc, m.q_stage, m.v_stage)
        for i in range(1, s):
            position_rows(top, w, t + m.c[i] * h, m.q_stage[i])
            for k in range(len(top.pairs)):
                m.gap[i - 1, k, 0], m.gap[i - 1, k, 1] = w.phi[k, 0], w.phi[k, 1]
        for j in range(s - 1):
            prepare(top, w, t + m.c[j] * h, m.q_stage[j])
            if has_forces:
                applied_forces(top, w, m.q_stage[j], m.v_stage[j])
            solved_rows(top, w, m.q_stage[j], m.v_stage[j])
            w.gamma[:, :] = 0.0
            rate_rows(top, w.jac, w.gamma, m.acc[j], m.pairs)
            for k in range(len(top.pairs)):
                for r in range(top.rows[k]):
                    total = m.pairs[k, r]
                    for i in range(s - 1):
                        total -= m.inverse[j, i] / (h * h) * m.gap[i, k, r]
                    w.gamma[k, r] = total
            status = solve_system(top, w, c.solver, has_forces, m.change[j], m.lam[j], n > 0)
            if status != OK:
                return status
            for d in range(3 * bodies):
                m.change[j, d] -= m.acc[j, d]
        c.counts[RHS] += s - 1
        c.counts[FACTORIZATIONS] += s - 1
        c.counts[ITERATIONS] += 1
        n += 1
        for i in range(s):
            for d in range(3 * bodies):
                total = 0.0
                for j in range(s - 1):
                    total += h * h * m.a2[i, j] * m.change[j, d]
                m.spread[i, d] = total
        for j in range(s - 1):
            for d in range(3 * bodies):
                m.acc[j, d] += m.change[j, d]
        now = relative_sizes(m.spread, c.from_q, bodies)
        ratio = now / before
        if is_settled(n, now, ratio, now, m.tolerance[0]):
            return OK
        if n > 1 and ratio > IDLE_RATIO and now <= STAGNANT:
            idle += 1
            if idle >= IDLE:
                return OK
        if n >= m.choice[0] or (n > 4 and ratio > 4.0 and now > RUNAWAY) or not now < np.inf:
            report_divergence(c, n, m.change, s - 1)
            return DIVERGED
        before = now


@subkernel
def _finish(c, m, t, h):
    """Solve for the last stage, which takes the velocities onto their constraints; return a status."""
    top, w = c.top, c.w
    s = len(m.c)
    has_forces = len(top.springs) + len(top.loads) > 0
    m.acc[s - 1, :] = 0.0
    stage_states(h, m.bar, m.a2, m.c, c.from_q, c.from_v, m.acc, m.q_stage, m.v_stage)
    end, known = m.q_stage[s - 1], m.spread[0]
    copy(c.from_v, known)
    for j in range(s - 1):
        for d in range(len(c.q) - 3):
            known[d] += h * m.b[j] * m.acc[j, d]
    position_rows(top, w, t + h, end)
    if has_forces:
        applied_forces(top, w, end, m.v_stage[s - 1])
    solved_rows(top, w, end, m.v_stage[s - 1])
    rate_rows(top, w.jac, w.phi_t, known, w.gamma)
    for k in range(len(top.pairs)):
        for r in range(2):
            w.gamma[k, r] = -w.gamma[k, r] / (h * m.b[s - 1])
    c.counts[RHS] += 1
    c.counts[FACTORIZATIONS] += 1
    return solve_system(top, w, c.solver, has_forces, m.acc[s - 1], m.lam[s - 1], True)


@entry
def attempt(common, own, t, h, want_error):
    """Try a step from the base state; see `mbdkit.stepping.driver`."""
    c, m = load_common(common), load_pair(own)
    top, w = c.top, c.w
    s = len(m.c)
    n3 = len(c.q) - 3
    status = _iterate(c, m, t, h)
    if status == OK:
        status = _finish(c, m, t, h)
    if status != OK:
        m.begun[2] = 0.0
        return status
    _keep(m, t, h)
    c.gain[0] = c.gain[1] = 0.0
    c.dq[:] = 0.0
    c.dv[:] = 0.0
    for j in range(s):
        w1, w2 = h * m.b[j], h * h * m.a2[s - 1, j]
        for d in range(n3):
            c.dv[d] += w1 * m.acc[j, d]
            c.dq[d] += w2 * m.acc[j, d]
        if c.has_power[0] != 0 or j == s - 1:
            prepare(top, w, t + m.c[j] * h, m.q_stage[j])
            for k in range(len(top.pairs)):
                c.own_lam[k, 0], c.own_lam[k, 1] = m.lam[j, k, 0], m.lam[j, k, 1]
            unfold_multipliers(top, w.cs, c.own_lam)
        if c.has_power[0] != 0:
            applied_forces(top, w, m.q_stage[j], m.v_stage[j])
            m.power[j, 0], m.power[j, 1] = evaluate_powers(top, w, m.q_stage[j], m.v_stage[j], c.own_lam)
            c.gain[0] += w1 * m.power[j, 0]
            c.gain[1] += w1 * m.power[j, 1]
    for d in range(n3):
        c.dq[d] += h * c.from_v[d] + h * c.v_low[d]
    if not (stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv)):
        return NOT_FINITE
    return OK


def new_pair(method: LobattoPair, workspace: Workspace) -> Pair:
    """Return the bundle of a pair for a mechanism."""
    a, bar, b, c = (np.array(x, dtype=float) for x in coefficients(method.stages))
    a2 = a @ bar
    s, size, pairs = method.stages, workspace.mechanism.size, len(workspace.mechanism.topology.pairs)
    acc, q_stage, v_stage, change, spread = (np.zeros((s, size)) for _ in range(5))
    return Pair(
        bar=bar, a2=a2, inverse=np.ascontiguousarray(np.linalg.inv(a2[1:, :-1])), b=b, c=c,
        choice=np.array([method.max_iterations]),
        tolerance=np.array([method.tolerance if method.tolerance is not None else ROUND_OFF]),
        acc=acc, lam=np.zeros((s, pairs, 2)), past=np.zeros((MOST_PAST, s, size)), begun=np.zeros(3),
        q_stage=q_stage, v_stage=v_stage, gap=np.zeros((s - 1, pairs, 2)), change=change, spread=spread,
        pairs=np.zeros((pairs, 2)), power=np.zeros((s, 2)),
    )  # fmt: skip


class PairFamily(Family):
    """Lobatto IIIA-IIIB pairs."""

    attempt = attempt
    carries_stages = True
    carries_multipliers = True
    hint = "a smaller time.step may help, or radau-iia where forces are stiff"

    def __init__(self, method: LobattoPair, workspace: Workspace):
        super().__init__(workspace)
        self.own = new_pair(method, workspace)
        self.hold = PinnedBundle(self.own)
        self.memory = (self.own.past, self.own.begun)

    def forget(self) -> None:
        """Begin the next step without stage values from before."""
        self.own.begun[2] = 0.0

    def describe_divergence(self, report: np.ndarray) -> str:
        """Return the largest change of an acceleration and where it is."""
        return stage_divergence(self.workspace, report)
