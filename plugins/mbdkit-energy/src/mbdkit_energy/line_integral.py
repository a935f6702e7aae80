"""Steps that conserve energy: line integrals along polynomials, and Gonzalez's discrete gradient.

With the orthonormal Legendre polynomials P_0 ... P_(s-1) on [0, 1], the step of size h follows the polynomials

    v(c) = v_0 + h sum_j g_j int_0^c P_j                 q'(c) = sum_j P_j(c) int P_j v
    lam(c) = sum_j P_j(c) lam_j                          q(c) = q_0 + h int_0^c q'

whose coefficients g_j (n,) and lam_j (m,), j < s, satisfy

    M g_j = int P_j (Q - Phi_q^T lam)        Phi(t_1, q_1) = 0        int P_j (Phi_q q' + Phi_t) = 0,   0 < j < s

Integrals over the step are Gauss sums with k nodes. Then the change of kinetic energy is the integral of the power
(Q - Phi_q^T lam) q', and the reactions of scleronomic constraints do no work: energy is conserved up to the errors of
the Gauss sums. These errors are zero for polynomial forces and constraints of a degree that depends on k, and otherwise
fall below rounding as k grows. Without constraints, this is HBVM(k, s) (Brugnano, Iavernaro and Trigiante 2010). With
s = 1 and constraints, the conditions are those of Brugnano, Gurioli, Iavernaro and Weinmueller (2018). Conditions on
the projections of Phi_q q' for j > 0 keep the reactions from doing work with s > 1 as well.

*The discrete gradient* of Gonzalez (1996, 1999) is s = k = 1, the midpoint rule, with a force along M (q_1 - q_0) which
makes the work of conservative forces the change of the potential energy, and that of reactions zero.

*At the end of a step*, velocities are projected onto the constraints, as in projected collocation (Ascher and Petzold
1991), without which the order of Gauss methods on constraints is s or s + 1 instead of 2 s. This would take away
kinetic energy of order h^(2 s + 2); a factor on the velocities, which leaves them consistent, gives it back.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import legendre

import mbdkit
from mbdkit.plugin.equations import gauss_on_unit

if TYPE_CHECKING:
    from mbdkit.plugin import IterationMatrix

#: Relative change of velocities at which iterations end, and below which they end if the change does not halve.
CONVERGED, STAGNANT = 2e-16, 1e-9
#: Changes of the energy in a step below this share of it are rounding errors. Without their correction, which is below
#: one unit in the last place of velocities in most steps, they added up to 1e-12 of the kinetic energy in 10,000 steps.
ROUNDING = 1e-14
#: Velocities below this share of what reactions alone would cause in a step, or of the one that passes the largest
#: coordinate in a step, are not sizes for the changes of velocities: they may be sums of forces that cancel, as in a
#: gear whose centre is pinned. Such velocities of 1e-16 m/s change by their own size in each iteration.
ROUNDED = 1e-4
#: Relative change of positions in a step below which the corrections of the discrete gradient are rounding errors.
AT_REST = 1e-9


class Polynomials(NamedTuple):
    """Legendre polynomials at the nodes of a step, and integrals of them.

    - `nodes`, `weights`: (k,) of Gauss sums on [0, 1].
    - `values`, `integrals`: (k, s) values of P_j, and integrals of P_j from 0, at the nodes.
    - `coupling`: (s, s) integrals of P_i times the integral of P_j.
    - `modes`: eigenvalue of `coupling`, its right eigenvector (s,), and its left one (s,), whose product is 1, or 2 for
      an eigenvalue that stands for a complex pair.
    """

    nodes: np.ndarray
    weights: np.ndarray
    values: np.ndarray
    integrals: np.ndarray
    coupling: np.ndarray
    modes: list[tuple[complex, np.ndarray, np.ndarray]]


@lru_cache(maxsize=16)
def polynomials(k: int, s: int) -> Polynomials:
    """Return the polynomials of HBVM(k, s)."""
    nodes, weights = gauss_on_unit(k)
    on_nodes = legendre.legvander(2 * nodes - 1, s)
    norms = np.sqrt(2 * np.arange(s) + 1)
    integrals = np.column_stack([nodes, (on_nodes[:, 2:] - on_nodes[:, :-2]) / (2 * norms[1:])])
    beside = 0.5 / np.sqrt(4 * np.arange(1, s) ** 2 - 1)
    coupling = np.diag([0.5] + [0.0] * (s - 1)) + np.diag(beside, -1) - np.diag(beside, 1)
    roots, right = np.linalg.eig(coupling)
    left = np.linalg.inv(right)
    modes: list[tuple[complex, np.ndarray, np.ndarray]] = []
    for i, root in enumerate(roots):
        if abs(root.imag) < 1e-12:
            modes.append((float(root.real), right[:, i].real, left[i].real))
        elif root.imag > 0:
            modes.append((complex(root), right[:, i], 2 * left[i]))
    return Polynomials(nodes, weights, norms * on_nodes[:, :s], integrals, coupling, modes)


class LineIntegral(mbdkit.StepMethod):
    """HBVM(k, s), or with `is_corrected` the discrete gradient of Gonzalez, for which k = s = 1.

    - `k`, `s`: number of nodes, and of coefficients of the polynomials.
    - `max_iterations`: largest number of iterations in one step.
    """

    carries_multipliers = True

    def __init__(self, k: int, s: int, max_iterations: int, *, is_corrected: bool = False):
        self.k, self.s, self.max_iterations, self.is_corrected = k, s, max_iterations, is_corrected

    def begin(
        self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, why: object
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the index-1 accelerations and multipliers at the start of the step, from which iterations start, and
        the energy [J].
        """
        energy = equations.potential(t, state.q) + equations.kinetic(state.v)
        return *equations.accelerations(t, state.q, state.v), energy

    def step(self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float) -> mbdkit.Step:
        """Take one step; the multipliers are those of index 1 at its end."""
        trial = _Trial(self, equations, t, state, h)
        before, matrices = np.inf, trial.matrices()
        for _ in range(self.max_iterations):
            change = trial.improve(matrices)
            if change <= CONVERGED or before / 2 <= change < STAGNANT:
                break
            if not change < before / 4:
                trial.least, matrices = trial.least_sizes(), trial.matrices()
            before = change
        else:
            raise mbdkit.StepError(
                "newton-failed",
                f"the last of {self.max_iterations} iterations still changed velocities by {change:.1g} of their size",
            )
        return trial.end()


