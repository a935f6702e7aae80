"""Programs of expressions in postfix notation: their execution, and programs of their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from mbdkit.expressions.operations import OPERATIONS, arity_of

#: Name of an operation, and a number.
#:
#: ``const`` pushes the number and ``t`` the argument; all other operations replace their operands by their result. For
#: ``powi``, the number is the exponent, which is an integer; other operations do not use it.
Instruction = tuple[str, float]
Program = tuple[Instruction, ...]

MAX_DEPTH = 32  #: Largest number of operands on the stack of a program that is compiled.

Value = TypeVar("Value")


def execute(program: Program, step: Callable[..., Value]) -> Value:
    """Return the value of a program.

    Parameters
    ----------
    step
        Function ``step(operation, number, *operands)`` that returns the value of one instruction.
    """
    stack: list[Value] = []
    for operation, number in program:
        first = len(stack) - arity_of(operation)
        stack[first:] = [step(operation, number, *stack[first:])]
    return stack.pop()


def value_of(program: Program, leaf: Callable[[str, float], Any]) -> Any:
    """Return the value of a program, evaluated with NumPy functions.

    Parameters
    ----------
    leaf
        Function ``leaf(operation, number)`` that returns the value of an instruction without operands, such as
        ``const`` or ``t``.
    """

    def step(operation: str, number: float, *operands: Any) -> Any:
        if not operands:
            return leaf(operation, number)
        return OPERATIONS[operation].array(*operands, *(number,) * (operation == "powi"))

    return execute(program, step)


def parts_of_time(program: Program) -> list[Program]:
    """Return the largest parts of a program that are functions of the argument ``t`` alone, but for ``t`` itself."""
    parts: list[Program] = []

    def step(operation: str, number: float, *operands: Program | None) -> Program | None:
        if not operands:
            return ((operation, number),) if operation in ("t", "const") else None
        known = [operand for operand in operands if operand is not None]
        if len(known) == len(operands):
            return (*(instruction for operand in known for instruction in operand), (operation, number))
        parts.extend(operand for operand in known if len(operand) > 1 and ("t", 0.0) in operand)
        return None

    whole = execute(program, step)
    return parts if whole is None else [whole]


def depth_of(program: Program) -> int:
    """Return the largest number of operands on the stack of a program."""
    depth = height = 0
    for operation, _ in program:
        height += 1 - arity_of(operation)
        depth = max(depth, height)
    return depth


def derivative_of(program: Program) -> Program:
    """Return the program of the derivative of a program, which must not contain operations with a switch.

    The compiled kernel computes the value and two derivatives of a program. Applied to the program returned here, it
    gives the first three derivatives of the given program. A derivative can be written as a program because the rules
    for derivatives use only operations; the rule for ``cos``, for example, uses ``sin``.
    """

    def step(operation: str, number: float, *operands: tuple[Formula, Formula]) -> tuple[Formula, Formula]:
        if operation in ("const", "t"):
            return Formula(((operation, number),)), Formula.of(1.0 if operation == "t" else 0.0)
        return with_slope(operation, number, operands, _ZERO)

    return execute(program, step)[1].program


def with_slope(operation: str, number: float, operands: Sequence[tuple[Any, Any]], zero: Any) -> tuple[Any, Any]:
    """Return value and derivative of an operation, given the values and derivatives of its operands.

    `zero` is a zero of the same type as these values.
    """
    rule = OPERATIONS[operation].rule
    if len(operands) == 2:
        (a, da), (b, db) = operands
        value, slope, _ = rule(a, da, zero, b, db, zero)
        return value, slope
    ((x, dx),) = operands
    value, slope, _ = rule(x, number) if operation == "powi" else rule(x)
    return value, slope * dx


class Formula:
    """A program as an operand, as of rules; sums with 0, products with 0 or 1, and quotients by 1 are simplified."""

    def __init__(self, program: Program):
        self.program = program

    @staticmethod
    def of(value: Any) -> Formula:
        """Return a formula, or a number as one."""
        return value if isinstance(value, Formula) else Formula((("const", float(value)),))

    def then(self, operation: str, *others: Formula, number: float = 0.0) -> Formula:
        """Return an operation on this formula and others."""
        return Formula((*self.program, *(i for other in others for i in other.program), (operation, number)))

    def __eq__(self, other: object) -> bool:
        return self.program == Formula.of(other).program

    __hash__ = None  # type: ignore[assignment]

    def __neg__(self) -> Formula:
        return self.then("neg")

    def __add__(self, other: Formula | float) -> Formula:
        other = Formula.of(other)
        if other == 0.0:
            return self
        return other if self == 0.0 else self.then("add", other)

    def __sub__(self, other: Formula | float) -> Formula:
        other = Formula.of(other)
        if other == 0.0:
            return self
        return -other if self == 0.0 else self.then("sub", other)

    def __rsub__(self, other: float) -> Formula:
        return Formula.of(other) - self

    def __mul__(self, other: Formula | float) -> Formula:
        other = Formula.of(other)
        if self == 0.0 or other == 0.0:
            return _ZERO
        if self == 1.0:
            return other
        return self if other == 1.0 else self.then("mul", other)

    def __rmul__(self, other: float) -> Formula:
        return Formula.of(other) * self

    def __truediv__(self, other: Formula | float) -> Formula:
        other = Formula.of(other)
        return self if self == 0.0 or other == 1.0 else self.then("div", other)

    def __rtruediv__(self, other: float) -> Formula:
        return Formula.of(other) / self

    def __pow__(self, exponent: Any) -> Formula:
        if isinstance(exponent, Formula):
            return self.then("pow", exponent)
        if exponent in (0, 1):
            return self if exponent else Formula.of(1.0)
        return self.then("powi", number=float(exponent))

    def __array_ufunc__(self, function: Any, method: str, x: Formula, *others: Any) -> Any:
        """Apply the operation of a NumPy function."""
        if others:
            if function.__name__ != "power":  # no other function of two operands is in rules that are differentiated
                return NotImplemented
            return Formula.of(x).__pow__(others[0])
        return x.then(next(operation.name for operation in OPERATIONS.values() if operation.ufunc is function))


_ZERO: Formula = Formula.of(0.0)
