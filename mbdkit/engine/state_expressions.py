"""Expressions of the state for kernels: values of loads, rates of states, and values of sampled controllers.

An expression becomes a law (`mbdkit.engine.force_laws`) without a pathway. Its parameters are its constants, its inputs
and the states that it contains; kernels update the inputs and states before each evaluation. Inputs are coordinates,
velocities, and lengths, rates and tensions of pathways; all other quantities are written in terms of these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from itertools import count
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbdkit.base import elementary, higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass, field
from mbdkit.engine.force_laws import CompiledLaw, bind_law
from mbdkit.engine.kernels.applied_forces import LENGTH_INPUT, POSITION_INPUT, RATE_INPUT, TENSION_INPUT, VELOCITY_INPUT
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.parser import symbolic
from mbdkit.expressions.program import Formula, Instruction, Program, execute
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.mechanism.force_law import RecordedExpression

if TYPE_CHECKING:
    import sympy

    from mbdkit.expressions.recorded import Recorded
    from mbdkit.mechanism.mechanism import Mechanism

STATE_INPUT = -1  #: Code of an input that is a first-order state.
POSITIONS = {"x": 0, "y": 1, "angle": 2}
VELOCITIES = {"vx": 0, "vy": 1, "angular_velocity": 2}


class ExpressionInput(NamedTuple):
    """Input of an expression: its kind, and the index of the coordinate, of the first segment, or of the state."""

    kind: int
    number: int


@dataclass(frozen=True)
class StateExpression:
    """A compiled expression of the state.

    `law`: the expression as a law. `inputs`: its inputs, in the order of the parameters that stand for them, which come
    first. `slopes`: its derivatives with respect to the inputs, except states. `parameters`: number of its parameters,
    followed by their values; those that stand for inputs are zero.
    """

    law: CompiledLaw
    inputs: tuple[ExpressionInput, ...]
    slopes: tuple[CompiledLaw, ...]
    parameters: list[float]


@dataclass(frozen=True)
class Numbering:
    """Indices of the elements, in a mechanism that is being compiled, to which expressions can refer.

    `bodies`: index of each body by name, ground included. `springs`: index of the first segment of each force element
    on a pathway, by its key and name, such as ``forces.NAME``. `states`: index of each first-order state, and of each
    output and state of a controller, ``controller.output``. `inputs`: index of the state with the value of each input.
    """

    mechanism: Mechanism
    bodies: Mapping[str, int]
    springs: Mapping[str, int] = field(default_factory=dict)
    states: Mapping[str, int] = field(default_factory=dict)
    inputs: Mapping[str, int] = field(default_factory=dict)

    def expression(self, text: str, name: str) -> StateExpression:
        """Compile an expression; `name` is the name of its element in error messages.

        Raises SpecError if the expression is invalid, or contains a quantity of a load, which kernels cannot evaluate
        here.
        """
        program, quantities = higher_layers.state_program(text, self.mechanism)
        terms = _Terms(self)
        written = [terms.written(*quantity).program for quantity in quantities]
        constants = [number for operation, number in program if operation == "const"]
        places, whole = count(), list[Instruction]()
        for operation, number in program:
            if operation == "get":
                whole += written[int(number)]
            else:  # constants become parameters, too
                whole.append(("number", next(places)) if operation == "const" else (operation, number))
        value, slopes = laws_of(tuple(whole), len(terms.inputs))
        counts = {"input": len(terms.inputs), "constant": len(terms.constants), "number": len(constants)}
        names = [f"{kind}_{i}" for kind, size in counts.items() for i in range(size)]
        values = [0.0] * len(terms.inputs) + terms.constants + constants
        options = dict(zip(names, values, strict=True))
        compiled, block = bind_law(value, options, name)
        bound = [
            bind_law(slope, options, name)[0]
            for given, slope in zip(terms.inputs, slopes, strict=True)
            if given.kind != STATE_INPUT
        ]
        return StateExpression(compiled, tuple(terms.inputs), tuple(bound), block)


class _Terms:
    def __init__(self, numbering: Numbering):
        self.numbering = numbering
        self.inputs: list[ExpressionInput] = []
        self.constants: list[float] = []

    def written(self, kind: str, name: str, attribute: str) -> Formula:
        """Return a quantity as a program of inputs and constants."""
        mechanism = self.numbering.mechanism
        match kind:
            case "states":
                return self._input(STATE_INPUT, self.numbering.states[name])
            case "inputs":
                return self._input(STATE_INPUT, self.numbering.inputs[name])
            case "bodies":
                return self._of_body(name, attribute)
            case "markers":
                marker = mechanism.markers[name]
                return self._of_point(marker.body, marker.held, attribute)
            case "joints":
                return self._coordinate(name)
            case further if (element_kind := element_kinds().get(further)) is not None:
                codes = {"length": LENGTH_INPUT, "rate": RATE_INPUT, "tension": TENSION_INPUT}
                part, _, value = element_kind.in_expressions[attribute].rpartition(".")
                spring = f"{further}.{name}.{part}" if part else f"{further}.{name}"
                return self._input(codes[value], self.numbering.springs[spring])
            case "forces" if f"forces.{name}" in self.numbering.springs:
                code = {"length": LENGTH_INPUT, "rate": RATE_INPUT, "value": TENSION_INPUT}[attribute]
                given, force = self._input(code, self.numbering.springs[f"forces.{name}"]), mechanism.forces[name]
                pathway = getattr(force, "pathway", None)
                turns = attribute == "value" and pathway is not None and pathway.length_unit == "rad"
                return -given if turns else given
        raise SpecError(
            f"'forces.{name}.{attribute}' is a quantity of a load; an expression of the state can contain those of "
            "springs and laws"
        )

    def _input(self, kind: int, index: int) -> Formula:
        given = ExpressionInput(kind, index)
        if given not in self.inputs:
            self.inputs.append(given)
        return Formula((("input", self.inputs.index(given)),))

    def _constant(self, value: float) -> Formula:
        self.constants.append(float(value))
        return Formula((("constant", len(self.constants) - 1),))

    def _of_body(self, name: str, attribute: str) -> Formula:
        if name == "ground":
            return Formula.of(0.0)
        kind, places = (POSITION_INPUT, POSITIONS) if attribute in POSITIONS else (VELOCITY_INPUT, VELOCITIES)
        return self._input(kind, 3 * self.numbering.bodies[name] + places[attribute])

    def _of_point(self, body: str, point: Sequence[float], attribute: str) -> Formula:
        px, py = map(self._constant, point)
        angle, spin = self._of_body(body, "angle"), self._of_body(body, "angular_velocity")
        c, s = elementary.cos(angle), elementary.sin(angle)
        x, y = px * c - py * s, px * s + py * c
        return self._of_body(body, attribute) + {"x": x, "y": y, "vx": -spin * y, "vy": spin * x}[attribute]

    def _coordinate(self, name: str) -> Formula:
        joint = self.numbering.mechanism.joints[name]
        a, b = joint.bodies
        if joint.travel is None:
            return self._of_body(b, "angle") - self._of_body(a, "angle")
        *point, ux, uy = map(self._constant, (joint.travel[i] for i in (0, 1, 4, 5)))
        turn = self._of_body(a, "angle")
        c, s = elementary.cos(turn), elementary.sin(turn)
        x, y = (self._of_point(b, joint.travel[2:4], axis) - self._of_body(a, axis) for axis in "xy")
        return ux * (c * x + s * y - point[0]) + uy * (c * y - s * x - point[1])


@cache
def laws_of(program: Program, inputs: int) -> tuple[RecordedExpression, tuple[RecordedExpression, ...]]:
    """Return the law of a program of inputs, constants and numbers, and those of its derivatives by the inputs."""

    def law(by: str) -> RecordedExpression:
        return RecordedExpression(
            partial(_symbolic, program, by), parameters=dict, function=partial(_value, program, by)
        )

    return law(""), tuple(law(f"input_{i}") for i in range(inputs))


def _value(program: Program, by: str, _length: Any, _rate: Any, time: Recorded, p: Mapping[str, Recorded]) -> Recorded:
    """Return the value of a program, or its derivative with respect to a parameter, with a choice for each corner."""
    from mbdkit.expressions.recorded_derivatives import derivative  # most mechanisms have no such expression

    sizes: dict[int, Recorded] = {}

    def step(operation: str, number: float, *operands: Any) -> Any:
        if operation in ("min", "max"):
            a, b = operands
            return np.where(a <= b if operation == "min" else a >= b, a, b)
        if operation == "abs":
            (x,) = operands
            size: Any = np.where(x >= 0.0, x, -x)
            sizes[size.index] = x
            return size
        if operation == "div" and operands[1].index in sizes:
            x = sizes[operands[1].index]  # a choice between values that differ is known as a jump
            return operands[0] * np.where(x >= 0.0, 1.0 / x, -1.0 / x)
        if operands:
            return OPERATIONS[operation].array(*operands, *(number,) * (operation == "powi"))
        if operation == "const":
            return time.recorder.constant(number)
        return time if operation == "t" else p[f"{operation}_{int(number)}"]

    value: Recorded = execute(program, step)
    return derivative(value, p[by]) if by else value


def _symbolic(program: Program, by: str) -> sympy.Expr:
    """Return the same as a SymPy expression."""
    import sympy as sp

    names = {"t": "time"}
    value = symbolic(program, lambda operation, number: names.get(operation, f"{operation}_{int(number)}"))
    value = value.rewrite(sp.Piecewise)
    return value.diff(sp.Symbol(by, real=True)) if by else value
