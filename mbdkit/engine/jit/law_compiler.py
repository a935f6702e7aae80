"""Compile force laws to machine code.

Each law becomes a C function in a small generated module in the cache folder. The name of the module contains a hash of
all sources in the package of the law's function. A law is therefore compiled once, loaded by later processes, and
compiled again after any change. If the function cannot be imported by its name, such as a lambda or a bound method, the
name contains a hash of the code generated from its expression instead; a law that is a function of numbers is then
compiled in every process.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from numba import types

from mbdkit.base.errors import PluginError
from mbdkit.base.text import one_line
from mbdkit.engine.jit.cache import FOLDER, store, stored
from mbdkit.engine.jit.law_calls import HAS_POTENTIAL, PARAMETERS, PASSIVE, compiled
from mbdkit.mechanism.force_law import ExpressionLaw, ForceLaw
from mbdkit.mechanism.law_parameters import law_parameters

_HEAD = """from math import nan

from numba import carray, cfunc

from mbdkit.engine.jit.cache import cached_cfunc
from mbdkit.engine.jit.law_calls import SIGNATURE, compiled, read_only

"""
_ENTRY = '''

@{decorator}(SIGNATURE, error_model="numpy")
def entry(length, rate, time, parameters, out):
    """Write force, its derivatives by length and by rate, and the potential; all stay NaN if the law raises."""
    results = carray(out, (4,))
    results[0] = results[1] = results[2] = results[3] = nan
    count = int(carray(parameters, (1,))[0])
    force, by_length, by_rate, potential = law(length, rate, time, read_only(carray(parameters, (count + 1,))[1:]))
    results[0] = force
    results[1] = by_length
    results[2] = by_rate
    results[3] = potential
'''
_DUAL_HEAD = """from math import nan

from mbdkit.engine.jit.cache import cached_cfunc
from mbdkit.engine.jit.law_calls import DUAL_SIGNATURE, compiled, dual_at, duals_behind, put_dual

"""
_DUAL_ENTRY = '''

@{decorator}(DUAL_SIGNATURE, error_model="numpy")
def entry(length, rate, time, parameters, out):
    """Write force, its derivatives by length and by rate, and the potential, with their derivatives by parameters."""
    for i in range(4):
        put_dual(out, i, nan)
    count = int(dual_at(parameters, 0))
    force, by_length, by_rate, potential = law(
        dual_at(length, 0), dual_at(rate, 0), time, duals_behind(parameters, count)
    )
    put_dual(out, 0, force)
    put_dual(out, 1, by_length)
    put_dual(out, 2, by_rate)
    put_dual(out, 3, potential)
'''


@dataclass(frozen=True)
class _Form:
    """Template of the generated module of a law: imports, and the function that kernels call."""

    head: str
    entry: str


_FOR_NUMBERS, _FOR_DUAL_NUMBERS = _Form(_HEAD, _ENTRY), _Form(_DUAL_HEAD, _DUAL_ENTRY)

_FOR_DUALS: dict[int, CompiledLaw] = {}
"""Laws compiled for dual numbers, by the address of the law for numbers."""
_COMPILED: dict[tuple[ForceLaw, tuple[str, ...]], CompiledLaw] = {}
"""Laws compiled or loaded by this process; the key is the law and the names of its parameters."""

_ARGUMENTS = (types.float64, types.float64, types.float64, PARAMETERS)


@dataclass(frozen=True)
class CompiledLaw:
    """A force law in machine code.

    Parameters
    ----------
    address
        Address of the C function.
    claims
        `HAS_POTENTIAL` and `PASSIVE`, as bits.
    keeper
        Reference that keeps the machine code in memory.
    law, parameters
        The law, and the names and example values of its parameters.
    """

    address: int
    claims: int
    keeper: Any
    law: ForceLaw
    parameters: tuple[tuple[str, float], ...]


def bind_law(law: ForceLaw, options: Any, name: str) -> tuple[CompiledLaw, list[float]]:
    """Return the machine code of a law, and the parameters of one element: their number, followed by their values.

    Parameters
    ----------
    law
        The law.
    options
        Instance of the law's options.
    name
        Name of the law in error messages.

    Raises
    ------
    PluginError
        If the law cannot be compiled, does not return derivatives, or fails to compute its parameters.
    """
    names, values = law_parameters(law, options, name)
    if (law, names) not in _COMPILED:
        _COMPILED[law, names] = _compile(law, dict(zip(names, values, strict=False)), name)
    return _COMPILED[law, names], [float(len(values)), *values]


def law_for_duals(compiled_law: CompiledLaw, name: str) -> CompiledLaw:
    """Return a law compiled for dual numbers; `name` is that of the force in error messages.

    Raises
    ------
    PluginError
        If its source cannot be compiled for them.
    """
    key = compiled_law.address
    if key not in _FOR_DUALS:
        law, example = compiled_law.law, dict(compiled_law.parameters)
        try:
            if isinstance(law, ExpressionLaw):
                keeper = _of_expression(law, example, _FOR_DUAL_NUMBERS)
            else:
                keeper = _of_function(law.function, _FOR_DUAL_NUMBERS)
        except Exception as error:
            raise PluginError(
                f"the law of force {name} cannot be differentiated by parameters: {one_line(error)}"
            ) from error
        _FOR_DUALS[key] = CompiledLaw(
            keeper["entry"].address, compiled_law.claims, keeper, law, compiled_law.parameters
        )
    return _FOR_DUALS[key]


def _compile(law: ForceLaw, example: dict[str, float], name: str) -> CompiledLaw:
    """Return the machine code of a law; `example` maps the names of an expression's parameters to example values."""
    try:
        if isinstance(law, ExpressionLaw):
            keeper = _of_expression(law, example)
        else:
            keeper = _of_function(law.function)
    except PluginError as error:
        raise PluginError(f"force law {name}: {error}") from error
    except Exception as error:
        raise PluginError(f"force law {name} cannot be compiled: {one_line(error)}") from error
    claims = HAS_POTENTIAL * (law.potential not in (None, False)) | PASSIVE * law.passive
    return CompiledLaw(keeper["entry"].address, claims, keeper, law, tuple(example.items()))


