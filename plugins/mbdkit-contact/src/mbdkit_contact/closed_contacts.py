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
        self.n, self.mass, self.modes = self.p.n, self.p.mass, modes
        self.closed = np.flatnonzero(modes != OPEN)
        self.sticks = modes[self.closed] == STICK
        self.m = self.p.m + len(self.closed)
        self._none = np.zeros(self.n)

    def solve(self, t: float, q: np.ndarray, force: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `ConstrainedSystem.solve`."""
        return self.contacts.solution(t, q, force, rows, self.modes)

    def constraints(self, t: float, q: np.ndarray) -> np.ndarray:
        """See `ConstrainedSystem.constraints`."""
        return np.concatenate([self.p.constraints(t, q), self.contacts.kinematics.rows(q, self._none, self.closed).gap])

    def constraint_rates(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """See `ConstrainedSystem.constraint_rates`."""
        rates, slips = self.contacts.kinematics.rows(q, self._none, self.closed).rates(v)
        return np.concatenate([self.p.constraint_rates(t, q, v), rates, slips[self.sticks]])

    def relative_change(self, q: np.ndarray, dq: np.ndarray) -> float:
        """See `ConstrainedSystem.relative_change`."""
        return self.p.relative_change(q, dq)
