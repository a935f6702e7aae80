"""Compile a mechanism, whose bodies, joints and forces have names, to flat numbered arrays."""

from __future__ import annotations

import marshal
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.base import higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import plain, quoted
from mbdkit.engine.compiled_mechanism import (
    ActingMuscle,
    CompiledMechanism,
    ElementState,
    ForceElement,
    Row,
    SampledController,
)
from mbdkit.engine.contact_forces import HELD, ActingContact, acting_contacts, contact_laws
from mbdkit.engine.elimination_order import minimum_degree, neighbours
from mbdkit.engine.force_laws import CompiledLaw, bind_law
from mbdkit.engine.kernels.acting import ANGLE, TRAVEL
from mbdkit.engine.kernels.applied_forces import (
    BODY_FORCE,
    PATHWAYS,
    POINT_FORCE,
    POSITION_INPUT,
    TORQUE,
    VELOCITY_INPUT,
)
from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.cross_sections import NODES, PARAMETERS
from mbdkit.engine.kernels.motions import OPCODES
from mbdkit.engine.kernels.system import Topology
from mbdkit.engine.state_expressions import STATE_INPUT, Numbering, StateExpression
from mbdkit.expressions.parser import Expression
from mbdkit.expressions.program import Program, derivative_of
from mbdkit.mechanism.angle_function import AngleFunction, Center, expression_of
from mbdkit.mechanism.contacts import COMPLIANT
from mbdkit.mechanism.forces import AppliedLoad, Force, PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import Pathway, path_ends
from mbdkit.mechanism.state_values import is_of_state
from mbdkit.mechanism.values import Motion, Table, curve_of
from mbdkit.muscles.acting_muscles import MuscleForce, acting_muscles
from mbdkit.muscles.hill_laws import activation_rate_text

Numbers = tuple[float, ...]

LOADS = {"torque": TORQUE, "point_force": POINT_FORCE, "body_force": BODY_FORCE}
"""Kernel code of each kind of load."""
WELL_SCALED = 1e6
"""Largest ratio of masses, and of inertias over squared lever arms, for which the Schur complement is accurate."""


MOST_DISTANCES = 1 << 16
"""Number of distances between points of a body that are computed at once."""


class _Motions:
    """Collects the programs of all motions of a mechanism in flat lists; equal motions share one number.

    The programs of moving centers come last; see `mbdkit.engine.kernels.motions`.
    """

    def __init__(self) -> None:
        self.numbers: dict[Motion, int] = {}
        self.start, self.ops, self.constants = [0], [], []  # type: list[int], list[int], list[float]
        self.tables: list[float] = []

    def add(self, motion: Motion) -> int:
        if motion not in self.numbers:
            self.numbers[motion] = self._append(self._program(motion))
        return self.numbers[motion]

    def add_center(self, center: Center) -> int:
        """Append the programs of both components and their derivatives; return the number of the first."""
        first = len(self.start) - 1
        for _, function in center.functions:
            for derivative in (False, True):
                self._append(self._function_of_angle(function, derivative))
        return first

    def _append(self, program: Program) -> int:
        self.ops += [OPCODES[name] for name, _ in program]
        self.constants += [float(value) for _, value in program]
        self.start.append(len(self.ops))
        return len(self.start) - 2

    def _function_of_angle(self, function: AngleFunction, derivative: bool) -> Program:
        if isinstance(function, str):
            program = expression_of(function).program
            return derivative_of(program) if derivative else program
        if not isinstance(function, Table):
            return (("const", 0.0 if derivative else float(function)),)
        return self._table(function, derivative=derivative)

    def _table(self, table: Table, *, derivative: bool = False) -> Program:
        begin = len(self.tables)
        self.tables += _piecewise_polynomial(table, derivative=derivative)
        return (("table", float(begin)),)

    def _program(self, motion: Motion) -> Program:
        if is_of_state(motion):
            return (("const", 0.0),)  # kernels replace this value
        if isinstance(motion, str):
            return Expression.parse(motion).program
        if not isinstance(motion, Table):
            return (("const", float(motion)),)
        return self._table(motion)

    @property
    def values(self) -> list[float]:
        """The constants of the programs, followed by the tables; the offset of each table is made absolute."""
        ops = zip(self.ops, self.constants, strict=True)
        return [x + len(self.ops) if op == OPCODES["table"] else x for op, x in ops] + self.tables


