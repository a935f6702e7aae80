"""Types and code, for Numba, of the functions that `mbdkit.engine.native.functions` declares.

Kernels refer to ordinary functions of Python. Numba looks up the type of each such function here: a subkernel becomes
a dispatcher, so that it is compiled for the types of its arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

from numba import njit, types
from numba.core.typing.templates import infer, infer_global, make_intrinsic_template
from numba.extending import overload, typeof_impl

from mbdkit.engine.native.functions import DECLARED
from mbdkit_builder.subkernel_compiler import SubkernelCompiler

_OPTIONS: dict[str, Any] = {
    # Undocumented options of njit. Kernels allocate no memory, and reference counts of arrays would cost more time than
    # the arithmetic of a small mechanism. Wrappers for calls from C and from Python take time to compile.
    "_nrt": False,
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
    "pipeline_class": SubkernelCompiler,
    "error_model": "numpy",
}

_DEFINED: set[Callable[..., Any]] = set()


@cache
def dispatcher(function: Callable[..., Any], is_inlined: bool = False) -> Any:
    """Return the dispatcher of Numba for a function; `is_inlined` makes LLVM copy it into each of its callers."""
    compiler: Any = njit
    return compiler(function, **_OPTIONS, **({"forceinline": True} if is_inlined else {}))


@typeof_impl.register(FunctionType)
def _typeof_function(function: Callable[..., Any], context: Any) -> Any:
    if function not in DECLARED.subkernels:
        return None
    return dispatcher(function, DECLARED.subkernels[function])._numba_type_


def implement(function: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Define a placeholder for compiled code; the decorated function has the form that ``numba.intrinsic`` requires."""

    def define(typing: Callable[..., Any]) -> Callable[..., Any]:
        template = make_intrinsic_template(function, typing, function.__name__)
        infer(template)
        infer_global(function, types.Function(template))
        _DEFINED.add(function)
        return typing

    return define


def define_overloads() -> None:
    """Define the functions declared by `mbdkit.engine.native.functions.overload` for compiled code."""
    for function, chosen in DECLARED.overloads:
        overload(function)(chosen)


def check_placeholders() -> None:
    """Raise RuntimeError if a placeholder is not defined for compiled code."""
    missing = sorted(f"{function.__module__}.{function.__qualname__}" for function in DECLARED.placeholders - _DEFINED)
    if missing:
        raise RuntimeError(f"not defined for compiled code: {', '.join(missing)}")
