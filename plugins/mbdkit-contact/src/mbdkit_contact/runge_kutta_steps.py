"""Steps of explicit and implicit Runge-Kutta methods between events of rigid contacts."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.methods.kinds import ExplicitRungeKutta, Method
from mbdkit.methods.step_methods import Step, StepMethod, StepState

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.methods.tableau import ButcherTableau
    from mbdkit_contact.forced_equations import ForcedEquations

MOST_ITERATIONS = 50
CONVERGED, STAGNANT = 4e-16, 1e-9
"""Changes of the stages, relative to the largest ones, that count as zero, and below which the iteration may stagnate.
"""


class RungeKuttaSteps(StepMethod):
    """A Runge-Kutta method for y = (q, v, z) on the index-1 equations with closed contacts.

    The stages of an implicit method are solved by the simplified Newton method, with the Jacobian at the start of the
    step. With tolerances, explicit methods use the estimates of their embedded pair, and implicit ones the difference
    from the embedded method of order s of Hairer and Wanner (1996, IV.8), which has the additional node 0.

    Parameters
    ----------
    method
        The method, whose traits have a tableau.
    """

    def __init__(self, method: Method):
        tableau = cast("ButcherTableau", method.traits.tableau)
        self._is_explicit, self._name = tableau.is_explicit, tableau.name
        self._matrix, weights, nodes = tableau.floats()
        self._a, self._b, self._c = self._matrix.tolist(), weights.tolist(), nodes.tolist()
        self.tolerances = method.traits.tolerances
        if self.tolerances is None:
            return
        if isinstance(method, ExplicitRungeKutta):
            assert method.pair is not None
            # of two estimates, that of higher order, which is smaller by two orders than their combination
            several = len(method.pair.error) > 1
            self._error, self.error_order = method.pair.error[0], method.pair.estimate_order - (3.0 if several else 1.0)
            return
        #: Weight of the additional node: largest real eigenvalue of the matrix, or largest real part.
        self._first = float(np.max(np.linalg.eigvals(self._matrix).real))
        powers = np.arange(len(nodes))
        right = 1.0 / (powers + 1.0) - self._first * (powers == 0)
        self._error = np.linalg.solve(nodes[None, :] ** powers[:, None], right) - weights
        self.error_order = float(len(nodes))

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        """See `StepMethod.step`."""
        forced = cast("ForcedEquations", equations)
        stages = self._explicit(forced, t, state, h) if self._is_explicit else self._implicit(forced, t, state, h)
        q_rates, rates, z_rates, work, lost = zip(*stages, strict=True)
        weights, none = self._b, np.zeros(equations.n)
        q = state.q + h * sum((x * y for x, y in zip(weights, q_rates, strict=True)), none)
        v = state.v + h * sum((x * y for x, y in zip(weights, rates, strict=True)), none)
        z = state.z + h * sum((x * y for x, y in zip(weights, z_rates, strict=True)), 0.0 * state.z)
        end = StepState(
            q,
            v,
            work=h * sum(x * y for x, y in zip(weights, work, strict=True)),
            dissipated=h * sum(x * y for x, y in zip(weights, lost, strict=True)),
            z=z,
        )
        return Step(end) if self.tolerances is None else Step(end, error=self._estimate(forced, t, state, h, stages))

    def _explicit(self, equations: ForcedEquations, t: float, state: StepState, h: float) -> list[tuple]:  # type: ignore[type-arg]
        """Return for each stage the rates of q, v and z, the power of loads and drivers, and the dissipated power."""
        stages: list[tuple] = []  # type: ignore[type-arg]
        none = np.zeros(equations.n)
        for row, node in zip(self._a, self._c, strict=True):
            q, v, z = (
                start + h * sum((x * stage[k] for x, stage in zip(row, stages, strict=False)), zero)
                for k, (start, zero) in enumerate(((state.q, none), (state.v, none), (state.z, 0.0 * state.z)))
            )
            a, z_rates, powers = equations.rate(t + node * h, q, v, z)
            stages.append((v, a, z_rates, *powers))
        return stages

    def _implicit(self, equations: ForcedEquations, t: float, state: StepState, h: float) -> list[tuple]:  # type: ignore[type-arg]
        """See `_explicit`."""
        from scipy.linalg import lu_factor, lu_solve

        y, cuts = np.concatenate([state.q, state.v, state.z]), (equations.n, 2 * equations.n)
        count, before = len(self._c), np.inf
        matrix = np.eye(count * len(y)) - np.kron(h * self._matrix, equations.jacobian(t, state.q, state.v, state.z))
        factors = lu_factor(matrix, check_finite=False)
        k = np.tile(_rates(equations, t, y, cuts), (count, 1))
        for _ in range(MOST_ITERATIONS):
            inner = y + h * self._matrix @ k
            values = [_rates(equations, t + c * h, x, cuts) for c, x in zip(self._c, inner, strict=True)]
            dk = lu_solve(factors, (np.array(values) - k).ravel(), check_finite=False).reshape(k.shape)
            k = k + dk
            change = h * float(np.max(np.abs(dk))) / max(float(np.max(np.abs(inner))), 1e-300)
            if change <= CONVERGED or before / 2 <= change < STAGNANT:
                break
            if not np.isfinite(change):
                raise StepError("newton-failed", f"the iteration for the stages of {self._name} does not converge")
            before = change
        else:
            raise StepError("newton-failed", f"the stages of {self._name} need more than {MOST_ITERATIONS} iterations")
        inner = y + h * self._matrix @ k
        stages = []
        for c, x, rates in zip(self._c, inner, k, strict=True):
            q, v, z = np.split(x, cuts)
            stages.append((*np.split(rates, cuts), *equations.rate(t + c * h, q, v, z)[2]))
        return stages

    def _estimate(
        self,
        equations: ForcedEquations,
        t: float,
        state: StepState,
        h: float,
        stages: list[tuple],  # type: ignore[type-arg]
    ) -> np.ndarray:
        """Return the estimate (2 n + Z,) of the local error."""
        rates = np.array([np.concatenate(stage[:3]) for stage in stages])
        error = np.asarray(h * self._error @ rates)
        if self._is_explicit:
            return error
        y, cuts = np.concatenate([state.q, state.v, state.z]), (equations.n, 2 * equations.n)
        error = error + h * self._first * _rates(equations, t, y, cuts)
        matrix = np.eye(len(y)) - h * self._first * equations.jacobian(t, state.q, state.v, state.z)
        return np.asarray(np.linalg.solve(matrix, error))


def _rates(equations: ForcedEquations, t: float, y: np.ndarray, cuts: tuple[int, int]) -> np.ndarray:
    """Return the derivative of y = (q, v, z) by time."""
    q, v, z = np.split(y, cuts)
    a, _, rates = equations.derivatives(t, q, v, z)
    return np.concatenate([v, a, rates])
