"""Numbers that record how code computes with them: formulas of what follows from a few numbers, and their conditions.

Code that computes with plain floats is called once with these numbers in place of some of its input. Arithmetic and
elementary functions are recorded; so is the outcome of each comparison, as a condition under which the code would take
the same branches. Whatever would lose a number, such as its conversion to a float or to text, raises
`UntraceableError`, so that a formula is either complete or absent. The recorded operations are repeated by the same
functions on floats, hence with the same bits.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar
from functools import cached_property
from itertools import count
from types import CodeType
from typing import Any

import numpy as np

from mbdkit.base import elementary, higher_layers
from mbdkit.base.context_values import value_within
from mbdkit.base.frozen import dataclass

Numbers = Sequence[float]

_current: ContextVar[Trace | None] = ContextVar("current trace", default=None)


_IF_NOT, _RETURN = " if not (", "): return None"  #: Beginning and end of the line of a condition.


class UntraceableError(Exception):
    """Code uses a traced number in a way that cannot be recorded."""


@dataclass(frozen=True, eq=False)
class Formulas:
    """Results as a function of the values of the inputs, which returns None if a condition does not hold.

    `inputs`, `results`: names of the inputs, and texts of the results. `lines`: recorded operations and conditions.
    `kept`: conditions under which no result becomes, or ceases to be, zero or finite.
    """

    inputs: tuple[str, ...]
    lines: tuple[str, ...]
    kept: tuple[str, ...]
    results: tuple[str, ...]

    def compiled(self, functions: Mapping[str, Any]) -> Callable[..., tuple[Any, ...] | None]:
        """Return the results as a Python function that calls `functions` by their names; `kept` is not asked for."""
        return self._with(self._code, functions)

    def _with(self, code: CodeType, functions: Mapping[str, Any]) -> Callable[..., Any]:
        space: dict[str, Any] = {"inf": math.inf, "nan": math.nan, **functions}
        exec(code, space)  # the text consists of recorded operations only
        function: Callable[..., Any] = space["formulas"]
        return function

    def _compiled(self, lines: Iterable[str], results: Iterable[str]) -> CodeType:
        text = "\n".join([*lines, f" return ({', '.join([*results, ''])})"])
        return compile(f"def formulas({', '.join(self.inputs)}):\n{text}", "<formulas>", "exec")

    @cached_property
    def _code(self) -> CodeType:
        return self._compiled(self.lines, self.results)

    @cached_property
    def _function(self) -> Callable[..., tuple[float, ...] | None]:
        return self._with(self._compiled((*self.lines, *self.kept), self.results), recorded_functions())

    def __call__(self, *inputs: float) -> tuple[float, ...] | None:
        """Return the results; see the class."""
        try:
            return self._function(*inputs)
        except (ArithmeticError, ValueError):
            return None

    def of_columns(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return whether the results for N rows of values (N, K) of the inputs are known, (N,), and the results (N, R),
        which have the same bits as those of single calls; single calls know more of them.
        """
        known, results = np.zeros(len(values), bool), np.zeros((len(values), len(self.results)))
        if self._of_columns is not None:
            with np.errstate(all="ignore"):
                holds, *columns = self._of_columns(*values.T)
            known[:] = holds & np.isfinite(values).all(axis=1)
            for column, result in enumerate(columns):
                results[:, column] = result
        return known, results

    @cached_property
    def _of_columns(self) -> Callable[..., tuple[Any, ...]] | None:
        """The results as a function of arrays, which returns before them where all conditions hold; None if an
        operation is not known for arrays.
        """
        lines = [" holds = True"]
        for line in (*self.lines, *self.kept):
            name, is_operation, text = line.partition(" = ")
            _, is_quotient, divisor = text.partition(" / ")
            if not is_operation:
                condition = line.removeprefix(_IF_NOT).removesuffix(_RETURN)
                lines.append(f" holds = holds & {condition.replace('not ', '~', 1)}")
                continue
            lines.append(line)
            if is_quotient:
                lines.append(f" holds = holds & ({divisor} != 0.0)")
            elif "(" in text:  # functions of single numbers may raise errors where these return nan
                lines.append(f" holds = holds & ({name.strip()} == {name.strip()})")
        function = self._with(self._compiled(lines, ("holds", *self.results)), _of_arrays())
        is_known = _of_arrays().keys() >= {*function.__code__.co_names}
        return function if is_known and not any(symbol in line for line in lines for symbol in ("//", "%")) else None


