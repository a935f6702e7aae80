"""Functions that branch on symbols, rewritten so that they are executed once.

`merged` rewrites a function of Python: both branches of a condition on symbols are executed, and each variable is
selected by the condition. A search for the nearest edge thus takes as many selections as there are edges, whereas
`mbdkit_predict.symbols.every_branch` would execute all sequences of outcomes. An integer that depends on conditions,
such as the number of this edge, is an `IntegerChoice` among a few numbers. Functions that are called must be rewritten
too, and must not change anything but elements of arrays. Loops are ``for`` over `range`, or ``while True``.
"""

from __future__ import annotations

import ast
import inspect
import operator
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import cache, reduce
from types import FunctionType
from typing import Any

import numpy as np

from mbdkit.engine.interpreter import Arithmetic
from mbdkit_predict.symbols import BranchError, Symbol, apply, every_branch, where

#: Number of passes of ``while True``, a search that is repeated until it succeeds; the last one must be complete.
MOST_REPEATS = 2


class IntegerChoice:
    """An integer that depends on conditions: its possible values, each with its condition, one of which holds."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, cases: dict[int, Any]):
        self.cases = cases

    def __index__(self) -> int:
        raise BranchError("an integer depends on the state")


def _cases(x: Any) -> dict[int, Any]:
    return x.cases if isinstance(x, IntegerChoice) else {int(x): True}


def _chosen(pairs: Iterator[tuple[Any, Any]]) -> Any:
    cases = dict[Any, Any]()
    for value, holds in pairs:
        cases[value] = either(cases.get(value, False), holds)
    if isinstance(next(iter(cases)), bool):
        return cases.get(True, False) if False in cases else True
    return IntegerChoice(cases) if len(cases) > 1 else next(iter(cases))


def _operation(name: str, *, is_reflected: bool = False) -> Callable[..., Any]:
    def combine(x: object, y: object) -> Any:
        first, second = (y, x) if is_reflected else (x, y)
        pairs = [(a, b) for a in _cases(first).items() for b in _cases(second).items()]
        return _chosen((getattr(operator, name)(a, b), both(is_a, is_b)) for (a, is_a), (b, is_b) in pairs)

    return combine


for _name in ("add", "sub", "mul", "floordiv", "mod", "eq", "ne", "lt", "le", "gt", "ge"):
    setattr(IntegerChoice, f"__{_name}__", _operation(_name))
for _name in ("add", "sub", "mul"):
    setattr(IntegerChoice, f"__r{_name}__", _operation(_name, is_reflected=True))


class Numbers(np.ndarray):
    """An array of numbers and symbols in which an index may be a choice."""

    def __getitem__(self, index: Any) -> Any:
        (first, _), *others = index.cases.items() if isinstance(index, IntegerChoice) else [(index, True)]
        value = super().__getitem__(first)
        for i, condition in others:
            value = where(condition, super().__getitem__(i), value)
        return value


def both(first: object, second: object) -> Any:
    """Return whether two conditions hold."""
    if isinstance(first, Symbol):
        return first & second if isinstance(second, Symbol) else first if second else False
    return second if first else False


def either(first: object, second: object) -> Any:
    """Return whether one of two conditions holds."""
    return negated(both(negated(first), negated(second)))


def negated(condition: object) -> Any:
    """Return whether a condition does not hold."""
    return ~condition if isinstance(condition, Symbol) else not condition


def select(condition: Any, x: Any, y: Any) -> Any:
    """Return `x` where the condition holds, else `y`; also of integers, conditions, and tuples."""
    if x is y or not isinstance(condition, Symbol):
        return x if x is y or condition else y
    if isinstance(x, tuple):
        return tuple(select(condition, *pair) for pair in zip(x, y, strict=True))
    if all(isinstance(value, int | IntegerChoice) for value in (x, y)):
        sides = ((x, condition), (y, negated(condition)))
        if isinstance(x, bool):
            return _chosen(iter(sides))
        return _chosen((i, both(is_i, holds)) for value, holds in sides for i, is_i in _cases(value).items())
    return where(condition, x, y)


def every(*conditions: Callable[[], Any]) -> Any:
    """Return whether all conditions hold; those after a wrong one are not evaluated."""
    result: Any = True
    for condition in conditions:
        result = result if result is False else both(result, condition())
    return result


def some(*conditions: Callable[[], Any]) -> Any:
    """Return whether a condition holds; those after a right one are not evaluated."""
    return negated(every(*(lambda x=condition: negated(x()) for condition in conditions)))


def if_else(condition: object, x: Callable[[], Any], y: Callable[[], Any]) -> Any:
    """Return ``x()`` where the condition holds, else ``y()``."""
    return select(condition, x(), y()) if isinstance(condition, Symbol) else (x if condition else y)()


class MergedExecution:
    """The execution of a function: the conditions of the statement that is executed.

    A stack has the condition under which the function has not returned yet, those of the branches around the
    statement, and for each loop that it was not left, followed by that the rest of this pass was not skipped.
    """

    _running: list[MergedExecution] = []  # noqa: RUF012

    def __init__(self) -> None:
        self._stack, self._loops = [True], list[int]()
        self.result: Any = None
        self._outer = self._running[-1].guard() if self._running else True

    def __enter__(self) -> MergedExecution:
        self._running.append(self)
        return self

    def __exit__(self, *error: object) -> None:
        self._running.pop()

    def guard(self) -> Any:
        """Return the condition of the statement, in the functions that call this one, too."""
        return reduce(both, self._stack, self._outer)

    def new(self, values: Any, *old: Callable[[], Any], is_item: bool) -> Any:
        """Return the values of variables, or of elements of arrays, after an assignment."""
        guard = self.guard() if is_item else reduce(both, self._stack)
        results = []
        for x, before in zip(values, old, strict=True):
            try:
                results.append(x if guard is True else select(guard, x, before()))
            except NameError:  # has no value yet
                results.append(x)
        return results

    def begins(self, condition: Any) -> bool:
        """Begin a branch; return whether it is executed."""
        is_executed = isinstance(condition, Symbol) or bool(condition)
        self._stack += [condition] * is_executed
        return is_executed

    def ends(self) -> None:
        """End a branch."""
        self._stack.pop()

    def returns(self, value: object) -> bool:
        """Return a value; return whether the function ends."""
        is_first, guard = self._stack[0] is True and self.result is None, reduce(both, self._stack)
        self.result = value if is_first else select(guard, value, self.result)
        return self._closed(0)

    def passes(self, *limits: Any) -> Iterator[int]:
        """Yield the numbers of a range, whose limits may be choices."""
        first, last = limits if len(limits) > 1 else (0, *limits)
        begin = len(self._stack)
        self._loops.append(begin)
        self._stack += [True, True]
        for i in range(min(_cases(first)), max(_cases(last))):
            self._stack[begin + 1 :] = [both(first <= i, i < last)]
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
        self._stack[index] = both(self._stack[index], negated(reduce(both, self._stack[index + 1 :], True)))
        return self._stack[index] is False


class _Rewriter(ast.NodeTransformer):
    def visit(self, node: ast.AST) -> Any:
        self.generic_visit(node)
        rewrite = getattr(self, f"visit_{type(node).__name__}", None)
        return node if rewrite is None else rewrite(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.body = _block("with _merged.MergedExecution() as _run:", node.body, "return _run.result")
        node.decorator_list = []
        return node

    def visit_Assign(self, node: ast.Assign) -> list[ast.stmt]:
        (target,) = node.targets
        parts = target.elts if isinstance(target, ast.Tuple) else [target]
        value = ast.unparse(node.value) if isinstance(target, ast.Tuple) else f"({ast.unparse(node.value)},)"
        is_item = any(isinstance(part, ast.Subscript) for part in parts)
        names = [ast.unparse(part) for part in parts]
        old = ", ".join(f"lambda: {name}" for name in names)
        return ast.parse(f"{', '.join(names)}, = _run.new({value}, {old}, is_item={is_item})").body

    def visit_AugAssign(self, node: ast.AugAssign) -> list[ast.stmt]:
        return self.visit_Assign(ast.Assign([node.target], ast.BinOp(node.target, node.op, node.value)))

    def visit_If(self, node: ast.If) -> list[ast.stmt]:
        condition = f"_condition_{node.lineno}"
        statements = ast.parse(f"{condition} = {ast.unparse(node.test)}").body
        for body, test in ((node.body, condition), (node.orelse, f"_merged.negated({condition})")):
            if body:
                statements += _block(f"if _run.begins({test}):", [*body, *ast.parse("_run.ends()").body])
        return statements

    def visit_For(self, node: ast.For) -> list[ast.stmt]:
        limits = ast.unparse(node.iter).removeprefix("range")
        return _block(f"for {ast.unparse(node.target)} in _run.passes{limits}:", node.body, "_run.end_loop()")

    def visit_While(self, node: ast.While) -> list[ast.stmt]:
        return _block(f"for _ in _run.passes({MOST_REPEATS}):", node.body, "_run.end_loop()")

    def visit_Return(self, node: ast.Return) -> list[ast.stmt]:
        value = ast.unparse(node.value or ast.Constant(None))
        return ast.parse(f"if _run.returns({value}):\n    return _run.result").body

    def visit_Break(self, node: ast.Break) -> list[ast.stmt]:
        return _block("if _run.leaves():", [node])

    def visit_Continue(self, node: ast.Continue) -> list[ast.stmt]:
        return _block("if _run.skips():", [node])

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        return _call("every" if isinstance(node.op, ast.And) else "some", node.values)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        return _call("negated", [], node.operand) if isinstance(node.op, ast.Not) else node

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        return _call("if_else", [node.body, node.orelse], node.test)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        if isinstance(node.ops[0], ast.In):
            return _call("some", [ast.Compare(node.left, [ast.Eq()], [x]) for x in node.comparators[0].elts])  # type: ignore[attr-defined]
        sides = [node.left, *node.comparators]
        pairs = [ast.Compare(x, [op], [y]) for x, op, y in zip(sides, node.ops, sides[1:], strict=False)]
        return node if len(pairs) == 1 else _call("every", pairs)


def _block(head: str, body: list[ast.stmt], after: str = "") -> list[ast.stmt]:
    first, *others = ast.parse(f"{head}\n    pass\n{after}").body
    first.body = body  # type: ignore[attr-defined]
    return [first, *others]


def _call(name: str, delayed: Sequence[ast.expr], *given: ast.expr) -> ast.expr:
    operands = [*map(ast.unparse, given), *(f"lambda: {ast.unparse(x)}" for x in delayed)]
    return ast.parse(f"_merged.{name}({', '.join(operands)})", mode="eval").body


@cache
def merged(function: FunctionType) -> FunctionType:
    """Return a function that is executed once for all outcomes of its conditions; see this module."""
    tree = _Rewriter().visit(ast.parse(textwrap.dedent(inspect.getsource(function))))
    names = dict[str, Any]()
    exec(compile(ast.fix_missing_locations(tree), function.__code__.co_filename, "exec"), names)
    code, known = names[function.__name__].__code__, {**function.__globals__, "_merged": sys.modules[__name__]}
    return FunctionType(code, known, function.__name__, function.__defaults__)


#: Symbols as numbers with which kernels are executed.
SYMBOLS = Arithmetic(Symbol, BranchError, where, apply, every_branch, merged, Numbers)
