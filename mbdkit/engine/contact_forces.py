"""Contacts that act in a run: loads at the centres of mass, whose values are traced functions of the state.

A contact exerts a force and a torque on each of its bodies that is not ground. Their values are laws without a pathway
(see `mbdkit.engine.state_expressions`) that share one block of parameters: the coordinates and velocities of the
bodies, which kernels update, the parameters of the shapes, and the parameters of the force laws. The tangents are the
derivatives of the traced functions with respect to these coordinates and velocities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.kernels.applied_forces import POSITION_INPUT, VELOCITY_INPUT
from mbdkit.engine.traced_law import Source, Traced
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.contacts import OPEN, SLIP, STICK, Contact, ContactPair
from mbdkit.mechanism.force_law import TracedLaw

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism

HEAVY = 10.0
"""Largest contact force at the start, relative to the weight of all bodies, that is accepted. Larger forces mean that
shapes overlap too much."""

HELD = {"normal_force": "N", "friction_force": "N", "mode": "1"}
"""First-order states that store the force and mode of a rigid contact during a step, and their units; they have no
rates.
"""

NO_LAW = (0.0,) * 7
"""Parameters of the law of a rigid contact, which exerts no compliant force."""

HELD_BY_BODY = {"contact_force_x": "N", "contact_force_y": "N", "contact_torque": "N m"}
"""First-order states of a body, with units: the sum of the forces of its rigid contacts, and of their torques about the
centre of mass.
"""

COORDINATES = 6
"""Number of coordinates and velocities of a body: x, y, angle and their rates."""

FORCES = {"hunt-crossley": "hertz", "flores": "hertz", "lankarani-nikravesh": "hertz", "linear": "linear",
          "smooth-sphere-half-space": "smooth"}  # fmt: skip
"""Form of the normal force of each law; see `mbdkit.symbolic.contact_definitions.normal_force`."""


class Form(NamedTuple):
    """All properties of a contact on which its programs depend; parameters are left out.

    Attributes
    ----------
    kind, law, has_friction
        See `mbdkit.symbolic.contact_definitions.definition`.
    moving
        Number of coordinates of the first and of the second body: 0 for ground, 2 for a point mass, else 3.
    """

    kind: tuple[str, int]
    law: str
    has_friction: bool
    moving: tuple[int, int]

    @property
    def inputs(self) -> list[int]:
        """Indices, among the coordinates and velocities of both bodies, of the inputs: those that can change."""
        return [
            COORDINATES * side + 3 * rate + axis
            for side, count in enumerate(self.moving)
            for rate in range(2)
            for axis in range(count)
        ]

    @property
    def wrenches(self) -> list[int]:
        """Indices, among the components of force and torque on both bodies, of those that have an effect."""
        return [3 * side + axis for side, count in enumerate(self.moving) for axis in range(count)]


class ContactLaws(NamedTuple):
    """Laws that contacts of one `Form` share.

    Attributes
    ----------
    values
        Law of each component of `Form.wrenches`.
    slopes
        Laws of the derivatives that are not always zero, by index of the component and of the input.
    """

    values: dict[int, TracedLaw]
    slopes: dict[tuple[int, int], TracedLaw]


@dataclass(frozen=True)
class ActingContact:
    """One row (possible contact point) of a contact that acts in runs.

    Attributes
    ----------
    pair
        Names, bodies and geometry of the row.
    form
        The properties on which its programs depend.
    bodies
        Indices of its bodies.
    law
        Parameters of its force law, in the order of `mbdkit.symbolic.contact_definitions.LAW`.
    first_state
        Index of the first of the `HELD` states of a rigid contact; -1 for a compliant contact.
    coefficients
        Coefficient of restitution, and static and kinetic coefficient of friction.
    """

    pair: ContactPair
    form: Form
    bodies: tuple[int, int]
    law: tuple[float, ...]
    first_state: int = -1
    coefficients: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def numbers(self) -> tuple[float, ...]:
        """Parameters of the shapes and of the force law."""
        return *self.pair.numbers, *self.law

    @property
    def inputs(self) -> list[tuple[int, int, int]]:
        """For each input, kind and index as in `mbdkit.engine.kernels.applied_forces`, and item of `Form.inputs`."""
        found = []
        for one in self.form.inputs:
            side, place = divmod(one, COORDINATES)
            kind = POSITION_INPUT if place < 3 else VELOCITY_INPUT
            found.append((kind, 3 * self.bodies[side] + place % 3, one))
        return found

    @cached_property
    def options(self) -> dict[str, float]:
        """Parameters of the laws by name; those that are inputs are zero."""
        given = {_input(one): 0.0 for one in self.form.inputs}
        return given | {_number(i): float(x) for i, x in enumerate(self.numbers)}


def contact_values(
    contacts: Sequence[ActingContact], q: np.ndarray, v: np.ndarray, z: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the quantities (T, C) of contacts in recorded states, their points and their normals (T, C, 2).

    Positions and velocities are (T, 3 (B + 1)), first-order states (T, Z). Points, at which the forces act, and normals
    are given in the global frame.
    """
    found = {name: np.zeros((len(q), len(contacts))) for name in ("gap", "slip", *HELD)}
    found |= {name: np.zeros((len(q), len(contacts), 2)) for name in ("point", "normal")}
    alike: dict[Form, list[int]] = {}
    for i, one in enumerate(contacts):
        alike.setdefault(one.form, []).append(i)
    for form, places in alike.items():
        some = [contacts[i] for i in places]
        bodies, numbers = np.array([one.bodies for one in some]).T, np.array([one.numbers for one in some]).T
        state = [x[:, 3 * side + axis] for side in bodies for x in (q, v) for axis in range(3)]
        with np.errstate(all="ignore"):
            gap, normal, friction, slip, *_, x, y, nx, ny = _function(form)(*state, *numbers)
        found["gap"][:, places], found["slip"][:, places] = gap, slip
        for name, pair in (("point", (x, y)), ("normal", (nx, ny))):
            for axis, values in enumerate(pair):
                found[name][:, places, axis] = values
        if form.law == "none":
            first = np.array([one.first_state for one in some])
            for i, name in enumerate(HELD):
                found[name][:, places] = z[:, first + i]
            continue
        found["normal_force"][:, places], found["friction_force"][:, places] = normal, friction
        sticks = form.has_friction & (np.abs(slip) <= numbers[-1])
        found["mode"][:, places] = np.where((gap < 0.0) & (normal > 0.0), np.where(sticks, STICK, SLIP), OPEN)
    return found


