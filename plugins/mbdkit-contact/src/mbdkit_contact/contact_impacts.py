"""Impacts of rigid contacts: impulses by the laws of Newton, Poisson or Stronge, with Coulomb friction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit_contact.kernels.impacts import (
    AS_ASKED,
    LAWS,
    UNSOLVED,
    new_impacts,
    new_strike,
    order_matters,
    strike_all,
)
from mbdkit_contact.rigid_contacts import RigidContacts


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
    both = np.vstack([rows.normal[some], rows.tangent[some]])
    moved, loaded = contacts.answers(t, q, both)
    response, before = both @ moved, both @ v
    k, strike = len(some), new_strike(len(some))
    strike.cones.response[:], strike.cones.friction[:] = response, contacts.kinetic[some]
    strike.before[:], strike.restitution[:] = before, e[some]
    outcome = strike_all(strike, k, LAWS.index(law))
    if outcome == UNSOLVED:
        raise StepError("contact-solver", "no impulses of the contacts satisfy the law of impact")
    impulses = strike.impulses
    normal, tangent = np.zeros(len(touching)), np.zeros(len(touching))
    normal[some], tangent[some] = np.split(impulses, 2)
    ordered = some[depend_on_order(contacts, law, response, before, e[some], some)]
    return Struck(v + moved @ impulses, normal, tangent, loaded @ impulses, outcome == AS_ASKED, ordered)


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
    k, x = len(some), new_impacts(len(some))
    x.all.cones.response[:], x.all.cones.friction[:] = response, contacts.kinetic[some]
    x.all.before[:], x.restitution[:] = before, e
    order_matters(x, k, LAWS.index(law))
    return x.ordered > 0
