"""Steps of half-explicit Runge-Kutta methods on the index-2 equations.

    M v' + Phi_q^T lam = Q(t, q, v),      Phi_q v + Phi_t = 0,      z' = r(t, q, v, z)

Stage i evaluates the equations of motion at a state that is known from the stages before it. Its multipliers are those
with which a velocity V_i~, at a position Q_i~ that is known too, satisfies the constraints:

    Q_i = q_0 + h sum_{j<i} a_ij V_j             V_i = v_0 + h sum_{j<i} a_ij V'_j
    Q_i~ = q_0 + h sum_{j<=i} a~_ij V_j          V_i~ = v_0 + h sum_{j<=i} a~_ij V'_j
    M V'_i + Phi_q(Q_i)^T Lam_i = Q(Q_i, V_i)    Phi_q(Q_i~) V_i~ + Phi_t = 0

so that each stage is one linear system with the Jacobians of two positions. The last row of a~ holds the weights of the
step. The methods of Brasey and Hairer (1993) have Q_i~ = Q_(i+1); in the partitioned ones of Murua (1997) the two
differ, and V'_1 is the acceleration at the start of the step.

At both ends of each step, accelerations and multipliers are those of the index-1 equations, as with the option IACC = 1
of Murua's code. Two things follow from them, which differ from the codes of the authors:

- *Dense output* is `StepState.interpolant`, with the accelerations and rates of both ends.
- *The error estimate* of controlled steps is the difference between the step and Simpson's rule, for which one
  acceleration is evaluated in the middle of the dense output, and for positions the corrected trapezoidal rule. Both
  have order 4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

import mbdkit
from mbdkit.plugin.seams import integrator_method

if TYPE_CHECKING:
    from mbdkit.plugin import Rates


@dataclass(frozen=True)
class HalfExplicitTableau:
    """Coefficients of a half-explicit method with s stages.

    - `order`: order of positions and velocities.
    - `a`: (s, s) coefficients a, strictly lower triangular.
    - `consistent`: (s, s) coefficients a~, lower triangular. If the first row is zero, the first stage has the
      acceleration at the start of the step.
    """

    order: int
    a: np.ndarray
    consistent: np.ndarray

    def __post_init__(self) -> None:
        first = 0 if self.consistent[0, 0] else 1
        is_implicit = np.any(np.triu(self.a)) or np.any(np.triu(self.consistent, 1))
        if is_implicit or not np.all(np.diag(self.consistent)[first:]):
            raise mbdkit.PluginError("the coefficients of a half-explicit method are not those of explicit stages")


@integrator_method
class HalfExplicit(mbdkit.StepMethod):
    """A half-explicit method, given by its coefficients; without `tolerances`, its steps are fixed."""

    carries_multipliers = True
    error_order = 4.0

    def __init__(self, tableau: HalfExplicitTableau, tolerances: mbdkit.Tolerances | None = None):
        self.tableau, self.tolerances = tableau, tolerances
        rows = enumerate(zip(tableau.a, tableau.consistent, strict=True))
        self.stages = [
            (float(a.sum()), a[:i, None], float(b.sum()), b[: i + 1, None], float(b[i])) for i, (a, b) in rows
        ]

    def begin(self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, why: object) -> Rates:
        """Return the accelerations, multipliers and rates at the start of the step."""
        return equations.derivatives(t, state.q, state.v, state.z)

    def step(self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float) -> mbdkit.Step:
        """Take one step."""
        a, _, rates = state.memory
        dq, dv, dz = self._increments(equations, t, state, h)
        result = state.moved(dq, dv, dz)
        a1, lam, rates1 = equations.derivatives(t + h, result.q, result.v, result.z)
        dense = state.interpolant(h, (dq, dv, dz), (a, a1), (rates, rates1))
        end = replace(result, multipliers=lam, memory=(a1, lam, rates1))
        if self.tolerances is None:
            return mbdkit.Step(end, dense=dense)
        a_half, _, rates_half = equations.derivatives(t + h / 2, *dense(0.5))
        error = (
            dq - h / 2 * (state.v + result.v) - h**2 / 12 * (a - a1),
            dv - h / 6 * (a + 4 * a_half + a1),
            dz - h / 6 * (rates + 4 * rates_half + rates1),
        )
        return mbdkit.Step(end, error=np.concatenate(error), dense=dense)

    def _increments(
        self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the changes of positions, velocities and first-order states in a step."""
        n, add = equations.n, np.add.reduce  # which adds in the same order on every processor, as BLAS does not
        y = np.concatenate([state.q, state.v, state.z])
        slopes = np.zeros((len(self.stages), len(y)))
        for i, (c, known, c_end, consistent, own) in enumerate(self.stages):
            begin, x, slope = t + c * h, y + h * add(known * slopes[:i]), slopes[i]
            q, slope[:n] = x[:n], x[n : 2 * n]
            slope[2 * n :] = equations.rates(begin, q, slope[:n], x[2 * n :])
            if not own:
                slope[n : 2 * n] = state.memory[0]
                continue
            force, end = equations.forces(begin, q, slope[:n]), y + h * add(consistent * slopes[: i + 1])
            slope[n : 2 * n], _ = equations.solve_between(
                begin, q, force, t + c_end * h, end[:n], end[n : 2 * n], h * own
            )
        change = h * add(consistent * slopes)
        return change[:n], change[n : 2 * n], change[2 * n :]
