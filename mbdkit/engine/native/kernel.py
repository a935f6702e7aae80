"""Calls of machine code: of kernels from Python, and of entries from kernels.

The machine code of a kernel is a C function ``int64 kernel(int64 *block)``. The block holds 64-bit words: the
arguments, the addresses of NumPy's types `DTYPES`, and room for the results. An argument is a number or a truth value;
the address of the members of an array object, which the machine code reads and checks itself; or a bundle (NamedTuple
of arrays), in the layout of `mbdkit.engine.native.bundle`. The returned number is 0, or 1 if an array has another type
than expected.

The machine code of an entry is a C function ``int64 entry(int64 first, int64 second, double t, double h, double x)``.
"""

from __future__ import annotations

import ctypes
import inspect
import math
import struct
from array import array
from collections.abc import Callable, Iterable
from functools import cached_property
from types import BuiltinFunctionType, SimpleNamespace
from typing import Any, TypeVar, get_args, get_origin

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.native.bundle import ARRAY_WORDS, HEAD, ArrayType, array_words, arrays_in, arrays_of
from mbdkit.engine.native.machine_code import IN_PYTHON, IS_COMPILED, address_of

_CALL = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)
DTYPES = (np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.complex128))
"""Types of the elements of arrays, in the order in which the block of a kernel names them."""
_CODES = {int: "q", bool: "q", float: "d"}
Called = TypeVar("Called", bound=Callable[..., object])
MODULES: dict[str, dict[str, Any]] = {}
"""Global names of the modules of kernels."""
_ENTRIES: dict[int, Callable[[int, int, float, float, float], int]] = {}
"""Entries by address; used only with ``MBDKIT_KERNELS=python``."""


class Kernel:
    """A function that Python calls.

    Parameters
    ----------
    symbol
        Name of its machine code.
    function
        The function. Its arguments are annotated with int, float, bool, bundles, or types of arrays such as
        ``Annotated[np.ndarray, np.float64, 1]``, and its result with int, float, bool, None or a tuple of these.
    """

    def __init__(self, symbol: str, function: Callable[..., object]):
        self.symbol, self.function = symbol, function
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    @cached_property
    def signature(self) -> tuple[tuple[Any, ...], tuple[Any, ...] | Any]:
        """Annotations of its arguments and of its result."""
        found = inspect.signature(self.function, eval_str=True)
        return tuple(one.annotation for one in found.parameters.values()), found.return_annotation

    @cached_property
    def results(self) -> tuple[Any, ...]:
        """Types of its results."""
        kind = self.signature[1]
        return () if kind is None else get_args(kind) if get_origin(kind) is tuple else (kind,)

    @cached_property
    def _call(self) -> Callable[..., Any]:
        return _in_python(self.function) if IN_PYTHON else _caller(self)

    def __call__(self, *arguments: Any) -> Any:
        """Call the machine code; the first call loads it."""
        return self._call(*arguments)


def _in_python(function: Called) -> Called:
    """Return a function after replacing `math` by our elementary functions in all modules of kernels.

    In machine code, the builder replaces them, and finds them by their names.
    """
    if IS_COMPILED:
        return function
    own = {getattr(math, name, math.gamma): one for name, one in elementary.FUNCTIONS.items()}
    for names in MODULES.values():
        for name, value in names.items():
            if value is math:
                names[name] = SimpleNamespace(**vars(math) | {one.__name__: own[one] for one in own})
            elif isinstance(value, BuiltinFunctionType) and value in own:
                names[name] = own[value]
    return function


