"""Entries: functions that kernels call by address, so that they are compiled independently of their callers.

An entry is a C callback of Numba. Its arguments are two addresses (int) and three numbers (float), and it returns a
status (int). `intrinsic` is public API of Numba; `call_entry` generates its code with the IR builder of
llvmlite.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import cached_property
from typing import Any

from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from mbdkit.engine.jit.cache import FOLDER, cached_cfunc, exists, is_warm, locked, mark
from mbdkit.engine.jit.numba_version import PLAIN

_SIGNATURE = types.int64(types.int64, types.int64, types.float64, types.float64, types.float64)
_OPTIONS: dict[str, Any] = {} if PLAIN else {"_nrt": False}  # see `mbdkit.engine.jit.decorators`
_JIT_DISABLED = vars(config)["DISABLE_JIT"]
_PYTHON_ENTRIES: dict[int, Callable[..., Any]] = {}
"""Entries by address; used only with NUMBA_DISABLE_JIT=1."""


class Entry:
    """A function that kernels call by its address, compiled on first use."""

    def __init__(self, function: Callable[[int, int, float, float, float], int]):
        self.function = function

    @cached_property
    def address(self) -> int:
        """Address of the machine code; the first access compiles it or reads it from the cache."""
        if _JIT_DISABLED:
            _PYTHON_ENTRIES[id(self)] = self.function
            return id(self)
        done = FOLDER / f"entry-{self.function.__module__}.{self.function.__name__}"
        with ExitStack() as stack:
            # While the kernels are compiled, `compiling` already holds the lock. If `done` exists, the entry is only
            # read from the cache, which needs no lock.
            if is_warm() and not exists(done):
                print("mbdkit compiles the kernels of this method; this happens once ...", file=sys.stderr, flush=True)
                stack.enter_context(locked())
            self._compiled = cached_cfunc(_SIGNATURE, error_model="numpy", **_OPTIONS)(self.function)
            mark(done)
        return int(self._compiled.address)


def _call_python(address, first, second, t, h, x):
    return _PYTHON_ENTRIES[address](first, second, t, h, x)


@intrinsic
def _call_compiled(typing_context, address, first, second, t, h, x):
    def generate(context, builder, signature, arguments):
        word, real = ir.IntType(64), ir.DoubleType()
        kind = ir.FunctionType(word, [word, word, real, real, real])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return types.int64(types.int64, types.int64, types.int64, types.float64, types.float64, types.float64), generate


call_entry: Any = _call_python if _JIT_DISABLED else _call_compiled
"""Call the entry at `address` (int64) with its five arguments; returns its status."""
