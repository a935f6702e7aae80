"""Rigid contacts of a mechanism, and the first-order states that hold their forces and modes."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.methods.step_methods import StepState
from mbdkit_contact.acting_contacts import ActingContact
from mbdkit_contact.contact_kinematics import EXACT, arms_of, shapes_of
from mbdkit_contact.contact_state import ContactState, HeldForces

NEAR = 1e-3  #: Gap, relative to the length of the mechanism, up to which two shapes count as near each other.
FEW = 8  #: Up to this number of contacts, all gaps are computed exactly.


def zeros(shapes: Mapping[str, tuple[int, ...]], kind: type = float) -> dict[str, np.ndarray]:
    """Return arrays by name; the keys are names of arrays of the same shape, separated by spaces."""
    return {name: np.zeros(shape, dtype=kind) for names, shape in shapes.items() for name in names.split()}


class RigidContacts:
    """Contacts of a mechanism in one run.

    Parameters
    ----------
    equations
        The equations of motion, whose forces do not include those of contacts.
    only_reacting
        Whether compliant contacts are left out.

    Attributes
    ----------
    coefficients
        (C, 3) coefficients of restitution, and of static and kinetic friction.
    shapes
        Their geometry, with the features at which closed contacts stay.
    arms
        (C, 2) see `mbdkit_contact.kernels.event_bundle.Touch`.
    reach
        Largest gap that time-stepping always computes exactly [m].
    """

    def __init__(self, equations: EquationsOfMotion, *, only_reacting: bool = True):
        self.p = equations
        acting: tuple[ActingContact, ...] = equations.workspace.mechanism.extensions.get("contacts", ())
        self.contacts = tuple(contact for contact in acting if contact.first_state >= 0 or not only_reacting)
        self.held = HeldForces(self.contacts)
        #: Whether a first-order state (Z,) does not belong to contacts.
        self._is_own = np.ones(len(equations.z0), dtype=bool)
        self._is_own[self.held.states] = False
        self.names = [contact.pair.name for contact in self.contacts]
        self.coefficients = np.array([contact.coefficients for contact in self.contacts]).reshape(-1, 3)
        self.shapes = shapes_of(self.contacts, equations.n // 3, EXACT * equations.length)
        self.arms = arms_of(self.shapes)
        self.reach = NEAR * equations.length if len(self.contacts) > FEW else math.inf

    def named(self, marked: np.ndarray) -> frozenset[str]:
        """Return the names of the contacts for which an array (C,) is not 0."""
        return frozenset(self.names[i] for i in np.flatnonzero(marked).tolist())

    def own(self, z: np.ndarray) -> np.ndarray:
        """Return those of the first-order states (Z,) that do not belong to contacts."""
        return z[self._is_own]

    def all_states(self, own: np.ndarray, memory: ContactState | None = None) -> np.ndarray:
        """Return all first-order states (Z,), with the contact forces in a memory or without any."""
        z = np.zeros(len(self._is_own))
        z[self._is_own] = own
        if memory is not None:
            z[self.held.states] = self.held.of(memory)
        return z

    def hold(self, own: np.ndarray) -> None:
        """Use values of the states that do not belong to contacts in later evaluations, without contact forces."""
        self.p.hold(self.all_states(own))

    def all_open(self) -> ContactState:
        """Return the `ContactState` of open contacts, without forces."""
        count = len(self.contacts)
        return ContactState(np.zeros(count, dtype=int), np.zeros(count), np.zeros(count), np.zeros(self.p.n))

    def begun(self, state: StepState) -> ContactState:
        """Return the `ContactState` of a step that begins anew at a state: it determines the modes."""
        return (self.all_open() if state.memory is None else state.memory).after_stop()