def _piecewise_polynomial(table: Table, *, derivative: bool) -> list[float]:
    """Return the curve of a table for the kernel: numbers of pieces and coefficients, period, times, coefficients."""
    times = np.array(table.table[0])
    coefficients = np.full((len(times) - 1, 4), np.nan)  # reported later, by `check_motions` of assembly
    with np.errstate(all="ignore"), suppress(ValueError, np.linalg.LinAlgError):
        curve = curve_of(table).derivative() if derivative else curve_of(table)
        if np.all(np.isfinite(curve.c)):
            times, coefficients = curve.x, curve.c[::-1].T
    pieces, terms = coefficients.shape
    return [float(pieces), float(terms), table.period, *times.tolist(), *coefficients.ravel().tolist()]


def compile_mechanism(mechanism: Mechanism) -> CompiledMechanism:
    """Compile a validated mechanism to flat arrays.

    Parameters
    ----------
    mechanism
        Bodies, joints and forces by name.

    Returns
    -------
    CompiledMechanism
        The flat arrays. Pairs of constraint rows are numbered in order of elimination.
    """
    bodies = tuple(mechanism.bodies)
    number = {name: i for i, name in enumerate(bodies)}
    ground = number["ground"] = len(bodies)
    motions = _Motions()
    pairs = _pairs(mechanism, number, motions)
    forces = _Forces(mechanism, number, motions)
    forces.add_expressions(mechanism)
    beams = _Beams(mechanism, number)
    centered = _add_centers(pairs, motions)
    order, below = minimum_degree(neighbours([pair.bodies for pair in pairs], ground))
    place = {pair: k for k, pair in enumerate(order)}

    joint_pairs: list[list[int]] = [[] for _ in mechanism.joints]
    joints = list(mechanism.joints.items())
    rows = []
    for written, pair in enumerate(pairs):
        joint_pairs[pair.joint].append(place[written])
        name, joint = joints[pair.joint]
        for r in range(pair.rows):
            row = pair.first_row + r
            rows.append(Row(place[written], r, f"{name}.{joint.rows[row]}", joint.units[row]))

    length = characteristic_length(mechanism)
    topology = Topology(
        **_of_bodies(mechanism),
        **_of_pairs([pairs[k] for k in order], rows, min(1.0, length)),
        **forces.arrays(),
        sections=np.array(beams.sections, dtype=np.int64).reshape(-1, 2 + NODES),
        section_parameters=np.array(beams.parameters, dtype=float).reshape(-1, PARAMETERS),
        **_of_joints_and_markers(mechanism, number),
        centers=np.array([pair.bodies for pair in centered], dtype=np.int64).reshape(-1, 2),
        motion_start=np.array(motions.start, dtype=np.int64),
        motion_ops=np.array(motions.ops, dtype=np.int64),
        motion_values=np.array(motions.values, dtype=float),
        baumgarte=np.zeros(2),
    )
    return CompiledMechanism(
        topology=topology,
        bodies=bodies,
        joints=tuple(mechanism.joints),
        joint_bodies=tuple(joint.bodies for joint in mechanism.joints.values()),
        rows=tuple(rows),
        joint_pairs=tuple(tuple(members) for members in joint_pairs),
        joint_units=tuple(joint.coordinate_unit for _, joint in joints),
        forces=tuple(forces.elements[: len(mechanism.forces)]),
        beams=tuple((name, beam.elements) for name, beam in mechanism.beams.items()),
        markers=tuple((name, marker.body) for name, marker in mechanism.markers.items()),
        drivers=frozenset(name for name, joint in joints if joint.is_driver),
        coordinates=sum(2 if body.inertia is None else 3 for body in mechanism.bodies.values()),
        length=length,
        motions=tuple(motions.numbers),
        laws=tuple(forces.laws),
        states=tuple(forces.states),
        controllers=tuple(forces.controllers),
        muscles=tuple(forces.muscles),
        contacts=tuple(forces.contacts),
        contact_treatment=mechanism.contact_treatment if mechanism.contacts else COMPLIANT,
        order=tuple(order),
        below=tuple(frozenset(b) for b in below),
        well_scaled=_is_well_scaled(mechanism),
    )


def _of_bodies(mechanism: Mechanism) -> dict[str, np.ndarray]:
    """Return the arrays of `Topology` about masses, the ground last."""
    mass = np.ones((len(mechanism.bodies) + 1, 3))
    for i, body in enumerate(mechanism.bodies.values()):
        mass[i] = (body.mass, body.mass, 1.0 if body.inertia is None else body.inertia)
    weight = 1 / mass
    weight[-1] = 0.0
    return {"mass": mass, "weight": weight, "gravity": np.array(mechanism.gravity, dtype=float)}


