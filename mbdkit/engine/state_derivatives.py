"""The first-order form of the equations of motion: (q, v, z)', its Jacobian, and its derivative by time.

Accelerations are differentiated exactly with respect to q and v. Rates of first-order states z, derivatives with
respect to z, and those of mechanisms with friction in joints are central differences.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from mbdkit.engine.kernels.motions import OF_CENTER
from mbdkit.engine.kernels.observe import first_order_rates
from mbdkit.engine.kernels.system import fold_values
from mbdkit.engine.workspace import Workspace

SHARE = float(np.finfo(float).eps ** (1 / 3))
"""Step of a central difference as a share of its argument; it balances truncation and rounding errors."""
LEAST = 0.1
"""Smaller arguments [m, rad, m/s, rad/s, or the unit of a state] count as this large: tendons are short and stiff."""
TIME_STEP = 1e-5
"""Step of a difference by time [s]; the relative error with motions of frequency f is about ``(6 f TIME_STEP)^2``."""

Rates = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Accelerations (n,), multipliers (m,) and rates of first-order states (Z,)."""


def time_difference(values: Callable[[float], np.ndarray], t: float, sides: np.ndarray) -> np.ndarray:
    """Return the derivative by time of a vector, from its values at times between `sides` (2,) [s].

    The difference is central, or one-sided of the same order where a side is closer than the step.
    """
    h = min(max(TIME_STEP, SHARE * 1e-3 * abs(t)), (sides[1] - sides[0]) / 2)
    if t - h < sides[0] or t + h > sides[1]:
        start = max(t, sides[0]) if t - h < sides[0] else min(t, sides[1])
        h = h if t - h < sides[0] else -h
        first, second = start + h, start + 2 * h
        one, two = first - start, second - start
        here = values(start)
        difference: np.ndarray = (values(first) - here) * (two / one) - (values(second) - here) * (one / two)
        return difference / (two - one)
    before, after = t - h, t + h
    return (values(after) - values(before)) / (after - before)


def differences(values: Callable[[np.ndarray], np.ndarray], y: np.ndarray, columns: range) -> np.ndarray:
    """Return the derivatives of a vector (N,) with respect to some components of `y`, (N, columns)."""
    found = []
    for j in columns:
        h = SHARE * max(LEAST, abs(y[j]))
        before, after = y.copy(), y.copy()
        before[j] -= h
        after[j] += h
        found.append((values(after) - values(before)) / (after[j] - before[j]))
    return np.array(found).T


class StateDerivatives:
    """What is constant in the derivatives of the first-order form of one mechanism.

    Parameters
    ----------
    workspace
        The mechanism and its working arrays.
    """

    def __init__(self, workspace: Workspace):
        self._workspace = workspace
        mechanism = workspace.mechanism
        top = mechanism.topology
        # Loads and drivers are motions; laws may use the time.
        self._may_change = len(top.motion_start) - 1 > OF_CENTER * len(top.centers) or len(top.laws) > 0
        self._is_exact = not len(top.frictions)  # they depend on multipliers, which the tangents hold constant
        changing = top.states[top.states[:, 2] >= 0]
        self._coupled = len(changing) > 0 and (bool(np.any(changing[:, 0] >= 0)) or len(top.inputs) > 0)
        index, n = mechanism.row_index.ravel(), 3 * len(mechanism.bodies)
        self.row_places = np.argsort(index, kind="stable")[np.count_nonzero(index < n) :]
        """(m,) place of each solved row in arrays (P, 2)."""

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Place of each term in three matrices, one after another, and its sign."""
        terms, size = self._workspace.terms, self._workspace.unknowns
        part = np.array([0, 1, 1, 2])[terms.factor]
        return (part * size + terms.row) * size + terms.column, np.array([1.0, 1.0, -1.0, 1.0])[terms.factor]

    def evaluated(
        self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray, checked: Callable[[Callable[[], int]], None]
    ) -> Rates:
        """Return accelerations (n,), multipliers (m,) and rates (Z,); `checked` calls the kernel."""
        n, workspace = len(q), self._workspace
        y = np.concatenate([q, v, (0.0, 0.0), z])
        out, acc = np.empty(len(y)), np.zeros((3, workspace.mechanism.size))
        lam = np.zeros((len(workspace.mechanism.topology.pairs), 2))
        checked(lambda: first_order_rates(workspace.stepping_engine, False, t, y, acc, lam, out))
        fold_values(workspace.mechanism.topology, workspace.scratch.cs, lam)
        return out[n : 2 * n], lam.ravel()[self.row_places], out[2 * n + 2 :]

    def by_time(self, t: float, derivatives: Callable[[float], Rates]) -> Rates:
        """Return the derivatives by time [s] of what `derivatives` returns; zeros if nothing depends on time."""
        n, m = 3 * len(self._workspace.mechanism.bodies), len(self.row_places)
        if not self._may_change:
            return np.zeros(n), np.zeros(m), np.zeros(len(self._workspace.mechanism.states))
        found = time_difference(lambda at: np.concatenate(derivatives(at)), t, self._workspace.scratch.sides)
        return found[:n], found[n : n + m], found[n + m :]

    def jacobian(
        self,
        q: np.ndarray,
        v: np.ndarray,
        z: np.ndarray,
        derivatives: Callable[[np.ndarray, np.ndarray, np.ndarray], Rates],
    ) -> np.ndarray:
        """Return the derivatives of (v, a, z') with respect to (q, v, z); requires the tangents at this state.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the system is singular.
        """
        n, y = len(q), np.concatenate([q, v, z])

        def rates(x: np.ndarray) -> np.ndarray:
            a, _, z_rates = derivatives(x[:n], x[n : 2 * n], x[2 * n :])
            return np.concatenate([a, z_rates])

        out = np.zeros((len(y), len(y)))
        out[:n, n : 2 * n] = np.eye(n)
        exact = self._accelerations_by_state() if self._is_exact else None
        first = 0 if exact is None or self._coupled else 2 * n
        if first < len(y):
            out[n:, first:] = differences(rates, y, range(first, len(y)))
        if exact is not None:
            out[n : 2 * n, : 2 * n] = exact
        return out

    def _accelerations_by_state(self) -> np.ndarray:
        """Return the derivatives of the accelerations with respect to q and v (n, 2 n), from the last tangents."""
        workspace, (places, sign) = self._workspace, self._places
        size, n = workspace.unknowns, 3 * len(workspace.mechanism.bodies)
        values = sign * workspace.scratch.source[workspace.terms.source]
        parts = np.bincount(places, values, 3 * size * size).reshape(3, size, size)
        return -np.linalg.solve(parts[0], np.concatenate([parts[2][:, :n], parts[1][:, :n]], axis=1))[:n]
