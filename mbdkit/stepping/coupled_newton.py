"""Newton's method on all stages of a step at once, each with the tangents of its own state.

The iteration of `mbdkit.stepping.collocation_index1` takes one tangent for all stages, which does not converge within a
step of a singular position: accelerations change with the state like 1 / x there, x being the distance to it, so that
the tangents of different stages have nothing in common, however small the step. The equations themselves stay smooth,

    M a_i + Phi_q^T lambda_i = Q,    Phi_q a_i = gamma    at    (t_i, q_i(a), v_i(a)),    i = 1..s

with q_i and v_i as in `mbdkit.stepping.collocation_index1`, and so Newton's method converges on them, unless a stage
comes to stand in the singular position itself. One system of s (n + m) unknowns, by SuperLU; for the few steps that
need it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError, equilibrate
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels import equations
from mbdkit.errors import StepError

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace

MOST_ITERATIONS = 20

SHORT = 0.5
"""Largest move over a step, in rad or in lengths of the mechanism, for which its equations are tried.

A longer step may have solutions that have nothing to do with the motion.
"""

CONTRACTION = 0.5
"""Largest ratio of one change to the one before (Deuflhard 2004): beyond it the start is too far away."""

DONE = 1e-15
"""Change relative to the accelerations that ends the iteration."""

STAGNANT = 1e-8
"""Largest change that round-off next to a singular position may leave where it shrinks no more."""


class CoupledNewton:
    """Solves the stage equations of a fully implicit tableau with exact tangents.

    Parameters
    ----------
    workspace
        The mechanism.
    a, a2, c
        (s, s) the tableau's matrix and its square, (s,) its nodes.

    Attributes
    ----------
    counters
        Iterations, evaluations and factorizations so far.
    """

    def __init__(self, workspace: Workspace, a: np.ndarray, a2: np.ndarray, c: np.ndarray):
        self.workspace, self.a, self.a2, self.c = workspace, a, a2, c
        self.equations = EquationsOfMotion(workspace)
        self.counters = self.equations.counters
        terms, size, s = workspace.terms, workspace.unknowns, len(c)
        i, j = np.meshgrid(np.arange(s), np.arange(s), indexing="ij")
        entry = (i == j)[..., None] | (terms.factor > 0)
        """(s, s, N) which terms enter the block of stage i and the accelerations of stage j."""
        self.entry = entry
        self.row = (size * i[..., None] + terms.row)[entry]
        self.column = (size * j[..., None] + terms.column)[entry]

    def solve(self, t: float, h: float, q: np.ndarray, v: np.ndarray, acc: np.ndarray, lam: np.ndarray) -> int:
        """Solve for the stages of a step, beginning with constant accelerations.

        Parameters
        ----------
        t, h
            Start of the step and its size [s].
        q, v
            (3 (B + 1),) state at its start, ground last.
        acc : (s, 3 (B + 1)) array
            Receives the accelerations of the stages.
        lam : (s, P, 2) array
            Receives their multipliers.

        Returns
        -------
        int
            Iterations; 0 where they do not converge or the step is too long: `acc` and `lam` are left as they were.
        """
        p, s = self.equations, len(self.c)
        try:
            a0, lam0 = p.accelerations(t, q[: p.n], v[: p.n])
            move = np.abs(h * v[: p.n]) + h * h * np.abs(a0)
            lengths = np.arange(p.n) % 3 < 2
            if not np.max(np.where(lengths, move / self.workspace.mechanism.length, move)) <= SHORT:
                return 0
            stages, multipliers = np.tile(a0, (s, 1)), np.tile(lam0, (s, 1))
            iterations = self._iterate(t, h, q[: p.n], v[: p.n], stages, multipliers)
        except (StepError, SingularSystemError, RuntimeError):
            return 0
        if iterations:
            for i in range(s):
                at = q[: p.n] + h * self.c[i] * v[: p.n] + h * h * (self.a2[i] @ stages)
                equations.pair_multipliers_of(p.address, float(t + self.c[i] * h), at, multipliers[i], lam[i])
            acc[:, : p.n] = stages
        return iterations

    def _iterate(self, t: float, h: float, q: np.ndarray, v: np.ndarray, acc: np.ndarray, lam: np.ndarray) -> int:
        """Change stage accelerations (s, n) and multipliers (s, m) until they meet the equations."""
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import splu

        n, size = self.equations.n, self.workspace.unknowns
        before = np.inf
        for iteration in range(1, MOST_ITERATIONS + 1):
            values, defect = self._linearise(t, h, q, v, acc, lam)
            total = len(defect)
            row_scale, column_scale = equilibrate(total, self.row, self.column, np.abs(values))
            scaled = values * row_scale[self.row] * column_scale[self.column]
            self.counters.factorizations += 1
            self.counters.newton_iterations += 1
            lu = splu(csc_array((scaled, (self.row, self.column)), shape=(total, total)))
            change = (column_scale * lu.solve(row_scale * defect)).reshape(-1, size)
            acc -= change[:, :n]
            lam -= change[:, n:]
            now = self._relative(change[:, :n], acc)
            if not now < np.inf:
                return 0
            if now <= DONE or (now > CONTRACTION * before and now <= STAGNANT):
                return iteration
            if now > CONTRACTION * before:
                return 0
            before = now
        return 0

    def _linearise(
        self, t: float, h: float, q: np.ndarray, v: np.ndarray, acc: np.ndarray, lam: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the entries of the matrix, and what the equations lack (s (n + m),)."""
        p, terms, n, s = self.equations, self.workspace.terms, self.equations.n, len(self.c)
        defect = np.empty((s, self.workspace.unknowns))
        values = np.empty((s, s, len(terms.source)))
        rows = terms.kept((terms.factor == 0) & (terms.row >= n))
        for i in range(s):
            at = t + self.c[i] * h
            q_i = q + h * self.c[i] * v + h * h * (self.a2[i] @ acc)
            v_i = v + h * (self.a[i] @ acc)
            defect[i, :n] = p.residual(at, q_i, v_i, acc[i], lam[i])
            gamma = p.gamma(at, q_i, v_i)
            source = p.evaluated_terms(at, q_i, v_i, acc[i], lam[i])
            held = np.bincount(rows.row - n, source[rows.source] * acc[i][rows.column], minlength=p.m)
            defect[i, n:] = held - gamma
            rate, level = h * self.a[i][:, None], h * h * self.a2[i][:, None]
            coefficients = np.hstack([np.ones_like(rate), rate, -rate, level])
            values[i] = coefficients[:, terms.factor] * source[terms.source]
        return values[self.entry], defect.ravel()

    def _relative(self, change: np.ndarray, acc: np.ndarray) -> float:
        """Return the largest change relative to the largest acceleration, linear and angular ones apart."""
        largest = 0.0
        for some in (np.arange(self.equations.n) % 3 < 2, np.arange(self.equations.n) % 3 == 2):
            moved, size = np.max(np.abs(change[:, some])), np.max(np.abs(acc[:, some]))
            largest = max(largest, float(moved / max(size, moved))) if moved > 0 else largest
            if not np.isfinite(moved):
                return np.inf
        return largest
