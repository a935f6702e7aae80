"""Joints and closed contacts as one system of constraints."""

from __future__ import annotations

import numpy as np

from mbdkit.mechanism.contacts import OPEN, STICK
from mbdkit_contact.rigid_contacts import RigidContacts


class ClosedSystem:
    """Joints and closed contacts as one system of constraints; see `mbdkit.engine.nearest_state.ConstrainedSystem`.

    The positions satisfy one constraint for each closed contact: its gap is zero. The velocities satisfy another one
    for each contact that sticks: its slip is zero.
    """

    def __init__(self, contacts: RigidContacts, modes: np.ndarray):
        self.contacts, self.p = contacts, contacts.p
        self.n, self.mass = self.p.n, self.p.mass
        self.closed, self.sticking = np.flatnonzero(modes != OPEN), np.flatnonzero(modes == STICK)
        self.m = self.p.m + len(self.closed)
        self._none = np.zeros(self.n)

    def _held(self, q: np.ndarray, *, is_of_velocities: bool) -> np.ndarray:
        rows = self.contacts.kinematics.rows(q, self._none, self.closed)
        sticking = np.isin(self.closed, self.sticking) & is_of_velocities
        return np.vstack([rows.normal, rows.tangent[sticking]])

    def solve(self, t: float, q: np.ndarray, force: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `ConstrainedSystem.solve`."""
        x, mu = self.p.solve(t, q, force, rows[: self.p.m])
        held = self._held(q, is_of_velocities=len(rows) > self.m)
        if not len(held):
            return x, mu
        moved, loaded = self.contacts.answers(t, q, held)
        forces = np.linalg.lstsq(held @ moved, rows[self.p.m :] - held @ x, rcond=1e-11)[0]
        return x + moved @ forces, mu + loaded @ forces

    def constraints(self, t: float, q: np.ndarray) -> np.ndarray:
        """See `ConstrainedSystem.constraints`."""
        return np.concatenate([self.p.constraints(t, q), self.contacts.kinematics.rows(q, self._none, self.closed).gap])

    def constraint_rates(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """See `ConstrainedSystem.constraint_rates`."""
        return np.concatenate([self.p.constraint_rates(t, q, v), self._held(q, is_of_velocities=True) @ v])

    def relative_change(self, q: np.ndarray, dq: np.ndarray) -> float:
        """See `ConstrainedSystem.relative_change`."""
        return self.p.relative_change(q, dq)
