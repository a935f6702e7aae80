"""The rules of operations (`mbdkit.expressions.operations`) in compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from types import FunctionType
from typing import Any

from mbdkit.engine.native import arithmetic
from mbdkit.engine.native.functions import inlined, overload
from mbdkit.expressions import operations
from mbdkit.expressions.operations import Operation

Code = int  #: Value by which a kernel identifies an operation.


@overload(operations.where)
def _where(condition, x, y):
    return lambda condition, x, y: arithmetic.where(condition, x, y)


@overload(operations.power)
def _power(x, n):
    return operations.power


def compiled_rule(operation: Operation) -> Any:
    """Return the rule of an operation, compiled.

    Every caller gets a function of its own: the rule for dual numbers calls the one for numbers, which the compiler
    would otherwise take for a recursion.
    """
    rule: Any = operation.rule
    return inlined(FunctionType(rule.__code__, rule.__globals__, rule.__name__, rule.__defaults__, rule.__closure__))


def chosen_rule(choices: Sequence[tuple[Code, Operation]]) -> Any:
    """Return a function of a code and operands that applies the rule of the operation with this code.

    The rule of the last operation also applies to all other codes.
    """
    *others, (_, last) = choices
    rule = _without_code(compiled_rule(last))
    for code, operation in reversed(others):
        rule = _either(code, compiled_rule(operation), rule)
    return rule


def _without_code(rule: Any) -> Any:
    return inlined(lambda code, *operands: rule(*operands))


def _either(own_code: Code, rule: Any, others: Any) -> Any:
    def apply(code, *operands):
        if code == own_code:
            return rule(*operands)
        return others(code, *operands)

    return inlined(apply)
