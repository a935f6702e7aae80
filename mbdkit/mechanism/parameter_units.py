"""Units of expressions of named parameters that are given with units, such as ``force/length``."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from fractions import Fraction

from mbdkit.base.errors import SpecError
from mbdkit.base.units import Unit, read_unit

_SECOND = read_unit("s")
_NUMBER = Unit("1")  #: Unit of pure numbers and of angles in radians.
#: Functions whose value is a pure number or an angle.
_PURE = frozenset({"sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log", "sign"})
_OF_ANGLE = frozenset({"sin", "cos", "tan"})
_LIKE_OPERANDS = frozenset({"abs", "min", "max"})


def unit_of_expression(text: str, units: Mapping[str, Unit], *, of_time: bool = False) -> Unit | None:
    """Return the unit of an expression; None if it cannot be derived.

    It cannot be derived if all parameters are pure numbers or angles, and usually not from powers that are not whole
    numbers, or if other parameters have no unit. In functions of time, numbers as factors may have any unit: in
    ``A*t/0.5``, 0.5 is a time.

    `units`: units of the parameters that have one, by name. `of_time`: whether the name ``t`` is the time. Raises
    SpecError if quantities of different kinds are added or subtracted, or if a frequency, such as one in Hz or 1/min,
    is used as an angular velocity.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # reported when the expression is compiled
        return None
    if isinstance(tree, ast.Name):
        return units.get(tree.id)
    if not _has_units(tree, units):
        return None
    derived = _Derived(units, is_of_time=of_time and any(_is_time(node) for node in ast.walk(tree)))
    unit = derived.unit(tree)
    derived.check_cycles(tree)
    return unit


def unit_of_parts(node: ast.expr, units: Mapping[str, Unit]) -> Unit | None:
    """Return the unit of a part of an expression in which numbers have no unit; None if it cannot be derived."""
    return _Derived(units, is_of_time=False).unit(node)


def _is_time(node: ast.AST) -> bool:
    return isinstance(node, ast.Name) and node.id == "t"


def _has_units(tree: ast.expr, units: Mapping[str, Unit]) -> bool:
    """Return whether a tree contains a parameter with a dimension; angles and shares are pure numbers."""
    return any(isinstance(node, ast.Name) and node.id in units and any(units[node.id].exponents)
               for node in ast.walk(tree))  # fmt: skip


def outside_pure_functions(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and the nodes below it, except the arguments of functions such as ``exp``, which are no angles."""
    remaining = [node]  # no recursion, because long sums are deeply nested
    while remaining:
        yield (node := remaining.pop())
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _PURE):
            remaining.extend(ast.iter_child_nodes(node))


def is_turn(node: ast.expr) -> bool:
    """Return whether a node is ``2*pi``, the angle of a cycle."""
    return (
        isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult)
        and {ast.unparse(node.left), ast.unparse(node.right)} == {"2", "pi"}
    )  # fmt: skip


class _Derived:
    """Derives the units of the parts of an expression."""

    def __init__(self, units: Mapping[str, Unit], *, is_of_time: bool):
        self.units, self.is_of_time = units, is_of_time

    def unit(self, node: ast.expr) -> Unit | None:
        if isinstance(node, ast.Constant) or is_turn(node) or (isinstance(node, ast.Name) and node.id == "pi"):
            return _NUMBER
        if isinstance(node, ast.Name):
            return _SECOND if self.is_of_time and _is_time(node) else self.units.get(node.id)
        if isinstance(node, ast.UnaryOp):
            return self.unit(node.operand)
        if isinstance(node, ast.Call):
            return self._of_call(node)
        if not isinstance(node, ast.BinOp):
            return None
        left, right = self._factor(node, node.left), self._factor(node, node.right)
        if isinstance(node.op, ast.Add | ast.Sub):
            return self._of_sum(node, left, right)
        if left is None:
            return None
        if isinstance(node.op, ast.Pow):
            power = _whole(node.right)
            return None if power is None else left.times(left, Fraction(power - 1))
        if right is None or not isinstance(node.op, ast.Mult | ast.Div):
            return None
        return left.times(right, Fraction(1 if isinstance(node.op, ast.Mult) else -1))

    def _factor(self, node: ast.BinOp, operand: ast.expr) -> Unit | None:
        """Return the unit of an operand; None for numbers that may have a unit, such as a time."""
        is_number = isinstance(operand, ast.Constant) and isinstance(node.op, ast.Mult | ast.Div)
        return None if self.is_of_time and is_number else self.unit(operand)

    def _of_call(self, node: ast.Call) -> Unit | None:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name in _OF_ANGLE and len(node.args) == 1:
            self.check_cycles(node.args[0])
        operands = [self.unit(argument) for argument in node.args]
        if name in _PURE:
            return _NUMBER
        if name in _LIKE_OPERANDS:
            first = operands[0] if operands else None
            is_alike = first is not None and all(operand is not None and first.is_like(operand) for operand in operands)
            return first if is_alike else None
        return None  # the units of other functions are not derived

    def _of_sum(self, node: ast.BinOp, left: Unit | None, right: Unit | None) -> Unit | None:
        """Return the unit of a sum or difference; a term without parameters with units takes that of the other term."""
        if not _has_units(node.left, self.units):
            return right
        if not _has_units(node.right, self.units):
            return left
        if left is None or right is None:
            return None
        if not left.is_like(right):
            raise SpecError(f"'{ast.unparse(node)}' adds numbers in {left} and in {right}")
        return left

    def check_cycles(self, node: ast.expr) -> None:
        """Raise SpecError for a product of the time and a frequency that is used as an angle in radians."""
        parts = [*outside_pure_functions(node)]
        names = [part.id for part in parts if isinstance(part, ast.Name)]
        has_number = "pi" in names or any(isinstance(part, ast.Constant) for part in parts)
        cycles = [name for name in names if name in self.units and self.units[name].is_frequency]
        if not self.is_of_time or has_number or not cycles or "t" not in names:
            return
        if (unit := self.unit(node)) is not None and unit.is_like(_NUMBER):
            name = cycles[0]
            raise SpecError(
                f"'{ast.unparse(node)}' is a number of cycles, because {name} has the unit {self.units[name]}; "
                f"give {name} in rev/s or rev/min (rpm), or write '2*pi*{ast.unparse(node)}'"
            )


def _whole(node: ast.expr) -> int | None:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, int) else None
