"""Expressions of the state for kernels: values of loads, rates of states, and values of sampled controllers.

An expression becomes a law (`mbdkit.engine.force_laws`) without a pathway. Its parameters are its constants, its inputs
and the states that it contains; kernels update the inputs and states before each evaluation. Inputs are coordinates,
velocities, and lengths, rates and tensions of pathways; all other quantities are written in terms of these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from mbdkit.base import higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.engine.force_laws import CompiledLaw, bind_law
from mbdkit.engine.kernels.applied_forces import LENGTH_INPUT, POSITION_INPUT, RATE_INPUT, TENSION_INPUT, VELOCITY_INPUT
from mbdkit.expressions.parser import symbolic_operation
from mbdkit.expressions.program import Program, execute
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.mechanism.force_law import ExpressionLaw

if TYPE_CHECKING:
    import sympy

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
        written = tuple(terms.written(*quantity) for quantity in quantities)
        constants = [number for operation, number in program if operation == "const"]
        form = tuple((operation, 0.0 if operation == "const" else number) for operation, number in program)
        value, slopes = _laws(form, written, len(terms.inputs), tuple(terms.constants))
        values = [0.0] * len(terms.inputs) + list(terms.constants.values()) + constants
        names = [*_names(len(terms.inputs)), *terms.constants, *(f"number_{i}" for i in range(len(constants)))]
        options = dict(zip(names, values, strict=True))
        compiled, block = bind_law(value, options, name)
        bound = [
            bind_law(slope, options, name)[0]
            for given, slope in zip(terms.inputs, slopes, strict=True)
            if given.kind != STATE_INPUT
        ]
        return StateExpression(compiled, tuple(terms.inputs), tuple(bound), block)


def _names(count: int) -> list[str]:
    return [f"input_{i}" for i in range(count)]


class _Terms:
    def __init__(self, numbering: Numbering):
        self.numbering = numbering
        self.inputs: list[ExpressionInput] = []
        self.constants: dict[str, float] = {}

    def written(self, kind: str, name: str, attribute: str) -> str:
        """Return a quantity as SymPy source."""
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
                text, force = self._input(code, self.numbering.springs[f"forces.{name}"]), mechanism.forces[name]
                pathway = getattr(force, "pathway", None)
                turns = attribute == "value" and pathway is not None and pathway.length_unit == "rad"
                return f"(-{text})" if turns else text
        raise SpecError(
            f"'forces.{name}.{attribute}' is a quantity of a load; an expression of the state can contain those of "
            "springs and laws"
        )

    def _input(self, kind: int, index: int) -> str:
        given = ExpressionInput(kind, index)
        if given not in self.inputs:
            self.inputs.append(given)
        return f"input_{self.inputs.index(given)}"

    def _constant(self, value: float) -> str:
        name = f"constant_{len(self.constants)}"
        self.constants[name] = float(value)
        return name

    def _of_body(self, name: str, attribute: str) -> str:
        if name == "ground":
            return "0"
        kind, places = (POSITION_INPUT, POSITIONS) if attribute in POSITIONS else (VELOCITY_INPUT, VELOCITIES)
        return self._input(kind, 3 * self.numbering.bodies[name] + places[attribute])

    def _of_point(self, body: str, point: Sequence[float], attribute: str) -> str:
        px, py = (self._constant(coordinate) for coordinate in point)
        angle, spin = self._of_body(body, "angle"), self._of_body(body, "angular_velocity")
        x = f"({px}*cos({angle}) - {py}*sin({angle}))"
        y = f"({px}*sin({angle}) + {py}*cos({angle}))"
        moved = {"x": x, "y": y, "vx": f"(-{spin}*{y})", "vy": f"({spin}*{x})"}[attribute]
        return f"({self._of_body(body, attribute)} + {moved})"

    def _coordinate(self, name: str) -> str:
        joint = self.numbering.mechanism.joints[name]
        a, b = joint.bodies
        if joint.travel is None:
            return f"({self._of_body(b, 'angle')} - {self._of_body(a, 'angle')})"
        ax, ay, bx, by, ux, uy = joint.travel
        turn = self._of_body(a, "angle")
        x = f"({self._of_point(b, (bx, by), 'x')} - {self._of_body(a, 'x')})"
        y = f"({self._of_point(b, (bx, by), 'y')} - {self._of_body(a, 'y')})"
        along = f"(cos({turn})*{x} + sin({turn})*{y} - {self._constant(ax)})"
        across = f"(cos({turn})*{y} - sin({turn})*{x} - {self._constant(ay)})"
        return f"({self._constant(ux)}*{along} + {self._constant(uy)}*{across})"


@cache
def _laws(
    program: Program, written: tuple[str, ...], inputs: int, constants: tuple[str, ...]
) -> tuple[ExpressionLaw, tuple[ExpressionLaw, ...]]:
    """Compile a program of quantities to a law and the laws of its derivatives with respect to the inputs.

    Constants of the program become parameters of the law.
    """
    import sympy as sp

    symbols = {name: sp.Symbol(name, real=True) for name in (*_names(inputs), *constants)}
    quantities = [sp.sympify(text, locals=symbols) for text in written]
    numbers = iter(range(len(program)))

    def step(operation: str, number: float, *operands: sympy.Expr) -> sympy.Expr:
        match operation:
            case "const":
                return sp.Symbol(f"number_{next(numbers)}", real=True)
            case "t":
                return sp.Symbol("time", real=True)
            case "get":
                return quantities[int(number)]
            case "powi":
                return operands[0] ** int(number)
        return symbolic_operation(operation)(*operands)

    value = execute(program, step).rewrite(sp.Piecewise)
    slopes = tuple(ExpressionLaw(value.diff(symbols[name]), parameters=dict) for name in _names(inputs))
    return ExpressionLaw(value, parameters=dict), slopes
