"""Functions that branch on symbols, rewritten so that they are executed once.

`merged` rewrites a function of Python: both branches of a condition on symbols are executed, and each variable is
selected by the condition where they join. A search for the nearest edge thus takes as many selections as there are
edges, whereas `mbdkit_predict.symbols.every_branch` would execute all sequences of outcomes. Integers that depend on
conditions, such as the number of this edge, are a `Choice` among a few numbers.

Loops run over numbers, and may be left or continued on symbols. Called functions must not have side effects but on
arrays, and these must be rewritten too.
"""

from __future__ import annotations

import ast
import inspect
import operator
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from functools import cache, reduce
from types import FunctionType
from typing import Any

import numpy as np

from mbdkit_predict.symbols import BranchError, Symbol, where

MOST_REPEATS = 2
"""Largest number of passes of a search that is repeated until it succeeds; the last one must be complete."""


class Choice:
    """An integer that depends on conditions.

    Attributes
    ----------
    cases
        Its possible values, each with its condition; one of these holds.
    """

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, cases: Mapping[int, Any]):
        self.cases = dict(cases)

    def __index__(self) -> int:
        raise BranchError("an integer depends on the state")


def _combined(operation: Callable[[int, int], Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return an operation on two integers, at least one of which is a choice, and that with exchanged operands."""

    def combine(x: Any, y: Any) -> Any:
        cases = dict[Any, Any]()
        for a, is_a in _cases(x).items():
            for b, is_b in _cases(y).items():
                result = operation(a, b)
                cases[result] = either(cases.get(result, False), both(is_a, is_b))
        if all(isinstance(result, bool) for result in cases):
            return cases.get(True, False) if False in cases else True
        return Choice(cases) if len(cases) > 1 else next(iter(cases))

    return combine, lambda x, y: combine(y, x)


def _cases(x: Any) -> dict[int, Any]:
    return x.cases if isinstance(x, Choice) else {int(x): True}


for _name in ("add", "sub", "mul", "floordiv", "mod"):
    for _prefix, _function in zip(("", "r"), _combined(getattr(operator, _name)), strict=True):
        setattr(Choice, f"__{_prefix}{_name}__", _function)
for _name in ("eq", "ne", "lt", "le", "gt", "ge"):
    setattr(Choice, f"__{_name}__", _combined(getattr(operator, _name))[0])


class Numbers(np.ndarray):
    """An array of numbers and symbols in which an index may be a choice."""

    def __getitem__(self, index: Any) -> Any:
        if not isinstance(index, Choice):
            return super().__getitem__(index)
        (first, _), *others = index.cases.items()
        value = super().__getitem__(first)
        for i, condition in others:
            value = where(condition, super().__getitem__(i), value)
        return value


def both(first: Any, second: Any) -> Any:
    """Return whether two conditions hold."""
    if isinstance(first, Symbol):
        return first & second if isinstance(second, Symbol) else first if second else False
    return second if first else False


def either(first: Any, second: Any) -> Any:
    """Return whether one of two conditions holds."""
    if isinstance(first, Symbol):
        return first | second if isinstance(second, Symbol) else True if second else first
    return True if first else second


def negated(condition: Any) -> Any:
    """Return whether a condition does not hold."""
    return ~condition if isinstance(condition, Symbol) else not condition


def every(*conditions: Callable[[], Any]) -> Any:
    """Return whether all conditions hold; those after a wrong one are not evaluated."""
    result: Any = True
    for condition in conditions:
        if (result := both(result, condition())) is False:
            break
    return result


def some(*conditions: Callable[[], Any]) -> Any:
    """Return whether a condition holds; those after a right one are not evaluated."""
    result: Any = False
    for condition in conditions:
        if (result := either(result, condition())) is True:
            break
    return result


def select(condition: Any, x: Any, y: Any) -> Any:
    """Return `x` where the condition holds, else `y`; also of integers, conditions, and tuples."""
    if x is y or not isinstance(condition, Symbol):
        return x if x is y or condition else y
    if isinstance(x, tuple):
        return tuple(select(condition, *pair) for pair in zip(x, y, strict=True))
    if isinstance(x, bool) and isinstance(y, bool):
        return x if x == y else condition if x else negated(condition)
    if all(isinstance(value, int | Choice) and not isinstance(value, bool) for value in (x, y)):
        cases = dict[int, Any]()
        for value, holds in ((x, condition), (y, negated(condition))):
            for number, is_number in _cases(value).items():
                cases[number] = either(cases.get(number, False), both(holds, is_number))
        return Choice(cases) if len(cases) > 1 else x
    return where(condition, x, y)


def if_else(condition: Any, x: Callable[[], Any], y: Callable[[], Any]) -> Any:
    """Return ``x()`` where the condition holds, else ``y()``."""
    return select(condition, x(), y()) if isinstance(condition, Symbol) else x() if condition else y()


class Run:
    """The execution of a function: the conditions of the statement that is executed.

    A stack has the condition under which the function has not returned yet, those of the branches around the
    statement, and for each loop that it was not left, followed by that the rest of this pass was not skipped.
    """

    _running: list[Run] = []  # noqa: RUF012

    def __init__(self) -> None:
        self._outer = self._running[-1].guard(with_outer=True) if self._running else True
        self._stack: list[Any] = [True]
        self._loops: list[int] = []
        self.result: Any = None
        self._has_result = False

    def __enter__(self) -> Run:
        self._running.append(self)
        return self

    def __exit__(self, *error: object) -> None:
        self._running.pop()

    def guard(self, begin: int = 0, *, with_outer: bool = False) -> Any:
        """Return the condition of the present statement, of those on the stack from an index on."""
        return reduce(both, self._stack[begin:], self._outer if with_outer else True)

    def new(self, value: Any, *old: Callable[[], Any], is_item: bool = False) -> Any:
        """Return the value of a variable, or those of several, after an assignment."""
        guard = self.guard(with_outer=is_item)
        if guard is True:
            return value
        values = value if len(old) > 1 else (value,)
        results = []
        for x, before in zip(values, old, strict=True):
            try:
                results.append(select(guard, x, before()))
            except NameError:  # has no value yet
                results.append(x)
        return results if len(old) > 1 else results[0]

    def begins(self, condition: Any) -> bool:
        """Begin a branch; return whether it is executed."""
        if isinstance(condition, Symbol) or condition:
            self._stack.append(condition)
            return True
        return False

    def ends(self) -> None:
        """End a branch."""
        self._stack.pop()

    def returns(self, value: Any) -> bool:
        """Return a value; return whether the function ends."""
        guard = self.guard()
        self.result = select(guard, value, self.result) if self._has_result else value
        self._has_result = True
        return self._closed(0)

    def passes(self, *limits: Any) -> Iterator[int]:
        """Yield the numbers of a range, whose limits may be choices."""
        first, last = limits if len(limits) > 1 else (0, *limits)
        numbers = range(min(_cases(first)), max(_cases(last)))
        yield from self._loop((i, both(first <= i, i < last)) for i in numbers)

    def repeats(self, condition: Callable[[], bool]) -> Iterator[int]:
        """Yield numbers while a condition holds, at most `MOST_REPEATS` times."""
        yield from self._loop((i, True) for i in range(MOST_REPEATS) if condition())

    def _loop(self, passes: Iterator[tuple[int, Any]]) -> Iterator[int]:
        begin = len(self._stack)
        self._loops.append(begin)
        self._stack += [True, True]
        for i, takes_part in passes:
            self._stack[begin + 1 :] = [takes_part]
            if takes_part is not False:
                yield i

    def end_loop(self) -> None:
        """End the loop."""
        del self._stack[self._loops.pop() :]

    def leaves(self) -> bool:
        """Leave the loop; return whether all do."""
        return self._closed(self._loops[-1])

    def skips(self) -> bool:
        """Skip the rest of a pass; return whether all do."""
        return self._closed(self._loops[-1] + 1)

    def _closed(self, index: int) -> bool:
        self._stack[index] = both(self._stack[index], negated(self.guard(index + 1)))
        return self._stack[index] is False


class _Rewriter(ast.NodeTransformer):
    """Rewrites statements and conditions."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> Any:
        self.generic_visit(node)
        body = ast.parse("with _merged.Run() as _run:\n    pass\nreturn _run.result").body
        body[0].body = node.body  # type: ignore[attr-defined]
        node.body, node.decorator_list = body, []
        return node

    def visit_Assign(self, node: ast.Assign) -> Any:
        self.generic_visit(node)
        (target,) = node.targets
        parts = target.elts if isinstance(target, ast.Tuple) else [target]
        is_item = any(isinstance(part, ast.Subscript) for part in parts)
        old = ", ".join(f"lambda: {ast.unparse(part)}" for part in parts)
        text = f"{ast.unparse(target)} = _run.new({ast.unparse(node.value)}, {old}, is_item={is_item})"
        return ast.parse(text).body

    def visit_AugAssign(self, node: ast.AugAssign) -> Any:
        return self.visit_Assign(ast.Assign([node.target], ast.BinOp(node.target, node.op, node.value)))

    def visit_If(self, node: ast.If) -> Any:
        self.generic_visit(node)
        condition = f"_condition_{node.lineno}"
        statements = ast.parse(f"{condition} = {ast.unparse(node.test)}").body
        for body, test in ((node.body, condition), (node.orelse, f"_merged.negated({condition})")):
            if body:
                (branch,) = ast.parse(f"if _run.begins({test}):\n    _run.ends()").body
                branch.body[:0] = body  # type: ignore[attr-defined]
                statements.append(branch)
        return statements

    def visit_For(self, node: ast.For) -> Any:
        self.generic_visit(node)
        limits = ast.unparse(node.iter).removeprefix("range(")
        return self._loop(ast.unparse(node.target), f"passes({limits}", node.body)

    def visit_While(self, node: ast.While) -> Any:
        self.generic_visit(node)
        return self._loop("_", f"repeats(lambda: {ast.unparse(node.test)})", node.body)

    def _loop(self, target: str, passes: str, body: list[ast.stmt]) -> list[ast.stmt]:
        loop, *rest = ast.parse(f"for {target} in _run.{passes}:\n    pass\n_run.end_loop()").body
        loop.body = body  # type: ignore[attr-defined]
        return [loop, *rest]

    def visit_Return(self, node: ast.Return) -> Any:
        self.generic_visit(node)
        value = "None" if node.value is None else ast.unparse(node.value)
        return ast.parse(f"if _run.returns({value}):\n    return _run.result").body

    def visit_Break(self, _node: ast.Break) -> Any:
        return ast.parse("while True:\n    if _run.leaves():\n        break").body[0].body  # type: ignore[attr-defined]

    def visit_Continue(self, _node: ast.Continue) -> Any:
        return ast.parse("while True:\n    if _run.skips():\n        continue").body[0].body  # type: ignore[attr-defined]

    def visit_BoolOp(self, node: ast.BoolOp) -> Any:
        self.generic_visit(node)
        return _call("every" if isinstance(node.op, ast.And) else "some", *node.values)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:
        self.generic_visit(node)
        return _expression(f"_merged.negated({ast.unparse(node.operand)})") if isinstance(node.op, ast.Not) else node

    def visit_IfExp(self, node: ast.IfExp) -> Any:
        self.generic_visit(node)
        x, y = ast.unparse(node.body), ast.unparse(node.orelse)
        return _expression(f"_merged.if_else({ast.unparse(node.test)}, lambda: {x}, lambda: {y})")

    def visit_Compare(self, node: ast.Compare) -> Any:
        self.generic_visit(node)
        if isinstance(node.ops[0], ast.In):
            (group,) = node.comparators
            return _call("some", *(ast.Compare(node.left, [ast.Eq()], [x]) for x in group.elts))  # type: ignore[attr-defined]
        operands = [node.left, *node.comparators]
        pairs = [ast.Compare(operands[i], [op], [operands[i + 1]]) for i, op in enumerate(node.ops)]
        return node if len(pairs) == 1 else _call("every", *pairs)


def _expression(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def _call(name: str, *conditions: ast.expr) -> ast.expr:
    return _expression(f"_merged.{name}({', '.join(f'lambda: {ast.unparse(x)}' for x in conditions)})")


@cache
def merged(function: FunctionType) -> FunctionType:
    """Return a function that is executed once for all outcomes of its conditions; see this module."""
    tree = _Rewriter().visit(ast.parse(textwrap.dedent(inspect.getsource(function))))
    names = dict[str, Any]()
    exec(compile(ast.fix_missing_locations(tree), function.__code__.co_filename, "exec"), names)
    code, known = names[function.__name__].__code__, {**function.__globals__, "_merged": sys.modules[__name__]}
    return FunctionType(code, known, function.__name__, function.__defaults__)
