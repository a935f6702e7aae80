"""Repeated calls of a kernel, most of whose arguments are written into its argument block once.

Checking a mechanism and its working arrays, and writing their arguments, takes a hundred times longer than running a
kernel on a small mechanism; writing arrays takes as long as running it. As with `PinnedBundle`, the arguments are not
checked. `mbdkit.engine.native.kernel` defines the layout of the block.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np

from mbdkit.engine.native.bundle import HEAD, words_of
from mbdkit.engine.native.kernel import DTYPES, Kernel
from mbdkit.engine.native.machine_code import IN_PYTHON, address_of

_CALL = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)


class RepeatedCall:
    """A kernel with fixed arguments, for calls from one thread at a time.

    `kernel`: the kernel; it returns no result, or one number. `arguments`: all arguments: integers, arrays and bundles,
    and None for each one that is given anew in each call. The arrays must not be replaced while this object is in use.
    """

    def __init__(self, kernel: Kernel, *arguments: Any):
        self.kernel, self.arguments = kernel, arguments
        self._address = 0

    def __call__(self, *given: float | np.ndarray) -> Any:
        """Call the kernel with the arguments that are not fixed: floats, and arrays of the required types."""
        if IN_PYTHON:
            return self._ordinary(given)
        if not self._address:
            self._prepare()
        for position, value in zip(self._open, given, strict=True):
            if isinstance(value, float):
                self._numbers[position] = value
            else:
                self._words[position] = id(value) + HEAD
        if self._call(self._address) != 0:
            return self._ordinary(given)  # raises the error with its reason
        return self._results[-1]

    def _ordinary(self, given: tuple[object, ...]) -> object:
        rest = iter(given)
        return self.kernel(*(next(rest) if argument is None else argument for argument in self.arguments))

    def _prepare(self) -> None:
        words: list[int] = []
        self._open = []
        for argument in self.arguments:
            if argument is None:
                self._open.append(len(words))
                words.append(0)
            elif isinstance(argument, tuple):
                words += words_of(argument)
            else:
                words.append(id(argument) + HEAD if isinstance(argument, np.ndarray) else int(argument))
        words += [*map(id, DTYPES), 0]
        self._words = (ctypes.c_int64 * len(words))(*words)
        self._numbers = (ctypes.c_double * len(words)).from_buffer(self._words)
        self._results: Any = self._numbers if self.kernel.results == (float,) else self._words
        self._address = ctypes.addressof(self._words)
        self._call = _machine_code(self.kernel)


@cache
def _machine_code(kernel: Kernel) -> Any:
    return _CALL(address_of(kernel.symbol))