def recorded_functions() -> dict[str, Callable[..., Any]]:
    """Return the functions that recorded operations call, by name."""
    return {**higher_layers.elementary_functions(), **_FUNCTIONS}


@functools.cache
def _of_arrays() -> dict[str, Any]:
    """Return what formulas of arrays may use: functions with the same bits as those of single numbers."""
    chosen = {"_sqrt": np.sqrt, "_max": _choice(operator.gt), "_min": _choice(operator.lt)}
    single = {name: _one_by_one(_FUNCTIONS[name]) for name in ("_dist", "_hypot", "_power", "_second")}
    return {**elementary.FUNCTIONS, **chosen, **single, "abs": abs, "sum": sum, "inf": math.inf, "nan": math.nan}


def _one_by_one(function: Callable[..., float]) -> Callable[..., np.ndarray]:
    """Return a function of arrays, and of sequences of them, that calls `function` for each element; nan for errors."""

    def call(*operands: Any) -> np.ndarray:
        leaves = [*_flat(operands)]

        def value(*numbers: float) -> float:
            left = iter(numbers)
            try:
                return function(*([next(left) for _ in x] if isinstance(x, tuple) else next(left) for x in operands))
            except (ArithmeticError, ValueError):
                return math.nan

        return np.asarray(np.frompyfunc(value, len(leaves), 1)(*leaves), dtype=float)

    return call


