"""Values that are expressions of the state of a run, and first-order states of the mechanism itself."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, TypeGuard

from pydantic import BeforeValidator, Field, model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import LONGEST_NAME, quoted
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.units import read_unit
from mbdkit.expressions.parser import Code, Compiler, ExpressionError
from mbdkit.mechanism.values import Motion, NotNegative, Number, Positive, Table, pair
from mbdkit.mechanism.values import motion as checked_motion

_QUANTITY = re.compile(r"(?:(?<!\w)\d*+[A-Za-z_]|\])\w*+\s*+\.\s*+[A-Za-z_]|\[\s*+[\"']")


class StateExpressionError(ExpressionError):
    """An expression of the state that is not valid; an unknown name in it may be the name of a parameter."""


class StateSyntax(Compiler):
    """Checks the syntax of an expression of the state; its quantities are checked later, with the complete
    mechanism.
    """

    wanted = "an expression of the state, which consists of numbers, t, pi, quantities such as bodies.NAME.angle"
    error = StateExpressionError

    def operand(self, node: ast.expr) -> Code:
        """Accept any quantity."""
        match node:
            case ast.Attribute() | ast.Subscript():
                return [("get", 0.0)]
        return super().operand(node)


def is_of_state(value: object) -> TypeGuard[str]:
    """Return whether a value is a text that contains a quantity of a run, such as ``bodies.leg.angle``."""
    return isinstance(value, str) and _QUANTITY.search(value) is not None


def _value(given: object) -> object:
    """Accept functions of time, and expressions of the state."""
    if not is_of_state(given):
        return checked_motion(given)
    StateSyntax(given).program()
    return given


#: A function of time, or an expression of the state such as ``"-20*bodies.leg.angle"``.
Value = Annotated[Number | str | Table, BeforeValidator(_value)]
ValuePair = Annotated[tuple[Value, Value], BeforeValidator(pair("two numbers, expressions or tables [x, y]"))]


class _WithParameters(StateSyntax):
    """Also accepts any name, which is checked later, with the parameters of the spec."""

    def operand(self, node: ast.expr) -> Code:
        """Accept any quantity and any name."""
        return [("get", 0.0)] if isinstance(node, ast.Name) else super().operand(node)


def _rate(given: object, syntax: type[StateSyntax] = StateSyntax) -> object:
    if isinstance(given, str):
        syntax(given).program()
        return given
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise SpecError(f'should be a number or an expression such as "(u - states.i)/0.01", not {given!r}')
    return repr(float(given))


#: An expression of the state, or a number.
Expression = Annotated[str, BeforeValidator(_rate, json_schema_input_type=str | float)]
#: An expression of the state outside the model, which keeps the names of parameters; or a number.
OuterExpression = Annotated[
    str, BeforeValidator(lambda given: _rate(given, _WithParameters), json_schema_input_type=str | float)
]


class FirstOrderState(StrictModel):
    """A first-order state z of the mechanism, z' = rate, such as the current of a motor or the output of a filter."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("initial", "unit")

    initial: Number = 0.0
    """Value of the state at the start."""
    rate: Expression
    """Derivative of the state with respect to time: an expression of t and of the quantities of the mechanism, such as
    `states.NAME`."""
    unit: str = "1"
    """Unit of the state."""

    def expressions(self) -> list[tuple[str, str]]:
        """Return (key, text) of its expression."""
        return [("rate", self.rate)]


ELECTRICAL = ("A", "V")  #: SI units of inputs that are not units of mechanics.


class Input(StrictModel):
    """A number that a run receives from outside: from a table in the run spec. It is constant between the times at
    which it is set, or changes linearly.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("initial", "unit", "bounds", "hold")

    initial: Number = 0.0
    """Value before the input is first set."""
    unit: str = "1"
    """SI unit of the input, such as `N m`; also `V` or `A`."""
    bounds: Annotated[tuple[Number, Number], BeforeValidator(pair("two numbers [smallest, largest]"))] | None = None
    """Smallest and largest value that the input may have; unbounded by default."""
    hold: Literal["zero", "linear"] = "zero"
    """Between two times at which the input is set: `zero` keeps the earlier value, `linear` goes along a straight line
    to the later one."""

    @model_validator(mode="after")
    def _consistent(self) -> Input:
        with SpecError.locate("unit"):
            if self.unit not in ELECTRICAL and (unit := read_unit(self.unit)).factor != 1.0:
                raise SpecError(f"should be an SI unit such as {unit.si}, not {self.unit}")
        if self.bounds is not None and not self.bounds[0] < self.bounds[1]:
            low, high = self.bounds
            raise SpecError(f"the smallest value, {low:g}, should be less than the largest, {high:g}", key="bounds")
        if not self.is_within(self.initial):
            raise SpecError(self.beyond(self.initial), key="initial")
        return self

    def is_within(self, value: float) -> bool:
        """Return whether a value is within the bounds."""
        return self.bounds is None or self.bounds[0] <= value <= self.bounds[1]

    def beyond(self, value: float) -> str:
        """Return a clause that says that a value is not within the bounds."""
        assert self.bounds is not None
        return f"should be within the bounds from {self.bounds[0]:g} to {self.bounds[1]:g}, not {value:g}"


class ControllerState(StrictModel):
    """A state of a controller, which changes at its samples only."""

    initial: Number = 0.0
    """Value of the state before the first sample."""
    next: Expression
    """Value of this state after a sample: an expression of the state of the run at the sample."""


class PythonOutput(StrictModel):
    """An output of a controller in Python."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("unit",)

    unit: str = "1"
    """Unit of the output."""


