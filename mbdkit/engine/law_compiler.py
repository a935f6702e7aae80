"""Programs of force laws (`mbdkit.engine.kernels.law_programs`) that are SymPy expressions or Python functions.

SymPy differentiates an expression, whose operations are recorded. A Python function is called once, with numbers that
record its operations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, reduce
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import PluginError
from mbdkit.engine.function_program import block
from mbdkit.engine.kernels.law_programs import OPCODES
from mbdkit.expressions.recorded import Recorded, Recorder
from mbdkit.expressions.recorded_derivatives import derivative
from mbdkit.mechanism.force_law import ARGUMENTS, ExpressionLaw, RecordedExpression, TracedLaw

if TYPE_CHECKING:
    import sympy


@cache
def program_of(law: ExpressionLaw | TracedLaw, example: tuple[tuple[str, float], ...]) -> np.ndarray:
    """Return the program of a law as integers, some of which are the bits of constants."""
    names, recorder = list(dict(example)), Recorder()
    length, rate, time = arguments = [recorder.input(name) for name in ARGUMENTS]
    parameters = {name: recorder.input(f"parameter {name}") for name in names}
    inputs = [*arguments, *parameters.values()]
    if isinstance(law, TracedLaw | RecordedExpression):
        value = recorder.constant(law.function(length, rate, time, parameters))
        slopes = [derivative(value, by) for by in (length, rate)] if law.has_derivatives else [0.0, 0.0]
        return block(inputs, [value, *slopes, 0.0])
    import sympy as sp

    from mbdkit.symbolic.symbolic_law import law_results

    symbols = (sp.Symbol(name, real=True) for name in (*ARGUMENTS, *names))
    return block(inputs, _of_sympy(law_results(law, dict(example)), dict(zip(symbols, inputs, strict=True))))


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
