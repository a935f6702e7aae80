"""Programs of force laws (`mbdkit.engine.kernels.law_programs`) that are SymPy expressions or Python functions.

SymPy writes the source of an expression with all derivatives, and the operations of this source become the
instructions. A Python function is called once, with numbers that record its operations.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

from mbdkit.base.errors import PluginError
from mbdkit.engine.function_program import Assembler, block
from mbdkit.engine.kernels.law_programs import OPCODES
from mbdkit.expressions.recorded import Recorder
from mbdkit.expressions.recorded_derivatives import derivative
from mbdkit.mechanism.force_law import ARGUMENTS, ExpressionLaw, TracedLaw


@cache
def program_of(law: ExpressionLaw | TracedLaw, example: tuple[tuple[str, float], ...]) -> np.ndarray:
    """Return the program of a law as integers, some of which are the bits of constants."""
    if isinstance(law, TracedLaw):
        return _recorded(law, list(dict(example)))
    from mbdkit.symbolic.symbolic_law import law_source

    return _compiled(law_source(law, dict(example)), len(example))


def _recorded(law: TracedLaw, names: Sequence[str]) -> np.ndarray:
    """Return the program of a law that is a Python function, with derivatives if they are needed, else 0."""
    recorder = Recorder()
    length, rate, time = arguments = [recorder.input(name) for name in ARGUMENTS]
    parameters = {name: recorder.input(f"parameter {name}") for name in names}
    value = recorder.constant(law.function(length, rate, time, parameters))
    slopes = [derivative(value, by) for by in (length, rate)] if law.has_derivatives else [0.0, 0.0]
    return block([*arguments, *parameters.values()], [value, *slopes, 0.0])


_BINARY = {
    ast.Add: "add", ast.Sub: "subtract", ast.Mult: "multiply", ast.Div: "divide", ast.Mod: "remainder",
}  # fmt: skip
_COMPARED = {
    ast.Lt: "less", ast.LtE: "less_equal", ast.Gt: "greater", ast.GtE: "greater_equal", ast.Eq: "equal",
    ast.NotEq: "not_equal",
}  # fmt: skip
_FOLDED: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
}  # fmt: skip
_NAMES = {"abs": "abs", "fabs": "abs", "ceil": "ceil", "floor": "floor"}
_CONSTANTS = {"pi": np.pi, "e": np.e, "inf": np.inf, "nan": np.nan}


def _compiled(source: str, parameters: int) -> np.ndarray:
    """Return the program of the source of a law, a function that returns four numbers."""
    (function,) = ast.parse(source).body
    assert isinstance(function, ast.FunctionDef)
    compiler = _Compiler(parameters)
    for statement in function.body:
        if isinstance(statement, ast.Assign):
            (target,) = statement.targets
            assert isinstance(target, ast.Name)
            compiler.names[target.id] = compiler.value(statement.value)
    assert isinstance(statement, ast.Return)
    assert isinstance(statement.value, ast.Tuple)
    return compiler.assembler.block([compiler.value(result) for result in statement.value.elts])


class _Compiler:
    """Appends the operations of the source of a law, in their order, which determines the rounding errors."""

    def __init__(self, parameters: int):
        self.assembler = Assembler(3 + parameters)
        self.names: dict[str, int] = {name: i for i, name in enumerate(ARGUMENTS)}

    def value(self, node: ast.expr) -> int:
        """Append the instructions of an expression; return the index of its value."""
        if (number := _number(node)) is not None:
            return self.assembler.constant(number)
        match node:
            case ast.Name(id=name):
                return self.names[name] if name in self.names else self.assembler.constant(_CONSTANTS[name])
            case ast.Subscript(slice=ast.Constant(value=int(index))):
                return 3 + index
            case ast.UnaryOp(op=ast.USub()):
                return self.assembler.append("negate", self.value(node.operand))
            case ast.UnaryOp(op=ast.Not()):
                return self.assembler.append("not", self.value(node.operand))
            case ast.UnaryOp(op=ast.UAdd()):
                return self.value(node.operand)
            case ast.BinOp(op=ast.Pow()):
                return self._power(node)
            case ast.BinOp():
                return self.assembler.append(_BINARY[type(node.op)], self.value(node.left), self.value(node.right))
            case ast.Compare(ops=[sign], comparators=[right]):
                return self.assembler.append(_COMPARED[type(sign)], self.value(node.left), self.value(right))
            case ast.BoolOp():
                name = "and" if isinstance(node.op, ast.And) else "or"
                result, *others = (self.value(operand) for operand in node.values)
                for other in others:
                    result = self.assembler.append(name, result, other)
                return result
            case ast.IfExp():
                return self.assembler.append("select", *map(self.value, (node.test, node.body, node.orelse)))
            case ast.Call(func=ast.Name(id="float")):
                return self.value(node.args[0])
            case ast.Call(func=ast.Name(id=name)) if _NAMES.get(name, name) in OPCODES:
                return self.assembler.append(_NAMES.get(name, name), *map(self.value, node.args))
        raise PluginError(f"'{ast.unparse(node)}' in its force or a derivative cannot be compiled")

    def _power(self, node: ast.BinOp) -> int:
        exponent = _number(node.right)
        base = self.value(node.left)
        if isinstance(exponent, int):
            if exponent == 0:
                return self.assembler.constant(1.0)
            return self.assembler.append("power_of_integer", base, exponent)
        if exponent == 0.5:
            return self.assembler.append("sqrt", base)
        if exponent == 2.0:
            return self.assembler.append("multiply", base, base)
        return self.assembler.append("power", base, self.value(node.right))


def _number(node: ast.expr) -> int | float | None:
    """Return the value of a constant expression, such as ``-3/2``; None if it is not constant."""
    match node:
        case ast.Constant(value=bool(value)):
            return float(value)
        case ast.Constant(value=int() | float() as value):
            return value
        case ast.UnaryOp(op=ast.USub()):
            inner = _number(node.operand)
            return None if inner is None else -inner
        case ast.BinOp(op=op) if type(op) in _FOLDED:
            left, right = _number(node.left), _number(node.right)
            if left is None or right is None:
                return None
            try:
                return _FOLDED[type(op)](left, right)
            except ZeroDivisionError:
                return None
    return None
