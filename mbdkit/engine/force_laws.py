"""Force laws for kernels, which call them by address.

A law that is a SymPy expression becomes a program (`mbdkit.engine.kernels.law_programs`): SymPy writes its source with
all derivatives, and the operations of this source become the instructions. The packaged laws have machine code of their
own (`mbdkit.engine.kernels.law_kernels`). Functions of plugins are compiled by Numba, once in every process.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar, cast

import numpy as np

from mbdkit.base.errors import PluginError
from mbdkit.base.text import one_line
from mbdkit.engine.kernels import law_kernels, law_programs
from mbdkit.engine.kernels.law_programs import HEAD, ONLY_OF_NUMBERS, OPCODES, REGISTERS, WORDS
from mbdkit.engine.native.calls import HAS_POTENTIAL, PASSIVE
from mbdkit.engine.native.kernel import LawFunction
from mbdkit.engine.native.machine_code import BUILDER, builder
from mbdkit.engine.traced_law import traced_source
from mbdkit.laws import exponential, gas_spring, linear, one_sided, tabulated
from mbdkit.mechanism.force_law import ARGUMENTS, ExpressionLaw, ForceLaw, LawState, TracedLaw
from mbdkit.mechanism.law_parameters import law_parameters

_STORED: Mapping[ForceLaw, LawFunction] = {
    exponential.LAW: law_kernels.exponential,
    gas_spring.LAW: law_kernels.gas_spring,
    linear.LAW: law_kernels.linear,
    one_sided.LAW: law_kernels.one_sided,
    tabulated.LAW: law_programs.table,
}
"""The packaged laws, which have their own machine code."""

_COMPILED: dict[tuple[ForceLaw | NativeLaw, tuple[str, ...]], CompiledLaw] = {}
"""Laws compiled by this process; keys are a law and the names of its parameters."""


@dataclass(frozen=True)
class CompiledLaw:
    """A force law that kernels can call.

    - `address`: address of the C function.
    - `program`: address that the function gets as first argument; 0 if it needs none.
    - `claims`: the properties `HAS_POTENTIAL` and `PASSIVE`, as bits.
    - `keeper`: object that keeps the program and the machine code in memory.
    - `law`, `parameters`: the law, and the names and example values of its parameters.
    """

    address: int
    program: int
    claims: int
    keeper: object = field(compare=False)
    law: ForceLaw | NativeLaw
    parameters: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class NativeLaw:
    """A law that consists of machine code and integers of its own, which the code finds at the address of its program.

    - `function`: the code, declared by `mbdkit.kernels.law_function`.
    - `program`: the integers.
    - `parameters`: function from an element to the numbers that the code finds behind their count, in this order;
      needed by the `force_law` of a kind of elements.
    - `potential`, `passive`: whether the fourth result is a potential, and whether all power that is not stored is
      dissipated, as in `FunctionLaw`.
    """

    function: LawFunction
    program: tuple[int, ...] = ()
    parameters: Callable[[Any], Sequence[float]] | None = None
    potential: bool = False
    passive: bool = False
    states: ClassVar[tuple[LawState, ...]] = ()
    valid_range: ClassVar[Mapping[str, tuple[float, float]]] = {}


@cache
def native_law(law: NativeLaw) -> CompiledLaw:
    """Return a native law that kernels can call."""
    address, program, keeper = _code_of(law, {}, duals=False)
    return CompiledLaw(address, program, 0, keeper, law, ())


@cache
def _integers(program: tuple[int, ...]) -> np.ndarray:
    return np.array(program, dtype=np.int64)


def bind_law(law: ForceLaw | NativeLaw, options: object, name: str) -> tuple[CompiledLaw, list[float]]:
    """Return a law that kernels can call, and the parameters of one element: first their number, then their values.

    `options`: instance of the law's options. `name`: name of the law in error messages. Raises PluginError if the law
    cannot be compiled, does not return derivatives, or fails to compute its parameters.
    """
    names, values = law_parameters(cast("ForceLaw", law), options, name)
    if (law, names) not in _COMPILED:
        _COMPILED[law, names] = _compile(law, dict(zip(names, values, strict=False)), name)
    return _COMPILED[law, names], [float(len(values)), *values]


def _compile(law: ForceLaw | NativeLaw, example: dict[str, float], name: str) -> CompiledLaw:
    claims = HAS_POTENTIAL * (law.potential not in (None, False)) | PASSIVE * law.passive
    try:
        address, program, keeper = _code_of(law, example, duals=False)
    except PluginError as error:
        raise PluginError(f"force law {name}: {error}") from error
    except Exception as error:
        raise PluginError(f"force law {name} cannot be compiled: {one_line(error)}") from error
    return CompiledLaw(address, program, claims, keeper, law, tuple(example.items()))


@cache
def law_for_duals(compiled_law: CompiledLaw, name: str) -> CompiledLaw:
    """Return a law for dual numbers; `name` is the name of the force element in error messages.

    Raises PluginError if the law cannot be compiled for dual numbers.
    """
    law, example = compiled_law.law, dict(compiled_law.parameters)
    try:
        address, program, keeper = _code_of(law, example, duals=True)
    except Exception as error:
        raise PluginError(
            f"the law of force {name} cannot be differentiated with respect to parameters: {one_line(error)}"
        ) from error
    return CompiledLaw(address, program, compiled_law.claims, keeper, law, compiled_law.parameters)


def _code_of(law: ForceLaw | NativeLaw, example: dict[str, float], *, duals: bool) -> tuple[int, int, object]:
    """Return the addresses of a law's function and of its program, and an object that keeps them in memory."""
    if isinstance(law, NativeLaw):
        block = _integers(law.program)
        return (law.function.address_for_duals if duals else law.function.address), block.ctypes.data, block
    if law in _STORED and tuple(example) == law_kernels.PARAMETERS.get(_STORED[law].function.__name__, ()):
        stored = _STORED[law]
        return (stored.address_for_duals if duals else stored.address), 0, stored
    if isinstance(law, ExpressionLaw | TracedLaw):
        block = _program_of(law, tuple(example.items()))
        stored = law_programs.run_program
        if duals and (missing := sorted(ONLY_OF_NUMBERS & set(_names_in(block)))):
            raise PluginError(f"the derivatives of {missing[0]} are not known")
        return (stored.address_for_duals if duals else stored.address), block.ctypes.data, block
    try:
        compiled_function = builder("function_laws").compiled_function
    except ImportError as error:
        absent = BUILDER if error.name == BUILDER else "Numba"
        raise PluginError(
            f"it is a function that Numba compiles, and {absent} is not installed: "
            "`pip install mbdkit[numba]`, or write the law as a SymPy expression"
        ) from error
    callback = compiled_function(law.function, duals=duals)
    return callback.address, 0, callback