def _choice(is_better: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Return a function like `max` that chooses among several arrays; the first of equal ones remains."""

    def choose(*given: Any) -> Any:
        values = given if len(given) > 1 else given[0]
        return functools.reduce(lambda best, x: np.where(is_better(x, best), x, best), values)

    return choose


_serials = count()


class Trace:
    """The operations and conditions that were recorded so far.

    While it is `recording`, arrays that `float_array` makes of traced numbers are noted. If it `keeps_texts`,
    expressions have names of traced numbers in place of their values.
    """

    def __init__(self, *, keeps_texts: bool = False) -> None:
        self.keeps_texts, self.serial = keeps_texts, next(_serials)
        self.named: dict[str, TracedNumber] = {}  #: Numbers in texts, by name.
        self._lines: list[str] = []
        self.arrays: dict[int, tuple[np.ndarray, dict[int, TracedNumber]]] = {}
        self.has_failed = False  #: Whether a number was lost; code may catch `UntraceableError`.
        self._known: dict[str, TracedNumber] = {}
        self._conditions: set[str] = set()
        self._inputs: list[str] = []

    def recording(self) -> AbstractContextManager[None]:
        """Make this the current trace of the thread."""
        return value_within(_current, self)

    def failure(self, reason: str) -> UntraceableError:
        """Return the error for a number that is lost."""
        self.has_failed = True
        return UntraceableError(reason)

    def input(self, value: float) -> TracedNumber:
        """Return a new input that has a value while operations are recorded."""
        self._inputs.append(f"x{len(self._inputs)}")
        return TracedNumber(self, self._inputs[-1], value)

    def result(self, text: str, value: Any) -> TracedNumber:
        """Return the value of an operation, given by its Python text."""
        if (known := self._known.get(text)) is None:
            name = f"v{len(self._known)}"
            self._lines.append(f" {name} = {text}")
            self._known[text] = known = TracedNumber(self, name, float(value))
        return known

    def parts(self, text: str, values: Sequence[float]) -> list[TracedNumber]:
        """Return the values of an operation whose result is an array, given by its Python text."""
        if (known := self._known.get(text)) is None:
            self._known[text] = known = TracedNumber(self, f"v{len(self._known)}", math.nan)
            self._lines.append(f" {known.traced_name} = {text}")
        return [self.result(f"{known.traced_name}[{index}]", value) for index, value in enumerate(values)]

    def combine(self, symbol: str, compute: Callable[[Any, Any], Any], a: Any, b: Any) -> Any:
        """Return the result of an operator."""
        if not (isinstance(a, int | float) and isinstance(b, int | float)):
            return NotImplemented
        text = f"_power({_text(a)}, {_text(b)})" if symbol == "**" else f"{_text(a)} {symbol} {_text(b)}"
        return self.result(text, compute(plain(a), plain(b)))

    def compare(self, symbol: str, compute: Callable[[Any, Any], Any], a: Any, b: Any) -> Any:
        """Return the outcome of a comparison."""
        if not (isinstance(a, int | float) and isinstance(b, int | float)):
            return NotImplemented
        return self.condition(f"({_text(a)} {symbol} {_text(b)})", bool(compute(plain(a), plain(b))))

    def apply(self, ufunc: Any, operands: Sequence[Any]) -> Any:
        """Return the result of an elementary function, or of an operator of NumPy."""
        symbol = _SYMBOLS.get(ufunc, "")
        if symbol in _OPERATORS:
            return self.combine(symbol, _OPERATORS[symbol], *operands)
        if symbol in _COMPARISONS:
            return self.compare(symbol, _COMPARISONS[symbol], *operands)
        if ufunc not in _UFUNCS:  # other functions of NumPy have other bits than those of `elementary`
            raise self.failure(f"{ufunc.__name__} is not recorded")
        name, function = _UFUNCS[ufunc]
        return self.result(f"{name}({', '.join(map(_text, operands))})", function(*map(plain, operands)))

    def condition(self, text: str, holds: bool) -> bool:
        """Record the outcome of a comparison, and return it."""
        required = text if holds else f"not {text}"
        if required not in self._conditions:
            self._conditions.add(required)
            self._lines.append(f"{_IF_NOT}{required}{_RETURN}")
        return holds

    def formulas(self, results: Iterable[Any]) -> Formulas:
        """Return the results as a function of the inputs, which returns None if a condition does not hold.

        Results must be finite, and remain zero or not zero.
        """
        if self.has_failed:
            raise UntraceableError("a traced number was lost")
        results = tuple(results)
        names, count = tuple(map(_text, results)), len(self._lines)
        for number in results:
            if isinstance(number, TracedNumber):
                self.condition(f"({number.traced_name} != 0.0)", number.traced_value != 0.0)
        sizes = ", ".join([*(f"abs({name})" for name in dict.fromkeys(names)), ""])
        kept = (*self._lines[count:], f"{_IF_NOT}(sum(({sizes})) < inf){_RETURN}")
        return Formulas(tuple(self._inputs), tuple(self._lines[:count]), kept, names)


def _text(operand: Any) -> str:
    if isinstance(operand, tuple | list):
        return f"({', '.join([*map(_text, operand), ''])})"
    if isinstance(operand, TracedNumber):
        return operand.traced_name
    value = operand if type(operand) is int else float(operand)
    return f"({value!r})" if value < 0 or math.copysign(1.0, value) < 0 or not math.isfinite(value) else repr(value)


class TracedText(str):
    """An expression with names in place of traced numbers; `traced_value` has their values."""

    __slots__ = ("traced_value",)
    traced_value: str


def text_with(substitute: Callable[[Callable[[float], str]], str]) -> str:
    """Return an expression that `substitute` makes, given a function that returns the text of a number in it.

    If the current trace keeps texts, these are the names of traced numbers.
    """
    if (trace := _current.get()) is None or not trace.keeps_texts:
        return substitute(repr)

    def text(number: Any) -> str:
        if not isinstance(number, TracedNumber):
            return repr(number)
        name = f"traced_{trace.serial}_{number.traced_name}"  # programs of texts are cached
        trace.named[name] = number
        return name

    result = TracedText(substitute(text))
    result.traced_value = substitute(lambda number: repr(plain(number)))
    return result if result != result.traced_value else result.traced_value


def named_number(name: str) -> float | None:
    """Return the traced number that has this name in texts; None if there is none."""
    trace = _current.get()
    return None if trace is None else trace.named.get(name)  # type: ignore[return-value]


def _power(base: float, exponent: float) -> float:
    value: float | complex = base**exponent
    if isinstance(value, complex):
        raise ValueError(f"{base} ** {exponent} is not real")
    return value


def _binary(symbol: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    compute = _OPERATORS[symbol]

    def forward(self: TracedNumber, other: Any) -> Any:
        return self.traced_by.combine(symbol, compute, self, other)

    def backward(self: TracedNumber, other: Any) -> Any:
        return self.traced_by.combine(symbol, compute, other, self)

    return forward, backward


def _comparison(symbol: str) -> Callable[[Any, Any], Any]:
    compute = _COMPARISONS[symbol]

    def compare(self: TracedNumber, other: Any) -> Any:
        return self.traced_by.compare(symbol, compute, self, other)

    return compare


def _lost(what: str) -> Callable[..., Any]:
    def lose(self: TracedNumber, *_: object) -> Any:
        """Raise UntraceableError."""
        raise self.traced_by.failure(f"a traced number is converted to {what}")

    return lose


_OPERATORS: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "**": _power,
    "//": operator.floordiv, "%": operator.mod,
}  # fmt: skip
_COMPARISONS: Mapping[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq, "!=": operator.ne,
}  # fmt: skip


class TracedNumber:
    """A number of a `Trace`; `isinstance` takes it for a float.

    `traced_name`: its name in the recorded formulas. `traced_value`: its value while they are recorded. Other code may
    ask any object for its `name` or `value`, as for those of enumerations.
    """

    __slots__ = ("traced_by", "traced_name", "traced_value")

    def __init__(self, trace: Trace, name: str, value: float):
        self.traced_by, self.traced_name, self.traced_value = trace, name, value

    @property  # type: ignore[misc]
    def __class__(self) -> Any:
        return float

    __add__, __radd__ = _binary("+")
    __sub__, __rsub__ = _binary("-")
    __mul__, __rmul__ = _binary("*")
    __truediv__, __rtruediv__ = _binary("/")
    __pow__, __rpow__ = _binary("**")
    __floordiv__, __rfloordiv__ = _binary("//")
    __mod__, __rmod__ = _binary("%")
    __lt__, __le__, __gt__, __ge__ = (_comparison(symbol) for symbol in ("<", "<=", ">", ">="))
    __eq__, __ne__ = (_comparison(symbol) for symbol in ("==", "!="))
    __repr__, __str__, __format__, __reduce__, __reduce_ex__ = (_lost("text") for _ in range(5))
    __hash__ = _lost("a hash")

    def __bool__(self) -> bool:
        return self.traced_by.condition(f"({self.traced_name} != 0.0)", self.traced_value != 0.0)

    def __neg__(self) -> TracedNumber:
        return self.traced_by.result(f"-{self.traced_name}", -self.traced_value)

    def __pos__(self) -> TracedNumber:
        return self

    def __abs__(self) -> TracedNumber:
        return self.traced_by.result(f"abs({self.traced_name})", abs(self.traced_value))

    def is_integer(self) -> bool:
        """Return whether the number is an integer."""
        return self.traced_by.condition(f"{self.traced_name}.is_integer()", self.traced_value.is_integer())

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **options: Any) -> Any:
        if method == "__call__" and not options and all(np.ndim(plain(operand)) == 0 for operand in operands):
            return self.traced_by.apply(ufunc, operands)
        raise self.traced_by.failure(f"{ufunc.__name__} is not recorded")

    def __elementary__(self, function: Any, operands: Sequence[Any]) -> Any:
        if all(np.ndim(plain(operand)) == 0 for operand in operands):
            return self.traced_by.result(
                f"{function.name}({', '.join(map(_text, operands))})", function(*plain(operands))
            )
        raise self.traced_by.failure(f"{function.name} of arrays is not recorded")


# Whatever else floats have, as conversions to arrays and pickles use, would take the number out.
for _name in (
    {*dir(float), "__array__", "__array_interface__", "__array_struct__"} - {*dir(object)} - {*vars(TracedNumber)}
):
    setattr(TracedNumber, _name, property(_lost(f"what `{_name}` gives")))


def plain(value: Any) -> Any:
    """Return plain data, or a number, with values in place of traced numbers."""
    if isinstance(value, TracedNumber | TracedText):
        return value.traced_value
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [*map(plain, value)] if isinstance(value, list) else tuple(map(plain, value))
    return value


def is_recording() -> bool:
    """Return whether there is a current trace."""
    return _current.get() is not None


def is_traced(value: object) -> bool:
    """Return whether plain data, or a number, contains traced numbers."""
    if isinstance(value, list | tuple | Mapping):
        return any(map(is_traced, value.values() if isinstance(value, Mapping) else value))
    return isinstance(value, TracedNumber | TracedText)


def as_float(value: Any) -> Any:
    """Return a number as a float, and a traced number unchanged."""
    return value if isinstance(value, TracedNumber) else float(value)


def float_array(values: Any, columns: int | None = None) -> np.ndarray:
    """Return (nested) sequences of numbers as an array, with this number of columns if it is given.

    Traced numbers are noted in their `Trace` with their indices in the flat array.
    """
    trace = _current.get()
    array = np.array(values if trace is None else plain(values), dtype=float)
    array = array if columns is None else array.reshape(-1, columns)
    if trace is not None:
        traced = {index: number for index, number in enumerate(_flat(values)) if isinstance(number, TracedNumber)}
        trace.arrays[id(array)] = array, traced
    return array


def _flat(values: Any) -> Iterator[Any]:
    for value in values:
        if isinstance(value, list | tuple):
            yield from _flat(value)
        else:
            yield value


_UFUNCS: Mapping[Any, tuple[str, Callable[..., Any]]] = {np.sqrt: ("_sqrt", math.sqrt), np.absolute: ("abs", abs)}
_SYMBOLS = {
    np.add: "+", np.subtract: "-", np.multiply: "*", np.divide: "/", np.less: "<", np.less_equal: "<=",
    np.greater: ">", np.greater_equal: ">=", np.equal: "==", np.not_equal: "!=",
}  # fmt: skip


def recordable(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of `_FUNCTIONS` that is recorded if it is called with traced numbers; others unchanged."""
    return _RECORDABLE.get(function, function)


def _recordable(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def call(*operands: Any, **options: Any) -> Any:
        if (trace := _current.get()) is None or not is_traced(operands):
            return function(*operands, **options)
        text, value = f"{name}({', '.join(map(_text, operands))})", function(*plain(operands))
        return trace.parts(text, value) if isinstance(value, list) else trace.result(text, value)

    return call


def _second(values: Sequence[float]) -> float:
    """Return the second largest of the values."""
    return sorted(values)[-2]


def _cubic_pieces(arguments: Sequence[float], values: Any) -> Any:
    """Return five numbers for each piece of a cubic spline, which are linear in the values (N,), as a list.

    They are the coefficients in ascending powers of the distance from the beginning of the piece, and the integral up
    to there. The ends are not-a-knot; three points have a parabola, two points a straight line. For values (N, K) of
    several splines, the result is an array (..., K).
    """
    from scipy.interpolate import CubicSpline

    # the influence of a point fades along the spline, down to zero
    with np.errstate(all="raise", under="raise" if np.ndim(values) == 1 else "ignore"):
        coefficients = np.moveaxis(CubicSpline(np.array(arguments), np.array(values)).c[::-1], 0, -1)
        h = np.diff(np.array(arguments)).reshape(-1, *[1] * (coefficients.ndim - 1))
        areas = np.sum(coefficients * elementary.pow(h, np.arange(1, 5)) / np.arange(1, 5), axis=-1)
    stored = np.concatenate([0.0 * areas[:1], np.cumsum(areas, axis=0)[:-1]])
    pieces = np.moveaxis(np.concatenate([coefficients, stored[..., None]], axis=-1), -1, 1)
    flat = pieces.reshape(-1, *pieces.shape[2:])
    return flat if flat.ndim > 1 else flat.tolist()


_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "_cubic_pieces": _cubic_pieces, "_dist": math.dist, "_hypot": math.hypot, "_sqrt": math.sqrt, "_max": max,
    "_min": min,
    "_power": _power, "_second": _second,
}  # fmt: skip
_RECORDABLE = {function: _recordable(name, function) for name, function in _FUNCTIONS.items()}
cubic_pieces, dist, hypot, sqrt, largest, smallest, _, second_largest = _RECORDABLE.values()
