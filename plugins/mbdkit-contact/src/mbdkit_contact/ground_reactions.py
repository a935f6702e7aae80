"""Forces of the ground on the bodies that touch it, and their points of application."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from mbdkit.mechanism.bodies import GROUND
from mbdkit_contact.acting_contacts import ActingContact
from mbdkit_contact.modes import OPEN


def feet(pairs: Iterable[Sequence[str]]) -> list[str]:
    """Return the names of the bodies that may touch the ground, given the two bodies of each contact."""
    return list(dict.fromkeys(name for pair in pairs if GROUND in pair for name in pair if name != GROUND))


def ground_reactions(contacts: Sequence[ActingContact], values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the reactions of the ground on each body that may touch it.

    Parameters
    ----------
    contacts
        All contacts of the mechanism.
    values
        Quantities of the contacts; see `mbdkit_contact.acting_contacts.contact_values`.

    Returns
    -------
    dict
        For T states and F bodies: ``force`` (T, F, 2) and ``normal_force`` (T, F), sums over the contacts of a body
        [N], and ``center_of_pressure`` (T, F, 2) [m], nan where no contact is closed. The moment of all contacts about
        this point is zero. It lies on the line through the mean of the contact points, weighted with the normal forces,
        at right angles to the vector sum of the normal forces. On flat ground without rolling resistance, it is this
        mean.
    """
    pairs = [contact.pair.ordered for contact in contacts]
    names = feet(pairs)
    touching: dict[str, list[int]] = {name: [] for name in names}
    for i, pair in enumerate(pairs):
        if GROUND in pair:
            touching[pair[0] if pair[1] == GROUND else pair[1]].append(i)
    push, normal = values["normal_force"], values["normal"]
    turned = np.stack([normal[..., 1], -normal[..., 0]], axis=-1)
    on_second = push[..., None] * normal + values["friction_force"][..., None] * turned
    shape = len(push), len(names)
    columns = {
        "force": np.zeros((*shape, 2)),
        "normal_force": np.zeros(shape),
        "center_of_pressure": np.zeros((*shape, 2)),
    }
    with np.errstate(invalid="ignore", divide="ignore"):
        for number, name in enumerate(names):
            own = touching[name]
            signs = np.array([1.0 if contacts[i].pair.bodies[1] == name else -1.0 for i in own])
            on_body, points = signs[:, None] * on_second[:, own], values["point"][:, own]
            force = np.sum(on_body, axis=1)
            columns["force"][:, number], columns["normal_force"][:, number] = force, np.sum(push[:, own], axis=1)
            pressed = np.where(values["mode"][:, own] != OPEN, push[:, own], 0.0)
            mean = np.sum(pressed[..., None] * points, axis=1) / np.sum(pressed, axis=1)[:, None]
            arms = points - mean[:, None]
            torques = arms[..., 0] * on_body[..., 1] - arms[..., 1] * on_body[..., 0]
            torque = np.sum(torques + signs * values["rolling_torque"][:, own], axis=1)
            total = np.sum((signs * pressed)[..., None] * normal[:, own], axis=1)  # of the normal forces, as vectors
            ahead = torque / np.sum(total * force, axis=1)
            along = np.stack([total[:, 1], -total[:, 0]], axis=1)
            columns["center_of_pressure"][:, number] = mean + ahead[:, None] * along
    return columns