@cache
def _program_of(law: ExpressionLaw | TracedLaw, example: tuple[tuple[str, float], ...]) -> np.ndarray:
    """Return the program of a law as integers, some of which are the bits of constants."""
    if isinstance(law, TracedLaw):
        return _Compiler(traced_source(law, list(dict(example))), len(example)).block()
    from mbdkit.symbolic.symbolic_law import law_source

    return _Compiler(law_source(law, dict(example)), len(example)).block()


def _names_in(block: np.ndarray) -> list[str]:
    names = list(OPCODES)
    return [names[code] for code in block[HEAD : HEAD + WORDS * block[0] : WORDS]]


_BINARY = {
    ast.Add: "add", ast.Sub: "subtract", ast.Mult: "multiply", ast.Div: "divide", ast.Mod: "remainder",
}  # fmt: skip
_COMPARED = {
    ast.Lt: "less", ast.LtE: "less_equal", ast.Gt: "greater", ast.GtE: "greater_equal", ast.Eq: "equal",
    ast.NotEq: "not_equal",
}  # fmt: skip
_FOLDED: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
}  # fmt: skip
_NAMES = {"abs": "abs", "fabs": "abs", "ceil": "ceil", "floor": "floor"}
_CONSTANTS = {"pi": np.pi, "e": np.e, "inf": np.inf, "nan": np.nan}