def held_coordinates(contacts: Sequence[ActingContact]) -> list[int]:
    """Return the indices of the coordinates on which forces of rigid contacts act, in increasing order."""
    sides = [side for one in contacts if one.first_state >= 0 for side in zip(one.bodies, one.form.moving, strict=True)]
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
    if not mechanism.contacts:
        return []
    found = []
    is_rigid = mechanism.contact_treatment.is_rigid
    for name, contact in mechanism.contacts.items():
        for pair in contact.pairs(name, mechanism.joints):
            moving = tuple(_coordinates(mechanism, body) for body in pair.bodies)
            bodies = (number[pair.bodies[0]], number[pair.bodies[1]])
            static, kinetic = contact.coefficients
            if is_rigid:
                form = Form(pair.kind, "none", False, moving)  # type: ignore[arg-type]
                given = contact.restitution, static, kinetic
                found.append(ActingContact(pair, form, bodies, NO_LAW, 0, given))
                continue
            if contact.compliance is None:
                raise SpecError(
                    "is missing: the compliant treatment needs a law of the normal force, such as {stiffness: 1.0e6}",
                    key=f"{pair.key}.compliance",
                )
            form = Form(pair.kind, FORCES[contact.compliance.law], static > 0.0, moving)  # type: ignore[arg-type]
            found.append(ActingContact(pair, form, bodies, _law_numbers(contact, pair.radius)))
    return found


