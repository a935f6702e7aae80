"""First-order states in statics and in small motions: their values at rest, and their derivatives.

The states z have the rates ``z' = g(t, q, v, z)``. At rest, they satisfy ``g(t, q, 0, z) = 0``, which is solved for
every position q that a search for an equilibrium tries. The applied forces Q are then a function of q alone, with the
stiffness

    K = -dQ/dq + Q_z g_z^-1 g_q

Subscripts denote partial derivatives. Q_z and the derivatives of g are computed by differences of order 8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from mbdkit.base.errors import SpecError, StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.tangents import Tangents
from mbdkit.engine.workspace import Workspace

MOST_ITERATIONS = 50  #: Largest number of Newton steps for the states at rest.

#: Criteria of convergence of Newton's method for the states.
#:
#: The method has converged if the relative change of the states is at most `SMALL`. It has also converged if the change
#: is at most `NEGLIGIBLE`, and at least `STALLED` times the previous change, so that it is round-off.
SMALL, STALLED, NEGLIGIBLE = 1e-15, 0.5, 1e-9

#: Changes of a state are relative to its magnitude, or to this share of the largest state if that is larger.
LEAST = 1e-6

#: Distance between the points of differences, as a share of 1 rad, of the size of the mechanism, or of the magnitude of
#: a state (at least 1).
DISTANCE = 2.0**-10

PLACES = (-4, -3, -2, -1, 1, 2, 3, 4)
#: Points and weights of differences of order 8.
WEIGHTS = (1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280)


class StatesAtRest:
    """The first-order states of a mechanism at given positions; inputs have their initial values.

    The states of inputs come last. Derivatives are those of and with respect to the others, F of all Z states.

    Parameters
    ----------
    workspace
        The mechanism at its start.
    equations
        The equations of motion of the mechanism.

    Raises
    ------
    SpecError
        If the mechanism has sampled controllers.
    """

    def __init__(self, workspace: Workspace, equations: EquationsOfMotion):
        mechanism = workspace.mechanism
        if mechanism.controllers:
            names = ", ".join(controller.name for controller in mechanism.controllers)
            raise SpecError(
                f"an equilibrium does not include sampled controllers ({names}); write their outputs as loads",
                key="model.controllers",
            )
        self._workspace, self._p = workspace, equations
        self.names = tuple(state.name for state in mechanism.named_states)
        self.z = mechanism.initial_states.copy()

    def forces(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the generalized applied forces (n,)."""
        self.use(z)
        return self._p.forces(t, q, v)

    def use(self, z: np.ndarray) -> None:
        """Use these states in later evaluations."""
        self._workspace.take_states(z)

    def solve(self, t: float, q: np.ndarray) -> np.ndarray:
        """Return the states (Z,) at rest in a position (n,).

        Raises
        ------
        StepError
            If there are no such states, or if the position does not determine them.
        """
        rest, z, before, free = np.zeros_like(q), self.z.copy(), np.inf, slice(len(self.names))
        for _ in range(MOST_ITERATIONS):
            rate, slope = self._p.rates(t, q, rest, z)[free], self.by_states(t, q, rest, z)[1]
            try:
                change = -np.linalg.solve(slope, rate)
            except np.linalg.LinAlgError:
                break
            if not np.all(np.isfinite(change)):
                break
            z[free] += change
            size = np.maximum(np.abs(z[free]), LEAST * np.max(np.abs(z)))
            shares = np.divide(np.abs(change), size, out=np.where(change == 0.0, 0.0, np.inf), where=size > 0.0)
            now = float(np.max(shares, initial=0.0))
            if now <= SMALL or (now >= STALLED * before and now <= NEGLIGIBLE):
                self.z = z
                return z
            before = now
        names = ", ".join(self.names)
        raise StepError(
            "newton-failed",
            f"the first-order states ({names}) have values at rest that the position does not determine; this "
            f"happens if the rate of a state does not depend on the states",
        )

    def by_states(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of the forces (n, F) and of the rates (F, F) with respect to the states."""
        return self._by(range(len(self.names)), t, q, v, z)

    def by_inputs(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of the forces (n, U) and of the rates (F, U) with respect to the inputs."""
        return self._by([item.state for item in self._workspace.mechanism.inputs], t, q, v, z)

    def _by(
        self, columns: Sequence[int], t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        n, size, count = len(q), np.maximum(np.abs(z), 1.0), len(self.names)
        both = self._differences(
            lambda x: np.concatenate([self.forces(t, q, v, x), self._p.rates(t, q, v, x)]), z, DISTANCE * size
        )[:, list(columns)]
        return both[:n], both[n : n + count]

    def rates_by_motion(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of the rates with respect to the positions, and with respect to the velocities, both
        (F, n).
        """
        length = self._workspace.mechanism.length
        size = DISTANCE * np.tile([length, length, 1.0], len(q) // 3)
        by_position = self._differences(lambda x: self._p.rates(t, x, v, z), q, size)
        by_velocity = self._differences(lambda x: self._p.rates(t, q, x, z), v, size)
        return by_position[: len(self.names)], by_velocity[: len(self.names)]

    @staticmethod
    def _differences(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Return the derivatives (..., len(x)) of a function with respect to each entry of `x`."""
        columns = []
        for k, unit in enumerate(distance):
            total: np.ndarray | float = 0.0
            for place, weight in zip(PLACES, WEIGHTS, strict=True):
                moved = x.copy()
                moved[k] += place * unit
                total = total + weight / unit * function(moved)
            columns.append(total)
        return np.array(columns).T


@dataclass(frozen=True)
class CoupledStates:
    """Small motions of first-order states: ``z' = by_position y + by_velocity y' + by_state z``.

    The states cause the accelerations ``force z`` of the degrees of freedom y.

    Attributes
    ----------
    names
        Names of the Z states.
    force : (f, Z) array
        Derivatives of the accelerations with respect to the states.
    by_position, by_velocity, by_state : (Z, f), (Z, f) and (Z, Z) arrays
        Derivatives of the rates.
    inputs
        Names of the U inputs of the mechanism.
    by_input : (f + Z, U) array
        Derivatives of the accelerations and of the rates with respect to the inputs.
    """

    names: tuple[str, ...]
    force: np.ndarray
    by_position: np.ndarray
    by_velocity: np.ndarray
    by_state: np.ndarray
    inputs: tuple[str, ...]
    by_input: np.ndarray


def first_order_form(stiffness: np.ndarray, damping: np.ndarray, states: CoupledStates | None = None) -> np.ndarray:
    """Return the matrix of the first-order form of ``y'' + damping y' + stiffness y = 0``, for ``(y, y')`` or, with
    coupled states, ``(y, y', z)``.
    """
    f = len(stiffness)
    rows = [[np.zeros((f, f)), np.eye(f)], [-stiffness, -damping]]
    if states is not None:
        rows = [[*rows[0], np.zeros((f, len(states.names)))], [*rows[1], states.force]]
        rows.append([states.by_position, states.by_velocity, states.by_state])
    return np.block(rows)


class StaticEquations(EquationsOfMotion):
    """Equations of motion at rest; the position determines the first-order states, see `StatesAtRest.solve`."""

    def __init__(self, workspace: Workspace):
        super().__init__(workspace)
        self.states = StatesAtRest(workspace, EquationsOfMotion(workspace))

    def residual(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """See `EquationsOfMotion.residual`."""
        self.states.use(self.states.solve(t, q))
        return super().residual(t, q, v, a, lam)

    def _sparse_tangents(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> Tangents:
        # the stiffness is that of slow motions, in which the states stay at their values at rest
        states = self.states
        z = states.solve(t, q)
        force, rate = states.by_states(t, q, v, z)
        by_position, _ = states.rates_by_motion(t, q, v, z)
        states.use(z)
        result = super()._sparse_tangents(t, q, v, a, lam)
        return replace(result, stiffness=csr_array(result.stiffness + force @ np.linalg.solve(rate, by_position)))
