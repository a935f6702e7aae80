"""The unit of a parameter without a unit, from the numbers in which it is used: ``k`` in ``stiffness: k`` is in N/m."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping
from fractions import Fraction

from mbdkit.base.errors import SpecError
from mbdkit.base.units import Unit, read_unit
from mbdkit.mechanism.parameter_units import is_turn, outside_pure_functions, unit_of_parts

_RADIAN, _SECOND = read_unit("rad"), read_unit("s")
_SAME = frozenset({"abs", "min", "max"})
_OF_ANGLE = frozenset({"sin", "cos", "tan"})
#: Factors that are assumed to have no unit. Others may be constants of nature or densities, such as 9.81 and 7800.
_FACTORS = frozenset({float(n) for n in range(1, 11)} | {1.0 / n for n in range(2, 11)})

#: Units of quantities of bodies in expressions of the state.
_STATE = {".angular_velocity": read_unit("rad/s"), ".angle": _RADIAN, ".x": read_unit("m"), ".y": read_unit("m")}


class _OfState(ast.NodeTransformer):
    """Replaces quantities of bodies, such as ``rod.angle``, by names with a unit, such as ``.angle``."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        return ast.Name(f".{node.attr}") if f".{node.attr}" in _STATE and isinstance(node.value, ast.Name) else node


def unit_of_use(name: str, uses: Iterable[tuple[str, str]], units: Mapping[str, Unit]) -> str:
    """Return the unit of a parameter; empty if its uses do not determine it, or contradict each other.

    Parameters
    ----------
    uses
        Expressions, and the unit of the number that each of them replaces.
    units
        Units of the parameters that have one, by name.
    """
    result = set()
    for text, unit in uses:
        try:
            tree = _OfState().visit(ast.parse(text.strip(), mode="eval").body)
            wanted = read_unit(unit.replace("²", "^2"))
        except (SyntaxError, SpecError):  # a unit such as "N or N m", or none
            continue
        derived = _unit(tree, name, wanted, {**_STATE, **units, "t": _SECOND})
        if derived is not None and _contains(tree, name):
            result.add(derived.text)
    return result.pop() if len(result) == 1 else ""


def _contains(node: ast.expr, name: str) -> bool:
    return any(isinstance(one, ast.Name) and one.id == name for one in ast.walk(node))


def _unit(node: ast.expr, name: str, wanted: Unit | None, units: Mapping[str, Unit]) -> Unit | None:
    """Return the unit of a parameter in a part of an expression, whose unit is `wanted`; None for units not known."""
    if isinstance(node, ast.Name):
        return wanted
    if isinstance(node, ast.UnaryOp):
        return _unit(node.operand, name, wanted, units)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        part = next((arg for arg in node.args if _contains(arg, name)), None)
        return None if part is None else _of_call(node.func.id, part, name, wanted, units)
    if not isinstance(node, ast.BinOp):
        return None
    part, other = (node.left, node.right) if _contains(node.left, name) else (node.right, node.left)
    if isinstance(node.op, ast.Add | ast.Sub):
        return _unit(part, name, wanted, units)
    if _contains(other, name) or not isinstance(node.op, ast.Mult | ast.Div):
        return None
    factor = None if wanted is None else _factor(other, wanted, units)
    if wanted is None or factor is None:
        inner = None
    elif isinstance(node.op, ast.Mult):
        inner = _product(wanted, factor, -1)
    else:
        inner = _product(wanted, factor, 1) if part is node.left else _product(factor, wanted, -1)
    return _unit(part, name, inner, units)


def _of_call(function: str, part: ast.expr, name: str, wanted: Unit | None, units: Mapping[str, Unit]) -> Unit | None:
    if function in _OF_ANGLE:
        return _unit(part, name, _RADIAN, units)
    if function == "degrees" and wanted is not None and wanted.text.startswith("rad"):
        return _unit(part, name, read_unit(wanted.text.replace("rad", "deg")), units)
    return _unit(part, name, wanted, units) if function in _SAME else None


def _factor(node: ast.expr, wanted: Unit, units: Mapping[str, Unit]) -> Unit | None:
    """Return the unit of the other factor of a product."""
    if is_turn(node) and wanted.text == "rad/s":
        return Unit("rad", counts=(Fraction(1), Fraction(-1), Fraction(0)))
    numbers = [one.value for one in outside_pure_functions(node) if isinstance(one, ast.Constant)]
    return unit_of_parts(node, units) if {*numbers} <= _FACTORS else None


def _product(unit: Unit, other: Unit, power: int) -> Unit:
    """Return the product of a unit and a power of another unit, with radians and cycles where these are usual."""
    if other.counts[1] and unit.text == "rad/s":
        return read_unit("Hz")
    if not any(other.exponents):
        return unit
    times = unit.times(other, Fraction(power))
    length, mass, time = times.exponents
    if unit.counts[0] == 1 and not length and not mass:
        angle = unit.text.partition("/")[0]
        return read_unit(angle if not time else f"{angle}/s" if time == -1 else f"{angle}*s^{time}")
    return times
