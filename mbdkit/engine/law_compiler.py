"""Programs of force laws (`mbdkit.engine.kernels.law_programs`) that are SymPy expressions or Python functions.

SymPy differentiates an expression, whose operations are recorded. A Python function is called once, with numbers that
record its operations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, reduce
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.base.errors import PluginError
from mbdkit.engine.function_program import block
from mbdkit.engine.kernels.law_programs import OPCODES
from mbdkit.expressions.recorded import Recorded, Recorder
from mbdkit.expressions.recorded_derivatives import derivative
from mbdkit.mechanism.force_law import ARGUMENTS, ExpressionLaw, ForceLaw, RecordedExpression, SwitchingLaw, TracedLaw

if TYPE_CHECKING:
    import sympy


@cache
def program_of(law: ExpressionLaw | TracedLaw, example: tuple[tuple[str, float], ...]) -> np.ndarray:
    """Return the program of a law as integers, some of which are the bits of constants."""
    inputs, results = _recorded(law, example)
    return block(inputs, results)


class Switches(NamedTuple):
    """Where a law switches: at the zeros of functions of its inputs.

    `program`: the program of these functions. `number`: how many these are. `inputs`: the inputs on which they depend,
    by their numbers: length, rate, time and the parameters.
    """

    program: np.ndarray
    number: int
    inputs: frozenset[int]


@cache
def switches_of(law: ForceLaw, example: tuple[tuple[str, float], ...]) -> Switches | None:
    """Return where a law is not smooth; None if it always is, or if this is unknown, as of a function of a plugin."""
    if isinstance(law, SwitchingLaw) and law.switch is None:
        return None
    if isinstance(law, SwitchingLaw):
        inputs = _inputs(example)
        length, rate, _, *parameters = inputs
        found = [law.switch(length, rate, dict(zip(dict(example), parameters, strict=True)))]
    elif isinstance(law, ExpressionLaw | TracedLaw):
        inputs, results = _recorded(law, example)
        found = _switching_functions(inputs[0].recorder, results[0])
    else:
        return None
    if not found:
        return None
    needed = {*inputs[0].recorder.ancestors(found)}
    return Switches(block(inputs, found), len(found), frozenset(i for i, x in enumerate(inputs) if x.index in needed))


def _inputs(example: tuple[tuple[str, float], ...]) -> list[Recorded]:
    recorder = Recorder()
    return [*map(recorder.input, ARGUMENTS), *(recorder.input(f"parameter {name}") for name in dict(example))]


@cache
def _recorded(
    law: ExpressionLaw | TracedLaw, example: tuple[tuple[str, float], ...]
) -> tuple[list[Recorded], list[Recorded]]:
    """Return the inputs of a law, and its results: the force, its derivatives, and the potential."""
    names, inputs = list(dict(example)), _inputs(example)
    length, rate, time, *parameters = inputs
    recorder = length.recorder
    if isinstance(law, TracedLaw | RecordedExpression):
        value = recorder.constant(law.function(length, rate, time, dict(zip(names, parameters, strict=True))))
        slopes = [derivative(value, by) for by in (length, rate)] if law.has_derivatives else [0.0, 0.0]
        return inputs, [*map(recorder.constant, (value, *slopes, 0.0))]
    import sympy as sp

    from mbdkit.symbolic.symbolic_law import law_results

    symbols = (sp.Symbol(name, real=True) for name in (*ARGUMENTS, *names))
    return inputs, _of_sympy(law_results(law, dict(example)), dict(zip(symbols, inputs, strict=True)))


def _switching_functions(recorder: Recorder, value: Recorded) -> list[Recorded]:
    """Return functions that change their signs where operations switch on which a value depends."""

    def at(index: int) -> Recorded:
        return Recorded(recorder, index)

    def margin(index: int) -> Recorded | None:
        """Return a function that is positive where a condition holds; None for the equality of two numbers."""
        term = recorder.terms[index]
        if term.operation in ("and", "or"):
            a, b = map(margin, term.operands)
            if a is None or b is None:
                return a if b is None else b
            return recorder.apply("minimum" if term.operation == "and" else "maximum", [a, b])
        if term.operation == "not":
            inner = margin(term.operands[0])
            return None if inner is None else -inner
        if term.operation.startswith(("less", "greater")):
            a, b = map(at, term.operands)
            return b - a if term.operation.startswith("less") else a - b
        return None

    found: dict[int, Recorded] = {}
    for index in recorder.ancestors([value]):
        operation, operands, *_ = recorder.terms[index]
        given = [at(operand) for operand in operands]
        match operation:
            case "select":
                function = margin(operands[0])
            case "minimum" | "maximum":
                function = given[0] - given[1]
            case "abs":
                function = given[0]
            case "floor" | "ceil":
                function = np.sin(np.pi * given[0])
            case "remainder":
                function = np.sin(np.pi * (given[0] / given[1]))
            case "atan2":  # its branch cut
                function = recorder.apply("select", [given[1] < 0.0, given[0], abs(given[0])])
            case _:
                continue
        if function is not None and recorder.terms[function.index].operation != "constant":
            found[function.index] = function
    return [*found.values()]


@cache
def program_of_guide(function: Callable[[Recorded], Sequence[Recorded]]) -> np.ndarray:
    """Return the program of a guided segment, whose results are those of `mbdkit_statics.element_definitions.GUIDE`."""
    recorder = Recorder()
    inputs = angle, *_ = [recorder.input(name) for name in ARGUMENTS]
    results = []
    for value in map(recorder.constant, function(angle)):
        slope = derivative(value, angle)
        results += [value, slope, derivative(slope, angle)]
    return block(inputs, results)


#: Operations of classes of SymPy with other names.
_NAMES = {
    "Add": "add", "Mul": "multiply", "Pow": "power", "Mod": "remainder", "StrictLessThan": "less",
    "LessThan": "less_equal", "StrictGreaterThan": "greater", "GreaterThan": "greater_equal", "Equality": "equal",
    "Unequality": "not_equal", "And": "and", "Or": "or", "Not": "not", "Abs": "abs", "ceiling": "ceil",
    "loggamma": "lgamma", "ITE": "select",
}  # fmt: skip


def _of_sympy(expressions: Sequence[sympy.Basic], known: Mapping[sympy.Basic, Recorded]) -> list[Recorded]:
    """Return expressions of SymPy as recorded numbers, given their symbols."""
    import sympy as sp

    recorder, found = next(iter(known.values())).recorder, dict(known)

    def value(node: sympy.Basic) -> Recorded:
        if node not in found:
            found[node] = computed(node)
        return found[node]

    def computed(node: sympy.Basic) -> Recorded:
        if isinstance(node, sp.Piecewise):
            result = recorder.constant(np.nan)
            for branch, condition in reversed(node.args):
                result = recorder.apply("select", [value(condition), value(branch), result])
            return result
        if not node.args:  # numbers, true and false
            return recorder.constant(float(node) if isinstance(node, sp.Expr) else float(bool(node)))
        top, bottom = sp.fraction(node, exact=True) if isinstance(node, sp.Expr) else (node, 1)
        if bottom != 1:
            return recorder.apply("divide", [value(top), value(bottom)])
        name, operands = _NAMES.get(type(node).__name__, type(node).__name__), [*map(value, node.args)]
        if name not in OPCODES:
            raise PluginError(f"'{node}' in its force or a derivative cannot be compiled")
        if name == "select" or len(operands) == 1:
            return recorder.apply(name, operands)
        return reduce(lambda x, y: recorder.apply(name, [x, y]), operands)

    return [*map(value, expressions)]
