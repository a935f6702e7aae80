"""Force laws for kernels, which call them by address.

A law that is a SymPy expression or a traced Python function becomes a program (`mbdkit.engine.law_compiler`). The
packaged laws have machine code of their own (`mbdkit.engine.kernels.law_kernels`). Other functions of plugins are
compiled by Numba, once in every process.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, ClassVar, cast

import numpy as np

from mbdkit.base.errors import PluginError
from mbdkit.base.frozen import dataclass, field
from mbdkit.base.text import one_line
from mbdkit.engine.kernels import law_kernels, law_programs
from mbdkit.engine.kernels.law_programs import HEAD, ONLY_OF_NUMBERS, OPCODES, WORDS
from mbdkit.engine.native.calls import HAS_POTENTIAL, PASSIVE
from mbdkit.engine.native.kernel import LawFunction
from mbdkit.engine.native.machine_code import BUILDER, builder
from mbdkit.laws import exponential, gas_spring, linear, one_sided, tabulated
from mbdkit.mechanism.force_law import ExpressionLaw, ForceLaw, LawState, TracedLaw, law_parameters

#: The packaged laws, which have their own machine code.
_STORED: Mapping[ForceLaw, LawFunction] = {
    exponential.LAW: law_kernels.exponential,
    gas_spring.LAW: law_kernels.gas_spring,
    linear.LAW: law_kernels.linear,
    one_sided.LAW: law_kernels.one_sided,
    tabulated.LAW: law_programs.table,
}

#: Laws compiled by this process; keys are a law and the names of its parameters.
_COMPILED: dict[tuple[ForceLaw | NativeLaw, tuple[str, ...]], CompiledLaw] = {}


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
        from mbdkit.engine.law_compiler import program_of  # many mechanisms have no such law

        block = program_of(law, tuple(example.items()))
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


def _names_in(block: np.ndarray) -> list[str]:
    names, begin = list(OPCODES), HEAD + block[2]
    return [names[code] for code in block[begin : begin + WORDS * block[0] : WORDS]]
