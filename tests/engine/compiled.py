"""What the tests of this room ask of a compiled mechanism, in plain arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.observe import constraints_at, first_order_rates, tangents_at
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.mechanism import Mechanism

OK = 0


class Compiled:
    """A mechanism at a state, with what its kernels say of it.

    Parameters
    ----------
    mechanism
        The mechanism; its initial values are the state.
    t
        Time [s].
    """

    def __init__(self, mechanism: Mechanism, t: float = 0.0):
        bodies = mechanism.bodies.values()
        self.mechanism, self.t = mechanism, t
        self.compiled: CompiledMechanism = compile_mechanism(mechanism)
        self.q = np.array([(*body.position, body.angle) for body in bodies] + [(0.0, 0.0, 0.0)]).ravel()
        self.v = np.array([(*body.velocity, body.angular_velocity) for body in bodies] + [(0.0, 0.0, 0.0)]).ravel()
        self.n = len(self.q) - 3
        self.workspace = Workspace(self.compiled, t, self.q, self.v)

    @property
    def top(self) -> Any:
        return self.compiled.topology

    @property
    def scratch(self) -> Any:
        return self.workspace.scratch

    def constraints(self, q: np.ndarray, v: np.ndarray | None = None, t: float | None = None) -> Any:
        """Return Phi, Phi_t, the Jacobian (m, 3 B) and gamma as the kernels have them, rows in the order of labels."""
        at = self.t if t is None else t
        constraints_at(self.top, self.scratch, at, q, np.zeros_like(q) if v is None else v)
        w = self.scratch
        rows = [(row.pair, row.place) for row in self.compiled.rows]
        jacobian = np.zeros((len(rows), len(q)))
        for i, (pair, place) in enumerate(rows):
            for side in range(2):
                body = self.top.pairs[pair, PAIR.first + side]
                columns = slice(6 * place + 3 * side, 6 * place + 3 * side + 3)
                jacobian[i, 3 * body : 3 * body + 3] += w.jac[pair, columns]
        values = (np.array([x[row] for row in rows]) for x in (w.phi, w.phi_t, w.gamma))
        phi, phi_t, gamma = values
        return phi, phi_t, jacobian[:, : self.n], gamma

    def accelerations(self, *, pivoted: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Return accelerations (3 B,) and multipliers (m,) in the order of the rows' labels."""
        _, acc, lam = self.observed(pivoted=pivoted)[:3]
        return acc, np.array([lam[row.pair, row.place] for row in self.compiled.rows])

    def observed(self, *, pivoted: bool = False) -> Any:
        """Return what `observe` says: kinetic and potential energy, accelerations, multipliers, reactions."""
        if pivoted:
            constraints_at(self.top, self.scratch, self.t, self.q, self.v)
            self.workspace.use_pivots()
        observer = StateObserver(self.workspace)
        found = observer.arrays(1)
        assert observer.observe(np.array([self.t]), self.q[None], self.v[None], found) is None
        energies = float(found.kinetic[0]), float(found.potential[0])
        return energies, found.acc[0, : self.n], found.lam[0], found.reactions[0]

    def tangents(self) -> None:
        """Evaluate forces and all tangents into the scratch."""
        acc, lam = np.zeros(len(self.q)), np.zeros((len(self.top.pairs), 2))
        assert tangents_at(self.workspace.engine, self.t, self.q, self.v, acc, lam) == OK

    def powers(self) -> tuple[float, float]:
        """Return the power of loads and drivers and the dissipated power [W]."""
        y = np.concatenate([self.q[: self.n], self.v[: self.n], np.zeros(2)])
        acc, lam = np.zeros((3, len(self.q))), np.zeros((len(self.top.pairs), 2))
        rates = np.zeros(len(y))
        assert first_order_rates(self.workspace.engine, True, self.t, y, acc, lam, rates) == OK
        return float(rates[-2]), float(rates[-1])


STEP = 1e-200


def gradient(function: Callable[[Any], Any], at: np.ndarray) -> np.ndarray:
    """Return the derivatives of `function` by `at`, along the last axis, by complex step."""
    return np.stack([np.asarray(function(at + 1j * STEP * e)).imag / STEP for e in np.eye(len(at))], axis=-1)


def place(q: Any, body: int, point: tuple[float, float]) -> Any:
    """Return where `point` of `body` is, for complex `q` too."""
    c, s = np.cos(q[3 * body + 2]), np.sin(q[3 * body + 2])
    return np.array([q[3 * body] + c * point[0] - s * point[1], q[3 * body + 1] + s * point[0] + c * point[1]])


def assert_close(found: Any, expected: Any, tolerance: float = 1e-12, size: float = 0.0) -> None:
    """Assert equality to `tolerance` of the largest number that took part."""
    scale = max(size, float(np.max(np.abs(expected), initial=0.0)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * scale)
