"""Force laws to machine code: each a C function in a small generated module, kept in the cache folder.

The module is named after a hash of all that its code comes from, so that it is compiled once, found again by every
later process, and never stale. A function that no module can import, such as a lambda, is compiled in every process.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numba import types

from mbdkit.engine.jit.cache import FOLDER, cached_here
from mbdkit.engine.jit.law_calls import compiled
from mbdkit.engine.kernels.forces import HAS_POTENTIAL, PASSIVE
from mbdkit.errors import MbdkitError, PluginError
from mbdkit.mechanism.force_law import ARGUMENTS, ExpressionLaw, ForceLaw, FunctionLaw
from mbdkit.text import one_line

_HEAD = """from math import nan

from numba import carray, cfunc

from mbdkit.engine.jit.law_calls import SIGNATURE, compiled

"""
_ENTRY = '''

@cfunc(SIGNATURE, cache={cache}, error_model="numpy")
def entry(length, rate, time, parameters, out):
    """Write force, its derivatives by length and by rate, and the potential; they stay NaN where the law raises."""
    results = carray(out, (4,))
    results[0] = results[1] = results[2] = results[3] = nan
    count = int(carray(parameters, (1,))[0])
    force, by_length, by_rate, potential = law(length, rate, time, carray(parameters, (count + 1,))[1:])
    results[0] = force
    results[1] = by_length
    results[2] = by_rate
    results[3] = potential
'''
_COMPILED: dict[tuple[ForceLaw, tuple[str, ...]], CompiledLaw] = {}
"""What this process has compiled, by law and names of parameters."""

_ARGUMENTS = (types.float64, types.float64, types.float64, types.float64[::1])


@dataclass(frozen=True)
class CompiledLaw:
    """A law's address, what it claims, and what keeps its code alive."""

    address: int
    claims: int
    keeper: Any


def bind_law(law: ForceLaw, options: Any, name: str) -> tuple[CompiledLaw, list[float]]:
    """Return the machine code of a law, and what it reads of an element: the number of its parameters, and these.

    Parameters
    ----------
    law
        The law.
    options
        Instance of the law's options.
    name
        What to call the law in messages.

    Raises
    ------
    PluginError
        Where the law cannot be compiled, its derivatives missing included, or fails to make its parameters.
    """
    names, values = law_parameters(law, options, name)
    if (law, names) not in _COMPILED:
        _COMPILED[law, names] = _compile(law, dict(zip(names, values, strict=False)), name)
    return _COMPILED[law, names], [float(len(values)), *values]


def law_parameters(law: ForceLaw, options: Any, name: str) -> tuple[tuple[str, ...], list[float]]:
    """Return the names of a law's parameters, none for a function's, and their values; see `bind_law`."""
    try:
        names, values = _parameters(law, options)
    except MbdkitError:
        raise
    except Exception as error:
        raise PluginError(f"force law {name} failed to make its parameters: {one_line(error)}") from error
    if clash := sorted(set(names) & set(ARGUMENTS)):
        raise PluginError(
            f"force law {name}: its parameter '{clash[0]}' has the name of what every law is a function of"
        )
    if not np.all(np.isfinite(values)):
        raise PluginError(f"force law {name} made parameters that are not finite")
    return names, values


def _parameters(law: ForceLaw, options: Any) -> tuple[tuple[str, ...], list[float]]:
    given: Any
    if law.parameters is not None:
        given = law.parameters(options)
    elif isinstance(law, ExpressionLaw):
        whole = {option: getattr(options, option) for option in law_options(options)}
        given = {option: value for option, value in whole.items() if isinstance(value, int | float)}
    else:
        given = [getattr(options, option) for option in law_options(options)]
    if isinstance(law, FunctionLaw):
        return (), [float(x) for x in given]
    names = tuple(sorted(given))
    return names, [float(given[name]) for name in names]


def law_options(options: Any) -> list[str]:
    """Return the names of a law's own options, in the order of their definition, from an element that has them."""
    own: list[str] = list(type(options).law_options.model_fields)
    return own


