"""Repeated calls of a kernel with the same bundles, whose addresses and sizes are written into its argument block once.

Checking a mechanism and its working arrays, and writing their arguments, takes a hundred times longer than running a
kernel on a small mechanism. As with `PinnedBundle`, the bundles are not checked. `mbdkit.engine.native.kernel` defines
the layout of the block.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from mbdkit.engine.native.bundle import HEAD, words_of
from mbdkit.engine.native.kernel import DTYPES, Kernel
from mbdkit.engine.native.machine_code import IN_PYTHON, address_of

_CALL = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)


class RepeatedCall:
    """A kernel that returns no results, with fixed first arguments.

    Parameters
    ----------
    kernel
        The kernel.
    bundles
        The first arguments. Their arrays must not be replaced while this object is in use.
    """

    def __init__(self, kernel: Kernel, *bundles: Any):
        self.kernel, self.bundles = kernel, bundles
        self._block: np.ndarray | None = None

    def __call__(self, *arguments: float | np.ndarray) -> None:
        """Call the kernel with further arguments: floats, and arrays of the required types."""
        if IN_PYTHON:
            self.kernel(*self.bundles, *arguments)
            return
        block = self._block if self._block is not None else self._block_for(len(arguments))
        for place, one in enumerate(arguments, self._first):
            if isinstance(one, float):
                self._numbers[place] = one
            else:
                block[place] = id(one) + HEAD
        if self._call(self._address) != 0:
            self.kernel(*self.bundles, *arguments)  # an ordinary call raises the error with its reason

    def _block_for(self, count: int) -> np.ndarray:
        words = [word for bundle in self.bundles for word in words_of(bundle)]
        self._first = len(words)
        self._block = np.array([*words, *[0] * count, *map(id, DTYPES)], dtype=np.int64)
        self._numbers, self._address = self._block.view(np.float64), self._block.ctypes.data
        self._call = _CALL(address_of(self.kernel.symbol))
        return self._block