def _of_expression(law: ExpressionLaw, example: dict[str, float], form: _Form = _FOR_NUMBERS) -> dict[str, Any]:
    def body() -> str:
        from mbdkit.symbolic.symbolic_law import law_source

        return "from math import *\n" + law_source(law, example) + "\nlaw = compiled(law)\n"

    expressions = [law.force] if law.potential is None else [law.force, law.potential]
    origins = [_origin(expression) for expression in expressions]
    if None not in origins:  # SymPy is imported only if the compiled law is not in the cache
        return _generated_module("\n".join(map(str, [*origins, "", *example])), body, form)
    text = body()
    return _generated_module(text, lambda: text, form)


def _of_function(function: Callable[..., Any], form: _Form = _FOR_NUMBERS) -> dict[str, Any]:
    origin = _origin(function)
    if origin is None:
        _check_results(function)
        space: dict[str, Any] = {"law": compiled(function), "__name__": "mbdkit_law"}
        exec("from numba import cfunc\n" + form.head + form.entry.format(decorator="cfunc"), space)
        return space

    def body() -> str:
        _check_results(function)
        python = getattr(function, "py_func", function)
        return f"from {python.__module__} import {python.__qualname__} as _law\n\nlaw = compiled(_law)\n"

    return _generated_module(origin, body, form)


def _check_results(function: Callable[..., Any]) -> None:
    """Raise PluginError unless the function returns four numbers."""
    dispatcher = compiled(function)
    dispatcher.compile(_ARGUMENTS)
    returned = dispatcher.overloads[_ARGUMENTS].signature.return_type
    numbers = list(getattr(returned, "types", [returned]))  # the elements of a tuple
    if len(numbers) == 4 and all(isinstance(one, types.Number | types.Boolean) for one in numbers):
        return
    found = "one value" if len(numbers) == 1 else f"{len(numbers)} values" if len(numbers) != 4 else "other types"
    raise PluginError(
        f"its function returns {found}, not the four numbers force, derivative by length, derivative by rate and "
        "potential: return all four, or write the law as a SymPy expression, whose derivatives are computed"
    )


def _origin(function: Any) -> str | None:
    """Return the module and name of a function and a hash of the source files of its package.

    None if these do not determine the function: if it is no function; in an interactive session or a script; if it is
    not what its module has under its name, such as a lambda, a bound method or one of several functions of the same
    name; and for closures, whose variables are not in the sources.
    """
    python = getattr(function, "py_func", function)
    module = sys.modules.get(str(getattr(python, "__module__", "")))
    name = str(getattr(python, "__qualname__", ""))
    file = getattr(module, "__file__", None)
    if module is None or not file or module.__name__ == "__main__" or getattr(python, "__closure__", None):
        return None
    if getattr(module, name, None) is not function:
        return None
    return f"{module.__name__} {name} {_package_hash(module.__name__.partition('.')[0], file)}"


@cache
def _package_hash(package: str, file: str) -> str:
    """Return a hash of all source files of a package; of `file` alone if it is a module outside of packages."""
    folders = map(Path, getattr(sys.modules.get(package), "__path__", ()))  # several for a namespace package
    found = [(folder, path) for folder in folders for path in sorted(folder.rglob("*.py")) if path.is_file()]
    digest = hashlib.sha256()
    for folder, path in found or [(Path(file).parent, Path(file))]:
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _generated_module(origin: str, body: Callable[[], str], form: _Form) -> dict[str, Any]:
    """Return the namespace of the generated module of a law; it is written first if it is not in the cache.

    Parameters
    ----------
    origin
        Text that depends on all sources of the law.
    body
        Returns source code that defines the function ``law``.
    form
        What surrounds the law.
    """
    name = f"mbdkit_law_{hashlib.sha256((origin + form.head + form.entry).encode()).hexdigest()[:24]}"
    path = FOLDER / f"{name}.law"
    text = stored(path)
    if text is None:
        text = (form.head + body() + form.entry.format(decorator="cached_cfunc")).encode()
        store(path, text)
    module = ModuleType(name)
    sys.modules[name] = module
    exec(compile(text, str(path), "exec"), vars(module))
    return vars(module)