class _Trial:
    """Coefficients of the polynomials of one step, while they are iterated."""

    def __init__(
        self, method: LineIntegral, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float
    ):
        self.p, self.is_corrected = polynomials(method.k, method.s), method.is_corrected
        self.equations, self.t, self.state, self.h = equations, t, state, h
        acceleration, lam, self.energy = state.memory
        self.g, self.lam = np.zeros((method.s, equations.n)), np.zeros((method.s, equations.m))
        self.g[0], self.lam[0] = acceleration, lam
        self.times, self.least = t + h * self.p.nodes, np.zeros(3)
        if self.is_corrected:
            self.potential = equations.potential(self.times[0], state.q)
        self._move()

    def _move(self) -> None:
        """Evaluate the polynomials at the nodes."""
        p, h, v0 = self.p, self.h, self.state.v
        rate = h * sums(p.coupling, self.g)
        rate[0] += v0  # coefficients of q'
        self.mean = rate[0]
        self.q = self.state.q + h * sums(p.integrals, rate)
        self.v = v0 + h * sums(p.integrals, self.g)
        self.rate = sums(p.values, rate)
        self.a, self.reactions = sums(p.values, self.g), sums(p.values, self.lam)

    def matrices(self) -> list[IterationMatrix]:
        """Return the matrices of the iteration, one for each eigenvalue, with tangents in the middle of the step."""
        h, v0 = self.h, self.state.v
        middle = self.state.q + h / 2 * (v0 + h / 4 * self.g[0])
        given = self.t + h / 2, middle, v0 + h / 2 * self.g[0], self.g[0], self.lam[0]
        scaled = [h * root for root, _, _ in self.p.modes]
        return [self.equations.iteration_matrix(*given, damping=x, stiffness=x * x, gamma_v=-x / 2) for x in scaled]

    def _residuals(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals of the equations of motion (s, n), and of the constraints as rates (s, m)."""
        equations, p, h = self.equations, self.p, self.h
        nodes = list(zip(self.times, self.q, self.v, self.rate, self.a, self.reactions, strict=True))
        weights = (p.weights[:, None] * p.values).T
        force = sums(weights, np.array([equations.residual(t, q, v, a, lam) for t, q, v, _, a, lam in nodes]))
        rows = np.zeros((len(self.lam), equations.m))
        if equations.m:
            if len(rows) > 1:
                rates = np.array([equations.constraint_rates(t, q, rate) for t, q, _, rate, _, _ in nodes])
                rows = sums(weights, rates)
            rows[0] = equations.constraints(self.t + h, self.state.q + h * self.mean) / h
        if self.is_corrected:
            force[0] += self._correction()
        return force, rows

    def _correction(self) -> np.ndarray:
        """Return the force (n,) that turns midpoint derivatives into the discrete ones of Gonzalez, less its effect.

        The power of conservative forces is that of all applied forces, without friction, less that of loads and
        dampers.
        """
        equations, h, mean, t, q = self.equations, self.h, self.mean, self.times[0], self.q[0]
        if equations.relative_change(self.state.q, h * mean) < AT_REST:
            return np.zeros(equations.n)
        none = np.zeros(equations.m)
        power = -float(np.add.reduce(equations.residual(t, q, mean, 0 * mean, none) * mean))
        if equations.has_power:
            work, lost = equations.powers(t, q, mean, none)
            power -= work - lost
        potential = equations.potential(t, self.state.q + h * mean)
        gap = potential - self.potential + h * power
        if equations.m:
            gap -= h * float(np.add.reduce(self.lam[0] * equations.constraint_rates(t, q, mean)))
        level = ROUNDING / 4 * (abs(potential) + abs(self.potential))
        gap -= min(max(gap, -level), level)  # near a turning point, a gap by rounding would become a large force
        force: np.ndarray = gap / (2 * h * equations.kinetic(mean)) * equations.mass * mean
        return force

    def improve(self, matrices: list[IterationMatrix]) -> float:
        """Take one simplified Newton iteration; return the change of velocities, relative to the largest of a kind."""
        force, rows = self._residuals()
        change = np.zeros(self.equations.n)
        for (root, right, left), matrix in zip(self.p.modes, matrices, strict=True):
            r, c = -sums(left[None], force)[0], -sums(left[None], rows)[0] / (self.h * root)
            da, dlam = matrix.solve(r, c)
            self.g += (right[:, None] * da).real
            self.lam += (right[:, None] * dlam).real
            change += np.abs(da)
        self._move()
        largest = np.maximum(np.abs(self.state.v), np.abs(self.h * self.g).max(axis=0)).reshape(-1, 3)
        sizes = np.maximum([largest[:, :2].max(), largest[:, :2].max(), largest[:, 2].max()], self.least)
        sizes[sizes == 0.0] = 1.0
        return float((self.h * change.reshape(-1, 3) / sizes).max())

    def least_sizes(self) -> np.ndarray:
        """Return the velocities (3,) of x, y and angle below which they are rounding errors, as `ROUNDED` says."""
        equations, h, q = self.equations, self.h, self.state.q
        sizes = np.array([1.0 / equations.relative_change(q, unit) for unit in np.eye(3, equations.n)]) / h
        if equations.m:
            rows = abs(equations.constraint_jacobian(self.t, q))
            causes = (h * (rows.T @ np.abs(self.lam).max(axis=0)) / equations.mass).reshape(-1, 3).max(axis=0)
            sizes = np.maximum(sizes, [causes[:2].max(), causes[:2].max(), causes[2]])
        return ROUNDED * sizes

    def end(self) -> mbdkit.Step:
        """Return the step, with consistent velocities of the same kinetic energy at its end."""
        equations, h, end = self.equations, self.h, self.t + self.h
        result = self.state.moved(h * self.mean, h * self.g[0])
        if equations.m:
            v = equations.project_velocities(end, result.q, result.v)
            if not equations.constraint_rates(end, result.q, 0 * v).any():  # a factor leaves only such rows at zero
                kinetic = equations.kinetic(v)
                v = v * np.sqrt(self._kinetic(end, result) / kinetic) if kinetic else v
            result = mbdkit.StepState(result.q, v)
        a, lam = equations.accelerations(end, result.q, result.v)
        result = replace(result, multipliers=lam, memory=(a, lam, self.energy))
        begin, none = self.state, np.zeros_like(result.z)
        change = result.q - begin.q, result.v - begin.v, none
        return mbdkit.Step(result, dense=begin.interpolant(h, change, (begin.memory[0], a), (none, none)))

    def _kinetic(self, t: float, end: mbdkit.StepState) -> float:
        """Return the kinetic energy of the end of the step, with which rounding errors of the energy do not accumulate
        over steps.
        """
        equations, none = self.equations, np.zeros(self.equations.m)
        potential, kinetic = equations.potential(t, end.q), equations.kinetic(end.v)
        lost: float = self.energy - potential - kinetic
        works = equations.has_power and any(equations.powers(t, end.q, end.v, none))
        if works or abs(lost) > ROUNDING * (abs(potential) + kinetic):
            self.energy, lost = potential + kinetic, 0.0
        return kinetic + lost


def sums(weights: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ``weights @ x`` for (r, c) and (c, n) arrays, added in the same order on every processor."""
    total: np.ndarray = np.add.reduce(weights[:, :, None] * x[None], axis=1)
    return total
