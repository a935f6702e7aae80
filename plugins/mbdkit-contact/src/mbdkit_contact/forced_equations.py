"""The equations of motion between two events of rigid contacts, for methods that evaluate accelerations only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.mechanism.contacts import OPEN

if TYPE_CHECKING:
    from mbdkit_contact.rigid_contacts import RigidContacts

_PLAIN = (
    *("n", "m", "mass", "t0", "q0", "v0", "length", "bodies", "constraint_names", "counters", "formulation"),
    *(
        "stabilization",
        "has_power",
        "first_step",
        "kinetic",
        "potential",
        "constraints",
        "constraint_rates",
        "contacts",
    ),
    "relative_change",
)
"""What contacts do not change."""


class ForcedEquations:
    """Stands for `EquationsOfMotion`: closed contacts act on the accelerations.

    Parameters
    ----------
    contacts
        The contacts.
    modes
        (C,) their modes, which do not change between events.
    """

    z0 = np.zeros(0)

    def __init__(self, contacts: RigidContacts, modes: np.ndarray):
        self._contacts, self._modes = contacts, modes

    def __getattr__(self, name: str) -> Any:
        if name in _PLAIN:
            return getattr(self._contacts.p, name)
        raise AttributeError(
            f"the treatment event-driven offers a method accelerations and derivatives, but not `equations.{name}`"
        )

    def accelerations(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `EquationsOfMotion.accelerations`."""
        forced = self._contacts.accelerations(t, q, v, self._modes, only_closed=True)
        return forced.a, forced.multipliers

    def derivatives(
        self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `EquationsOfMotion.derivatives`; there are no first-order states."""
        return *self.accelerations(t, q, v), self.z0

    def rate(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, float, float]:
        """Return the accelerations (n,), the power of loads and drivers, and the dissipated power [W]."""
        forced = self._contacts.accelerations(t, q, v, self._modes, only_closed=True)
        work, lost = self._contacts.p.powers(t, q, v, forced.multipliers)
        return forced.a, work, lost - float(forced.tangent[self._modes != OPEN] @ forced.rows.slip)