def _compile(law: ForceLaw, example: dict[str, float], name: str) -> CompiledLaw:
    """Return the machine code of a law; an expression's parameters have the names, and may have the values, given."""
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
    return CompiledLaw(keeper["entry"].address, claims, keeper)


def _of_expression(law: ExpressionLaw, example: dict[str, float]) -> dict[str, Any]:
    parts = [_origin(expression) for expression in (law.force, law.potential)]

    def body() -> str:
        from mbdkit.symbolic.symbolic_law import law_source

        return "from math import *\n" + law_source(law, example) + "\nlaw = compiled(law)\n"

    return _kept("\n".join([*parts, *example]), body)


def _origin(expression: Any) -> str:
    """Return text that changes whenever the expression does."""
    if expression is None:
        return ""
    sources = _sources(expression) if callable(expression) and getattr(expression, "__code__", None) else None
    if sources is not None:
        return f"{expression.__qualname__} {expression.__code__.co_firstlineno} {sources}"
    from sympy import srepr, sympify

    return str(srepr(sympify(expression() if callable(expression) else expression)))


def _of_function(function: Callable[..., Any]) -> dict[str, Any]:
    python = getattr(function, "py_func", function)
    module, name, sources = python.__module__, python.__qualname__, _sources(python)
    if sources is None or getattr(sys.modules[module], name, None) is not function:
        _check_results(function)
        space: dict[str, Any] = {"law": compiled(function), "__name__": "mbdkit_law"}
        exec(_HEAD + _ENTRY.format(cache=False), space)
        return space

    def body() -> str:
        _check_results(function)
        return f"from {module} import {name} as _law\n\nlaw = compiled(_law)\n"

    return _kept(f"{module} {name} {sources}", body)


def _check_results(function: Callable[..., Any]) -> None:
    """Raise PluginError unless the function returns four numbers."""
    dispatcher = compiled(function)
    dispatcher.compile(_ARGUMENTS)
    returned = dispatcher.overloads[_ARGUMENTS].signature.return_type
    numbers = list(getattr(returned, "types", [returned]))  # of a tuple
    if len(numbers) == 4 and all(isinstance(one, types.Number | types.Boolean) for one in numbers):
        return
    found = "one value" if len(numbers) == 1 else f"{len(numbers)} values" if len(numbers) != 4 else "other things"
    raise PluginError(
        f"its function returns {found}, not the four numbers force, derivative by length, derivative by rate and "
        "potential: give the derivatives, or write the law as a SymPy expression, which has them by itself"
    )


def _sources(function: Callable[..., Any]) -> str | None:
    """Return a hash of the source files of a function's package; None where its text does not say what it does."""
    module = sys.modules.get(function.__module__)
    file = getattr(module, "__file__", None)
    if module is None or not file or module.__name__ == "__main__" or getattr(function, "__closure__", None):
        return None
    return _package_hash(module.__name__.partition(".")[0], file)


@cache
def _package_hash(package: str, file: str) -> str:
    root = getattr(sys.modules.get(package), "__file__", None)
    files = sorted(Path(root).parent.rglob("*.py")) if root and Path(root).name == "__init__.py" else []
    digest = hashlib.sha256()
    for path in files or [Path(file)]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _kept(origin: str, body: Callable[[], str]) -> dict[str, Any]:
    """Return the names in the generated module of a law that comes from `origin`; it is written where it is missing."""
    name = f"mbdkit_law_{hashlib.sha256((origin + _HEAD + _ENTRY).encode()).hexdigest()[:24]}"
    path = FOLDER / f"{name}.py"
    if not path.exists():
        text = _HEAD + body() + _ENTRY.format(cache=True)
        handle, draft = tempfile.mkstemp(dir=FOLDER, suffix=".draft")
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        os.replace(draft, path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    with cached_here():
        spec.loader.exec_module(module)
    return vars(module)
