"""Groups of the archive that contacts add: their quantities, and the reactions of the ground."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import member_names
from mbdkit.quantities.array import Chart, Recorded
from mbdkit.quantities.entries import AXIS, TIME, computed, name_array, quantity_group
from mbdkit.quantities.states import States
from mbdkit_contact.acting_contacts import ActingContact, contact_values
from mbdkit_contact.contact import ContactPair
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
            own = [i for i, pair in enumerate(pairs) if GROUND in pair and name in pair]
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


#: Largest gap of a closed contact of rigid bodies in expressions of events [m], which are to be triggered once when it
#: closes, and not by rounding errors later.
CLOSED = -1e-100

_MORE = {"no_derivative": "the derivatives of quantities of contacts with respect to parameters are not known"}


def rows_of(mechanism: Mechanism) -> list[ContactPair]:
    """Return the rows (possible contact points) of all contacts of a mechanism."""
    return [pair for name, contact in mechanism.contacts.items() for pair in contact.pairs(name, mechanism.joints)]


@member_names
def contact_names(mechanism: Mechanism) -> list[str]:
    """Return the names of all possible contact points: ``contact``, or ``contact.a.b`` for two bodies of a group.

    If a shape is a polygon or polyline, there may be several names, which end with a number.
    """
    return [pair.name for pair in rows_of(mechanism)]


@member_names
def feet_of(mechanism: Mechanism) -> list[str]:
    """Return the names of the bodies that may touch the ground."""
    return feet(pair.ordered for pair in rows_of(mechanism))


def contacts_in(states: States) -> dict[str, np.ndarray]:
    """Return the quantities (T, C) of contacts by name; for events, gaps of closed contacts of rigid bodies are
    negative.
    """
    contacts = states.mechanism.extensions["contacts"]
    columns = contact_values(contacts, states.q, states.v, states.z)
    if states.is_for_events:
        is_closed = np.array([contact.first_state >= 0 for contact in contacts]) & (columns["mode"] > 0.0)
        columns["gap"] = np.where(is_closed, np.minimum(columns["gap"], CLOSED), columns["gap"])
    return columns


def ground_reactions_in(states: States) -> dict[str, np.ndarray]:
    """Return the quantities of the bodies that may touch the ground by name."""
    return ground_reactions(states.mechanism.extensions["contacts"], states.of(contacts_in))


def _of_contacts(name: str, units: str, what: str, **more: object) -> Recorded:
    return computed(name, ("time", "contact"), units, what, lambda s: s.of(contacts_in)[name], **_MORE, **more)


def _of_ground(name: str, units: str, what: str, **more: object) -> Recorded:
    dims = ("time", "foot", "axis") if "components" in more else ("time", "foot")
    return computed(name, dims, units, what, lambda s: s.of(ground_reactions_in)[name], **_MORE, **more)


# fmt: off
CONTACTS = quantity_group(
    "contacts",
    TIME,
    name_array("contact", "contact", "name of the contact; of polygons and polylines, with a number",
        lambda names: names.names_of("contacts")),
    name_array("first_body", "contact", "first body of the contact, from which the normal points",
        lambda names: names.bodies_of("contacts", 0), label="bodies"),
    name_array("second_body", "contact", "second body of the contact",
        lambda names: names.bodies_of("contacts", 1), label="bodies"),
    _of_contacts("gap", "m", "distance of the two shapes, negative where they overlap"),
    _of_contacts("normal_force", "N", "force that pushes the bodies apart",
        charts=(Chart("contact-forces", "Normal forces of the contacts", "They push the bodies apart.", "force",
            "N"),)),
    _of_contacts("friction_force", "N",
        "friction force on the second body, along the normal turned by -90 degrees"),
    _of_contacts("slip", "m/s", "velocity of the second body relative to the first, in that direction"),
    _of_contacts("mode", "1", "0: open, 1: sticks, 2: slips"),
    optional=True, word="contacts", one="contact", example="normal_force", axis="contact",
    is_optional=True,
)

GROUND_REACTIONS = quantity_group(
    "ground_reactions",
    TIME,
    name_array("foot", "foot", "name of the body that may touch the ground",
        lambda names: feet(bodies for _, bodies in dict(names.members).get("contacts", ()))),
    AXIS,
    _of_ground("force", "N", "force of all contacts with the ground on the body, global frame",
        vector="force", components=("force_x", "force_y"), has_norm=True),
    _of_ground("normal_force", "N", "sum of the normal forces of these contacts", is_not_negative=True,
        charts=(Chart("ground-reactions", "Ground reactions", "Normal force of the ground on each body.", "force",
            "N"),)),
    _of_ground("center_of_pressure", "m",
        "point about which the contacts with the ground have no moment, global frame; nan where none is closed",
        vector="center_of_pressure", components=("center_of_pressure_x", "center_of_pressure_y")),
    optional=True, word="ground_reactions", one="ground reaction", example="force_y",
    axis="foot", is_optional=True, may_be_unknown=True,
)
# fmt: on
