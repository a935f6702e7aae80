"""Decorators that compile the functions of mbdkit.

`kernel` is for functions that Python calls, `subkernel` and `inlined` for functions that only kernels call, and `entry`
for functions that kernels call by address.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

from mbdkit.engine.jit.cache import cached
from mbdkit.engine.jit.entry import Entry
from mbdkit.engine.jit.numba_version import PLAIN

_KERNEL: dict[str, Any] = {"nogil": True}
_SUBKERNEL: dict[str, Any] = {}
if not PLAIN:
    from mbdkit.engine.jit.subkernel_compiler import SubkernelCompiler

    # Undocumented options of njit. `_nrt`: kernels do not allocate memory, and reference counts of arrays would cost
    # more time than the arithmetic of a small mechanism. Wrappers for calls from C and from Python take time to
    # compile; they are omitted because only entries are called from C, and subkernels are not called from Python
    # either.
    _KERNEL |= {"_nrt": False, "no_cfunc_wrapper": True}
    _SUBKERNEL |= {
        "_nrt": False,
        "no_cfunc_wrapper": True,
        "no_cpython_wrapper": True,
        "pipeline_class": SubkernelCompiler,
    }


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    compiler: Any = njit
    return compiler(function, error_model="numpy", **options)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls.

    Its machine code is cached on disk, it releases the global interpreter lock, and division by zero follows IEEE 754
    instead of raising an exception.
    """
    return cached(_compiled(function, **_KERNEL))


def subkernel(function: Callable[..., Any]) -> Any:
    """Compile a function that only kernels and other subkernels call."""
    return _compiled(function, **_SUBKERNEL)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function that only kernels call and that LLVM copies into each of its callers."""
    return _compiled(function, **_SUBKERNEL, forceinline=True)


def entry(function: Callable[..., Any]) -> Entry:
    """Compile a function that kernels call by its address; see `mbdkit.engine.jit.entry`."""
    return Entry(function)