class _Compiler:
    """Compiles the source of a law, a function that returns four numbers, to a program.

    Operations stay in the order of the source, because it determines the rounding errors. Registers of intermediate
    results are reused after their last use.
    """

    def __init__(self, source: str, parameters: int):
        (function,) = ast.parse(source).body
        assert isinstance(function, ast.FunctionDef)
        self.parameters = parameters
        self.constants: list[float] = []
        self.places: dict[str, int] = {}
        self.code: list[tuple[str, int, int, int]] = []
        self.names: dict[str, int] = {name: i for i, name in enumerate(ARGUMENTS)}
        # Numbers of values: first the arguments and parameters, then the results of instructions in their order.
        # Constants have negative numbers, since their count is not known yet.
        self.values = 3 + parameters
        for statement in function.body:
            if isinstance(statement, ast.Assign):
                (target,) = statement.targets
                assert isinstance(target, ast.Name)
                self.names[target.id] = self.value(statement.value)
            elif isinstance(statement, ast.Return):
                assert isinstance(statement.value, ast.Tuple)
                self.results = [self.value(element) for element in statement.value.elts]

    def value(self, node: ast.expr) -> int:
        """Append the instructions of an expression; return the index of its value."""
        number = _number(node)
        if number is not None:
            return self._constant(number)
        match node:
            case ast.Name(id=name):
                return self.names[name] if name in self.names else self._constant(_CONSTANTS[name])
            case ast.Subscript(slice=ast.Constant(value=int(index))):
                return 3 + index
            case ast.UnaryOp(op=ast.USub()):
                return self._append("negate", self.value(node.operand))
            case ast.UnaryOp(op=ast.Not()):
                return self._append("not", self.value(node.operand))
            case ast.UnaryOp(op=ast.UAdd()):
                return self.value(node.operand)
            case ast.BinOp(op=ast.Pow()):
                return self._power(node)
            case ast.BinOp():
                return self._append(_BINARY[type(node.op)], self.value(node.left), self.value(node.right))
            case ast.Compare(ops=[sign], comparators=[right]):
                return self._append(_COMPARED[type(sign)], self.value(node.left), self.value(right))
            case ast.BoolOp():
                name = "and" if isinstance(node.op, ast.And) else "or"
                result, *others = (self.value(operand) for operand in node.values)
                for other in others:
                    result = self._append(name, result, other)
                return result
            case ast.IfExp():
                return self._append("select", *map(self.value, (node.test, node.body, node.orelse)))
            case ast.Call(func=ast.Name(id="float")):
                return self.value(node.args[0])
            case ast.Call(func=ast.Name(id=name)) if _NAMES.get(name, name) in OPCODES:
                return self._append(_NAMES.get(name, name), *map(self.value, node.args))
        raise PluginError(f"'{ast.unparse(node)}' in its force or a derivative cannot be compiled")

    def _power(self, node: ast.BinOp) -> int:
        exponent = _number(node.right)
        base = self.value(node.left)
        if isinstance(exponent, int):
            return self._constant(1.0) if exponent == 0 else self._append("power_of_integer", base, exponent)
        if exponent == 0.5:
            return self._append("sqrt", base)
        if exponent == 2.0:
            return self._append("multiply", base, base)
        return self._append("power", base, self.value(node.right))

    def _constant(self, number: float) -> int:
        bits = float(number).hex()  # 0.0 and -0.0 are different constants
        if bits not in self.places:
            self.places[bits] = len(self.constants)
            self.constants.append(float(number))
        return -1 - self.places[bits]

    def _append(self, name: str, *operands: int) -> int:
        self.values += 1
        first, second, third = (*operands, 0, 0)[:3]
        self.code.append((name, first, second, third))
        return self.values - 1

    def block(self) -> np.ndarray:
        """Return the program as integers for the kernel."""
        places = self._registers()
        code = [len(self.code), len(self.constants), *(places[result] for result in self.results)]
        for number, (name, first, second, third) in enumerate(self.code, 3 + self.parameters):
            second = second if name == "power_of_integer" else places[second]
            code += [OPCODES[name], places[first], second, places[third], places[number]]
        return np.concatenate([np.array(code, dtype=np.int64), np.array(self.constants).view(np.int64)])

    def _registers(self) -> dict[int, int]:
        fixed = 3 + self.parameters
        places = {i: i for i in range(fixed)} | {-1 - i: fixed + i for i in range(len(self.constants))}
        last = {value: i for i, (name, *operands) in enumerate(self.code) for value in _used(name, operands)}
        last |= dict.fromkeys(self.results, len(self.code))
        free: list[int] = []
        count = fixed + len(self.constants)
        for i, (name, *operands) in enumerate(self.code):
            ended = {value for value in _used(name, operands) if value >= fixed and last[value] == i}
            free += sorted({places[value] for value in ended})
            if free:
                places[fixed + i] = free.pop()
            else:
                places[fixed + i], count = count, count + 1
            if fixed + i not in last:
                free.append(places[fixed + i])
        if count > REGISTERS:
            raise PluginError(f"its force and derivatives need {count} registers, more than {REGISTERS}")
        return places


def _used(name: str, operands: list[int]) -> list[int]:
    count = {"select": 3, "power_of_integer": 1}.get(name, 2)
    return operands[:count]


def _number(node: ast.expr) -> int | float | None:
    """Return the value of a constant expression, such as ``-3/2``; None if it is not constant."""
    match node:
        case ast.Constant(value=bool(value)):
            return float(value)
        case ast.Constant(value=int() | float() as value):
            return value
        case ast.UnaryOp(op=ast.USub()):
            inner = _number(node.operand)
            return None if inner is None else -inner
        case ast.BinOp(op=op) if type(op) in _FOLDED:
            left, right = _number(node.left), _number(node.right)
            if left is None or right is None:
                return None
            try:
                return _FOLDED[type(op)](left, right)
            except ZeroDivisionError:
                return None
    return None
