"""Impacts of rigid contacts: impulses by the laws of Newton, Poisson or Stronge, with Coulomb friction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit_contact.complementarity import coulomb, stronge
from mbdkit_contact.rigid_contacts import RigidContacts

SMALL_RESTITUTION = 1e-3
"""If an impact would gain energy, the coefficients of restitution are reduced in steps of 10 %; values up to this are
set to 0.
"""

ORDER_MATTERS, STOPPED = 1e-6, 1e-9
"""Velocities of contacts, relative to the largest before an impact: differences above the first depend on the order of
impacts, and approach below the second ends a sequence of impacts.
"""
MOST_STRIKES = 100
"""Largest number of impacts, for each contact, in a sequence of single impacts."""


class Struck(NamedTuple):
    """Result of an impact.

    Velocities (n,) after it, impulses (C,) of the contacts [N s], impulses (m,) of the joint constraints, whether the
    impact law was the one chosen for the run, and the indices of the contacts whose velocities depend on the order of
    the impacts.
    """

    v: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    multipliers: np.ndarray
    is_as_asked: bool
    ordered: np.ndarray


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
    impulses, is_asked = _without_gain(contacts, law, response, before, e[some], some)
    normal, tangent = np.zeros(len(touching)), np.zeros(len(touching))
    normal[some], tangent[some] = np.split(impulses, 2)
    moved, loaded = contacts.answers(t, q, both)
    ordered = some[depend_on_order(contacts, law, response, before, e[some], some)]
    return Struck(v + moved @ impulses, normal, tangent, loaded @ impulses, is_asked, ordered)


def _without_gain(
    contacts: RigidContacts, law: str, response: np.ndarray, before: np.ndarray, e: np.ndarray, some: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Return the impulses (2 k,) of k contacts, normal ones first, and whether they follow the given law.

    If the law would create energy, another one is used.
    """
    impulses = _impulses(contacts, law, response, before, e, some)
    is_asked = not _gains(response, before, impulses)
    if not is_asked and len(some) == 1:
        impulses = stronge(response, before, float(contacts.kinetic[some[0]]), float(e[0]))
    while _gains(response, before, impulses) and np.any(e):
        e = np.where(e > SMALL_RESTITUTION, 0.9 * e, 0.0)
        impulses = _impulses(contacts, "poisson", response, before, e, some)
    return impulses, is_asked


def depend_on_order(
    contacts: RigidContacts, law: str, response: np.ndarray, before: np.ndarray, e: np.ndarray, some: np.ndarray
) -> np.ndarray:
    """Return which of k contacts (k,) have other velocities after impacts one after another than after one impact of
    all.

    In a sequence, the first approaching contact in a given order is struck alone, by the same law, until none
    approaches. The orders are the cyclic ones in both directions: all orders of up to three contacts.

    Parameters
    ----------
    response
        (2 k, 2 k) matrix that maps impulses of contacts to changes of their velocities, normal components first.
    before
        (2 k,) velocities before the impact.
    some
        (k,) indices of the contacts.
    """
    k, size = len(some), float(np.max(np.abs(before), initial=0.0))
    blocks = np.abs(response.reshape(2, k, 2, k)).max(axis=(0, 2))
    if k < 2 or np.all(blocks - np.diag(np.diag(blocks)) <= STOPPED * np.max(blocks)):
        return np.zeros(k, dtype=bool)
    turns = [tuple((i + j) % k for j in range(k)) for i in range(k)]
    try:
        together = before + response @ _without_gain(contacts, law, response, before, e, some)[0]
        for order in dict.fromkeys(turns + [turn[::-1] for turn in turns]):
            u = before.copy()
            for _ in range(MOST_STRIKES * k):
                first = next((i for i in order if u[i] < -STOPPED * size), None)
                if first is None:
                    break
                own = np.array([first, first + k])
                alone = response[np.ix_(own, own)]
                u += response[:, own] @ _without_gain(contacts, law, alone, u[own], e[own[:1]], some[own[:1]])[0]
            unfinished = -float(np.min(u[:k], initial=0.0))
            differs = np.abs(u - together) > ORDER_MATTERS * size + MOST_STRIKES * unfinished
            if np.any(differs):
                return np.asarray(differs.reshape(2, k).any(axis=0))
    except StepError:  # a contact alone has no solution
        pass
    return np.zeros(k, dtype=bool)


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