def _of_pairs(pairs: Sequence[_Pair], rows: Sequence[Row], unit: float) -> dict[str, np.ndarray]:
    """Return the arrays of `Topology` about pairs of constraint rows in order of elimination; `unit` of lengths [m]."""
    row_units = np.full((len(pairs), 2), unit)
    for one in rows:
        if one.unit == "rad":
            row_units[one.pair, one.place] = 1.0
    codes = [(KINDS[pair.kind], *pair.bodies, pair.motion) for pair in pairs]
    return {
        "pairs": np.array(codes, dtype=np.int64).reshape(-1, 4),
        "rows": np.array([pair.rows for pair in pairs], dtype=np.int64),
        "length": np.array([unit]),
        "row_units": row_units,
        "pair_parameters": np.array([pair.parameters for pair in pairs], dtype=float).reshape(-1, 6),
        "spare": np.zeros((0, 2), dtype=np.int64),
        "spare_axes": np.zeros((0, 2)),
        "pair_joint": np.array([pair.joint for pair in pairs], dtype=np.int64),
    }


def _of_joints_and_markers(mechanism: Mechanism, number: dict[str, int]) -> dict[str, np.ndarray]:
    """Return the arrays of `Topology` about recorded angles and travels of joints, and about markers."""
    joints, markers = mechanism.joints.values(), mechanism.markers.values()
    recorded = [(ANGLE if joint.travel is None else TRAVEL, *(number[x] for x in joint.bodies)) for joint in joints]
    return {
        "joints": np.array(recorded, dtype=np.int64).reshape(-1, 3),
        "joint_lines": np.array([joint.travel or (0.0,) * 6 for joint in joints], dtype=float).reshape(-1, 6),
        "markers": np.array([number[marker.body] for marker in markers], dtype=np.int64),
        "marker_points": np.array([marker.held for marker in markers], dtype=float).reshape(-1, 2),
    }


def compiled_content(mechanism: Mechanism) -> bytes | None:
    """Return all input of `compile_mechanism` and of the choice of fixed bodies as a key; None if it cannot be a key.

    Mechanisms with equal keys differ in their initial positions and velocities only; these are part of the key if a
    joint depends on them. Numbers are compared bitwise, so that 0.0 and -0.0 differ.
    """
    posed = any(joint.point_moves_on_first or joint.angles() for joint in mechanism.joints.values())
    bodies = [
        (name, body.mass, body.inertia, (body.position, body.angle) if posed else None)
        for name, body in mechanism.bodies.items()
    ]
    elements = [
        (name, type(one).__name__, one.__dict__)
        for kind, named in mechanism.elements.items()
        for name, one in named.items()
        if kind not in ("muscles", "contacts")
    ]
    fixed = mechanism.assembly.fix
    data = [
        (name, plain(one))
        for named in (
            mechanism.beams,
            mechanism.states,
            mechanism.controllers,
            mechanism.muscles if mechanism.muscles_act else {},
            mechanism.contacts,
            {"treatment": tuple(mechanism.contact_treatment)} if mechanism.contacts else {},
        )
        for name, one in named.items()
    ]
    try:
        return marshal.dumps((bodies, data, elements, len(mechanism.joints), tuple(mechanism.gravity), tuple(fixed)), 2)
    except ValueError:  # hashing fails for a table of a motion, or for the options of a force law
        return None


@dataclass(frozen=True)
class _Pair:
    """One or two constraint rows of a joint; `first_row` is the index of the first one among the rows of the joint."""

    joint: int
    first_row: int
    rows: int
    kind: str
    bodies: tuple[int, int]
    parameters: Numbers
    motion: int = -1
    center: Center | None = None


def _pairs(mechanism: Mechanism, number: dict[str, int], motions: _Motions) -> list[_Pair]:
    """Return the pairs of rows of all joints. The rows of a pair have the same unit, metres or radians."""
    pairs: list[_Pair] = []
    for j, joint in enumerate(mechanism.joints.values()):
        a, b = joint.bodies
        for one in joint.constraints(mechanism.relative_angle(a, b)):
            motion = -1 if one.motion is None else motions.add(one.motion)
            numbers = (*one.points, *one.constants)
            ends = (number[a], number[b])
            pairs.append(_Pair(j, one.first_row, one.rows, one.kind, ends, numbers, motion, one.center))
    return pairs


