"""Functions of several inputs that are recorded: Python functions called once, with numbers that record operations.

A `Recorder` keeps all terms of a function as a graph in which equal terms occur once. Derivatives of any order are
further terms of this graph (`mbdkit.expressions.recorded_derivatives`), which `mbdkit.engine.function_program`
assembles to a program for kernels. Simplifications do not change the value of a term where it is finite, and the
order of operations is that of the function, because it determines rounding errors.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from mbdkit.base import elementary
from mbdkit.base.errors import PluginError

#: Operations that can be recorded, by functions of NumPy; `numpy.where` is the operation ``select``.
UFUNCS: Mapping[Any, str] = {
    np.add: "add", np.subtract: "subtract", np.multiply: "multiply", np.divide: "divide", np.power: "power",
    np.remainder: "remainder", np.negative: "negate", np.absolute: "abs", np.sqrt: "sqrt", np.exp: "exp",
    np.log: "log", np.sin: "sin", np.cos: "cos", np.tan: "tan", np.arcsin: "asin", np.arccos: "acos",
    np.arctan: "atan", np.sinh: "sinh", np.cosh: "cosh", np.tanh: "tanh", np.arctan2: "atan2", np.hypot: "hypot",
    np.floor: "floor", np.ceil: "ceil", np.minimum: "minimum", np.maximum: "maximum", np.less: "less",
    np.less_equal: "less_equal", np.greater: "greater", np.greater_equal: "greater_equal", np.equal: "equal",
    np.not_equal: "not_equal",
}  # fmt: skip

#: Functions that evaluate operations on constants.
_OF_NUMBERS: Mapping[str, Callable[..., Any]] = {name: function for function, name in UFUNCS.items()} | {
    UFUNCS[own.ufunc]: own for own in elementary.FUNCTIONS.values() if own.ufunc in UFUNCS
}
_COMMUTATIVE = ("add", "multiply")
_LARGEST_EXPONENT = 1 << 30  #: Larger integer exponents are ordinary numbers.


class Term(NamedTuple):
    """A term of a graph: its operation, and the indices of its operands, which are smaller than its own index.

    ``data`` is the number of a ``constant``, the name of an ``input``, the exponent of ``power_of_integer``, or the
    index and the order of derivative of a ``table``. Sorted by ``place`` and index, terms stand close to those whose
    derivatives they belong to, so that programs need few registers.
    """

    operation: str
    operands: tuple[int, ...]
    data: Any
    place: int


class Recorder:
    """Records functions as a graph of terms.

    Attributes
    ----------
    terms
        All terms; operands come before the terms that contain them.
    tables
        The numbers of each table: those of pieces and of terms of a piece, the period, the knots, the coefficients.
    slopes
        Derivatives with respect to an input that are known: indices of terms, by index of the input and of the term.
    place
        Place of further terms, while the derivative of a term is recorded; otherwise None.
    """

    def __init__(self) -> None:
        self.terms: list[Term] = []
        self.tables: list[tuple[float, ...]] = []
        self.slopes: dict[int, dict[int, int]] = {}
        self.place: int | None = None
        self._known: dict[tuple[Any, ...], int] = {}
        self._replaced: dict[tuple[int, int], dict[int, int]] = {}

    def input(self, name: str) -> Recorded:
        """Return the input with a name."""
        return self._term("input", (), name)

    def constant(self, number: Recorded | float) -> Recorded:
        """Return a number as a constant; a number that is recorded already is returned unchanged."""
        if isinstance(number, Recorded):
            return number
        return self._term("constant", (), float(number), key=float(number).hex())  # 0.0 and -0.0 differ

    def table(self, knots: Any, coefficients: Any, at: Recorded, period: float = 0.0) -> Recorded:
        """Return the value of a piecewise polynomial.

        Parameters
        ----------
        knots
            (n + 1,) increasing numbers where the pieces begin and end; the first and the last piece extrapolate.
        coefficients
            (n, m) coefficients of each piece in ascending powers of the distance from its beginning.
        at
            Argument of the polynomial.
        period
            Period with which the polynomial repeats; 0 if it does not.
        """
        knots, coefficients = np.asarray(knots, dtype=float), np.asarray(coefficients, dtype=float)
        pieces, terms = coefficients.shape
        if knots.shape != (pieces + 1,):
            raise PluginError(f"a table of {pieces} pieces needs {pieces + 1} knots, not an array of {knots.shape}")
        numbers = (float(pieces), float(terms), float(period), *knots.tolist(), *coefficients.ravel().tolist())
        if numbers not in self.tables:
            self.tables.append(numbers)
        return self._term("table", (at.index,), (self.tables.index(numbers), 0))

    def apply(self, operation: str, operands: Sequence[Recorded | float], data: Any = None) -> Recorded:
        """Return the value of an operation, simplified where this does not change it."""
        given = [self.constant(operand) for operand in operands]
        if any(one.recorder is not self for one in given):
            raise PluginError("a function combines numbers of two recordings")
        numbers = [one.number for one in given]
        exponent = numbers[-1]
        if operation == "power" and exponent is not None:
            if exponent == 0.5:
                return self.apply("sqrt", given[:1])
            if exponent.is_integer() and abs(exponent) < _LARGEST_EXPONENT:
                return self.apply("power_of_integer", given[:1], int(exponent))
        if (same := _without_effect(operation, given, numbers, data)) is not None:
            return self.constant(same)
        if operation == "power_of_integer" and numbers[0] is not None:
            return self.constant(elementary.pow(numbers[0], data))
        if operation in _OF_NUMBERS and None not in numbers:
            with np.errstate(all="ignore"):
                return self.constant(float(_OF_NUMBERS[operation](*numbers)))
        return self._term(operation, tuple(one.index for one in given), data)

    def _term(self, operation: str, operands: tuple[int, ...], data: Any, key: Any = None) -> Recorded:
        known = (operation, tuple(sorted(operands)) if operation in _COMMUTATIVE else operands, key or data)
        if known not in self._known:
            places = [self.terms[operand].place for operand in operands]
            own = len(self.terms) if self.place is None else self.place
            self._known[known] = len(self.terms)
            self.terms.append(Term(operation, operands, data, max(own, *places) if places else 0))
        return Recorded(self, self._known[known])

    def ancestors(
        self,
        results: Sequence[Recorded],
        known: Collection[int] = (),
        operands: Callable[[Term], tuple[int, ...]] = lambda term: term.operands,
    ) -> list[int]:
        """Return the indices of all terms on which results depend, in their order.

        The search ends at `known` terms, which are not included; `operands` returns those operands of a term that it
        follows.
        """
        needed: set[int] = set()
        pending = [result.index for result in results]
        while pending:
            index = pending.pop()
            if index not in needed and index not in known:
                needed.add(index)
                pending += operands(self.terms[index])
        return sorted(needed)

    def replaced(self, of: Recorded, old: Recorded, new: Recorded) -> Recorded:
        """Return a number with an input replaced by another number; the unknown of a root is no input of this root."""
        memo = self._replaced.setdefault((old.index, new.index), {old.index: new.index})
        for index in self.ancestors([of], memo):
            term = self.terms[index]
            operands = tuple(memo[operand] for operand in term.operands)
            if operands == term.operands or (term.operation == "root" and term.operands[-1] == old.index):
                memo[index] = index
            else:
                memo[index] = self.apply(term.operation, [Recorded(self, one) for one in operands], term.data).index
        return Recorded(self, memo[of.index])


def _without_effect(
    operation: str, given: Sequence[Recorded], numbers: Sequence[float | None], data: Any
) -> Recorded | float | None:
    """Return the simplified result of a sum with 0, a product or quotient with 0 or 1, a power with exponent 0 or 1,
    a double negation, or a choice that is known or between equals.

    None if the operation is none of these.
    """
    first, second = numbers[0], numbers[1] if len(numbers) > 1 else None
    match operation:
        case "select":
            if first is not None:
                return given[1] if first else given[2]
            return given[1] if given[1].index == given[2].index else None
        case "multiply":
            if 0.0 in (first, second):
                return 0.0
            return given[1] if first == 1.0 else given[0] if second == 1.0 else None
        case "add":
            return given[1] if first == 0.0 else given[0] if second == 0.0 else None
        case "subtract":
            return given[0] if second == 0.0 else None
        case "divide":
            return 0.0 if first == 0.0 else given[0] if second == 1.0 else None
        case "power_of_integer":
            return 1.0 if data == 0 else given[0] if data == 1 else None
        case "negate" if given[0].term.operation == "negate":
            return Recorded(given[0].recorder, given[0].term.operands[0])
        case "detached":
            return given[0] if given[0].term.operation in ("constant", "detached") else None
    return None


class Recorded(NDArrayOperatorsMixin):
    """A number that records the operations applied to it.

    It supports operators, comparisons, functions of NumPy and of `mbdkit.base.elementary`, and `numpy.where`.
    """

    __slots__ = ("index", "recorder")

    def __init__(self, recorder: Recorder, index: int):
        self.recorder, self.index = recorder, index

    def __repr__(self) -> str:
        term = self.term
        return f"Recorded({self.index}: {term.operation} {term.operands}{'' if term.data is None else f' {term.data}'})"

    @property
    def term(self) -> Term:
        """The term of the graph."""
        return self.recorder.terms[self.index]

    @property
    def number(self) -> float | None:
        """The value of a constant; None for other numbers."""
        return self.term.data if self.term.operation == "constant" else None

    @property
    def plain(self) -> Recorded:
        """The same number as a constant for derivatives, for comparisons and the first steps of an iteration."""
        return self.recorder.apply("detached", [self])

    def __bool__(self) -> bool:
        raise PluginError("a function that is recorded cannot branch on its arguments: use numpy.where")

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **_: Any) -> Any:
        if ufunc is np.arcsinh:  # dual numbers do not support it
            (x,) = operands
            return np.log(x + np.sqrt(x * x + 1.0))
        if method != "__call__" or ufunc not in UFUNCS:
            raise PluginError(f"'{ufunc.__name__}' is not one of the functions that can be recorded")
        return self.recorder.apply(UFUNCS[ufunc], operands)

    def __array_function__(self, function: Any, types: Any, operands: Any, options: Any) -> Any:
        if function is not np.where:
            raise PluginError(f"'{function.__name__}' is not one of the functions that can be recorded")
        return self.recorder.apply("select", operands)
