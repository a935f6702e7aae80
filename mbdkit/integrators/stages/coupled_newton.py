"""Newton's method for all stages of a step simultaneously, with the tangents evaluated at each stage.

The iteration of `mbdkit.integrators.stages.collocation_index1` uses the same tangents for all stages. It does not
converge if a singular position is less than a step away: accelerations vary like 1 / x there, with x the distance to
the singular position, so that the tangents of different stages differ strongly for any step size. But the equations

    M a_i + Phi_q^T lambda_i = Q,    Phi_q a_i = gamma    at    (t_i, q_i(a), v_i(a)),    i = 1..s

with q_i and v_i as in `mbdkit.integrators.stages.collocation_index1`, are smooth. Therefore Newton's method converges,
unless the position of a stage is singular itself. Each iteration solves one system of s (n + m) unknowns, which is
acceptable because few steps need it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.elimination_order import SingularSystemError, equilibrate, symmetric_order
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels import equations
from mbdkit.engine.kernels.projection import EPS, FEW_ROUNDINGS, STAGNANT
from mbdkit.engine.linear_systems import SparseFactors, product
from mbdkit.integrators.stages.convergence import NEGLIGIBLE_CHANGE, STALLED

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace

MOST_ITERATIONS = 20

#: Smallest entry of the diagonal that is preferred as pivot, relative to the largest entry of its column.
LEAST_PIVOT = 0.01

#: Largest displacement in a step for which this iteration is used, in rad or in characteristic lengths; chosen.
#:
#: The equations of a longer step can have spurious solutions that do not approximate the motion.
SHORT = 0.5


class CoupledNewton:
    """Solver for the stage equations of a fully implicit tableau, with exact tangents.

    Parameters
    ----------
    workspace
        The mechanism.
    a, a2, c
        (s, s) matrix of the tableau and its square, and (s,) nodes.

    Attributes
    ----------
    counters
        Counters of iterations, evaluations and factorizations.
    """

    def __init__(self, workspace: Workspace, a: np.ndarray, a2: np.ndarray, c: np.ndarray):
        self.workspace, self.a, self.a2, self.c = workspace, a, a2, c
        self.equations = EquationsOfMotion(workspace)
        self.counters = self.equations.counters
        terms, size, s = workspace.terms, workspace.unknowns, len(c)
        i, j = np.meshgrid(np.arange(s), np.arange(s), indexing="ij")
        #: (s, s, N) whether a term occurs in the block of the equations of stage i and the unknowns of stage j.
        entry = (i == j)[..., None] | (terms.factor > 0)
        self.entry = entry
        self.row = (size * i[..., None] + terms.row)[entry]
        self.column = (size * j[..., None] + terms.column)[entry]
        self._order = symmetric_order(s * size, self.row, self.column)

    def solve(self, t: float, h: float, q: np.ndarray, v: np.ndarray, acc: np.ndarray, lam: np.ndarray) -> int:
        """Solve for the stages of a step, with constant accelerations as the initial guess.

        Parameters
        ----------
        t, h
            Start of the step and its size [s].
        q, v
            (3 (B + 1),) state at the start of the step, ground last.
        acc : (s, 3 (B + 1)) array
            Accelerations of the stages; overwritten.
        lam : (s, P, 2) array
            Multipliers of the stages; overwritten.

        Returns
        -------
        int
            Number of iterations; 0 if the iteration does not converge or the step is too long. In this case `acc` and
            `lam` are not changed.
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
        except (StepError, SingularSystemError, np.linalg.LinAlgError):
            return 0
        if iterations:
            for i in range(s):
                at = q[: p.n] + h * self.c[i] * v[: p.n] + h * h * product(stages.T, self.a2[i])
                equations.pair_multipliers_of(p.address, float(t + self.c[i] * h), at, multipliers[i], lam[i])
            acc[:, : p.n] = stages
        return iterations

    def _iterate(self, t: float, h: float, q: np.ndarray, v: np.ndarray, acc: np.ndarray, lam: np.ndarray) -> int:
        """Solve for stage accelerations (s, n) and multipliers (s, m) in place; return the iterations, 0 on failure."""
        n, size = self.equations.n, self.workspace.unknowns
        before = np.inf
        for iteration in range(1, MOST_ITERATIONS + 1):
            values, defect = self._linearise(t, h, q, v, acc, lam)
            total = len(defect)
            row_scale, column_scale = equilibrate(total, self.row, self.column, np.abs(values))
            scaled = values * row_scale[self.row] * column_scale[self.column]
            self.counters.factorizations += 1
            self.counters.newton_iterations += 1
            factors = SparseFactors(self.row, self.column, scaled, self._order, LEAST_PIVOT)
            change = (column_scale * factors.solve_refined(row_scale * defect)).reshape(-1, size)
            acc -= change[:, :n]
            lam -= change[:, n:]
            now = self._relative(change[:, :n], acc)
            if not now < np.inf:
                return 0
            # Near a singular position, round-off is large: changes stop decreasing at 3e-15 to 7e-11 of the
            # accelerations. If the initial guess is too far away, they stop decreasing above 0.1. Stiff forces convert
            # round-off of positions into accelerations: for a beam that has made 30 turns, this happens at 1e-9.
            is_stalled = now > STALLED * before
            if now <= FEW_ROUNDINGS * EPS or (is_stalled and (now <= STAGNANT or self._is_negligible(h, change, q))):
                return iteration
            if is_stalled:
                return 0
            before = now
        return 0

    def _linearise(
        self, t: float, h: float, q: np.ndarray, v: np.ndarray, acc: np.ndarray, lam: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the entries of the matrix and the residual of the equations (s (n + m),)."""
        p, terms, n, s = self.equations, self.workspace.terms, self.equations.n, len(self.c)
        defect = np.empty((s, self.workspace.unknowns))
        values = np.empty((s, s, len(terms.source)))
        rows = terms.kept((terms.factor == 0) & (terms.row >= n))
        for i in range(s):
            at = t + self.c[i] * h
            q_i = q + h * self.c[i] * v + h * h * product(acc.T, self.a2[i])
            v_i = v + h * product(acc.T, self.a[i])
            defect[i, :n] = p.residual(at, q_i, v_i, acc[i], lam[i])
            gamma = p.gamma(at, q_i, v_i)
            source = p.evaluated_terms(at, q_i, v_i, acc[i], lam[i])
            held = np.bincount(rows.row - n, source[rows.source] * acc[i][rows.column], minlength=p.m)
            defect[i, n:] = held - gamma
            rate, level = h * self.a[i][:, None], h * h * self.a2[i][:, None]
            coefficients = np.hstack([np.ones_like(rate), rate, -rate, level])
            values[i] = coefficients[:, terms.factor] * source[terms.source]
        return values[self.entry], defect.ravel()

    def _is_negligible(self, h: float, change: np.ndarray, q: np.ndarray) -> bool:
        """Return whether a change (s, n + m) is within the rounding errors of the positions."""
        moved = (h * h * np.max(np.abs(change[:, : len(q)]), axis=0)).reshape(-1, 3)
        at = np.abs(q).reshape(-1, 3)
        return all(
            np.max(moved[:, some]) <= NEGLIGIBLE_CHANGE * max(1.0, float(np.max(at[:, some])))
            for some in (slice(0, 2), slice(2, 3))
        )

    def _relative(self, change: np.ndarray, acc: np.ndarray) -> float:
        """Return the largest change relative to the largest acceleration; linear and angular ones are compared
        separately.
        """
        largest = 0.0
        for some in (np.arange(self.equations.n) % 3 < 2, np.arange(self.equations.n) % 3 == 2):
            moved, size = np.max(np.abs(change[:, some])), np.max(np.abs(acc[:, some]))
            largest = max(largest, float(moved / max(size, moved))) if moved > 0 else largest
            if not np.isfinite(moved):
                return np.inf
        return largest
