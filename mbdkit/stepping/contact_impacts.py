"""Impacts of rigid contacts: impulses by the laws of Newton, Poisson or Stronge, with Coulomb friction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.stepping.complementarity import coulomb, stronge
from mbdkit.stepping.rigid_contacts import RigidContacts

SMALL_RESTITUTION = 1e-3
"""If an impact would gain energy, the coefficients of restitution are reduced in steps of 10 %; values up to this are
set to 0.
"""


class Struck(NamedTuple):
    """Result of an impact.

    Velocities (n,) after it, impulses (C,) of the contacts [N s], impulses (m,) of the joint constraints, and whether
    the impact law was the one chosen for the run.
    """

    v: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    multipliers: np.ndarray
    is_as_asked: bool


def struck(
    contacts: RigidContacts, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray, e: np.ndarray, law: str
) -> Struck:
    """Return the result of an impact of touching contacts.

    Parameters
    ----------
    contacts
        The contacts and the equations of motion that they act on.
    touching
        (C,) whether a contact is closed.
    e
        (C,) coefficients of restitution.
    law
        ``newton`` or ``poisson``.

    Raises
    ------
    StepError
        ``contact-solver`` if no impulses satisfy the law.
    """
    some, rows = np.flatnonzero(touching), contacts.kinematics.rows(q, v)
    response, both = contacts.response(t, q, rows, some)
    before = both @ v
    own = e[some]
    impulses = _impulses(contacts, law, response, before, own, some)
    is_asked = not _gains(response, before, impulses)
    if not is_asked and len(some) == 1:
        impulses = stronge(response, before, float(contacts.kinetic[some[0]]), float(own[0]))
    while _gains(response, before, impulses) and np.any(own):
        own = np.where(own > SMALL_RESTITUTION, 0.9 * own, 0.0)
        impulses = _impulses(contacts, "poisson", response, before, own, some)
    normal, tangent = np.zeros(len(touching)), np.zeros(len(touching))
    normal[some], tangent[some] = np.split(impulses, 2)
    moved, loaded = contacts.answers(t, q, both)
    return Struck(v + moved @ impulses, normal, tangent, loaded @ impulses, is_asked)


def _gains(response: np.ndarray, before: np.ndarray, impulses: np.ndarray) -> bool:
    """Return whether impulses would increase the kinetic energy by more than rounding errors do."""
    gain = impulses @ (before + 0.5 * response @ impulses)
    return bool(gain > 1e-12 * (np.abs(impulses) @ np.abs(before)))


def _impulses(
    contacts: RigidContacts, law: str, response: np.ndarray, before: np.ndarray, e: np.ndarray, some: np.ndarray
) -> np.ndarray:
    """Return the impulses (2 k,) of k contacts, normal ones first, by the law of Newton or of Poisson."""
    k = len(some)

    def solved(velocities: np.ndarray, pressed: np.ndarray | float = 0.0) -> np.ndarray:
        found = coulomb(response, velocities[:k], velocities[k:], contacts.kinetic[some], pressed=pressed)
        if found is None:
            raise StepError("contact-solver", "no impulses of the contacts satisfy the law of impact")
        return np.concatenate([found.normal, found.tangent])

    if law == "newton":
        back = np.where(before[:k] < 0.0, e * before[:k], 0.0)
        return solved(before + np.concatenate([back, np.zeros(k)]))
    pressed = solved(before)
    least = np.concatenate([e * pressed[:k], np.zeros(k)])
    return pressed + least + solved(before + response @ (pressed + least), least[:k])
