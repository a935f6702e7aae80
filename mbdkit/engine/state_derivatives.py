"""The first-order form of the equations of motion: (q, v, z)', its Jacobian, and its derivative by time.

Accelerations are differentiated exactly with respect to q and v. Rates of first-order states z, derivatives with
respect to z, and those of mechanisms with friction in joints are central differences.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TypeVar

import numpy as np

from mbdkit.engine.iteration_matrix import StateTangents, put
from mbdkit.engine.kernels.motions import OF_CENTER
from mbdkit.engine.kernels.observe import first_order_rates
from mbdkit.engine.kernels.system import fold_values
from mbdkit.engine.kernels.table_rows import STATE_ROW
from mbdkit.engine.linear_systems import factors_of
from mbdkit.engine.repeated_call import RepeatedCall
from mbdkit.engine.workspace import Workspace

#: Step of a central difference as a share of its argument; it balances truncation and rounding errors.
SHARE = float(np.finfo(float).eps ** (1 / 3))
#: Smaller arguments [m, rad, m/s, rad/s, or the unit of a state] count as this large: tendons are short and stiff.
LEAST = 0.1
#: Step of a difference by time [s]; the relative error with motions of frequency f is about ``(6 f TIME_STEP)^2``.
TIME_STEP = 1e-5

#: Accelerations (n,), multipliers (m,) and rates of first-order states (Z,).
Rates = tuple[np.ndarray, np.ndarray, np.ndarray]

T = TypeVar("T")
OfState = Callable[[np.ndarray, np.ndarray, np.ndarray], T]  #: A function of positions, velocities and states.
Kernel = Callable[[float], int]  #: A kernel that takes the time and returns a status.


def time_difference(values: Callable[[float], np.ndarray], t: float, sides: np.ndarray) -> np.ndarray:
    """Return the derivative by time of a vector, from its values at times between `sides` (2,) [s].

    The difference is central, or one-sided of the same order where a side is closer than the step.
    """
    h = min(max(TIME_STEP, SHARE * 1e-3 * abs(t)), (sides[1] - sides[0]) / 2)
    if t - h < sides[0] or t + h > sides[1]:
        start = max(t, sides[0]) if t - h < sides[0] else min(t, sides[1])
        h = h if t - h < sides[0] else -h
        first, second = start + h, start + 2 * h
        near, far = first - start, second - start
        here = values(start)
        difference: np.ndarray = (values(first) - here) * (far / near) - (values(second) - here) * (near / far)
        return difference / (far - near)
    before, after = t - h, t + h
    return (values(after) - values(before)) / (after - before)


def differences(values: Callable[[np.ndarray], np.ndarray], y: np.ndarray, columns: range) -> np.ndarray:
    """Return the derivatives of a vector (N,) with respect to some components of `y`, (N, columns)."""
    tangents = []
    for j in columns:
        h = SHARE * max(LEAST, abs(y[j]))
        before, after = y.copy(), y.copy()
        before[j] -= h
        after[j] += h
        tangents.append((values(after) - values(before)) / (after[j] - before[j]))
    return np.array(tangents).T


class StateDerivatives:
    """What is constant in the derivatives of the first-order form of one mechanism.

    `workspace`: the mechanism and its working arrays.
    """

    def __init__(self, workspace: Workspace):
        self._workspace = workspace
        mechanism = workspace.mechanism
        top = mechanism.topology
        # Loads and drivers are motions; laws may use the time.
        self._may_change = len(top.motion_start) - 1 > OF_CENTER * len(top.centers) or len(top.laws) > 0
        self._is_exact = not len(top.frictions)  # they depend on multipliers, which the tangents hold constant
        changing = top.states[top.states[:, STATE_ROW.rate] >= 0]
        self._coupled = len(changing) > 0 and (bool(np.any(changing[:, 0] >= 0)) or len(top.inputs) > 0)
        n, count, pairs = 3 * len(mechanism.bodies), len(top.states), len(top.pairs)
        index = mechanism.row_index.ravel()
        self._row_places = np.argsort(index, kind="stable")[np.count_nonzero(index < n) :]  # of solved rows, in (P, 2)
        size = 2 * n + 2 + count
        y, self._found = np.zeros(size), np.zeros(size + 2 * pairs)
        self._q, self._v, self._z = y[:n], y[n : 2 * n], y[2 * n + 2 :]
        self._a, self._rates = self._found[n : 2 * n], self._found[2 * n + 2 : size]
        self._lam = self._found[size:].reshape(pairs, 2)
        acc = np.zeros((3, mechanism.size))
        engine = workspace.stepping_engine
        self._kernel = RepeatedCall(first_order_rates, engine, False, None, y, acc, self._lam, self._found[:size])

    def evaluated(
        self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray, checked: Callable[[Kernel, float], None]
    ) -> Rates | None:
        """Return accelerations, multipliers and rates, or None if they are not finite; `checked` calls the kernel."""
        put(self._q, q)
        put(self._v, v)
        put(self._z, z)
        checked(self._kernel, t)
        fold_values(self._workspace.mechanism.topology, self._workspace.scratch.cs, self._lam)
        if not np.isfinite(self._found).all():
            return None
        return self._a.copy(), self._lam.ravel()[self._row_places], self._rates.copy()

    def by_time(self, t: float, derivatives: Callable[[float], Rates]) -> Rates:
        """Return the derivatives by time [s] of what `derivatives` returns; zeros if nothing depends on time."""
        n, m = len(self._q), len(self._row_places)
        if not self._may_change:
            return np.zeros(n), np.zeros(m), np.zeros(len(self._z))
        derivative = time_difference(lambda at: np.concatenate(derivatives(at)), t, self._workspace.scratch.sides)
        return derivative[:n], derivative[n : n + m], derivative[n + m :]

    def tangents(
        self, q: np.ndarray, v: np.ndarray, z: np.ndarray, residual: Callable[[np.ndarray], np.ndarray],
        rates: OfState[np.ndarray],
    ) -> StateTangents:  # fmt: skip
        """Return the derivatives that involve z, of ``residual(z)`` and ``rates(q, v, z)``."""
        n, y = len(q), np.concatenate([q, v, z])
        first = 0 if self._coupled else 2 * n
        by_state = np.zeros((len(z), len(y)))
        by_state[:, first:] = differences(lambda x: rates(*np.split(x, (n, 2 * n))), y, range(first, len(y)))
        force_z = differences(residual, z, range(len(z)))
        return StateTangents(force_z, *np.split(by_state, (n, 2 * n), axis=1))

    def jacobian(self, q: np.ndarray, v: np.ndarray, z: np.ndarray, derivatives: OfState[Rates]) -> np.ndarray:
        """Return the derivatives of (v, a, z') with respect to (q, v, z); requires the tangents at this state.

        Raises numpy.linalg.LinAlgError if the system is singular.
        """
        n, y = len(q), np.concatenate([q, v, z])

        def rates(x: np.ndarray) -> np.ndarray:
            a, _, z_rates = derivatives(x[:n], x[n : 2 * n], x[2 * n :])
            return np.concatenate([a, z_rates])

        out = np.zeros((len(y), len(y)))
        out[:n, n : 2 * n].flat[:: n + 1] = 1.0
        exact = self._accelerations_by_state() if self._is_exact else None
        first = 0 if exact is None or self._coupled else 2 * n
        if first < len(y):
            out[n:, first:] = differences(rates, y, range(first, len(y)))
        if exact is not None:
            out[n : 2 * n, : 2 * n] = exact
        return out

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Place of each term in the matrix of `_accelerations_by_state`, and its sign."""
        terms, n, size = self._workspace.terms, len(self._q), self._workspace.unknowns
        first = np.array([0, size + n, size + n, size])[terms.factor]
        return terms.row * (size + 2 * n) + first + terms.column, np.array([1.0, -1.0, 1.0, -1.0])[terms.factor]

    def _accelerations_by_state(self) -> np.ndarray:
        """Return the derivatives of the accelerations with respect to q and v (n, 2 n), from the last tangents."""
        workspace, (places, sign), n = self._workspace, self._places, len(self._q)
        size, values = workspace.unknowns, sign * workspace.scratch.source[workspace.terms.source]
        matrix = np.bincount(places, values, size * (size + 2 * n)).reshape(
            size, -1
        )  # index-1 matrix, right-hand sides
        return factors_of(matrix[:, :size]).solve(matrix[:, size:].T).T[:n]
