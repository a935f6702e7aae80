"""Compile the forces, loads, states and elements of further kinds of a mechanism to flat numbered arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Never

import numpy as np

from mbdkit.base.errors import PluginError, SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.traced_numbers import as_float, float_array
from mbdkit.engine.compiled_mechanism import ActingForce, CompiledInput, ElementState, ForceElement, SampledController
from mbdkit.engine.force_laws import CompiledLaw, NativeLaw, bind_law, native_law
from mbdkit.engine.friction_forces import FollowingForce, FrictionForce, following_forces, friction_forces
from mbdkit.engine.kernels import table_rows as rows
from mbdkit.engine.kernels.applied_forces import (
    BODY_FORCE,
    PATHWAYS,
    POINT_FORCE,
    POSITION_INPUT,
    TORQUE,
    VELOCITY_INPUT,
)
from mbdkit.engine.kernels.law_programs import run_program
from mbdkit.engine.kernels.motions import OPCODES
from mbdkit.engine.kernels.pose_functions import POSE
from mbdkit.engine.state_expressions import STATE_INPUT, Numbering, StateExpression, laws_of
from mbdkit.expressions.parser import Expression
from mbdkit.expressions.program import Program, derivative_of
from mbdkit.mechanism.angle_function import AngleFunction, Center, expression_of
from mbdkit.mechanism.element_kinds import element_kinds, forces_of
from mbdkit.mechanism.forces import AppliedLoad, Force, PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.joint_base import PoseFunction
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import LawForce, path_ends
from mbdkit.mechanism.state_values import Input, is_of_state
from mbdkit.mechanism.values import Motion, Table, curve_of
from mbdkit.registry.element_items import ElementKind
from mbdkit.registry.seam import OwnSeam


class CompiledMotions:
    """Collects the programs of all motions of a mechanism in flat lists. Equal motions share one program.

    A program is a list of operations with constants, see `mbdkit.engine.kernels.motions`. The programs of moving
    centers come last.
    """

    def __init__(self) -> None:
        self.numbers: dict[Motion, int] = {}
        self.start, self.ops, self.constants = [0], [], []  # type: list[int], list[int], list[float]
        self.tables: list[float] = []

    def add(self, motion: Motion) -> int:
        """Return the index of the program of a motion; a motion that equals an earlier one is not compiled again."""
        if motion not in self.numbers:
            self.numbers[motion] = self._append(self._program(motion))
        return self.numbers[motion]

    def add_center(self, center: Center) -> int:
        """Append the programs of both components of a moving centre and of their derivatives; return the index of the
        first.
        """
        first = len(self.start) - 1
        for _, function in center.functions:
            for derivative in (False, True):
                self._append(self._function_of_angle(function, derivative))
        return first

    def _append(self, program: Program) -> int:
        self.ops += [OPCODES[name] for name, _ in program]
        self.constants += [as_float(value) for _, value in program]
        self.start.append(len(self.ops))
        return len(self.start) - 2

    def _function_of_angle(self, function: AngleFunction, derivative: bool) -> Program:
        if isinstance(function, str):
            program = expression_of(function).program
            return derivative_of(program) if derivative else program
        if not isinstance(function, Table):
            return (("const", 0.0 if derivative else as_float(function)),)
        return self._table(function, derivative=derivative)

    def _table(self, table: Table, *, derivative: bool = False) -> Program:
        begin = len(self.tables)
        self.tables += _piecewise_polynomial(table, derivative=derivative)
        return (("table", float(begin)),)

    def _program(self, motion: Motion) -> Program:
        if is_of_state(motion):
            return (("const", 0.0),)  # placeholder; kernels compute the value from the state
        if isinstance(motion, str):
            return Expression.parse(motion).program
        if not isinstance(motion, Table):
            return (("const", as_float(motion)),)
        return self._table(motion)

    @property
    def values(self) -> list[float]:
        """The constants of the programs, followed by the numbers of the tables.

        The constant of a ``table`` operation is the index at which the table begins in this list.
        """
        ops = zip(self.ops, self.constants, strict=True)
        return [x + len(self.ops) if op == OPCODES["table"] else x for op, x in ops] + self.tables


def _piecewise_polynomial(table: Table, *, derivative: bool) -> list[float]:
    """Return the curve of a table, or its derivative, as the list of numbers that kernels read.

    The list contains the number of pieces, the number of coefficients of each piece, the period, the times (or angles)
    at which pieces begin and end, and the coefficients of each piece, those of the highest power last. All coefficients
    are nan if no curve passes through the points.
    """
    times = np.array(table.table[0])
    coefficients = np.full((len(times) - 1, 4), np.nan)  # stays if there is no curve; `check_motions` reports it
    with np.errstate(all="ignore"), suppress(ValueError, np.linalg.LinAlgError):
        curve = curve_of(table).derivative() if derivative else curve_of(table)
        if np.all(np.isfinite(curve.c)):
            times, coefficients = curve.x, curve.c[::-1].T
    pieces, terms = coefficients.shape
    return [float(pieces), float(terms), table.period, *times.tolist(), *coefficients.ravel().tolist()]


Numbers = tuple[float, ...]

#: Kernel code of each kind of load.
LOADS = {"torque": TORQUE, "point_force": POINT_FORCE, "body_force": BODY_FORCE}


#: Law whose value is its only parameter, and an example of its parameters.
_OF_PARAMETER = laws_of((("constant", 0),), 0)[0], {"constant_0": 0.0}

FRICTION = 200  #: Kinds of elements of lower order are compiled before the friction in joints.


def table(entries: Sequence[tuple[int, ...]], columns: tuple[int, ...]) -> np.ndarray:
    """Return rows of integers as a table; `columns` are its columns (`mbdkit.engine.kernels.table_rows`)."""
    return np.array(entries, dtype=np.int64).reshape(-1, len(columns))


class Lowering:
    """Collects the force elements on pathways, loads and first-order states of a mechanism in flat lists.

    Kinds of elements of plugins add theirs with `force`, `guide`, `state`, `wrench`, `law`, `pair` and `expression`.
    """

    def __init__(self, mechanism: Mechanism, number: dict[str, int], motions: CompiledMotions):
        self.mechanism, self.joints, self.bodies, self.motions = mechanism, mechanism.joints, number, motions
        self.springs: list[rows.SpringRow] = []
        self.spring_points: list[Numbers] = []
        self.couplings: list[rows.CouplingRow] = []
        self.linear: list[Numbers] = []
        self.laws: list[tuple[str, CompiledLaw]] = []
        self.law_rows: list[rows.LawRow] = []
        self.law_parameters: list[float] = []
        self.states: list[ElementState] = []
        self.state_rows: list[rows.StateRow] = []
        self.state_places: list[rows.StateUse] = []
        self.inputs: list[rows.InputRow] = []
        self.load_values: list[rows.LoadValueRow] = []
        self.slopes: list[rows.SlopeRow] = []
        self.first_segments: dict[str, int] = {}
        self.controllers: list[SampledController] = []
        self.compiled_inputs: list[CompiledInput] = []
        self.acting: list[ActingForce] = []
        self.extensions: dict[str, Any] = {}
        self.numbering: Numbering
        self.elements: list[ForceElement] = []
        self.spring_places: list[int] = []
        self.load_places: list[int] = []
        self.loads: list[rows.LoadRow] = []
        self.pairs: list[rows.InteractionRow] = []
        self.load_points: list[Numbers] = []
        self.frictions: list[int] = []
        self.reactions: list[tuple[int, int, int, int]] = []
        for name, force in mechanism.forces.items():
            self._add(name, force)
        further = acting_kinds(mechanism)
        for kind in further:
            if kind.order < FRICTION:
                self._add_kind(kind)
        self.friction = friction_forces(mechanism)
        self.first_friction = len(self.elements)
        self.following = following_forces(mechanism)
        of_joints: list[FrictionForce | FollowingForce] = [*self.friction, *self.following]
        for place, force_of_joint in enumerate(of_joints):
            self._add_friction(place, force_of_joint)
        for kind in further:
            if kind.order >= FRICTION:
                self._add_kind(kind)

    def number(self, body: str) -> int:
        """Return the index of a body; `ground` is last."""
        return self.bodies[body]

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of `Topology` about forces."""
        for k in self._unguided():
            name = self.elements[self.spring_places[k]].name
            raise PluginError(f"'{name}' has a guided segment without a function; give it one with `Lowering.guide`")
        return {
            "springs": table(self.springs, rows.SPRING),
            "spring_points": float_array(self.spring_points, 6),
            "couplings": table(self.couplings, rows.COUPLING),
            "linear": float_array(self.linear, len(rows.LINEAR)),
            "laws": table(self.law_rows, rows.LAW_ROW),
            "states": table(self.state_rows, rows.STATE_ROW),
            "state_places": table(self.state_places, rows.STATE_USE),
            "inputs": table(self.inputs, rows.INPUT),
            "load_values": table(self.load_values, rows.LOAD_VALUE),
            "slopes": table(self.slopes, rows.SLOPE),
            "law_parameters": float_array(self.law_parameters),
            "frictions": np.array(self.frictions, dtype=np.int64),
            "loads": table(self.loads, rows.LOAD),
            "load_points": float_array(self.load_points, 2),
            "interactions": table(self.pairs, rows.INTERACTION),
            "force_place": np.array(self.spring_places + self.load_places, dtype=np.int64),
        }

    def _add(self, name: str, force: Force) -> None:
        match force:
            case SpringDamper() | TorsionSpring():
                self._add_spring(name, f"forces.{name}", force.pathway, force.linear)
            case Law():
                self.force("force", "forces", name, force)
            case Torque() | PointForce():
                self._add_load(name, force.load)

    def _add_spring(self, name: str, key: str, pathway: Any, linear: Numbers, law: int = -1) -> None:
        segments = pathway.segments(self.joints)
        first, count = self.first_segments.setdefault(key, len(self.springs)), len(segments)
        for index, segment in enumerate(segments):
            self.spring_places.append(len(self.elements))
            a, b = (self.bodies[body] for body in segment.bodies)
            self.springs.append(rows.SpringRow(PATHWAYS[segment.kind], a, b, law, first, 0 if index else count))
            self.spring_points.append((*segment.points, *segment.constants))
            self.linear.append(linear)
        own = range(first, first + count)
        self.couplings += [rows.CouplingRow(k, other) for k in own for other in own if k != other]
        self.elements.append(ForceElement(name, path_ends(segments), pathway.length_unit))

    def _add_kind(self, kind: ElementKind) -> None:
        key, elements = kind.key_in_model, getattr(self.mechanism, kind.key_in_model)
        acting = tuple(self.force(kind.name, key, name, force) for name, force in forces_of(kind, elements).items())
        lower = kind.acts.lower
        self.extensions[key] = acting if lower is None else lowering.of(lower)(elements, self, acting)

    def force(self, kind: str, key: str, name: str, force: LawForce) -> ActingForce:
        """Add a force element with a law along a pathway, and its states.

        `kind`, `key`: word for the kind of element, and its key in the model. `name`, `force`: name of the element, and
        the force element.
        """
        acting = ActingForce(kind, name, force, len(self.elements), len(self.states))
        self._add_law(name, force, key)
        self.acting.append(acting)
        return acting

    def guide(self, acting: ActingForce, function: Callable[[Any], Sequence[Any]]) -> None:
        """Give the next guided segment of a force element its function of the relative angle, which is recorded: the
        length, and components x and y, in the frame of the second body, of its derivative with respect to p_b - p_a. A
        tension of 1 pulls the second body with the negative of these components.
        """
        from mbdkit.engine.law_compiler import program_of_guide

        k = next((k for k in self._unguided() if self.spring_places[k] == acting.place), None)
        if k is None:
            raise PluginError(f"{acting.kind} '{acting.name}' has no further guided segment")
        place = sum(row.guide >= 0 for row in self.springs)
        self.springs[k] = self.springs[k]._replace(guide=len(self.laws), place=place)
        law = native_law(NativeLaw(run_program, tuple(program_of_guide(function).tolist())))
        self._add_law_row(acting.name, law, len(self.law_parameters))
        self.law_parameters.append(0.0)

    def _unguided(self) -> list[int]:
        """Return the guided segments without a function."""
        return [k for k, row in enumerate(self.springs) if row.pathway == PATHWAYS["guided"] and row.guide < 0]

    def _add_law(self, name: str, force: LawForce, kind: str) -> None:
        law, segment, begin = force.force_law, len(self.springs), len(self.law_parameters)
        with SpecError.locate(f"model.{kind}.{quoted(name)}"):
            compiled, block = bind_law(law, force, force.law_id)
            rates = [bind_law(state.rate, force, force.law_id)[0] for state in law.states]
        self._add_spring(name, f"{kind}.{name}", force.pathway, (0.0, 0.0, 0.0), len(self.laws))
        names = [parameter for parameter, _ in compiled.parameters]
        for number, state in enumerate(law.states, len(self.laws) + 1):
            self.states.append(ElementState(f"{name}.{state.name}", state.unit))
            index = begin + 1 + names.index(state.name)
            self.state_places.append(rows.StateUse(len(self.state_rows), index))
            self.state_rows.append(rows.StateRow(segment, index, number))
        for part in (compiled, *rates):
            self._add_law_row(name, part, begin)
        self.law_parameters += block

    def _add_friction(self, number: int, friction: FrictionForce | FollowingForce) -> None:
        """Add a force that follows the reaction of a joint, and note which parameters of its law are multipliers."""
        begin, law = len(self.law_parameters), len(self.laws)
        self.frictions.append(len(self.springs))
        self._add_law(friction.name, friction, "joints")
        names = [parameter for parameter, _ in self.laws[law][1].parameters]
        for row, name in friction.reactions:
            self.reactions.append((friction.number, row, begin + 1 + names.index(name), number))

    def _add_load(self, name: str, load: AppliedLoad) -> None:
        element = ForceElement(name, (load.reaction_body, load.body), load.length_unit)
        bodies = (self.bodies[load.body], self.bodies[load.reaction_body])
        self._add_load_row(element, load.kind, bodies, load.values, load.point)

    def _add_load_row(
        self, element: ForceElement, kind: str, bodies: tuple[int, int], values: Sequence[Motion], point: Numbers
    ) -> list[int]:
        """Add a load, and return the indices of the programs of its values."""
        self.load_places.append(len(self.elements))
        self.elements.append(element)
        motions = [self.motions.add(value) for value in values]
        self.loads.append(rows.LoadRow(LOADS[kind], *bodies, *motions, *[-1] * (2 - len(motions))))
        self.load_points.append(point)
        return motions

    def pair(self, name: str, bodies: tuple[int, int], laws: Sequence[CompiledLaw], numbers: Sequence[float]) -> int:
        """Add a force between two bodies that depends on their poses and velocities; return the index of its law.

        `name`: name in messages. `bodies`: indices of the bodies. `laws`: the law of the forces and the law of their
        slopes. `numbers`: parameters of the laws, preceded by their number.
        """
        begin, first = len(self.law_parameters), len(self.laws)
        self.pairs.append(rows.InteractionRow(*bodies, first))
        self.law_parameters += numbers
        for law in laws:
            self._add_law_row(name, law, begin)
        return first

    def function(self, name: str, function: PoseFunction) -> int:
        """Add the laws of a function of the pose of a joint; return the index of the first one.

        The first law gives the value and the first two derivatives, the next one the third derivatives.
        """
        from mbdkit.engine.function_laws import laws_of_function  # most mechanisms have no such joint

        begin, first = len(self.law_parameters), len(self.laws)
        self.law_parameters += [float(POSE + len(function.parameters)), *[0.0] * POSE]
        self.law_parameters += [value for _, value in function.parameters]
        for law in laws_of_function(function, name):
            self._add_law_row(name, law, begin)
        return first

    def law(self, name: str, law: Any, options: Any, key: str) -> int:
        """Add a law without a pathway, whose value may be a component of a `wrench`; return its index."""
        begin = len(self.law_parameters)
        compiled, block = bind_law(law, options, key)
        self.law_parameters += block
        self._add_law_row(name, compiled, begin)
        return len(self.laws) - 1

    def wrench(self, name: str, body: int, laws: Sequence[int]) -> None:
        """Add a force at the centre of mass of a body, and a torque if there is a third law.

        `name`: name of the load in messages. `body`: index of the body. `laws`: indices of the laws of the components x
        and y, and of the torque.
        """
        for kind, components in (("point_force", (0, 1)), ("torque", (2,)))[: max(len(laws) - 1, 0)]:
            element, bodies = ForceElement(name, ("ground", "ground"), "m"), (body, self.bodies["ground"])
            values = [f'loads["{name}"].{len(self.loads)}.{component}' for component in components]
            motions = self._add_load_row(element, kind, bodies, values, (0.0, 0.0))
            self.load_values += map(rows.LoadValueRow, (laws[i] for i in components), motions)

    def add_expressions(self, mechanism: Mechanism) -> None:
        """Add the expressions that depend on the state, and the states that belong to them.

        These are values of loads, expressions of further kinds of elements, rates of the first-order states that the
        mechanism defines, outputs and states of sampled controllers, and inputs.
        """
        held = [
            (f"{name}.{value}", controller.unit_of(value), 0.0)
            for name, controller in mechanism.controllers.items()
            for value in controller.outputs
        ]
        held += [
            (f"{name}.{value}", "1", state.initial)
            for name, controller in mechanism.controllers.items()
            for value, state in controller.states.items()
        ]
        names = [*(state.name for state in self.states), *mechanism.states, *(name for name, *_ in held)]
        places = {name: i for i, name in enumerate(names)}
        self.compiled_inputs += _numbered(mechanism.inputs, len(names))
        inputs = {item.name: item.state for item in self.compiled_inputs}
        numbering = self.numbering = Numbering(mechanism, self.bodies, self.first_segments, places, inputs)
        loads = [(name, one.load) for name, one in mechanism.forces.items() if isinstance(one, Torque | PointForce)]
        for k, (name, load) in enumerate(loads):
            for component, text in enumerate(load.values):
                if is_of_state(text):
                    self._add_load_value(name, k, component, str(text))
        for kind in acting_kinds(mechanism):
            if (lower := kind.acts.lower_expressions) is not None:
                handle = self.extensions[kind.key_in_model]
                self.extensions[kind.key_in_model] = expression_lowering.of(lower)(handle, self)
        for name, state in mechanism.states.items():
            law = self.expression(f"model.states.{quoted(name)}.rate", name, state.rate)
            self.state(name, state.unit, state.initial, law)
        for name, unit, initial in held:
            self.state(name, unit, initial)
        for item in self.compiled_inputs:
            self._add_input(item)
        for name, controller in mechanism.controllers.items():
            laws = {
                key: self.expression(f"model.controllers.{quoted(name)}.{key}", name, text)
                for key, text in controller.expressions()
            }
            place = numbering.states
            outputs = tuple(
                (place[f"{name}.{value}"], laws.get(f"outputs.{quoted(value)}", -1)) for value in controller.outputs
            )
            states = tuple(
                (place[f"{name}.{value}"], laws[f"states.{quoted(value)}.next"]) for value in controller.states
            )
            arguments = tuple((text, laws[f"inputs[{i}]"]) for i, text in enumerate(controller.inputs))
            self.controllers.append(
                SampledController(
                    name, controller.period, controller.delay, outputs, states, tuple(controller.outputs),
                    controller.python or "", arguments,
                )
            )  # fmt: skip

    def _add_input(self, item: CompiledInput) -> None:
        value = self.state(f"inputs.{item.name}", item.unit, item.initial)
        if item.is_linear:
            law, _ = bind_law(*_OF_PARAMETER, item.name)
            self._add_law_row(item.name, law, len(self.law_parameters))  # the next state is its parameter
            self.set_rate(value, len(self.laws) - 1)
            self.state(f"inputs.{item.name}.slope", f"{item.unit}/s", 0.0)

    def state(self, name: str, unit: str, initial: float, law: int = -1, *, by_method: bool = False) -> int:
        """Add a first-order state, and return its index.

        `name`, `unit`: name, such as ``element.state``, and unit. `initial`: initial value. `law`: index of the law of
        its rate, see `expression`; -1 for a state that is constant during each step. `by_method`: whether the method of
        the run sets its values.
        """
        index = len(self.law_parameters) + 1
        self.law_parameters += [1.0, initial]
        self.state_places.append(rows.StateUse(len(self.states), index))
        self.state_rows.append(rows.StateRow(-1, index, law))
        self.states.append(ElementState(name, unit, by_method))
        return len(self.states) - 1

    def held_load(self, element: str, name: str, unit: str) -> int:
        """Add a state that the method sets, and a law with its value for `wrench`; return the index of the law."""
        law, _ = bind_law(*_OF_PARAMETER, element)
        self._add_law_row(element, law, len(self.law_parameters))  # the state is its parameter
        self.state(name, unit, 0.0, by_method=True)
        return len(self.laws) - 1

    def set_rate(self, state: int, law: int) -> None:
        """Replace the rate of a first-order state by a law, see `expression`; both are given by their index."""
        self.state_rows[state] = rows.StateRow(-1, self.state_rows[state].parameter, law)

    def expression(self, key: str, name: str, text: str) -> int:
        """Add an expression of the state as a law, and return its index; only in an `expression_lowering`.

        `key`, `name`: key path of the expression in a spec, and name of its element, for messages. `text`: the
        expression.
        """
        return self._add_expression(key, name, text)[0]

    def _add_load_value(self, name: str, load: int, component: int, text: str) -> None:
        law, begin, expression = self._add_expression(f"model.forces.{quoted(name)}.value", name, text)
        self.load_values.append(rows.LoadValueRow(law, self.loads[load][rows.LOAD.x + component]))
        inputs = iter(range(len(self.inputs) - len(expression.slopes), len(self.inputs)))
        for slope, number in zip(expression.slopes, inputs, strict=True):
            kind, source, _ = self.inputs[number]
            is_coordinate = kind in (POSITION_INPUT, VELOCITY_INPUT)
            for segment in [-1] if is_coordinate else range(source, source + self.springs[source].segments):
                self.slopes.append(rows.SlopeRow(load, component, len(self.laws), number, segment))
            self._add_law_row(name, slope, begin)

    def _add_expression(self, key: str, name: str, text: str) -> tuple[int, int, StateExpression]:
        with SpecError.locate(key):
            expression = self.numbering.expression(text, name)
        begin, law = len(self.law_parameters), len(self.laws)
        names = [parameter for parameter, _ in expression.law.parameters]
        self.law_parameters += expression.parameters
        self._add_law_row(name, expression.law, begin)
        for i, (kind, index) in enumerate(expression.inputs):
            place = begin + 1 + names.index(f"input_{i}")
            if kind == STATE_INPUT:
                self.state_places.append(rows.StateUse(index, place))
            else:
                self.inputs.append(rows.InputRow(kind, index, place))
        return law, begin, expression

    def _add_law_row(self, name: str, law: CompiledLaw, begin: int) -> None:
        self.laws.append((name, law))
        self.law_rows.append(rows.LawRow(law.address, begin, law.claims, law.program))


@OwnSeam
def lowering(elements: Never, lowering: Lowering, acting: tuple[ActingForce, ...], /) -> object:
    """Add forces and states of elements, given by name, whose force elements along pathways have been added.

    Returns the handle of the elements: what `CompiledMechanism.extensions` holds under their key.
    """
    raise NotImplementedError


@OwnSeam
def expression_lowering(handle: Never, lowering: Lowering, /) -> object:
    """Add expressions of the state, such as rates of states, but no states; return a new handle of the elements."""
    raise NotImplementedError


def acting_kinds(mechanism: Mechanism) -> list[ElementKind]:
    """Return the kinds of plugins of which a mechanism has elements that act, in their order."""
    elements = mechanism.elements
    return [
        kind
        for key, kind in element_kinds().items()
        if elements.get(key) and (mechanism.is_of_run or not kind.acts.only_in_runs)
    ]


def _numbered(inputs: Mapping[str, Input], first: int) -> Iterator[CompiledInput]:
    """Yield inputs whose states are numbered from `first` on."""
    for name, item in inputs.items():
        slope = first + 1 if item.hold == "linear" else -1
        yield CompiledInput(name, item.unit, item.initial, item.bounds, first, slope)
        first += 2 if item.hold == "linear" else 1
