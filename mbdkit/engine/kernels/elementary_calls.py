"""Elementary functions for code in Python; see `mbdkit.base.elementary`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mbdkit.engine.kernels.bundle_types import RealVector
from mbdkit.engine.kernels.elementary import FUNCTIONS
from mbdkit.engine.native.functions import inlined, kernel

_CODES = {name: code for code, name in enumerate(FUNCTIONS)}


def functions_of_numbers() -> Mapping[str, Callable[..., float]]:
    """Return the functions of numbers by name: their sources, which Python runs faster than it calls machine code."""
    return FUNCTIONS


def values_of(name: str, x: np.ndarray, y: np.ndarray | None = None) -> np.ndarray:
    """Return the values of a function of arrays, which are broadcast."""
    if y is None:
        y = x
    elif x.shape != y.shape:
        x, y = np.broadcast_arrays(x, y)
    values = np.empty(x.shape)
    elementary_values(_CODES[name], x.ravel(), y.ravel(), values.reshape(-1))
    return values


def _with_two_arguments(function):
    if function.__code__.co_argcount == 2:
        return function
    return inlined(lambda x, y: function(x))


def _either(own_code, own, others):
    def apply(code, x, y):
        if code == own_code:
            return own(x, y)
        return others(code, x, y)

    return inlined(apply)


@inlined
def _value(code, x, y):
    return x + y


for _name, _function in FUNCTIONS.items():
    _value = _either(_CODES[_name], _with_two_arguments(_function), _value)


@kernel
def elementary_values(code: int, x: RealVector, y: RealVector, values: RealVector) -> None:
    """Write the values of the function with a code; functions of one argument ignore `y`."""
    for i in range(len(values)):
        values[i] = _value(code, x[i], y[i])
