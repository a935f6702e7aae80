"""Units of expressions of named parameters that are given with units, such as ``force/length``."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from fractions import Fraction

from mbdkit.base.errors import SpecError
from mbdkit.base.units import PLAIN, Unit


def unit_of_expression(text: str, units: Mapping[str, Unit]) -> Unit | None:
    """Return the unit of an expression; None if it cannot be derived.

    It cannot be derived if no parameter has a unit, and usually not from functions, from powers that are not whole
    numbers, or if other parameters have no unit.

    Parameters
    ----------
    units
        Units of the parameters that have one, by name.

    Raises
    ------
    SpecError
        If quantities of different kinds are added or subtracted.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # reported when the expression is compiled
        return None
    if isinstance(tree, ast.Name):
        return units.get(tree.id)
    return _unit(tree, units) if _has_units(tree, units) else None


def _has_units(tree: ast.expr, units: Mapping[str, Unit]) -> bool:
    return any(isinstance(node, ast.Name) and node.id in units for node in ast.walk(tree))


def _unit(node: ast.expr, units: Mapping[str, Unit]) -> Unit | None:
    if isinstance(node, ast.Constant) or (isinstance(node, ast.Name) and node.id == "pi"):
        return PLAIN
    if isinstance(node, ast.Name):
        return units.get(node.id)
    if isinstance(node, ast.UnaryOp):
        return _unit(node.operand, units)
    if not isinstance(node, ast.BinOp):
        return None  # units are not derived for functions, whose results are rarely lengths or forces
    left, right = _unit(node.left, units), _unit(node.right, units)
    if isinstance(node.op, ast.Add | ast.Sub):
        return _of_sum(node, left, right, units)
    if left is None:
        return None
    if isinstance(node.op, ast.Pow):
        power = _whole(node.right)
        return None if power is None else left.times(left, Fraction(power - 1))
    if right is None or not isinstance(node.op, ast.Mult | ast.Div):
        return None
    return left.times(right, Fraction(1 if isinstance(node.op, ast.Mult) else -1))


def _of_sum(node: ast.BinOp, left: Unit | None, right: Unit | None, units: Mapping[str, Unit]) -> Unit | None:
    """Return the unit of a sum or difference; a term in which no parameter has a unit takes the unit of the
    other term.
    """
    if not _has_units(node.left, units):
        return right
    if not _has_units(node.right, units):
        return left
    if left is None or right is None:
        return None
    if not left.is_like(right):
        raise SpecError(f"'{ast.unparse(node)}' adds numbers in {left} and in {right}")
    return left


def _whole(node: ast.expr) -> int | None:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, int) else None
