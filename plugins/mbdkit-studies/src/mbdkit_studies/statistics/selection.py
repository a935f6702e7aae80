"""Conditions on the columns of a study, such as ``misalignment_max < 1e-6 and integrator == 'gauss'``.

Conditions may come from untrusted sources. They are parsed, never evaluated as Python, and only the operations that
`select_rows` lists are allowed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mbdkit.base.text import did_you_mean, listed
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.parser import MAX_NESTING, OPERATORS, Compiler

_ORDER: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
}

_FUNCTIONS: Mapping[str, Callable[[Any], Any]] = {
    **{name: OPERATIONS[name].array for name in ("abs", "sqrt")},
    "log10": np.log10,
    "isnan": np.isnan,
}

_QUOTED = r"\"[^\"\\\n]*\"|'[^'\\\n]*'"  #: A quoted text, without a backslash.

MOST_COMPARED = 1000  #: Largest number of values in a list after `in`.


def select_rows(condition: str, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return which rows of a table satisfy a condition, (N,) bool.

    Comparisons with nan are false, except for ``!=`` and ``not in``, as in NumPy.

    Parameters
    ----------
    condition
        Comparisons ``== != < <= > >=`` and ``in [...]`` of columns, numbers and quoted text, with ``and``, ``or``,
        ``not``, ``+ - * / **``, parentheses, and the functions abs, sqrt, log10 and isnan.
    columns
        (N,) numbers, or object arrays of texts, by name.

    Raises
    ------
    SpecError
        If the condition cannot be parsed, or refers to an unknown column.
    """
    return _Condition(condition, columns).rows()


