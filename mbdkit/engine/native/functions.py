"""Building blocks of kernels: decorators, overloads, and placeholders for operations of the compiler.

A compiled function is an ordinary function of Python. `subkernel`, `inlined` and `separate` mark functions that only
compiled code calls; `kernel` is for functions that Python calls, and `entry` for functions that kernels call by
address. Functions that differ between the arithmetics (`mbdkit.engine.native.arithmetic`) are declared by `overload`,
and those that only the compiler can express by `placeholder`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from mbdkit.engine.native.kernel import MODULES, Entry, Kernel, LawFunction
from mbdkit.engine.native.machine_code import CORE

Function = TypeVar("Function", bound=Callable[..., object])


class DeclaredFunctions(NamedTuple):
    """All functions that modules imported so far have declared."""

    #: Functions with machine code of their own, by the name of its symbol; so are the next two.
    kernels: dict[str, Kernel]
    entries: dict[str, Entry]
    laws: dict[str, LawFunction]
    #: Functions that only compiled code calls, and whether they are copied into their callers.
    subkernels: dict[Callable[..., object], bool]
    separate: set[Callable[..., object]]  #: Subkernels that are not copied into their callers.
    #: Overloaded functions, each with a function that returns its source for given types of arguments.
    overloads: list[tuple[Callable[..., object], Callable[..., object]]]
    #: Functions that only the compiler can express; in Python, they are not called or have a body of their own.
    placeholders: set[Callable[..., object]]


DECLARED = DeclaredFunctions({}, {}, {}, {}, set(), [], set())


def subkernel(function: Function) -> Function:
    """Mark a function that only kernels and other subkernels call."""
    MODULES[function.__module__] = function.__globals__
    DECLARED.subkernels[function] = False
    return function


def inlined(function: Function) -> Function:
    """Mark a function that only kernels call and that is copied into each of its callers."""
    MODULES[function.__module__] = function.__globals__
    DECLARED.subkernels[function] = True
    return function


def separate(function: Function) -> Function:
    """Mark a large function that only kernels call, from several places, and that is not copied into its callers.

    LLVM takes a minute for a kernel that consists of many copies, and the copies are not faster.
    """
    DECLARED.separate.add(function)
    return subkernel(function)


def overload(function: Callable[..., object]) -> Callable[[Function], Function]:
    """Declare how the source of a function depends on the types of its arguments.

    The decorated function gets these types and returns a function with the same arguments, or None. In Python, the
    function itself is called.
    """

    def declare(chosen: Function) -> Function:
        DECLARED.overloads.append((function, chosen))
        return chosen

    return declare


def placeholder(function: Function) -> Function:
    """Declare a function that only the compiler can express (`mbdkit_builder.implementation.implement`)."""
    DECLARED.placeholders.add(function)
    return function


def kernel(function: Callable[..., object]) -> Kernel:
    """Declare a function that Python calls.

    Its arguments and its result are annotated; see `mbdkit.engine.native.kernel`. It releases the global interpreter
    lock, and division by zero follows IEEE 754 instead of raising an exception.
    """
    return DECLARED.kernels.setdefault(_symbol(function), Kernel(_symbol(function), function))


def entry(function: Callable[[int, int, float, float, float], int]) -> Entry:
    """Declare a function that kernels call by its address; see `mbdkit.engine.native.kernel`."""
    return DECLARED.entries.setdefault(_symbol(function), Entry(_symbol(function), function))


def law_function(function: Callable[..., None]) -> LawFunction:
    """Declare a function of force laws, which kernels call by its address; see `mbdkit.engine.native.calls`.

    Its arguments are the program, length, rate, time, and the addresses of the parameters and of the results.
    """
    return DECLARED.laws.setdefault(_symbol(function), LawFunction(_symbol(function), function))


def _symbol(function: Callable[..., object]) -> str:
    MODULES[function.__module__] = function.__globals__
    package, _, path = function.__module__.partition(".")
    symbol = f"{path.rpartition('.')[2]}__{function.__name__}"
    return symbol if package == CORE else f"{package}___{symbol}"
