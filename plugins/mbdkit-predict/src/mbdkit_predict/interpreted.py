"""Kernels executed by Python with symbols, so that their definitions are not written a second time.

The source of kernels has no branches on numbers, because it is also compiled for lanes (several runs at once), with two
exceptions: tables of motions, and laws that are called by address. These are executed once for each branch
(`mbdkit_predict.symbols.every_branch`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.force_laws import CompiledLaw
from mbdkit.engine.kernels import angles, equations, law_programs, motions
from mbdkit.engine.kernels.law_programs import OPCODES
from mbdkit.engine.native import arithmetic, calls
from mbdkit.engine.native.functions import LAWS
from mbdkit.engine.native.kernel import Entry, Kernel, LawFunction
from mbdkit.expressions import operations
from mbdkit.mechanism.force_law import FunctionLaw
from mbdkit_contact.kernels import contact_laws
from mbdkit_predict.symbols import BranchError, Symbol, apply, every_branch, largest, smallest, where


class _OneRow(int):
    """The number of rows of a contact, of which only one is evaluated."""

    row: int


def _number(x: Any) -> Any:
    return x if isinstance(x, Symbol) else float(x)


def _range(*limits: int) -> Any:
    last = limits[-1]
    return (last.row,) if isinstance(last, _OneRow) else range(*limits)


def _cosine_and_sine(x: Any) -> tuple[Any, Any]:
    return apply(np.cos, x), apply(np.sin, x)


def _cosines_and_sines(q: np.ndarray, cs: np.ndarray) -> None:
    for b in range(len(cs) - 1):
        cs[b, 0], cs[b, 1] = _cosine_and_sine(q[3 * b + 2])


def _numbers_at(address: Any, first: int, count: int, like: Any) -> Any:
    """Return numbers of an array, which stands for its address, or those at an address."""
    if isinstance(address, np.ndarray):
        return address[first : first + count]
    return calls.numbers_at(int(address), first, int(count), 0.0).tolist()


_BUILTINS = {"min": smallest, "max": largest, "float": _number, "range": _range}
_REPLACED: Mapping[Any, Callable[..., Any]] = {
    arithmetic.where: where,
    arithmetic.any_of: lambda condition: isinstance(condition, Symbol) or bool(condition),
    arithmetic.is_refused: lambda sound: False,
    arithmetic.renewed: lambda new, old, condition: where(condition, new, old),
    calls.numbers_at: _numbers_at,
    calls.new_registers: lambda count, like: np.full(count, 0.0, dtype=object),
    operations.where: where,
    angles.cosine_and_sine: _cosine_and_sine,
    angles.cosines_and_sines: _cosines_and_sines,
    equations.load_equations: lambda equations: equations,
}
"""Functions that compiled code replaces as well, or that need a form for symbols."""


def _of_math(name: str) -> Any:
    """Return a function of `math` for numbers and symbols; a constant as it is."""
    other = {"atan2": "arctan2", "fabs": "absolute"}.get(name) or (
        name.replace("a", "arc", 1) if name[:4] in ("acos", "asin", "atan") else name
    )
    function = getattr(np, other, None)
    return (lambda *operands: apply(function, *operands)) if isinstance(function, np.ufunc) else getattr(math, name)


_MATH = SimpleNamespace(**{name: _of_math(name) for name in vars(math) if not name.startswith("_")})


class Interpreter:
    """Executes kernels with symbols.

    Parameters
    ----------
    laws
        Names and compiled laws of the elements of a mechanism.

    Attributes
    ----------
    known_forces
        Forces that are given, by address and program of the law, and index of its parameters; these laws are not
        evaluated.
    """

    def __init__(self, laws: tuple[tuple[str, CompiledLaw], ...]):
        self._names = {(law.address, law.program): name for name, law in laws}
        self._functions: dict[int, Any] = {}
        for _, compiled in laws:
            if isinstance(compiled.law, FunctionLaw):
                self._functions[compiled.address] = compiled.law.function
        self._functions |= {law.address: law for law in LAWS.values()}
        self._head: list[int] = []
        self.known_forces: dict[tuple[int, int, int], Symbol] = {}
        self._known: dict[Any, Any] = {
            **_REPLACED, calls.call_law: self.call_law, calls.integers_at: self._integers_at
        }  # fmt: skip
        execute, is_true = self(law_programs._execute), self(law_programs._is_true)

        def instruction(op: int, a: int, b: int, c: int, to: int, x: np.ndarray) -> None:
            """Execute an instruction; the results of comparisons are numbers, so that nothing branches on them."""
            if OPCODES["less"] <= op <= OPCODES["not"]:
                x[to] = where(is_true(op, x[a], x[b]), 1.0, 0.0)
            else:
                execute(op, a, b, c, to, x)

        self._known[law_programs._execute] = instruction
        polynomial = self(motions._piecewise_polynomial)
        self._known[motions._piecewise_polynomial] = lambda *given: every_branch(lambda: polynomial(*given))

    def __call__(self, function: Any) -> Any:
        """Return a function, kernel or law that is executed with symbols, as are all functions of mbdkit it calls."""
        if isinstance(function, Kernel | LawFunction | Entry):
            return self(function.function)
        if function in self._known:
            return self._known[function]
        names = dict[str, Any](_BUILTINS)
        cells = function.__closure__ and tuple(CellType() for _ in function.__closure__)
        translated = FunctionType(function.__code__, names, function.__name__, function.__defaults__, cells)
        self._known[function] = translated
        used = {name: function.__globals__[name] for name in _names_in(function.__code__) & function.__globals__.keys()}
        names |= {name: self._replaced(value) for name, value in used.items()}
        for cell, given in zip(cells or (), function.__closure__ or (), strict=True):
            cell.cell_contents = self._replaced(given.cell_contents)
        return translated

    def _replaced(self, value: Any) -> Any:
        if value is math:
            return _MATH
        if isinstance(value, BuiltinFunctionType) and value.__module__ == "math":
            return getattr(_MATH, value.__name__)
        if isinstance(value, FunctionType | Kernel | LawFunction | Entry) or value is equations.load_equations:
            return self(value)
        return value

    def call_law(
        self, address: int, program: int, length: Any, rate: Any, time: Any, parameters: np.ndarray, begin: int,
        out: np.ndarray, row: int, count: int,
    ) -> None:  # fmt: skip
        """Evaluate a law; see `mbdkit.engine.native.calls.call_law`."""
        if (force := self.known_forces.get((int(address), int(program), begin))) is not None:
            out[row] = [force, 0.0, 0.0, 0.0]
            return
        law = self._functions.get(int(address))
        name = self._names.get((int(address), int(program)), "")
        given = parameters[begin:]
        try:
            if law is contact_laws.contact:
                self._call_contact(int(program), given, out[row:])
            elif isinstance(law, LawFunction):
                run = self(law)

                def results() -> Any:
                    values = np.full(count, 0.0, dtype=object)
                    run(int(program), length, rate, time, given, values)
                    return values

                out[row] = every_branch(results)
            else:
                function, numbers = self(law), given[1 : 1 + int(given[0])]
                out[row] = every_branch(lambda: function(length, rate, time, numbers))
        except BranchError as error:
            raise SpecError(f"{name} cannot be exported: {error}") from None

    def _integers_at(self, address: int, count: int) -> Any:
        """Return the integers at an address; those of the contact that is evaluated, with the row that is wanted."""
        return self._head or calls.integers_at(int(address), int(count))

    def _call_contact(self, program: int, given: np.ndarray, out: np.ndarray) -> None:
        """Evaluate the contact of two shapes row by row, so that the numbers of their branches are not multiplied."""
        head = calls.integers_at(program, contact_laws.ROWS + 1).tolist()
        size = contact_laws.VALUE * head[-1] if head[contact_laws.MODE] == contact_laws.VALUES else 6
        run = self(contact_laws.contact)

        def results() -> Any:
            values = np.full(size, 0.0, dtype=object)
            run(program, 0.0, 0.0, 0.0, given, values)
            return values

        total = [0.0] * size
        for row in range(head[-1]):
            self._head = [*head[:-1], _OneRow(head[-1])]
            self._head[-1].row = row  # type: ignore[attr-defined]
            try:
                total = [x + y for x, y in zip(total, every_branch(results), strict=True)]
            finally:
                self._head = []
        out.reshape(-1)[:size] = total


def _names_in(code: CodeType) -> set[str]:
    """Return the names that a function and the functions in it use."""
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*map(_names_in, inner))
