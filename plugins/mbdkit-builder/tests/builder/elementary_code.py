"""Machine code that applies elementary functions to arrays: to numbers, to lanes, and by the C library, for comparison.

``python -m tests.builder.elementary_code FOLDER LEVEL ...`` builds a library for each of some levels of this platform.
Each symbol is a C function ``void f(const double *x, const double *y, double *values, int64 count)``.
"""

from __future__ import annotations

import ctypes
import math
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbdkit.base import file_locks
from mbdkit.engine.kernels.elementary import FUNCTIONS
from mbdkit.engine.native.levels import WIDTH, Level, this_platform
from mbdkit.engine.native.machine_code import COMPILED

NUMBERS, LANES, C_LIBRARY = "angles", "lane_loop", "equations"
"""Kinds of code; each is the name of a module of kernels in whose library the builder places its symbols."""

Values = Callable[[np.ndarray, np.ndarray], np.ndarray]


def build(folder: Path, levels: Sequence[Level]) -> None:
    """Build the libraries of some levels from the same modules."""
    from mbdkit_builder import libraries, lowering, object_code, sources

    lowering.symbols()
    lowering.prepare()
    target, modules = this_platform(), {sources.ELEMENTARY: object_code.elementary_module()}
    for kind in (NUMBERS, LANES, C_LIBRARY):
        for name in FUNCTIONS:
            modules[f"{kind}__{name}"] = _module(f"{kind}__{name}", kind, name)
    for level in levels:
        objects = []
        for symbol, module in modules.items():
            code = object_code.emitted(object_code.optimized(module, symbol, level), symbol, target, level)
            objects.append(folder / f"{symbol}-{level.name}.o")
            objects[-1].write_bytes(code)
        path = _path(folder, level)
        path.write_bytes(libraries._linked(target, objects, path.name, folder))


def _path(folder: Path, level: Level) -> Path:
    return folder / f"elementary-{level.name}.so"


def _called(name: str) -> Any:
    """Return a function that calls the C library's function of this name, as kernels do."""
    arguments = "x, y"[: 3 * argument_count(name) - 2]
    call = _CALLS.get(name, f"math.{name}({arguments})")
    return eval(f"lambda {arguments}: {call}", {"math": math, "np": np})


_CALLS = {"fmod": "np.fmod(x, y)", "pow": "x**y", "tgamma": "math.gamma(x)"}
"""How Python calls functions that have other names in the C library."""


def argument_count(name: str) -> int:
    """Return the number of arguments of a function."""
    return FUNCTIONS[name].__code__.co_argcount


def _module(symbol: str, kind: str, name: str) -> Any:
    from llvmlite import ir
    from numba import types
    from numba.core import cgutils

    from mbdkit_builder.lane_types import DOUBLE, REAL, VECTOR
    from mbdkit_builder.object_code import linked_module

    count, word = argument_count(name), ir.IntType(64)
    item, width = (VECTOR, WIDTH) if kind == LANES else (DOUBLE, 1)
    arguments = ((REAL if kind == LANES else types.float64),) * count

    def wrap(context: Any, builder: Any, callee: Any, signature: Any, given: list[Any]) -> None:
        with cgutils.for_range(builder, builder.sdiv(given[3], word(width))) as loop:
            at = [builder.gep(one, [builder.mul(loop.index, word(width))]) for one in given[:3]]
            places = [builder.bitcast(one, item.as_pointer()) for one in at]
            values = [builder.load(place, align=8) for place in places[:count]]
            if kind == C_LIBRARY:
                form = ir.FunctionType(DOUBLE, [DOUBLE] * count)
                result = builder.call(cgutils.get_or_insert_function(builder.module, form, name), values)
            else:
                _, result = context.call_conv.call_function(builder, callee, signature.return_type, arguments, values)
            builder.store(result, places[2], align=8)
        builder.ret_void()

    pointer = DOUBLE.as_pointer()
    form = ir.FunctionType(ir.VoidType(), [pointer, pointer, pointer, word])
    function = FUNCTIONS[name] if kind == LANES else _called(name)
    return linked_module(symbol, function, arguments, form, wrap)


def built(folder: Path, *levels: Level) -> list[ctypes.CDLL]:
    """Return the libraries of some levels, which the first caller builds by a process of its own."""
    with (folder / "lock").open("w") as lock:
        file_locks.lock(lock.fileno(), wait=True)
        if missing := [level.name for level in levels if not _path(folder, level).is_file()]:
            environment = os.environ | {"MBDKIT_KERNELS": COMPILED}
            subprocess.run([sys.executable, "-m", __name__, str(folder), *missing], env=environment, check=True)
    return [ctypes.CDLL(str(_path(folder, level))) for level in levels]


def evaluate(code: ctypes.CDLL, kind: str, name: str) -> Values:
    """Return a function of the library, for arrays of a length that all levels divide."""
    function = getattr(code, f"{kind}__{name}")

    def values(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        result = np.zeros(len(x))
        function(*(ctypes.c_void_p(one.ctypes.data) for one in (x, y, result)), ctypes.c_int64(len(x)))
        return result

    return values


if __name__ == "__main__":
    build(Path(sys.argv[1]), [level for level in this_platform().levels if level.name in sys.argv[2:]])