class _Condition(Compiler):
    wanted = "a condition on columns, such as misalignment_max < 1e-6"

    def __init__(self, text: str, columns: Mapping[str, np.ndarray]):
        self.columns = columns
        self.aliases: dict[str, str] = {}
        odd = sorted((name for name in columns if not (name.isidentifier() and name.isascii())), key=len, reverse=True)
        names = "|".join(re.escape(name) for name in odd) or "(?!)"
        self.words = re.compile(rf"({_QUOTED})|(?<![\w.])({names})(?![\w.])")
        super().__init__(text)

    def unquoted(self) -> str:
        return self.words.sub(lambda match: " " * len(match[0]), self.source)

    def tree(self) -> ast.expr:
        """Return the syntax tree. Columns whose names are not Python identifiers are replaced by identifiers of the
        same length.
        """
        original = self.source
        self.source = self.words.sub(lambda match: match[1] or self.alias(match[2]), original)
        try:
            return super().tree()
        finally:
            self.source = original

    def alias(self, name: str) -> str:
        """Return a Python identifier for a column.

        It has the same length as the name if possible, so that positions in messages stay correct.
        """
        text = f"_{len(self.aliases)}".ljust(len(name), "_")
        self.aliases[text] = name
        return text

    def rows(self) -> np.ndarray:
        """Return the rows that satisfy the condition."""
        node = self.tree()
        with np.errstate(all="ignore"):
            value = self.value(node, 0)
        count = len(next(iter(self.columns.values())))
        if np.asarray(value).dtype != bool:
            self.refuse("this is not a condition: it should compare a column, as in misalignment_max < 1e-6", node)
        return np.array(np.broadcast_to(value, (count,)))

    def value(self, node: ast.expr, nesting: int) -> Any:
        """Return the value of a node: an array (N,), a number, or a text."""
        if nesting > MAX_NESTING:
            self.refuse("the condition is too deeply nested", node)
        result: Any = None
        match node:
            case ast.Constant(value=str() as text):
                result = text
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                result = self.number(number, node)
            case ast.Name(id=name):
                result = self.column(name, node)
            case ast.BoolOp(op=op, values=values):
                parts = [self.condition(value, nesting + 1) for value in values]
                together = np.logical_and if isinstance(op, ast.And) else np.logical_or
                result = together.reduce(np.broadcast_arrays(*parts))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                result = np.logical_not(self.condition(operand, nesting + 1))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                result = np.negative(self.numeric(operand, nesting + 1))
            case ast.BinOp(left=left, op=operation, right=right) if type(operation) in OPERATORS:
                operands = self.numeric(left, nesting + 1), self.numeric(right, nesting + 1)
                result = OPERATIONS[OPERATORS[type(operation)]].array(*operands)
            case ast.BinOp(op=ast.BitAnd() | ast.BitOr()):
                self.refuse("conditions are joined by the words `and` and `or`", node)
            case ast.Compare():
                result = self.comparison(node, nesting)
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in _FUNCTIONS:
                result = _FUNCTIONS[name](self.numeric(argument, nesting + 1))
            case _:
                self.refuse(
                    f"'{self.segment(node)}' cannot be part of a condition, which consists of columns, numbers, "
                    f"'text', comparisons, and, or, not, + - * / **, parentheses and {listed(_FUNCTIONS, 'and')}",
                    node,
                )
        return result

    def number(self, number: float, node: ast.expr) -> np.float64:
        try:
            return np.float64(number)
        except OverflowError:
            self.refuse("the number is too large", node)

    def column(self, name: str, node: ast.expr) -> np.ndarray:
        """Return a column by its name or alias."""
        if (column := self.columns.get(self.aliases.get(name, name))) is None:
            keys = [key for key in self.columns if key.rpartition(".")[2] == name]
            known = f"; write {listed(keys, 'or')}" if keys else did_you_mean(name, self.columns)
            self.refuse(f"there is no column '{name}'{known or f'; columns: {listed(list(self.columns))}'}", node)
        return column

    def condition(self, node: ast.expr, nesting: int) -> Any:
        """Return the value of a node that must be true or false."""
        return self.of_kind("b", "is neither true nor false; compare it with something", node, nesting)

    def numeric(self, node: ast.expr, nesting: int) -> Any:
        """Return the value of a node that must be a number."""
        return self.of_kind("fiu", "is not a number", node, nesting)

    def of_kind(self, kinds: str, refusal: str, node: ast.expr, nesting: int) -> Any:
        """Return the value of a node whose array must have one of the `kinds` of NumPy."""
        result = self.value(node, nesting)
        if np.asarray(result).dtype.kind not in kinds:
            self.refuse(f"'{self.segment(node)}' {refusal}", node)
        return result

    def comparison(self, node: ast.Compare, nesting: int) -> Any:
        """Return where all comparisons of a chain hold."""
        result: Any = np.bool_(True)
        left = node.left
        for operation, right in zip(node.ops, node.comparators, strict=True):
            result = np.logical_and(result, self.compared(left, operation, right, nesting + 1))
            left = right
        return result

    def compared(self, left: ast.expr, operation: ast.cmpop, right: ast.expr, nesting: int) -> Any:
        if isinstance(operation, ast.In | ast.NotIn):
            if not isinstance(right, ast.List | ast.Tuple) or not 1 <= len(right.elts) <= MOST_COMPARED:
                self.refuse(f"`in` needs a list of at most {MOST_COMPARED} values, such as ['rk4', 'gauss']", right)
            value = self.value(left, nesting)
            among = [_equal(value, self.value(elt, nesting)) for elt in right.elts]
            within = np.logical_or.reduce(np.broadcast_arrays(*among))
            return within if isinstance(operation, ast.In) else np.logical_not(within)
        if isinstance(operation, ast.Eq | ast.NotEq):
            same = _equal(self.value(left, nesting), self.value(right, nesting))
            return same if isinstance(operation, ast.Eq) else np.logical_not(same)
        if type(operation) not in _ORDER:
            self.refuse("compare with == != < <= > >= or `in`", left)
        return _ORDER[type(operation)](self.numeric(left, nesting), self.numeric(right, nesting))


def _equal(left: Any, right: Any) -> Any:
    """Return where two values are equal; a text never equals a number."""
    kinds = {np.asarray(value).dtype.kind in "OU" for value in (left, right)}
    if len(kinds) == 2:
        return np.broadcast_to(np.bool_(False), np.broadcast_shapes(np.shape(left), np.shape(right)))
    dtype = object if True in kinds else float
    return np.asarray(np.equal(np.asarray(left, dtype), np.asarray(right, dtype)), bool)