def _caller(kernel: Kernel) -> Callable[..., Any]:
    call = _CALL(address_of(kernel.symbol))
    kinds, result = kernel.signature
    types = tuple(map(id, DTYPES))
    given = struct.Struct("=" + "".join(map(_format, kinds)) + "q" * len(types))
    taken = struct.Struct("=" + "".join(_CODES[kind] for kind in kernel.results))
    room, pack = bytes(taken.size), given.pack
    is_array = [kind not in _CODES and not hasattr(kind, "_fields") for kind in kinds]
    layouts = [arrays_in(kind) if hasattr(kind, "_fields") else None for kind in kinds]
    has_bundles = any(layout is not None for layout in layouts)
    is_single = get_origin(result) is not tuple

    def run(*arguments: Any) -> Any:
        words = [id(x) + HEAD if one else x for one, x in zip(is_array, arguments, strict=True)]
        if has_bundles:
            words = _with_bundles(layouts, words)
        block = array("b", pack(*words, *types) + room)
        if call(block.buffer_info()[0]) != 0:
            return run(*_checked(kinds, arguments))
        if not room:
            return None
        values = taken.unpack_from(block, given.size)
        typed = tuple(kind(value) for kind, value in zip(kernel.results, values, strict=True))
        return typed[0] if is_single else typed

    return run


def _format(kind: Any) -> str:
    if kind in _CODES:
        return _CODES[kind]
    if hasattr(kind, "_fields"):
        return "q" * sum(ARRAY_WORDS + 2 * one.dimensions for one in arrays_in(kind))
    return "q"


def _with_bundles(layouts: Iterable[tuple[ArrayType, ...] | None], given: Iterable[Any]) -> list[Any]:
    """Return arguments with each bundle replaced by its words.

    The types of its arrays are looked up beforehand: annotations take longer to read than the arrays.
    """
    words: list[Any] = []
    for layout, argument in zip(layouts, given, strict=True):
        if layout is None:
            words.append(argument)
            continue
        for (dtype, dimensions, sizes), x in zip(layout, arrays_of(argument), strict=True):
            _check_array(dtype, dimensions, x)
            for axis, size in sizes:
                if x.shape[axis] != size:
                    raise TypeError(f"an array of a bundle has shape {x.shape}; axis {axis} must have {size}")
            words += array_words(x)
    return words


def _check_array(dtype: np.dtype[Any], dimensions: int, x: Any) -> None:
    if not isinstance(x, np.ndarray) or x.dtype != dtype or x.ndim != dimensions or not x.flags.c_contiguous:
        what = f"one of {x.dtype} with shape {x.shape}" if isinstance(x, np.ndarray) else type(x).__name__
        raise TypeError(f"a kernel needs a C-contiguous array of {dtype} with {dimensions} dimensions, not {what}")


def _checked(kinds: Iterable[Any], arguments: Iterable[Any]) -> list[Any]:
    """Return the arguments, with arrays viewed as the dtype objects whose addresses the machine code knows.

    Raises
    ------
    TypeError
        If an array has another type, another number of dimensions, or is not contiguous.
    """
    checked = []
    for kind, x in zip(kinds, arguments, strict=True):
        if kind in _CODES or hasattr(kind, "_fields"):
            checked.append(x)
        else:
            dtype, dimensions = np.dtype(get_args(kind)[1]), get_args(kind)[2]
            _check_array(dtype, dimensions, x)
            checked.append(x.view(dtype))
    return checked


class Entry:
    """A function that kernels call by its address; the arguments are as in `mbdkit.engine.native.kernel`."""

    def __init__(self, symbol: str, function: Callable[[int, int, float, float, float], int]):
        self.symbol, self.function = symbol, function

    @cached_property
    def address(self) -> int:
        """Address of the machine code; the first access loads it."""
        if IN_PYTHON:
            _ENTRIES[id(self)] = _in_python(self.function)
            return id(self)
        return address_of(self.symbol)


class LawFunction:
    """A function of force laws, which kernels call by its address, for numbers and for dual numbers."""

    def __init__(self, symbol: str, function: Callable[..., None]):
        self.symbol, self.function = symbol, function

    @cached_property
    def address(self) -> int:
        """Address of the machine code for numbers."""
        return address_of(self.symbol)

    @cached_property
    def address_for_duals(self) -> int:
        """Address of the machine code for dual numbers."""
        return address_of(f"{self.symbol}__dual")


def entry_in_python(address: int) -> Callable[[int, int, float, float, float], int]:
    """Return the entry with an address; used only with ``MBDKIT_KERNELS=python``."""
    return _ENTRIES[address]