def _add_centers(pairs: list[_Pair], motions: _Motions) -> list[_Pair]:
    """Add the programs of moving centers after those of all motions; return the pairs that have one, in their order."""
    centered = []
    for k, pair in enumerate(pairs):
        if pair.center is not None:
            pairs[k] = replace(pair, motion=motions.add_center(pair.center))
            centered.append(pairs[k])
    return centered


class _Forces:
    """Collects force elements on pathways (springs) and loads: their kinds, bodies and parameters."""

    def __init__(self, mechanism: Mechanism, number: dict[str, int], motions: _Motions):
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
        self.load_points: list[Numbers] = []
        for name, force in mechanism.forces.items():
            self.add(name, force)
        for name, muscle in acting_muscles(mechanism).items():
            self.muscles.append(ActingMuscle(muscle, len(self.states)))
            self.add_law(name, muscle, "muscles")
        self.contacts = [self.add_contact(contact) for contact in acting_contacts(mechanism, number)]

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
            "loads": np.array(self.loads, dtype=np.int64).reshape(-1, 5),
            "load_points": np.array(self.load_points, dtype=float).reshape(-1, 2),
            "force_place": np.array(self.spring_places + self.load_places, dtype=np.int64),
        }

    def add(self, name: str, force: Force) -> None:
        match force:
            case SpringDamper() | TorsionSpring():
                self.add_spring(name, f"forces.{name}", force.pathway, force.linear)
            case Law():
                self.add_law(name, force)
            case Torque() | PointForce():
                self.add_load(name, force.load)

    def add_spring(
        self,
        name: str,
        key: str,
        pathway: Pathway | SpringDamper | TorsionSpring | MuscleForce,
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

    def add_law(self, name: str, force: Law | MuscleForce, kind: str = "forces") -> None:
        law, segment, begin = force.force_law, len(self.springs), len(self.law_parameters)
        try:
            compiled, block = bind_law(law, force, force.law_id)
            rates = [bind_law(state.rate, force, force.law_id)[0] for state in law.states]
        except SpecError as error:
            raise error.located(prefix=f"model.{kind}.{quoted(name)}") from None
        self.add_spring(name, f"{kind}.{name}", force.pathway, (0.0, 0.0, 0.0), len(self.laws))
        names = [parameter for parameter, _ in compiled.parameters]
        for number, state in enumerate(law.states, len(self.laws) + 1):
            self.states.append(ElementState(f"{name}.{state.name}", state.unit))
            place = begin + 1 + names.index(state.name)
            self.state_places.append((len(self.state_rows), place))
            self.state_rows.append((segment, place, number))
        for one in (compiled, *rates):
            self._add_law_row(name, one, begin)
        self.law_parameters += block

    def add_load(self, name: str, load: AppliedLoad) -> None:
        self.load_places.append(len(self.elements))
        self.elements.append(ForceElement(name, (load.reaction_body, load.body), load.length_unit))
        motions = [self.motions.add(value) for value in load.values]
        bodies = (self.number[load.body], self.number[load.reaction_body])
        self.loads.append((LOADS[load.kind], *bodies, *motions, *[-1] * (2 - len(motions))))
        self.load_points.append(load.point)

    def add_contact(self, contact: ActingContact) -> ActingContact:
        """Add a force and a torque at the centre of mass of each body that moves; see `contact_forces`.

        Returns the contact with the number of its first state, if it is rigid.
        """
        form, begin, name = contact.form, len(self.law_parameters), contact.pair.name
        laws = contact_laws(form, len(contact.numbers))
        first, places = len(self.inputs), {}
        rows: dict[int, int] = {}
        for component, law in laws.values.items():
            compiled, block = bind_law(law, contact.options, name)
            if not rows:
                self.law_parameters += block
                names = [parameter for parameter, _ in compiled.parameters]
                for i, (kind, index, number) in enumerate(contact.inputs):
                    self.inputs.append((kind, index, begin + 1 + names.index(f"input_{number:02d}")))
                    places[number] = first + i
            rows[component] = len(self.laws)
            self._add_law_row(f"contact '{name}'", compiled, begin)
        for side, count in enumerate(form.moving):
            of_side = (("point_force", (0, 1)), ("torque", (2,)))[: count - 1 if count else 0]
            for load_kind, components in of_side:
                load = len(self.loads)
                motions = [self.motions.add(f'contacts["{name}"].{3 * side + one}') for one in components]
                body, ground = contact.bodies[side], self.number["ground"]
                self.load_places.append(len(self.elements))
                self.elements.append(ForceElement(name, ("ground", "ground"), "m"))
                self.loads.append((LOADS[load_kind], body, ground, *motions, *[-1] * (2 - len(motions))))
                self.load_points.append((0.0, 0.0))
                for place, one in enumerate(components):
                    component = 3 * side + one
                    self.load_values.append((rows[component], motions[place]))
                    for (of, by), slope in laws.slopes.items():
                        if of == component:
                            self.slopes.append((load, place, len(self.laws), places[by], -1))
                            compiled, _ = bind_law(slope, contact.options, name)
                            self._add_law_row(f"contact '{name}'", compiled, begin)
        if contact.first_state < 0:
            return contact
        shapes = len(contact.pair.numbers)
        for i, quantity in enumerate(HELD):
            place = begin + 1 + names.index(f"number_{shapes + i:03d}")
            self.state_places.append((len(self.states), place))
            self.state_rows.append((-1, place, -1))
            self.states.append(ElementState(f"{name}.{quantity}", "1" if quantity == "mode" else "N"))
        return replace(contact, first_state=len(self.states) - len(HELD))

    def add_expressions(self, mechanism: Mechanism) -> None:
        """Add the expressions of the state: values of loads, and rates of the mechanism's own states."""
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
        """Add an expression; return its row of laws, the place of its parameters, and the expression."""
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


class _Beams:
    """Collects the cross-sections of all beams: their elements and nodes, and their parameters."""

    def __init__(self, mechanism: Mechanism, number: dict[str, int]):
        self.sections: list[Numbers] = []
        self.parameters: list[Numbers] = []
        elements = 0
        for name, beam in mechanism.beams.items():
            stiffness = beam.section_stiffness
            damping = tuple(beam.damping * one for one in stiffness)
            for section in beam.sections(name):
                nodes = [number[node] for node in section.nodes]
                spare = NODES - len(nodes)
                self.sections.append((elements + section.element, len(nodes), *nodes, *nodes[-1:] * spare))
                shapes = (*section.shape, *[0.0] * spare, *section.slope, *[0.0] * spare)
                self.parameters.append((*shapes, section.length, *stiffness, *section.reference, *damping))
            elements += beam.elements


def characteristic_length(mechanism: Mechanism) -> float:
    """Return the largest distance [m] between two joint points, or a joint point and the centre of mass, of one body.

    The length of a beam counts as well. The result is 1 if all distances are 0.
    """
    points: dict[str, set[tuple[float, float]]] = {name: {(0.0, 0.0)} for name in mechanism.bodies}
    for joint in mechanism.joints.values():
        for _, name, point in joint.attachments():
            if name in points:
                points[name].add(point)
    longest = max((beam.length for beam in mechanism.beams.values()), default=0.0)
    for held in points.values():
        if len(held) > 1:
            x, y = np.array(sorted(held)).T
            rows = max(1, MOST_DISTANCES // len(x))
            for first in range(0, len(x), rows):
                some = slice(first, first + rows)
                distances = np.hypot(x[some, None] - x, y[some, None] - y)
                longest = max(longest, float(np.max(distances)))
    return longest or 1.0


def _is_well_scaled(mechanism: Mechanism) -> bool:
    """Return whether the masses and inertias have ratios of at most `WELL_SCALED`.

    Masses are compared with inertias over squared lever arms of the joints. The inertias of bodies whose angles are
    coupled by a joint are compared with each other.
    """
    arms = dict.fromkeys(mechanism.bodies, 0.0)
    for joint in mechanism.joints.values():
        for _, name, (x, y) in joint.attachments():
            if name in arms:
                arms[name] = max(arms[name], x * x + y * y)
        a = joint.bodies[0]
        if joint.point_moves_on_first and a in arms:  # the reaction on `a` acts at the point of `b`
            for _, name, point in joint.attachments()[-1:]:
                x, y = mechanism.to_local(a, mechanism.to_global(name, point))
                arms[a] = max(arms[a], x * x + y * y)
    scales = [body.mass for body in mechanism.bodies.values()]
    scales += [body.inertia / arms[name] for name, body in mechanism.bodies.items() if body.inertia and arms[name] > 0]
    tied = {name for joint in mechanism.joints.values() if len(joint.angles()) == 2 for _, name in joint.angles()}
    inertias = [inertia for name in tied if name in arms and (inertia := mechanism.bodies[name].inertia)]
    return all(not sizes or max(sizes) <= WELL_SCALED * min(sizes) for sizes in (scales, inertias))
