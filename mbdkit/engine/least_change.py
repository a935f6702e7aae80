"""The positions and velocities nearest to given ones, in the mass metric, that satisfy all constraints."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism, with_ground
from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.observe import constraints_at, stiffness_at
from mbdkit.engine.kernels.table_rows import BODIES, PAIR
from mbdkit.engine.linear_systems import SparseFactors
from mbdkit.engine.nested_dissection import sparse_order
from mbdkit.engine.repeated_call import RepeatedCall
from mbdkit.engine.workspace import new_scratch

Entries = tuple[np.ndarray, np.ndarray, np.ndarray]  #: A sparse matrix as (row, column, value).

MOST_ITERATIONS = 60
MOST_DESCENTS = 30

REGULAR = 1e-13  #: Regularisation of redundant rows, relative to the diagonal of ``J M^-1 J^T``.

#: Diagonal of the scaled mass matrix. With 1, errors of the coordinates are as large as those of the multipliers.
HELD = 2.0**-7

#: Smallest entry of the diagonal that is preferred as pivot, relative to the largest entry of the column; see
#: `mbdkit.engine.linear_systems`.
LEAST_PIVOT = 0.01


class LeastChange:
    """Newton iterations that make states of a mechanism satisfy its constraints at a given time.

    `compiled`: the mechanism, with n = 3 B coordinates and m constraint rows. `t0`: time [s]. `fixed`: (n,) whether a
    coordinate is kept constant.
    """

    def __init__(self, compiled: CompiledMechanism, t0: float, fixed: np.ndarray):
        self.compiled, self.t0 = compiled, float(t0)
        self.scratch = new_scratch(compiled)[0]
        self._constraints = RepeatedCall(constraints_at, compiled.topology, self.scratch, None, None, None)
        self.n = len(fixed)
        self._at_rest = np.zeros(self.n + 3)
        self.mass = compiled.topology.mass[:-1].ravel()
        self.free = np.flatnonzero(~fixed)
        self.rows = np.array([(row.pair, row.place) for row in compiled.rows], dtype=np.int64).reshape(-1, 2)

    @cached_property
    def reach(self) -> float:
        """Largest lever arm of a joint, at least 1 m: the ratio of a joint point's velocity to the angular velocity."""
        return max(1.0, float(np.max(np.abs(self.compiled.topology.pair_parameters[:, :4]), initial=0.0)))

    def evaluate(self, q: np.ndarray) -> tuple[np.ndarray, Entries, np.ndarray]:
        """Return Phi (m,), the Jacobian as (row, column, value) and Phi_t (m,)."""
        w = self.scratch
        self._constraints(self.t0, with_ground(q), self._at_rest)
        pair, place = self.rows[:, 0], self.rows[:, 1]
        values = w.jac.reshape(-1, 2, 6)[pair, place].ravel()
        row, column = self._places
        keep = (column < self.n) & (values != 0)
        return w.phi[pair, place], (row[keep], column[keep], values[keep]), w.phi_t[pair, place]

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """(6 m,) row and column of each entry of the Jacobian, including those of ground."""
        bodies = self.compiled.topology.pairs[self.rows[:, 0], BODIES]
        return np.repeat(np.arange(len(self.rows)), 6), (3 * bodies[:, :, None] + np.arange(3)).ravel()

    def rates(self, jacobian: Entries, v: np.ndarray, phi_t: np.ndarray) -> np.ndarray:
        """Return ``Phi_q v + Phi_t`` (m,)."""
        row, column, value = jacobian
        return phi_t + np.bincount(row, value * v[column], minlength=len(phi_t))

    def positions(self, given: np.ndarray, tolerance: float) -> np.ndarray:
        """Return the positions nearest to the given ones that satisfy the constraints.

        If an iteration fails, the result may not be the nearest, or have residuals above the tolerance, which the
        caller must check.
        """
        q = self.closed(self.separated(given), tolerance)
        if float(np.max(np.abs(self.evaluate(q)[0]))) > tolerance:
            return q
        for _ in range(MOST_DESCENTS):
            if (nearest := self.stationary(given, q, tolerance)) is not None:
                return nearest
            if (nearer := self.descended(given, q, tolerance)) is None:
                return q
            q = nearer
        return q

    def velocities(self, v: np.ndarray, jacobian: Entries, phi_t: np.ndarray, tolerance: float) -> np.ndarray:
        """Return the velocities nearest to `v` with ``Phi_q v + Phi_t = 0``.

        If the tolerance is not reached, return the last iterate; the caller must check the residual.
        """
        rate = self.rates(jacobian, v, phi_t)
        try:
            solve = self.kkt(jacobian)
        except np.linalg.LinAlgError:
            return v
        for _ in range(6):
            v = v + solve(np.zeros(self.n), rate)[0]
            rate = self.rates(jacobian, v, phi_t)
            if np.max(np.abs(rate)) <= tolerance:
                break
        return v

    def closed(self, q: np.ndarray, tolerance: float) -> np.ndarray:
        """Solve ``Phi = 0`` by Newton steps of least norm, damped if the residual does not decrease.

        The result may have residuals above the tolerance.
        """
        phi, jacobian, _ = self.evaluate(q)
        size = max(1.0, float(np.max(np.abs(q), initial=0.0)), self.reach)
        nothing = np.zeros(self.n)
        for _ in range(MOST_ITERATIONS):
            gap = float(np.max(np.abs(phi)))
            try:
                step, _ = self.kkt(jacobian)(nothing, phi)
            except np.linalg.LinAlgError:
                return q
            largest = float(np.max(np.abs(step)))
            if not np.isfinite(largest):
                return q
            scale = min(1.0, 0.5 * size / largest) if largest > 0 else 1.0
            best = (q, phi, jacobian, gap)
            for _ in range(12):
                trial = q + scale * step
                phi_trial, jacobian_trial, _ = self.evaluate(trial)
                gap_trial = float(np.max(np.abs(phi_trial)))
                if gap_trial < best[3]:
                    best = (trial, phi_trial, jacobian_trial, gap_trial)
                if gap_trial <= 0.9 * gap:
                    break
                scale *= 0.5
            if best[0] is q:
                return q  # the residual is limited by round-off, or does not decrease any more
            closed_enough = gap <= tolerance
            q, phi, jacobian, _ = best
            if closed_enough:
                return q
        return q

    def stationary(self, given: np.ndarray, q: np.ndarray, tolerance: float) -> np.ndarray | None:
        """Apply Newton's method to the optimality conditions, starting at `q`.

        Returns None unless it converges to a point that is not farther from the given positions than `q`.
        """
        start = q
        size = max(1.0, float(np.max(np.abs(q), initial=0.0)), self.reach)
        multipliers: np.ndarray | None = None
        for _ in range(20):
            phi, jacobian, _ = self.evaluate(q)
            pull = self.mass * (q - given)
            try:
                if multipliers is None:
                    multipliers = self.kkt(jacobian)(pull, np.zeros(len(phi)))[1]
                row, column, value = jacobian
                gradient = pull + np.bincount(column, value * multipliers[row], minlength=self.n)
                step, change = self.kkt(jacobian, self.stiffness(q, multipliers))(gradient, phi)
            except np.linalg.LinAlgError:
                return None
            largest = float(np.max(np.abs(step)))
            if not largest < size:
                return None
            q, multipliers = q + step, multipliers + change
            if largest <= 1e-9 * size:  # with quadratic convergence, the next change would be round-off
                gap = float(np.max(np.abs(self.evaluate(q)[0])))
                near = self.distance(given, q) <= self.distance(given, start) * (1 + 1e-9)
                return q if gap <= tolerance and near else None
        return None

    def descended(self, given: np.ndarray, q: np.ndarray, tolerance: float) -> np.ndarray | None:
        """Take a step along the constraints towards the given positions; return None if it finds no nearer position."""
        _, jacobian, _ = self.evaluate(q)
        try:
            step, _ = self.kkt(jacobian)(self.mass * (q - given), np.zeros(len(self.rows)))
        except np.linalg.LinAlgError:
            return None
        scale = 1.0
        for _ in range(12):
            trial = self.closed(q + scale * step, tolerance)
            met = float(np.max(np.abs(self.evaluate(trial)[0]))) <= tolerance
            if met and self.distance(given, trial) < self.distance(given, q) * (1 - 1e-12):
                return trial
            scale *= 0.5
        return None

    def distance(self, given: np.ndarray, q: np.ndarray) -> float:
        """Return the squared distance of two positions in the mass metric, which assembly minimises."""
        return float(np.sum(self.mass * (q - given) ** 2))

    def separated(self, q: np.ndarray) -> np.ndarray:
        """Return positions at which the two points of each distance joint are distinct.

        The Jacobian of a distance joint is not defined if its points coincide.
        """
        top = self.compiled.topology
        for k in np.flatnonzero(top.pairs[:, PAIR.kind] == KINDS["distance"]):
            self._constraints(self.t0, with_ground(q), self._at_rest)
            if np.all(np.isfinite(self.scratch.jac[k])):
                continue
            for body in top.pairs[k, [PAIR.second, PAIR.first]]:
                if 3 * body in self.free:
                    q = q.copy()
                    q[3 * body] += top.pair_parameters[k, 4]
                    break
        return q

    def kkt(self, jacobian: Entries, stiffness: Entries | None = None) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
        """Return a solver of ``[M + K, J^T; J, -e] [step, mu] = [-gradient, -gap]`` over the free coordinates.

        The small regularisation `e` makes the matrix regular even if rows are redundant. It multiplies the change of
        the multipliers only, so that it has no influence on the converged result.

        The choice of pivots compares entries. Therefore the system is scaled such that the diagonal of M is `HELD` and
        rows of J have the norm 1. Most coordinates then follow from the constraints, and are accurate even if rows
        contradict each other and their multipliers are huge.
        """
        n, m = len(self.free), len(self.rows)
        row, column, value = jacobian
        row, column, value = self._of_free(n + row, column, value)
        lightness = np.sqrt(HELD / self.mass[self.free])
        square = np.bincount(row - n, (value * lightness[column]) ** 2, minlength=m)
        scale = np.concatenate([lightness, 1.0 / np.sqrt(np.where(square > 0.0, square, 1.0))])
        diagonal = np.arange(n + m)
        of_diagonal = np.concatenate([np.full(n, HELD), np.where(square > 0.0, -REGULAR / HELD, -1.0)])
        entries = value * scale[row] * scale[column]
        rows, columns, values = [diagonal, row, column], [diagonal, column, row], [of_diagonal, entries, entries]
        if stiffness is not None:
            row, column, value = stiffness
            row, column, value = self._of_free(self._free_places[row], column, value)
            rows, columns, values = [*rows, row], [*columns, column], [*values, value * scale[row] * scale[column]]
        parts = np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
        factors = SparseFactors(*parts, self._order, LEAST_PIVOT)

        def solve(gradient: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            solution = scale * factors.solve_refined(scale * np.concatenate([-gradient[self.free], -gap]))
            step = np.zeros(self.n)
            step[self.free] = solution[:n]
            return step, solution[n:]

        return solve

    def _of_free(self, row: np.ndarray, column: np.ndarray, value: np.ndarray) -> Entries:
        """Return the entries of a matrix in the columns of free coordinates, and in rows that are not negative."""
        column = self._free_places[column]
        is_free = (row >= 0) & (column >= 0)
        return row[is_free], column[is_free], value[is_free]

    @cached_property
    def _order(self) -> np.ndarray:
        """(n + m,) elimination order of the free coordinates and the rows.

        Bodies are ordered by minimum degree, and the rows of a pair follow the coordinates of one of its bodies.
        """
        pairs = self.compiled.topology.pairs[:, BODIES].tolist()
        rows_after: list[list[int]] = [[] for _ in range(self.n // 3 + 1)]
        adjacent: list[set[int]] = [set() for _ in rows_after]
        for place, pair in enumerate(self.rows[:, 0].tolist()):
            first, second = sorted(pairs[pair])
            rows_after[first].append(len(self.free) + place)
            if second < len(rows_after) - 1 and first != second:  # the ground is last
                adjacent[first].add(second)
                adjacent[second].add(first)
        order: list[int] = []
        for body in sparse_order(adjacent)[0]:
            order += [place for place in self._free_places[3 * body : 3 * body + 3].tolist() if place >= 0]
            order += rows_after[body]
        return np.array(order, dtype=np.int64)

    @cached_property
    def _free_places(self) -> np.ndarray:
        """(n,) index of each coordinate among the free ones; -1 for fixed coordinates."""
        places = np.full(self.n, -1, dtype=np.int64)
        places[self.free] = np.arange(len(self.free))
        return places

    def stiffness(self, q: np.ndarray, multipliers: np.ndarray) -> Entries:
        """Return d(J^T mu)/dq as (row, column, value)."""
        w, top = self.scratch, self.compiled.topology
        lam = np.zeros((len(top.pairs), 2))
        lam[self.rows[:, 0], self.rows[:, 1]] = multipliers
        stiffness_at(top, w, self.t0, with_ground(q), with_ground(np.zeros(self.n)), lam)
        columns = np.concatenate([3 * top.pairs[:, 1:2] + np.arange(3), 3 * top.pairs[:, 2:3] + np.arange(3)], axis=1)
        row, column = np.repeat(columns, 6, axis=1).ravel(), np.tile(columns, (1, 6)).ravel()
        keep = (row < self.n) & (column < self.n) & (w.stiff.ravel() != 0)
        return row[keep], column[keep], w.stiff.ravel()[keep]
