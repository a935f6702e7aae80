"""Kernels executed by Python with numbers of another kind, such as expressions of a library for optimal control.

The source of kernels has no branches on numbers, because it is also compiled for lanes (several runs at once), with two
exceptions: tables of motions, and laws that are called by address. These are executed once for each branch
(`Arithmetic.every_branch`), except in modules that search, such as the law of contacts among edges: their branches are
merged (`Arithmetic.merged`).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from functools import partial, reduce
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.engine.force_laws import CompiledLaw
from mbdkit.engine.kernels import angles, equations, law_programs, motions
from mbdkit.engine.kernels.law_programs import OPCODES
from mbdkit.engine.native import arithmetic, calls
from mbdkit.engine.native.functions import DECLARED
from mbdkit.engine.native.kernel import Entry, Kernel, LawFunction
from mbdkit.expressions import operations
from mbdkit.mechanism.force_law import FunctionLaw


@dataclass(frozen=True)
class Arithmetic:
    """What numbers of another kind need in addition to operators."""

    kind: type  #: Class of the numbers.
    error: type[Exception]  #: Raised where Python code cannot be executed with such numbers.
    where: Callable[[Any, Any, Any], Any]  #: Returns the second operand where the first, a condition, holds.
    apply: Callable[..., Any]  #: Returns the value of a function of NumPy, the first argument, at the others.
    #: Returns the results of a function that branches on conditions, executed once for each outcome.
    every_branch: Callable[[Callable[[], Sequence[Any]]], list[Any]]
    merged: Callable[[FunctionType], FunctionType]  #: Returns a function whose branches are selections.
    vector: type[np.ndarray]  #: Arrays in functions of this kind, whose indices may depend on conditions.


def _numbers_at(address: Any, first: int, count: int, like: Any) -> Any:
    """Return numbers of an array, which stands for its address, or those at an address."""
    if isinstance(address, np.ndarray):
        return address[first : first + count]
    return calls.numbers_at(int(address), first, int(count), 0.0).tolist()


def _replacements(numbers: Arithmetic) -> dict[Any, Callable[..., Any]]:
    """Return functions that compiled code replaces as well, or that need another form for these numbers."""

    def cosine_and_sine(x: Any) -> tuple[Any, Any]:
        return numbers.apply(np.cos, x), numbers.apply(np.sin, x)

    return {
        arithmetic.where: numbers.where,
        arithmetic.any_of: lambda condition: isinstance(condition, numbers.kind) or bool(condition),
        arithmetic.is_refused: lambda sound: False,
        arithmetic.renewed: lambda new, old, condition: numbers.where(condition, new, old),
        calls.integers_at: lambda address, count: calls.integers_at(int(address), int(count)).tolist(),
        calls.numbers_at: _numbers_at,
        calls.new_registers: lambda count, like: np.full(count, 0.0, dtype=object).view(numbers.vector),
        operations.where: numbers.where,
        angles.cosine_and_sine: cosine_and_sine,
        angles._near: cosine_and_sine,
        equations.load_equations: lambda equations: equations,
    }


def _builtins(numbers: Arithmetic) -> dict[str, Any]:
    def best(is_better: Callable[[Any, Any], Any], *values: object) -> Any:
        return reduce(lambda known, other: numbers.where(is_better(other, known), other, known), values)

    return {
        "min": partial(best, operator.lt),
        "max": partial(best, operator.gt),
        "float": lambda x: x if isinstance(x, numbers.kind) else float(x),
    }


def _math(numbers: Arithmetic) -> SimpleNamespace:
    """Return the functions of `math` for numbers of all kinds, and its constants as they are."""

    def value(name: str) -> Any:
        function = getattr(np, "absolute" if name == "fabs" else name, None)
        return partial(numbers.apply, function) if isinstance(function, np.ufunc) else getattr(math, name)

    return SimpleNamespace(**{name: value(name) for name in vars(math) if not name.startswith("_")})


class Interpreter:
    """Executes kernels with numbers of another kind.

    Parameters
    ----------
    laws
        Force laws by name.
    searching
        Modules whose functions search, so that their branches are merged.

    Attributes
    ----------
    known : dict
        Functions that are executed in another form, with this form.
    known_forces : dict
        Forces that are given, by address and program of the law, and index of its parameters; these laws are not
        evaluated.
    """

    def __init__(
        self, numbers: Arithmetic, laws: tuple[tuple[str, CompiledLaw], ...] = (), searching: Sequence[str] = ()
    ):
        self._numbers, self._math, self._builtins = numbers, _math(numbers), _builtins(numbers)
        self._names = {(law.address, law.program): name for name, law in laws}
        self._functions: dict[int, Any] = {law.address: law for law in DECLARED.laws.values()}
        self._functions |= {law.address: law.law.function for _, law in laws if isinstance(law.law, FunctionLaw)}
        self.known_forces: dict[tuple[int, int, int], Any] = {}
        self.known: dict[Any, Any] = {**_replacements(numbers), calls.call_law: self.call_law}
        self._searching = frozenset(searching)
        execute, is_true = self(law_programs._execute), self(law_programs._is_true)

        def instruction(op: int, a: int, b: int, c: int, to: int, x: np.ndarray) -> None:
            """Execute an instruction; the results of comparisons are numbers, so that nothing branches on them."""
            if OPCODES["less"] <= op <= OPCODES["not"]:
                x[to] = numbers.where(is_true(op, x[a], x[b]), 1.0, 0.0)
            else:
                execute(op, a, b, c, to, x)

        self.known[law_programs._execute] = instruction
        polynomial, table = self(motions._piecewise_polynomial), self(law_programs._piecewise_polynomial)
        self.known[motions._piecewise_polynomial] = lambda *given: numbers.every_branch(lambda: polynomial(*given))
        self.known[law_programs._piecewise_polynomial] = lambda *given: numbers.every_branch(lambda: [table(*given)])[0]

    def __call__(self, function: Any) -> Any:
        """Return a function, kernel or law that is executed with these numbers, as are all functions it calls."""
        if isinstance(function, Kernel | LawFunction | Entry):
            return self(function.function)
        if function in self.known:
            return self.known[function]
        original, names = function, dict(self._builtins)
        if function.__module__ in self._searching:
            function = self._numbers.merged(function)
        cells = function.__closure__ and tuple(CellType() for _ in function.__closure__)
        translated = FunctionType(function.__code__, names, function.__name__, function.__defaults__, cells)
        self.known[original] = translated
        used = {name: function.__globals__[name] for name in _names_in(function.__code__) & function.__globals__.keys()}
        names |= {name: self._replaced(value) for name, value in used.items()}
        for cell, given in zip(cells or (), function.__closure__ or (), strict=True):
            cell.cell_contents = self._replaced(given.cell_contents)
        return translated

    def _replaced(self, value: Any) -> Any:
        if value is math:
            return self._math
        if isinstance(value, BuiltinFunctionType) and value.__module__ == "math":
            return getattr(self._math, value.__name__)
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
        law, vector, every_branch = self._functions.get(int(address)), self._numbers.vector, self._numbers.every_branch
        name = self._names.get((int(address), int(program)), "")
        given = parameters[begin:]
        try:
            if isinstance(law, LawFunction) and law.function.__module__ in self._searching:
                self(law)(int(program), length, rate, time, given.view(vector), out[row:].reshape(-1).view(vector))
            elif isinstance(law, LawFunction):
                run = self(law)
                if law is law_programs.run_function:  # it writes all its results, into several rows
                    count = int(calls.integers_at(int(program), law_programs.HEAD)[2])

                def results() -> Any:
                    values = np.full(count, 0.0, dtype=object)
                    run(int(program), length, rate, time, given, values)
                    return values

                out[row:].reshape(-1)[:count] = every_branch(results)
            else:
                function, numbers = self(law), given[1 : 1 + int(given[0])]
                out[row] = every_branch(lambda: function(length, rate, time, numbers))
        except self._numbers.error as error:
            raise SpecError(f"{name} cannot be exported: {error}") from None


def _names_in(code: CodeType) -> set[str]:
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*map(_names_in, inner))
