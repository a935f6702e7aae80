"""Contacts that act in a run: the parameters of their laws, and their recorded quantities.

A law of `mbdkit_contact.kernels.contact_laws` evaluates all rows of two shapes. It computes the forces of compliant
contacts in runs, and the recorded quantities of all contacts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, ClassVar

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.engine.compile_forces import Lowering, lowering
from mbdkit.engine.compile_mechanism import recorded_members
from mbdkit.engine.compiled_mechanism import ActingForce, with_ground
from mbdkit.engine.consistent_start import start_values
from mbdkit.engine.force_laws import CompiledLaw, NativeLaw, native_law
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.target import Target
from mbdkit_contact.contact import Contact, ContactPair
from mbdkit_contact.kernels.contact_laws import (
    FORCE_LAWS,
    FORCES,
    KINDS,
    POSE,
    ROW,
    SLOPES,
    VALUE,
    VALUES,
    contact,
    contact_rows,
)
from mbdkit_contact.kernels.uneven_ground import EDGE, OWN, SEGMENT
from mbdkit_contact.modes import OPEN, SLIP, STICK
from mbdkit_contact.polylines import reaching_segments

#: Largest contact force at the start, relative to the weight of all bodies, that is accepted. Larger forces mean that
#: shapes overlap too much.
HEAVY = 10.0

#: Number of rounding errors of the largest position up to which distances are uncertain.
ROUNDED = 16.0

#: First-order states that store the force and mode of a rigid contact during a step, and their units; they have no
#: rates.
HELD = {"normal_force": "N", "friction_force": "N", "mode": "1"}

#: Parameters of the law of a rigid contact, which exerts no compliant force.
NO_LAW = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)

#: First-order states of a body, with units: the sum of the forces of its rigid contacts, and of their torques about the
#: centre of mass.
HELD_BY_BODY = {"contact_force_x": "N", "contact_force_y": "N", "contact_torque": "N m"}

#: Form of the normal force of each law, one of `mbdkit_contact.kernels.contact_laws.FORCE_LAWS`.
FORMS = {"hunt-crossley": "hertz", "flores": "hertz", "lankarani-nikravesh": "hertz", "linear": "linear",
          "smooth-sphere-half-space": "smooth"}  # fmt: skip


@dataclass(frozen=True)
class ActingContact:
    """One row (possible contact point) of a contact that acts in runs.

    Attributes
    ----------
    pair
        Names, bodies and geometry of the row.
    force
        Form of its normal force, one of `mbdkit_contact.kernels.contact_laws.FORCE_LAWS`.
    moving
        Number of coordinates of the first and of the second body: 0 for ground, 2 for a point mass, else 3.
    bodies
        Indices of its bodies.
    law
        Parameters of its force law; see `mbdkit_contact.contact.Contact.law_numbers`.
    first_state
        Index of the first of the `HELD` states of a rigid contact; -1 for a compliant contact.
    law_place
        Index of the law of a compliant contact; -1 for a rigid contact.
    coefficients
        Coefficient of restitution, and static and kinetic coefficient of friction.
    """

    pair: ContactPair
    force: str
    moving: tuple[int, int]
    bodies: tuple[int, int]
    law: tuple[float, ...]
    first_state: int = -1
    law_place: int = -1
    coefficients: tuple[float, float, float] = (0.0, 0.0, 0.0)
    symbolic: ClassVar[Target[Any]] = Target("mbdkit_contact.exported_contacts:SymbolicContacts")

    @property
    def edges(self) -> list[float]:
        """Start, normal and length of each edge of the first body's polygon."""
        return list(self.pair.numbers[len(self.pair.numbers) - EDGE * self.pair.kind[1] :])


def pairs_of_shapes(contacts: Sequence[ActingContact]) -> list[list[ActingContact]]:
    """Return the rows of each pair of shapes."""
    return [list(rows) for _, rows in groupby(contacts, lambda row: (row.pair.key, frozenset(row.pair.bodies)))]


def contact_law(rows: Sequence[ActingContact], mode: int) -> CompiledLaw:
    """Return the law of a pair of shapes in a mode of `mbdkit_contact.kernels.contact_laws`."""
    first, (kind, edges) = rows[0], rows[0].pair.kind
    count = edges or len(rows)
    other = polygon_edges(first) if kind == "polyline" else len(rows) - count
    turns = (int(moving == 3) for moving in first.moving)
    program = (mode, KINDS.index(kind), count, other, FORCE_LAWS.index(first.force), *turns, len(rows))
    return native_law(NativeLaw(contact, program))