def _output(given: object) -> object:
    return given if isinstance(given, Mapping | PythonOutput) else _rate(given)


#: An output of a controller: an expression of the state, or that of a Python function.
AnyOutput = Annotated[str | PythonOutput, BeforeValidator(_output, json_schema_input_type=str | float | PythonOutput)]

_FUNCTION = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*|[A-Za-z_][\w.-]*")


class Controller(StrictModel):
    """A sampled controller: its outputs are constant between samples, as those of a digital controller.

    The outputs are expressions or, with `python`, what a Python function returns.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("delay", "states", "python", "inputs")

    period: Positive
    """Time between two samples [s]; the first one is at the start of the run."""
    delay: NotNegative = 0.0
    """Time [s] between a sample and the change of the outputs to the values computed from it. Before the first of these
    changes, outputs are 0."""
    states: dict[str, ControllerState] = Field(default_factory=dict)
    """States by name, such as ``sum: {next: "controllers.pid.sum + 0.01*bodies.leg.angle"}``."""
    outputs: dict[str, AnyOutput] = Field(min_length=1)
    """Outputs by name: expressions of the state at a sample or, with `python`, mappings such as ``{unit: N m}``. Loads
    refer to an output as ``controllers.NAME.OUTPUT``."""
    python: Annotated[str, Field(max_length=LONGEST_NAME)] | None = None
    """Function that computes the outputs: ``module:function``, or the name of an entry point of the group
    `mbdkit.controllers`. At each sample, it is called with the time [s] and a dict of the `inputs`, and returns a dict
    of the outputs. It is called only with `mbdkit run --call`, or `call=True` in Python."""
    inputs: tuple[Expression, ...] = ()
    """Quantities at a sample that the function of `python` gets, such as ``leg.angle``: expressions of the state."""

    @model_validator(mode="after")
    def _of_one_kind(self) -> Controller:
        if self.python is not None and not _FUNCTION.fullmatch(self.python):
            message = f"should be module:function or the name of an entry point, not {self.python!r}"
            raise SpecError(message, key="python")
        for key in ("states",) if self.python is not None else ("inputs",):
            if getattr(self, key):
                raise SpecError(f"takes effect only with{'out' * (key == 'states')} `python`; leave it out", key=key)
        for name, output in self.outputs.items():
            if isinstance(output, PythonOutput) != (self.python is not None):
                wanted = "an expression" if self.python is None else "a mapping such as {unit: N m}, with `python`"
                raise SpecError(f"should be {wanted}", key=f"outputs.{quoted(name)}")
        if len({*self.inputs}) < len(self.inputs):
            raise SpecError("has a quantity twice", key="inputs")
        return self

    def expressions(self) -> list[tuple[str, str]]:
        """Return (key, text) of each expression."""
        texts = [(f"states.{quoted(name)}.next", state.next) for name, state in self.states.items()]
        texts += [(f"outputs.{quoted(name)}", text) for name, text in self.outputs.items() if isinstance(text, str)]
        return texts + [(f"inputs[{i}]", text) for i, text in enumerate(self.inputs)]

    def unit_of(self, output: str) -> str:
        """Return the unit of an output, or of a state."""
        of_python = self.outputs.get(output)
        return of_python.unit if isinstance(of_python, PythonOutput) else "1"


def of_time(values: list[tuple[str, Motion]]) -> list[tuple[str, Motion]]:
    """Return the pairs (key, value) whose value is a function of time."""
    return [(key, value) for key, value in values if not is_of_state(value)]


def of_state(values: list[tuple[str, Motion]]) -> list[tuple[str, str]]:
    """Return the pairs (key, value) whose value is an expression of the state."""
    return [(key, value) for key, value in values if isinstance(value, str) and is_of_state(value)]
