"""Compile the force elements of a mechanism, its loads, contacts, muscles and states, to flat numbered arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbdkit.base import higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.engine.compile_motions import CompiledMotions
from mbdkit.engine.compiled_mechanism import ActingMuscle, ElementState, ForceElement, SampledController
from mbdkit.engine.contact_forces import (
    HELD,
    HELD_BY_BODY,
    ActingContact,
    acting_contacts,
    contact_law,
    contact_numbers,
    held_coordinates,
    held_law,
    pairs_of_shapes,
)
from mbdkit.engine.force_laws import CompiledLaw, bind_law
from mbdkit.engine.friction_forces import FrictionForce, friction_forces
from mbdkit.engine.kernels.applied_forces import (
    BODY_FORCE,
    PATHWAYS,
    POINT_FORCE,
    POSITION_INPUT,
    TORQUE,
    VELOCITY_INPUT,
)
from mbdkit.engine.kernels.contact_laws import FORCES, SLOPES
from mbdkit.engine.state_expressions import STATE_INPUT, Numbering, StateExpression
from mbdkit.mechanism.forces import AppliedLoad, Force, PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import Pathway, path_ends
from mbdkit.mechanism.state_values import is_of_state
from mbdkit.muscles.acting_muscles import MuscleForce, acting_muscles
from mbdkit.muscles.hill_laws import activation_rate_text

Numbers = tuple[float, ...]

LOADS = {"torque": TORQUE, "point_force": POINT_FORCE, "body_force": BODY_FORCE}
"""Kernel code of each kind of load."""


class CompiledForces:
    """Collects the force elements on pathways, loads, contacts and first-order states of a mechanism in flat lists."""

    def __init__(self, mechanism: Mechanism, number: dict[str, int], motions: CompiledMotions):
        self.joints, self.number, self.motions = mechanism.joints, number, motions
        self.springs: list[Numbers] = []
        self.spring_points: list[Numbers] = []
        self.couplings: list[Numbers] = []
        self.linear: list[Numbers] = []
        self.laws: list[tuple[str, CompiledLaw]] = []
        self.law_rows: list[Numbers] = []
        self.law_parameters: list[float] = []
        self.states: list[ElementState] = []
        self.state_rows: list[Numbers] = []
        self.state_places: list[Numbers] = []
        self.inputs: list[Numbers] = []
        self.load_values: list[Numbers] = []
        self.slopes: list[Numbers] = []
        self.first_segments: dict[str, int] = {}
        self.controllers: list[SampledController] = []
        self.muscles: list[ActingMuscle] = []
        self.elements: list[ForceElement] = []
        self.spring_places: list[int] = []
        self.load_places: list[int] = []
        self.loads: list[Numbers] = []
        self.contact_rows: list[Numbers] = []
        self.load_points: list[Numbers] = []
        self.frictions: list[int] = []
        self.reactions: list[tuple[int, int, int, int]] = []
        for name, force in mechanism.forces.items():
            self._add(name, force)
        for name, muscle in acting_muscles(mechanism).items():
            self.muscles.append(ActingMuscle(muscle, len(self.states)))
            self._add_law(name, muscle, "muscles")
        self.friction = friction_forces(mechanism)
        for number_of_friction, friction in enumerate(self.friction):
            self._add_friction(number_of_friction, friction)
        self.contacts = acting_contacts(mechanism, number)
        if mechanism.contact_treatment.is_rigid:
            self.contacts = self._add_held(self.contacts, list(mechanism.bodies))
        else:
            for rows in pairs_of_shapes(self.contacts):
                self._add_contact(rows)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of `Topology` about forces."""
        return {
            "springs": np.array(self.springs, dtype=np.int64).reshape(-1, 6),
            "spring_points": np.array(self.spring_points, dtype=float).reshape(-1, 6),
            "couplings": np.array(self.couplings, dtype=np.int64).reshape(-1, 2),
            "linear": np.array(self.linear, dtype=float).reshape(-1, 3),
            "laws": np.array(self.law_rows, dtype=np.int64).reshape(-1, 4),
            "states": np.array(self.state_rows, dtype=np.int64).reshape(-1, 3),
            "state_places": np.array(self.state_places, dtype=np.int64).reshape(-1, 2),
            "inputs": np.array(self.inputs, dtype=np.int64).reshape(-1, 3),
            "load_values": np.array(self.load_values, dtype=np.int64).reshape(-1, 2),
            "slopes": np.array(self.slopes, dtype=np.int64).reshape(-1, 5),
            "law_parameters": np.array(self.law_parameters, dtype=float),
            "frictions": np.array(self.frictions, dtype=np.int64),
            "loads": np.array(self.loads, dtype=np.int64).reshape(-1, 5),
            "load_points": np.array(self.load_points, dtype=float).reshape(-1, 2),
            "contacts": np.array(self.contact_rows, dtype=np.int64).reshape(-1, 3),
            "force_place": np.array(self.spring_places + self.load_places, dtype=np.int64),
        }

    def _add(self, name: str, force: Force) -> None:
        match force:
            case SpringDamper() | TorsionSpring():
                self._add_spring(name, f"forces.{name}", force.pathway, force.linear)
            case Law():
                self._add_law(name, force)
            case Torque() | PointForce():
                self._add_load(name, force.load)

    def _add_spring(
        self,
        name: str,
        key: str,
        pathway: Pathway | SpringDamper | TorsionSpring | MuscleForce | FrictionForce,
        linear: Numbers,
        law: int = -1,
    ) -> None:
        segments = pathway.segments(self.joints)
        first, count = self.first_segments.setdefault(key, len(self.springs)), len(segments)
        for index, segment in enumerate(segments):
            self.spring_places.append(len(self.elements))
            ends = [self.number[body] for body in segment.bodies]
            self.springs.append((PATHWAYS[segment.kind], *ends, law, first, 0 if index else count))
            self.spring_points.append((*segment.points, *segment.constants))
            self.linear.append(linear)
        rows = range(first, first + count)
        self.couplings += [(k, other) for k in rows for other in rows if k != other]
        self.elements.append(ForceElement(name, path_ends(segments), pathway.length_unit))

    def _add_law(self, name: str, force: Law | MuscleForce | FrictionForce, kind: str = "forces") -> None:
        law, segment, begin = force.force_law, len(self.springs), len(self.law_parameters)
        try:
            compiled, block = bind_law(law, force, force.law_id)
            rates = [bind_law(state.rate, force, force.law_id)[0] for state in law.states]
        except SpecError as error:
            raise error.located(prefix=f"model.{kind}.{quoted(name)}") from None
        self._add_spring(name, f"{kind}.{name}", force.pathway, (0.0, 0.0, 0.0), len(self.laws))
        names = [parameter for parameter, _ in compiled.parameters]
        for number, state in enumerate(law.states, len(self.laws) + 1):
            self.states.append(ElementState(f"{name}.{state.name}", state.unit))
            place = begin + 1 + names.index(state.name)
            self.state_places.append((len(self.state_rows), place))
            self.state_rows.append((segment, place, number))
        for one in (compiled, *rates):
            self._add_law_row(name, one, begin)
        self.law_parameters += block

    def _add_friction(self, number: int, friction: FrictionForce) -> None:
        """Add the friction of a joint, and note which parameters of its law stand for multipliers of the joint."""
        begin, law = len(self.law_parameters), len(self.laws)
        self.frictions.append(len(self.springs))
        self._add_law(friction.name, friction, "joints")
        names = [parameter for parameter, _ in self.laws[law][1].parameters]
        for row, name in enumerate(friction.reactions):
            self.reactions.append((friction.number, row, begin + 1 + names.index(name), number))

    def _add_load(self, name: str, load: AppliedLoad) -> None:
        self.load_places.append(len(self.elements))
        self.elements.append(ForceElement(name, (load.reaction_body, load.body), load.length_unit))
        motions = [self.motions.add(value) for value in load.values]
        bodies = (self.number[load.body], self.number[load.reaction_body])
        self.loads.append((LOADS[load.kind], *bodies, *motions, *[-1] * (2 - len(motions))))
        self.load_points.append(load.point)

    def _add_contact(self, rows: Sequence[ActingContact]) -> None:
        """Add the contact of two shapes, given its rows."""
        name, begin = f"contact '{rows[0].pair.name}'", len(self.law_parameters)
        self.contact_rows.append((*rows[0].bodies, len(self.laws)))
        self.law_parameters += contact_numbers(rows)
        for mode in (FORCES, SLOPES):
            self._add_law_row(name, contact_law(rows, mode), begin)

    def _add_wrench(self, name: str, body: int, laws: Sequence[int]) -> None:
        """Add a force at the centre of mass of a body, and a torque if there is a third law."""
        for kind, components in (("point_force", (0, 1)), ("torque", (2,)))[: max(len(laws) - 1, 0)]:
            motions = [self.motions.add(f'contacts["{name}"].{len(self.loads)}.{one}') for one in components]
            self.load_places.append(len(self.elements))
            self.elements.append(ForceElement(name, ("ground", "ground"), "m"))
            self.load_values += [(laws[one], motion) for one, motion in zip(components, motions, strict=True)]
            self.loads.append((LOADS[kind], body, self.number["ground"], *motions, *[-1] * (2 - len(motions))))
            self.load_points.append((0.0, 0.0))

    def _add_held(self, contacts: Sequence[ActingContact], bodies: Sequence[str]) -> list[ActingContact]:
        """Add the states that store the forces and modes of rigid contacts, and the sum of these forces on each body.

        The values of these states are constant during a step. Loads apply the sums to the bodies.

        Returns the contacts, each with the index of its first state.
        """
        found = []
        for contact in contacts:
            found.append(replace(contact, first_state=len(self.states)))
            for name, unit in HELD.items():
                self._add_state(ElementState(f"{contact.pair.name}.{name}", unit), 0.0, -1)
        law = held_law()
        laws: dict[int, list[int]] = {}
        for coordinate in held_coordinates(found):
            number, axis = divmod(coordinate, 3)
            body, (name, unit) = bodies[number], list(HELD_BY_BODY.items())[axis]
            laws.setdefault(number, []).append(len(self.laws))
            self._add_law_row(f"contacts of '{body}'", bind_law(law, {"held": 0.0}, body)[0], len(self.law_parameters))
            self._add_state(ElementState(f"{body}.{name}", unit), 0.0, -1)
        for number, own in laws.items():
            self._add_wrench(bodies[number], number, own)
        return found

    def add_expressions(self, mechanism: Mechanism) -> None:
        """Add the expressions that depend on the state, and the states that belong to them.

        These are values of loads, excitations of muscles, rates of the first-order states that the mechanism defines,
        and outputs and states of sampled controllers.
        """
        held = [(name, value, 0.0) for name, one in mechanism.controllers.items() for value in one.outputs]
        held += [
            (name, value, state.initial)
            for name, one in mechanism.controllers.items()
            for value, state in one.states.items()
        ]
        names = [one.name for one in self.states] + [*mechanism.states, *(f"{name}.{value}" for name, value, _ in held)]
        numbering = Numbering(mechanism, self.number, self.first_segments, {name: i for i, name in enumerate(names)})
        loads = [name for name, force in mechanism.forces.items() if isinstance(force, Torque | PointForce)]
        for k, name in enumerate(loads):
            force = mechanism.forces[name]
            assert isinstance(force, Torque | PointForce)
            for component, text in enumerate(force.load.values):
                if is_of_state(text):
                    self._add_load_value(numbering, name, k, component, str(text))
        for k, one in enumerate(self.muscles):
            for key, text in one.force.muscle.expressions():
                name = one.force.name
                rate = activation_rate_text(one.force.muscle.activation, text, f'states["{name}.activation"]')
                law, _, _ = self._add_expression(numbering, f"model.muscles.{quoted(name)}.{key}", name, rate)
                self.state_rows[one.activation] = (-1, self.state_rows[one.activation][1], law)
                self.muscles[k] = replace(one, excitation=higher_layers.state_program(text, mechanism))
        for name, state in mechanism.states.items():
            law, _, _ = self._add_expression(numbering, f"model.states.{quoted(name)}.rate", name, state.rate)
            self._add_state(ElementState(name, state.unit), state.initial, law)
        for name, value, initial in held:
            self._add_state(ElementState(f"{name}.{value}", "1"), initial, -1)
        for name, controller in mechanism.controllers.items():
            rows = {
                key: self._add_expression(numbering, f"model.controllers.{quoted(name)}.{key}", name, text)[0]
                for key, text in controller.expressions()
            }
            place = numbering.states
            outputs = tuple(
                (place[f"{name}.{value}"], rows[f"outputs.{quoted(value)}"]) for value in controller.outputs
            )
            states = tuple(
                (place[f"{name}.{value}"], rows[f"states.{quoted(value)}.next"]) for value in controller.states
            )
            self.controllers.append(SampledController(name, controller.period, controller.delay, outputs, states))

    def _add_state(self, state: ElementState, initial: float, law: int) -> None:
        place = len(self.law_parameters) + 1
        self.law_parameters += [1.0, initial]
        self.state_places.append((len(self.states), place))
        self.state_rows.append((-1, place, law))
        self.states.append(state)

    def _add_load_value(self, numbering: Numbering, name: str, load: int, component: int, text: str) -> None:
        law, begin, expression = self._add_expression(numbering, f"model.forces.{quoted(name)}.value", name, text)
        self.load_values.append((law, int(self.loads[load][3 + component])))
        inputs = iter(range(len(self.inputs) - len(expression.slopes), len(self.inputs)))
        for slope, number in zip(expression.slopes, inputs, strict=True):
            kind, index, _ = self.inputs[number]
            is_coordinate = kind in (POSITION_INPUT, VELOCITY_INPUT)
            for segment in range(1 if is_coordinate else int(self.springs[int(index)][5])):
                place = -1 if is_coordinate else int(index) + segment
                self.slopes.append((load, component, len(self.laws), number, place))
            self._add_law_row(name, slope, begin)

    def _add_expression(self, numbering: Numbering, key: str, name: str, text: str) -> tuple[int, int, StateExpression]:
        """Add an expression; return the index of its law, where its parameters begin, and the expression."""
        try:
            expression = numbering.expression(text, name)
        except SpecError as error:
            raise error.located(prefix=key) from None
        begin, law = len(self.law_parameters), len(self.laws)
        names = [parameter for parameter, _ in expression.law.parameters]
        self.law_parameters += expression.parameters
        self._add_law_row(name, expression.law, begin)
        for i, (kind, index) in enumerate(expression.inputs):
            place = begin + 1 + names.index(f"input_{i}")
            if kind == STATE_INPUT:
                self.state_places.append((index, place))
            else:
                self.inputs.append((kind, index, place))
        return law, begin, expression

    def _add_law_row(self, name: str, law: CompiledLaw, begin: int) -> None:
        self.laws.append((name, law))
        self.law_rows.append((law.address, begin, law.claims, law.program))