def contact_numbers(rows: Sequence[ActingContact]) -> list[float]:
    """Return the parameters of the law of a pair of shapes, preceded by their number; the states of bodies are zero."""
    first, kind = rows[0], rows[0].pair.kind[0]
    if kind == "edge":
        shapes = [*first.pair.numbers[:3], *first.edges]
    elif kind == "inside":
        shapes = first.edges + rows[-1].edges
    elif kind == "polyline":
        shapes = surface_numbers(first)
    else:
        shapes = [number for row in rows for number in (*row.pair.numbers, 0.0)[:ROW]]
    numbers = [*[0.0] * (2 * POSE), *first.law, *shapes, *[0.0] * (len(rows) if has_sides(rows) else 0)]
    return [float(len(numbers)), *numbers]


def has_sides(rows: Sequence[ActingContact]) -> bool:
    """Return whether the law of a pair of shapes has a parameter for each row that decides whether it touches."""
    return rows[0].force == "linear" and rows[0].pair.kind[0] in ("line", "circles", "hole")


def polygon_edges(contact: ActingContact) -> int:
    """Return the number of edges of the polygon that touches a polyline; 0 for a circle."""
    return (len(contact.pair.numbers) - OWN - SEGMENT * contact.pair.kind[1]) // EDGE


def surface_numbers(contact: ActingContact) -> list[float]:
    """Return the parameters of a row on a polyline (`mbdkit_contact.kernels.uneven_ground`). For rigid bodies, segments
    reach into the material at concave corners.
    """
    numbers, begin = contact.pair.numbers, -SEGMENT * contact.pair.kind[1]
    return [*numbers[:begin], *reaching_segments(numbers[begin:])] if contact.force == "none" else list(numbers)


