"""The equations of motion between two events of rigid contacts, whose modes do not change there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.linear_systems import factors_of
from mbdkit.engine.state_derivatives import differences
from mbdkit.engine.tangents import Tangents

if TYPE_CHECKING:
    from mbdkit.engine.counters import Counters
    from mbdkit_contact.events_of_contacts import ContactEvents

Rates = tuple[np.ndarray, np.ndarray, np.ndarray]
Powers = tuple[float, float]  #: Power of loads and drivers, and dissipated power [W].


class ForcedEquations(EquationsOfMotion):
    """Equations of motion on which closed contacts act, as loads that are functions of time and state.

    The loads are those with which the gaps of closed contacts, and the slips of those that stick, do not accelerate;
    they act while `ContactEvents.acting` is in force. First-order states are those that do not belong to contacts.
    Derivatives are central differences.

    Parameters
    ----------
    events
        The contacts, in their present modes.
    """

    def __init__(self, events: ContactEvents):
        self.__dict__.update(events.p.__dict__)  # the arrays and counters of the same run
        self._events, self._contacts, self._derived = events, events.contacts, {}
        self._own = self.z0 = self._contacts.own(events.p.z0)
        self.has_power = events.p.has_power or bool(np.any(self._contacts.coefficients[:, 2] > 0.0))

    def hold(self, z: np.ndarray) -> None:
        """See `EquationsOfMotion.hold`."""
        self._own = z
        self._contacts.hold(z)

    def powers(self, t: float, q: np.ndarray, v: np.ndarray, lam: np.ndarray) -> Powers:
        """See `EquationsOfMotion.powers`; the dissipated power includes that of friction."""
        self.accelerations(t, q, v)  # which evaluates the forces of contacts at this state
        return super().powers(t, q, v, lam)

    def jacobian(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        """See `EquationsOfMotion.jacobian`."""
        n, y = self.n, np.concatenate([q, v, z])

        def rates(x: np.ndarray) -> np.ndarray:
            a, _, z_rates = self.derivatives(t, x[:n], x[n : 2 * n], x[2 * n :])
            return np.concatenate([x[n : 2 * n], a, z_rates])

        self.counters.jacobian_evaluations += 1
        by_state = differences(rates, y, range(len(y)))
        self.hold(z)
        return by_state

    def time_derivative(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Rates:
        """See `EquationsOfMotion.time_derivative`."""
        a, lam, rates = super().time_derivative(t, q, v, z)
        return a, lam, rates if len(rates) == len(z) else self._contacts.own(rates)

    def _residual(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> np.ndarray:
        return super()._residual(t, q, v, a, lam) - self._push(t, q, v)

    def _derivatives(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Rates:
        self._own = z
        a, lam, rates = self._events.p._derivatives(t, q, v, self._contacts.all_states(z))
        self._events.raise_failure()
        return a, lam, self._contacts.own(rates)

    def _not_finite(self) -> StepError:
        return self._events.failure or super()._not_finite()

    def _sparse_tangents(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> Tangents:
        from scipy.sparse import csr_array

        n = self.n
        by_q = differences(lambda x: self._push(t, x, v), np.asarray(q, dtype=float), range(n))
        by_v = differences(lambda x: self._push(t, q, x), np.asarray(v, dtype=float), range(n))
        parts = self._events.p.tangents(t, q, v, a, lam)
        stiffness, damping = csr_array(parts.stiffness.toarray() - by_q), csr_array(parts.damping.toarray() - by_v)
        return Tangents(stiffness, damping, parts.gamma_v, parts.residual_q)

    def _matrix(
        self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray, factors: np.ndarray
    ) -> Any:
        mass, _, damping, stiffness, gamma_v, residual_q = factors
        parts, rows = self.tangents(t, q, v, a, lam), self.constraint_jacobian(t, q).toarray()
        upper = damping * parts.damping.toarray() + stiffness * parts.stiffness.toarray() + mass * np.diag(self.mass)
        lower = rows + gamma_v * parts.gamma_v.toarray() + residual_q * parts.residual_q.toarray()
        self.counters.factorizations += 1
        return _Dense(np.block([[upper, rows.T], [lower, np.zeros((self.m, self.m))]]), self.n, self.counters)

    def _push(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the generalized forces (n,) of closed contacts."""
        events = self._events
        events.at(t, q, v, self._own)
        events.show_forces()
        return events.bundle.known.force[:-3].copy()


class _Dense:
    """A factorized matrix; see `mbdkit.engine.iteration_matrix.IterationMatrix`."""

    def __init__(self, matrix: np.ndarray, n: int, counters: Counters):
        self._n, self._counters = n, counters
        self._scale = 1.0 / np.maximum(np.max(np.abs(matrix), axis=1, initial=0.0), 1e-300)
        if not np.all(np.isfinite(matrix)):
            raise StepError("not-finite", "the matrix of an iteration is not finite")
        try:
            self._factors = factors_of(self._scale[:, None] * matrix)
        except np.linalg.LinAlgError:
            raise StepError("singular", "the matrix of the iteration is singular") from None

    def solve(self, force: Sequence[float] | np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `IterationMatrix.solve`."""
        self._counters.newton_iterations += 1
        x = self._factors.solve(self._scale * np.concatenate([force, rows])[None])[0]
        if not np.all(np.isfinite(x)):
            raise StepError("singular", "the matrix of the iteration is singular")
        return x[: self._n], x[self._n :]
