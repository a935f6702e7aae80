"""Diagonally implicit Runge-Kutta methods on the index-1 equations: stages are solved one after the other.

With the step size h, the lower triangular matrix A and the nodes c of the tableau, stage i in second-order form is

    v_i = v_n + h sum_{j<=i} A_ij a_j,        q_i = q_n + h c_i v_n + h^2 sum_{j<=i} (A A)_ij a_j,
    a_i = f(t_i, q_i, v_i)

Since the earlier stages are known, only ``a_i`` is unknown. With g = A_ii, each iteration of Newton's method solves one
system for the changes of ``a_i`` and of the multipliers,

    [ M + h g C + h^2 g^2 K                               Phi_q^T ] [ da   ]     [ M a + Phi_q^T lambda - Q ]
    [ Phi_q - h g gamma_v + h^2 g^2 (Phi_q a - gamma)_q   0       ] [ dlam ] = - [ Phi_q a - gamma          ]

where M is the mass matrix, C, K and gamma_v are the tangents of `mbdkit.engine.equations_of_motion.Tangents`, and all
derivatives are those at the current iterate. An explicit stage, g = 0, takes one evaluation. This scheme is
needed for tableaus whose matrix cannot be diagonalised, such as that of a singly diagonally implicit method, which has
only one eigenvalue and one eigenvector; see Hairer and Wanner (1996), IV.6.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.methods.step_methods import StepMethod, StepState

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.methods.kinds import ImplicitRungeKutta

Solved = tuple[np.ndarray, np.ndarray]  #: Accelerations (n,) and multipliers (m,).

MOST_ITERATIONS = 50
ROUNDING = 4e-16  #: Relative change of the accelerations that counts as round-off.
#: An iteration that no longer contracts is accepted as having reached round-off if its relative change is below this.
SMALL = 1e-6
#: An iteration counts as no longer contracting if the ratio of two successive changes is above this.
CONTRACTS = 0.5


class DiagonallyImplicit(StepMethod):
    """A diagonally implicit tableau in fixed steps. `method`: the tableau, and how its stages are solved."""

    hint = "a smaller time.step may help"

    def __init__(self, method: ImplicitRungeKutta):
        self._name = method.tableau.name
        self._a, self._b, self._c = method.tableau.floats()
        self._a2, self._b2 = method.tableau.second_order_floats()
        self._newton = method.stage_solver == "newton"
        self._tolerance = method.tolerance or 0.0
        self._most = method.max_iterations or MOST_ITERATIONS

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        """Take one step; see `StepMethod.step`."""
        accelerations: list[np.ndarray] = []
        n = equations.n
        work = dissipated = 0.0
        for i, node in enumerate(self._c):
            v = state.v + h * _combined(self._a[i, :i], accelerations, n)
            q = state.q + h * node * state.v + h * h * _combined(self._a2[i, :i], accelerations, n)
            now, rate = t + node * h, h * self._a[i, i]
            a, lam = self._solved(equations, now, q, v, rate) if rate else equations.accelerations(now, q, v)
            accelerations.append(a)
            given, lost = equations.powers(now, q + rate * rate * a, v + rate * a, lam)
            work += h * self._b[i] * given
            dissipated += h * self._b[i] * lost
        return state.moved(
            h * state.v + h * h * _combined(self._b2, accelerations, n),
            h * _combined(self._b, accelerations, n),
            work=work,
            dissipated=dissipated,
        )

    def _solved(self, equations: EquationsOfMotion, t: float, q: np.ndarray, v: np.ndarray, rate: float) -> Solved:
        """Return acceleration and multipliers of a stage whose state is ``q + rate^2 a``, ``v + rate a``.

        The iteration starts from zero acceleration. With a stiff force, it could converge from the acceleration of an
        earlier stage to another solution of the stage equations, which is far from the motion. The iteration ends when
        the change is within the tolerance, is round-off, or no longer decreases.
        """
        a, lam = np.zeros(equations.n), np.zeros(equations.m)
        before = np.inf
        for _ in range(self._most):
            change, lam = (self._newton_change if self._newton else _fixed_point_change)(
                equations, t, q + rate * rate * a, v + rate * a, rate, (a, lam)
            )
            a = a + change
            size = float(np.max(np.abs(change), initial=0.0) / max(float(np.max(np.abs(a), initial=0.0)), 1e-300))
            if size <= max(self._tolerance, ROUNDING) or (before <= SMALL and size >= CONTRACTS * before):
                return a, lam
            if not np.isfinite(size):
                break
            before = size
        raise StepError("newton-failed", f"the iteration for a stage of {self._name} does not converge")

    @staticmethod
    def _newton_change(
        equations: EquationsOfMotion, t: float, q: np.ndarray, v: np.ndarray, rate: float, solved: Solved
    ) -> Solved:
        a, lam = solved
        matrix = equations.iteration_matrix(
            t, q, v, a, lam, damping=rate, stiffness=rate * rate, gamma_v=-rate, residual_q=rate * rate
        )
        rows = equations.constraint_jacobian(t, q) @ a - equations.gamma(t, q, v)
        change, more = matrix.solve(-equations.residual(t, q, v, a, lam), -rows)
        return change, lam + more


def _fixed_point_change(
    equations: EquationsOfMotion, t: float, q: np.ndarray, v: np.ndarray, rate: float, solved: Solved
) -> Solved:
    a, lam = equations.accelerations(t, q, v)
    return a - solved[0], lam


def _combined(weights: np.ndarray, accelerations: list[np.ndarray], n: int) -> np.ndarray:
    return sum((w * a for w, a in zip(weights, accelerations, strict=True)), start=np.zeros(n))