def contact_values(
    contacts: Sequence[ActingContact], q: np.ndarray, v: np.ndarray, z: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the quantities (T, C) of contacts in recorded states, the torques of rolling resistance on their second
    bodies (T, C), their points and their normals (T, C, 2).

    Positions and velocities are (T, 3 (B + 1)), first-order states (T, Z). Points, at which the forces act, and normals
    are given in the global frame.
    """
    table, numbers, first = [], list[float](), 0
    for rows in pairs_of_shapes(contacts):
        law = contact_law(rows, VALUES)
        table.append((*rows[0].bodies, law.address, law.program, len(numbers), first))
        numbers += contact_numbers(rows)
        first += len(rows)
    values = np.zeros((len(q), len(contacts), VALUE))
    q, v = (np.ascontiguousarray(x, dtype=float) for x in (q, v))
    contact_rows(np.array(table, dtype=np.int64).reshape(-1, 6), np.array(numbers), q, v, values)
    gap, normal, friction, slip = values[..., :4].transpose(2, 0, 1).copy()
    has_friction, transition = np.array([(acting.law[3] > 0.0, acting.law[5]) for acting in contacts]).T
    sticks = (has_friction > 0.0) & (np.abs(slip) <= transition)
    mode = np.where((gap < 0.0) & (normal > 0.0), np.where(sticks, STICK, SLIP), OPEN).astype(float)
    columns = {"gap": gap, "slip": slip, "normal_force": normal, "friction_force": friction, "mode": mode}
    for i, acting in enumerate(contacts):
        for k, name in enumerate(HELD if acting.first_state >= 0 else ()):
            columns[name][:, i] = z[:, acting.first_state + k]
    columns["rolling_torque"] = values[..., 8].copy()
    return columns | {"point": values[..., 4:6].copy(), "normal": values[..., 6:8].copy()}


def held_coordinates(contacts: Sequence[ActingContact]) -> list[int]:
    """Return the indices of the coordinates on which forces of rigid contacts act, in increasing order."""
    sides = [side for row in contacts if row.first_state >= 0 for side in zip(row.bodies, row.moving, strict=True)]
    return [3 * body + axis for body, count in sorted(set(sides)) for axis in range(count)]


def held_states(contacts: Sequence[ActingContact]) -> range:
    """Return the indices of the first-order states that store the forces and modes of rigid contacts."""
    rigid = [contact for contact in contacts if contact.first_state >= 0]
    first = rigid[0].first_state if rigid else 0
    return range(first, first + len(HELD) * len(rigid) + len(held_coordinates(rigid)))


def acting_contacts(mechanism: Mechanism, number: Mapping[str, int]) -> list[ActingContact]:
    """Return all rows of the contacts of a mechanism.

    Parameters
    ----------
    number
        Index of each body by name, ground included.

    Raises
    ------
    SpecError
        If contacts are compliant and one of them has no compliance.
    """
    rows = []
    is_rigid = mechanism.reacting is not None
    for name, own in mechanism.contacts.items():
        for pair in own.pairs(name, mechanism.joints):
            moving = _coordinates(mechanism, pair.bodies[0]), _coordinates(mechanism, pair.bodies[1])
            bodies = (number[pair.bodies[0]], number[pair.bodies[1]])
            if is_rigid and own.rolling_resistance > 0.0:
                raise SpecError(
                    "rigid contacts have no rolling resistance; omit it, or use the compliant treatment",
                    key=f"{pair.key}.rolling_resistance",
                )
            if is_rigid:
                given = (own.restitution, *own.friction_coefficients)
                rows.append(ActingContact(pair, "none", moving, bodies, NO_LAW, 0, coefficients=given))
                continue
            if own.compliance is None:
                raise SpecError(
                    "is missing: the compliant treatment needs a law of the normal force, such as {stiffness: 1.0e6}",
                    key=f"{pair.key}.compliance",
                )
            law = tuple(own.law_numbers(pair.radius).values())
            rows.append(ActingContact(pair, FORMS[own.compliance.law], moving, bodies, law))
    return rows


def _coordinates(mechanism: Mechanism, body: str) -> int:
    return 0 if body == GROUND else 2 if mechanism.bodies[body].inertia is None else 3


@lowering
def lower_contacts(
    elements: Mapping[str, Contact], lowering: Lowering, acting: tuple[ActingForce, ...]
) -> tuple[ActingContact, ...]:
    """Add the forces of compliant contacts, or the states of rigid ones, to a mechanism that is compiled.

    These states store the forces and modes of rigid contacts, and the sum of these forces on each body. Their values
    are constant during a step, and loads apply the sums to the bodies.

    Returns the rows of all contacts; rigid ones with the index of their first state.
    """
    mechanism = lowering.mechanism
    contacts = acting_contacts(mechanism, lowering.bodies)
    if mechanism.reacting is None:
        compliant: list[ActingContact] = []
        for rows in pairs_of_shapes(contacts):
            laws = [contact_law(rows, mode) for mode in (FORCES, SLOPES)]
            number = lowering.pair(f"contact '{rows[0].pair.name}'", rows[0].bodies, laws, contact_numbers(rows))
            compliant += (replace(row, law_place=number) for row in rows)
        return tuple(compliant)
    rigid = []
    for row in contacts:
        states = [lowering.state(f"{row.pair.name}.{name}", unit, 0.0, by_method=True) for name, unit in HELD.items()]
        rigid.append(replace(row, first_state=states[0]))
    bodies, laws_of = list(mechanism.bodies), dict[int, list[int]]()
    for coordinate in held_coordinates(rigid):
        number, axis = divmod(coordinate, 3)
        body, (name, unit) = bodies[number], list(HELD_BY_BODY.items())[axis]
        laws_of.setdefault(number, []).append(lowering.held_load(f"contacts of '{body}'", f"{body}.{name}", unit))
    for number, own in laws_of.items():
        lowering.wrench(bodies[number], number, own)
    return tuple(rigid)


def position_error(q: np.ndarray) -> float:
    """Return how much rounding errors of positions and angles (..., 3) may change distances [m]."""
    return float(ROUNDED * np.finfo(float).eps * np.max(np.abs(q[..., :2])))


@start_values
def check_start(
    contacts: Sequence[ActingContact], mechanism: Mechanism, _t0: float, q: np.ndarray
) -> Mapping[int, float]:
    """Raise SpecError for the first contact whose shapes overlap too much at the start.

    The shapes of any contact may overlap by `assembly.tolerance` and the rounding errors of positions. Those of a
    compliant contact may overlap more if its force at rest is at most `HEAVY` times the weight.

    Parameters
    ----------
    q
        (B, 3) positions after assembly.

    Returns
    -------
    dict
        Nothing: the initial values of states do not depend on the positions.
    """
    tolerance = mechanism.assembly.tolerance + position_error(q)
    weight = sum(body.mass for body in mechanism.bodies.values()) * elementary.hypot(*mechanism.gravity)
    row = with_ground(q)[None]
    values = contact_values(contacts, row, np.zeros_like(row), np.zeros((1, held_states(contacts).stop)))
    for i, acting in enumerate(contacts):
        depth, push = -float(values["gap"][0, i]), float(values["normal_force"][0, i])
        is_deep = depth > 0.5 * acting.pair.radius > 0.0
        remedy = "check the unit of the radius and the direction of the normal, or " if is_deep else ""
        if acting.first_state >= 0 and depth > tolerance:
            raise SpecError(
                f"the shapes of '{acting.pair.name}' overlap by {depth:.4g} m at the start, more than "
                f"`assembly.tolerance`, {tolerance:.4g} m; {remedy}move the bodies apart",
                key=f"{acting.pair.key}.shapes",
            )
        if depth > tolerance and push > HEAVY * weight:
            raise SpecError(
                f"the shapes of '{acting.pair.name}' overlap by {depth:.4g} m at the start, where they would push each "
                f"other apart with {push:.4g} N, more than {HEAVY:g} times the weight of all bodies; "
                f"{remedy}move the bodies apart",
                key=f"{acting.pair.key}.shapes",
            )
    return {}


@recorded_members
def members_of(contacts: Sequence[ActingContact]) -> list[tuple[str, tuple[str, ...]]]:
    """Return name and bodies of each row of the contacts."""
    return [(acting.pair.name, acting.pair.ordered) for acting in contacts]