def _law_numbers(contact: Contact, radius: float) -> tuple[float, ...]:
    return tuple(contact.law_numbers(radius).values())


def _coordinates(mechanism: Mechanism, body: str) -> int:
    if body == GROUND:
        return 0
    return 2 if mechanism.bodies[body].inertia is None else 3


def _input(number: int) -> str:
    return f"input_{number:02d}"


def _number(index: int) -> str:
    return f"number_{index:03d}"


def _function(form: Form) -> Any:
    from mbdkit.symbolic.contact_definitions import contact_function  # loads SymPy

    return contact_function(form.kind, form.law, form.has_friction)


@lru_cache(maxsize=64)
def contact_laws(form: Form, numbers: int) -> ContactLaws:
    """Return the laws of a form; `numbers` is the number of parameters of its shapes and force law."""
    # The functions are traced once, with all derivatives; each law needs a part of the result.
    source, inputs = Source(), form.inputs
    parameters = [Traced(source, f"parameters[{i}]") for i in range(len(inputs) + numbers)]  # in the order of names
    state: list[Any] = [0.0] * (2 * COORDINATES)
    for i, one in enumerate(inputs):
        seed = tuple(float(i == k) for k in range(len(inputs)))
        state[one] = Traced(source, parameters[i].term, seed)
    wrenches = _function(form)(*state, *parameters[len(inputs) :])[4:]
    values, slopes = {}, {}
    for component in form.wrenches:
        value = wrenches[component]
        values[component] = _law(value)
        for by, slope in zip(inputs, value.slopes, strict=bool(value.slopes)):
            if isinstance(slope, Traced):
                slopes[component, by] = _law(slope)
    return ContactLaws(values, slopes)


def _law(value: Traced) -> TracedLaw:
    plain = Traced(value.source, value.term)
    return TracedLaw(lambda length, rate, time, p: plain, dict, has_derivatives=False)


@cache
def held_law() -> TracedLaw:
    """Return a law whose value is its only parameter."""
    return _law(Traced(Source(), "parameters[0]"))


def check_start(
    contacts: Sequence[ActingContact], q: np.ndarray, v: np.ndarray, tolerance: float, weight: float
) -> None:
    """Raise SpecError for the first contact whose shapes overlap too much at the start.

    The shapes of any contact may overlap by `tolerance`. Those of a compliant contact may overlap more if its force at
    rest is at most `HEAVY` times the weight.

    Parameters
    ----------
    q, v
        (3 (B + 1),) positions and velocities, ground last.
    tolerance
        Overlap that counts as closed [m].
    weight
        Weight of all bodies [N].
    """
    if not contacts:
        return
    values = contact_values(contacts, q[None], 0.0 * v[None], np.zeros((1, len(HELD) * len(contacts))))
    for i, one in enumerate(contacts):
        depth, push = -float(values["gap"][0, i]), float(values["normal_force"][0, i])
        is_deep = depth > 0.5 * one.pair.radius > 0.0
        remedy = "check the unit of the radius and the direction of the normal, or " if is_deep else ""
        if one.first_state >= 0 and depth > tolerance:
            raise SpecError(
                f"the shapes of '{one.pair.name}' overlap by {depth:.4g} m at the start, more than "
                f"`assembly.tolerance`, {tolerance:.4g} m; {remedy}move the bodies apart",
                key=f"{one.pair.key}.shapes",
            )
        if depth > tolerance and push > HEAVY * weight:
            raise SpecError(
                f"the shapes of '{one.pair.name}' overlap by {depth:.4g} m at the start, where they would push each "
                f"other apart with {push:.4g} N, more than {HEAVY:g} times the weight of all bodies; "
                f"{remedy}move the bodies apart",
                key=f"{one.pair.key}.shapes",
            )
