"""Elementary functions for code in Python; see `mbdkit.engine.elementary`."""

from __future__ import annotations

from mbdkit.engine.kernels.bundle_types import RealVector
from mbdkit.engine.kernels.elementary import FUNCTIONS
from mbdkit.engine.native.functions import inlined, kernel

CODES = {name: code for code, name in enumerate(FUNCTIONS)}
"""Numbers of the functions."""


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
    _value = _either(CODES[_name], _with_two_arguments(_function), _value)


@kernel
def elementary_value(code: int, x: float, y: float) -> float:
    """Return the value of the function with a code; functions of one argument ignore `y`."""
    return _value(code, x, y)


@kernel
def elementary_values(code: int, x: RealVector, y: RealVector, values: RealVector) -> None:
    """Write the values of the function with a code."""
    for i in range(len(values)):
        values[i] = _value(code, x[i], y[i])
