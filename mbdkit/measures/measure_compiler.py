"""Compiles expressions of measures, and derives unit, shape and dependence on time of each operand."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import ClassVar

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass, replace
from mbdkit.base.text import listed
from mbdkit.base.units import Unit, read_unit
from mbdkit.events.event_expression import RunCompiler
from mbdkit.expressions.operations import OPERATIONS, REDUCE
from mbdkit.expressions.parser import Code
from mbdkit.expressions.program import Program
from mbdkit.measures.measured_quantities import ATTRIBUTES, unit_of
from mbdkit.measures.reductions import INTEGRALS, OF_FUNCTIONAL, REDUCTIONS, VALUES, Functional
from mbdkit.quantities.quantity import Quantity
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.sections import QUANTITIES

PLAIN = read_unit("1")
_RADIAN = read_unit("rad")
_SECOND = read_unit("s")
_END: Program = (("t", 0.0), (REDUCE + "final", 0.0))  #: The end of a run, ``final(t)``.
#: Functions that return the largest or smallest value of a quantity along a beam at each time, by the reductions that
#: apply them first.
ALONG: Mapping[str, str] = {"max": "along_max", "min": "along_min"}
_OF_VECTORS = ("mean", "final", "integral", *VALUES)  #: Reductions that apply to each component of a vector.


@dataclass(frozen=True)
class _Value:
    """Properties of an operand that are known before a run.

    - `unit`: SI unit of the operand; None if it depends on named parameters, whose units are unknown.
    - `is_number`: whether the operand consists of numbers in the text only; in sums, numbers have the unit of the other
      operand.
    - `is_series`: whether the operand changes over time.
    - `is_vector`: whether the operand has two components.
    - `along`: name of the beam if the operand has a value in each of its elements; otherwise empty.
    """

    unit: Unit | None
    is_number: bool = False
    is_series: bool = False
    is_vector: bool = False
    along: str = ""


_NUMBER = _Value(PLAIN, is_number=True)


class _Code(list[tuple[str, float]]):
    def __init__(self, program: Code, value: _Value):
        super().__init__(program)
        self.value = value


#: Which operands of an operation may be vectors.
_VECTORS_OF = {"neg": ([True],), "mul": ([True, False], [False, True]), "div": ([True, False],)}
_HAS_ELEMENTS = (
    "has a value in each element of a beam; name an element, as in beams.NAME.moment[0], or use along_max or along_min "
    "of it"
)


class MeasureCompiler(RunCompiler):
    """Compiles the expression of a measure, and derives unit, shape and dependence on time of each operand."""

    attributes: ClassVar[Mapping[str, Sequence[str]]] = ATTRIBUTES
    wanted = (
        "an expression of a run, which has numbers, t, pi, bodies.NAME.angle, joints.NAME.force, forces.NAME.value, "
        "markers.NAME.position, beams.NAME.moment, events.NAME.time, energy.total"
    )
    own_functions: ClassVar[Mapping[str, int]] = {
        **dict.fromkeys((*REDUCTIONS, *ALONG.values()), 1),
        **dict.fromkeys(VALUES, 2),
    }

    def __init__(self, text: str, spec: ModelSpec, parameters: Mapping[str, float] | None = None):
        self.spec = spec
        super().__init__(text, spec.mechanism(), spec.numbers if parameters is None else parameters)
        self.known |= {"events": list(spec.event_names), "actuators": list(spec.actuator_units)}
        self.known |= {word: list(names) for word, names in spec.result_names.items()}
        self._functionals: list[tuple[str, str, Program, Program]] = []

    def measure(self) -> tuple[Program, _Value]:
        """Return the program and its value, which is one number; raise SpecError otherwise."""
        tree = self.tree()
        program = self.compile(tree, 0)
        value = _known(program)
        if value.is_series:
            self.refuse(
                "the expression changes over time, but a measure is one number; apply max, min, mean, rms, final, "
                "integral or at to it",
                tree,
            )
        if value.is_vector:
            self.refuse("the expression is a vector, but a measure is one number; use abs of it, its norm", tree)
        if all(operation not in ("get", "t") for operation, _ in program):
            self.refuse("the expression contains no quantity of the run", tree)
        return tuple(program), value

    def functionals(self) -> tuple[Functional, ...]:
        """Return the integrals, extrema and values at times in the expression, except those computed from recorded
        rows.
        """
        compiled: tuple[Functional, ...] = ()
        for text, reduction, program, when in self._functionals:
            compiled += (Functional(text, reduction, program, tuple(self.quantities), compiled, when),)
        return compiled

    def series(self) -> tuple[Program, _Value]:
        """Return the program and its value, which is one number in each recorded row; raise SpecError otherwise."""
        tree = self.tree()
        program = self.compile(tree, 0)
        value = _known(program)
        if any(operation.startswith(REDUCE) for operation, _ in program):
            self.refuse("the expression has functions that reduce values over time; write it without them", tree)
        if value.is_vector:
            self.refuse("the expression is a vector, which has no quantiles; use abs of it, its norm", tree)
        if value.along:
            self.refuse(f"the expression {_HAS_ELEMENTS}", tree)
        if not value.is_series:
            self.refuse("the expression does not change over time", tree)
        return tuple(program), value

    def compile(self, node: ast.expr, nesting: int) -> Code:
        """Return the program of a node."""
        program = super().compile(node, nesting)
        if isinstance(node, ast.Name) and node.id == "t":
            return _Code(program, _Value(_SECOND, is_series=True))
        return _Code(program, _Value(None)) if isinstance(node, ast.Name) and node.id in self.parameters else program

    def of(self, kind: str, name: str, attribute: str, node: ast.expr) -> Code:
        """Return the program of a quantity of a body, joint or other element of the run."""
        if kind == "actuators" and not self.known[kind]:
            self.refuse("only inverse dynamics has actuators; the torque of a driver is joints.NAME.torque", node)
        return super().of(kind, name, attribute, node)

    def get(self, quantity: Quantity) -> Code:
        """Return the program that pushes a quantity, which is known to exist.

        Raises SpecError if the runs do not record the quantity.
        """
        if quantity.kind in QUANTITIES and quantity.kind not in self.spec.recorded:
            raise SpecError(
                f"this expression needs {quantity.kind}, which the runs do not record; add '{quantity.kind}' to "
                "`output.quantities`"
            )
        value = _Value(
            unit_of(quantity, self.spec),
            is_series=quantity.is_over_time,
            is_vector=quantity.is_vector,
            along=quantity.beam,
        )
        return _Code(super().get(quantity), value)

    def along(self, name: str, attribute: str, node: ast.expr) -> Code:
        """Return the program of a quantity in all elements of a beam."""
        return self.get(Quantity("beams", name, attribute))

    def of_function(self, name: str, arguments: list[Code], node: ast.Call) -> Code:
        """Return the program of a function over time or along a beam."""
        program, *others = arguments
        if name in VALUES:
            return self.value_at(name, program, others[0], node)
        if name in ALONG.values():
            return self.extreme(name, program, node)
        if name in ALONG and _known(program).along:
            program = self.extreme(ALONG[name], program, node)
        return self.reduced(name, program, node)

    def extreme(self, operation: str, program: Code, node: ast.Call) -> _Code:
        """Return a program for the largest or smallest value along a beam."""
        value = _known(program)
        if not value.along:
            self.refuse(f"'{operation}' needs a quantity along a beam, such as beams.NAME.moment", node)
        return _Code([*program, (operation, 0.0)], replace(value, along=""))

    def value_at(self, name: str, program: Code, when: Code, node: ast.Call) -> Code:
        """Return the program of ``at(quantity, time)`` or ``after(quantity, time)``."""
        time = _known(when)
        if time.is_series or time.is_vector:
            self.refuse(f"the second argument of '{name}' is one time, such as 0.5 or events.NAME.time", node.args[1])
        if not time.is_number and time.unit is not None and not time.unit.is_like(_SECOND):
            self.refuse(f"the second argument of '{name}' is a time, but it has the unit {time.unit}", node.args[1])
        span = self.spec.span
        if span and len(when) == 1 and when[0][0] == "const" and not span[0] <= when[0][1] <= span[1]:
            self.refuse(f"the run goes from {span[0]:g} s to {span[1]:g} s", node.args[1])
        if name == "after" and span and (tuple(when) == _END or when == [("const", span[1])]):
            self.refuse("there is no value after the end of the run; use final or at", node.args[1])
        return self.reduced(name, program, node, when)

    def reduced(self, name: str, program: Code, node: ast.Call, when: Sequence[tuple[str, float]] = ()) -> _Code:
        """Return a program that reduces the values of `program` over time, or gives its value at the time `when`."""
        value = _known(program)
        if not value.is_series:
            self.refuse(
                f"'{self.segment(node.args[0])}' does not change over time, so that '{name}' cannot be applied", node
            )
        if value.is_vector and name not in _OF_VECTORS:
            self.refuse(f"'{self.segment(node.args[0])}' is a vector, which has no '{name}'; use abs of it", node)
        if value.along:
            self.refuse(f"'{self.segment(node.args[0])}' {_HAS_ELEMENTS}", node)
        unit = value.unit
        if name == "integral" and unit is not None:
            unit = unit.times(_SECOND)
        number = self._place_of_functional(name, program, node, tuple(when)) if name in (*OF_FUNCTIONAL, *VALUES) else 0
        if name == "after" and not (number and isinstance(self.spec, RunSpec)):
            what = f"'{self.segment(node.args[0])}' is known at recorded times only, which hold"
            self.refuse(f"{what} the value before a discontinuity; use 'at' instead of 'after'", node)
        operation = REDUCE + ("at" if name in VALUES else name)
        return _Code([*program, *when, (operation, float(number))], _Value(unit, is_vector=value.is_vector))

    def _place_of_functional(self, name: str, program: Code, node: ast.Call, when: Program) -> int:
        """Return the index of a reduction among the functionals, from 1; 0 if it is computed from the recorded rows."""
        read = [self.quantities[int(number)] for operation, number in program if operation == "get"]
        if (
            _is_of_rows(program)
            or _is_of_rows(_without_end(when))
            or any(not quantity.is_over_time or quantity.recorded.array.accumulates for quantity in read)
        ):
            return 0
        if name not in INTEGRALS and any(quantity.recorded.array.is_of_steps for quantity in read):
            return 0
        text, whole = ast.unparse(node.args[0]), tuple(program)
        if name not in INTEGRALS:
            entry = ast.unparse(node), name, whole, when
        elif name == "rms":
            entry = f"({text})**2", "integral", (*whole, ("powi", 2.0)), when
        else:
            entry = text, "integral", whole, when
        if entry not in self._functionals:
            self._functionals.append(entry)
        return 1 + self._functionals.index(entry)

    def apply(self, operation: str, operands: list[Code], node: ast.expr) -> Code:
        """Append an operation to the programs of its operands."""
        values = [_known(operand) for operand in operands]
        if operation == "abs" and values[0].is_vector:
            value = _Value(values[0].unit, is_series=values[0].is_series)
            return _Code([*operands[0], ("norm", 0.0)], value)
        exponent = operands[1][0][1] if operation == "pow" and [one[0] for one in operands[1]] == ["const"] else None
        unit = self.unit(operation, values, exponent, node)
        value = _Value(
            unit,
            is_number=all(operand.is_number for operand in values),
            is_series=any(operand.is_series for operand in values),
            is_vector=self.makes_vector(operation, values, node),
            along=self.beam_of(values, node),
        )
        return _Code(super().apply(operation, operands, node), value)

    def beam_of(self, values: Sequence[_Value], node: ast.expr) -> str:
        """Return the beam along which the result has values, or an empty name; raise SpecError if operands do not
        match.
        """
        beams = sorted({value.along for value in values if value.along})
        if len(beams) > 1:
            self.refuse(f"'{self.segment(node)}' combines the elements of two beams, {listed(beams, 'and')}", node)
        if beams and any(value.is_vector for value in values):
            self.refuse(f"'{self.segment(node)}' combines a vector with the elements of the beam '{beams[0]}'", node)
        return beams[0] if beams else ""

    def makes_vector(self, operation: str, values: Sequence[_Value], node: ast.expr) -> bool:
        """Return whether the result is a vector; raise SpecError if vectors are not allowed."""
        vectors = [value.is_vector for value in values]
        if not any(vectors):
            return False
        if operation in ("add", "sub"):
            if not all(vectors):
                self.refuse(f"'{self.segment(node)}' adds a vector and a number; use abs of the vector", node)
        elif vectors not in _VECTORS_OF.get(operation, ()):
            symbol = OPERATIONS[operation].symbol
            what = f"'{symbol}'" if symbol else operation
            self.refuse(f"'{self.segment(node)}' is not possible with a vector in {what}; use abs of it", node)
        return True

    def unit(self, operation: str, values: Sequence[_Value], exponent: float | None, node: ast.expr) -> Unit | None:
        """Return the unit of the result of an operation; raise SpecError if units do not match.

        `exponent`: the exponent of a power, if it is a constant.
        """
        dimension, base = OPERATIONS[operation].dimension, values[0].unit
        if dimension in ("common", "angle of common"):
            common = self.common(operation, values, node)
            return common if dimension == "common" else _RADIAN
        if dimension in ("product", "quotient"):
            return _product(values[0], values[1], Fraction(1 if dimension == "product" else -1))
        if dimension == "same" or (base is None and dimension in ("power", "root")):
            return base
        if dimension == "root" or exponent is not None:
            power = Fraction(1, 2) if exponent is None else Fraction(exponent).limit_denominator(1000)
            return PLAIN.times(base or PLAIN, power)
        for value in values:
            if value.unit is not None and not value.unit.is_like(PLAIN):
                what = OPERATIONS[operation].symbol or operation
                self.refuse(f"'{self.segment(node)}': {what} needs a number or an angle, not {value.unit}", node)
        return _RADIAN if dimension == "angle" else PLAIN

    def common(self, operation: str, values: Sequence[_Value], node: ast.expr) -> Unit | None:
        """Return the unit of operands that are added or compared."""
        units = [value.unit for value in values if value.unit is not None and not value.is_number]
        if not units:
            return PLAIN if all(value.is_number for value in values) else None
        if len(units) == 2 and not units[0].is_like(units[1]):
            verb = {"add": "adds", "sub": "subtracts"}.get(operation, "compares")
            text = listed([str(unit) for unit in units], "and")
            self.refuse(f"'{self.segment(node)}' {verb} quantities of different units, {text}", node)
        return units[0]


def _product(left: _Value, right: _Value, power: Fraction) -> Unit | None:
    """Return the unit of ``left * right**power``; if one factor is a plain number, the unit of the other."""
    if left.unit is None or right.unit is None:
        return None
    if right.is_number:
        return left.unit
    if left.is_number and power == 1:
        return right.unit
    return left.unit.times(right.unit, power)


def _known(program: Code) -> _Value:
    return program.value if isinstance(program, _Code) else _NUMBER


def _is_of_rows(program: Sequence[tuple[str, float]]) -> bool:
    return any(operation.startswith(REDUCE) and not number for operation, number in program)


def _without_end(program: Program) -> Program:
    ends = [index for index in range(1, len(program)) if program[index - 1 : index + 1] == _END]
    return tuple(instruction for index, instruction in enumerate(program) if index not in ends)
