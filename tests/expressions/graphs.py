"""Recorded functions as tests need them: drawn ones, and their values in any arithmetic and by the kernel."""

from __future__ import annotations

import ctypes
import math
import operator
import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mpmath
import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.kernels.law_programs import _power_of_integer, run_function
from mbdkit.engine.native.calls import LAW
from mbdkit.engine.native.number_arrays import new_duals
from mbdkit.expressions.recorded import Recorded, Recorder

_PLAIN = {
    "add": operator.add, "subtract": operator.sub, "multiply": operator.mul, "divide": operator.truediv,
    "negate": operator.neg, "less": operator.lt, "less_equal": operator.le, "abs": abs, "maximum": max,
    "select": lambda condition, x, y: x if condition else y, "detached": lambda x: x, "root": lambda x, *_: x,
}  # fmt: skip
_SAME = ("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "atan2", "hypot")
FLOATS = _PLAIN | {name: getattr(elementary, name) for name in _SAME}
FLOATS |= {"sqrt": math.sqrt, "power": elementary.pow, "power_of_integer": _power_of_integer}
PRECISE = _PLAIN | {name: getattr(mpmath, name) for name in _SAME}
PRECISE |= {"sqrt": mpmath.sqrt, "power": mpmath.power, "power_of_integer": mpmath.power}


def values(of: Sequence[Recorded], inputs: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]) -> list[Any]:
    """Return the values of all terms that `of` depend on, and then those of `of`, in an arithmetic."""
    recorder, known = of[0].recorder, dict[int, Any]()
    for index in recorder.ancestors(of, operands=lambda term: term.operands[: 1 if term.operation == "root" else None]):
        term = recorder.terms[index]
        if term.operation in ("constant", "input"):
            known[index] = term.data if term.operation == "constant" else inputs[term.data]
            continue
        exponent = (term.data,) if term.operation == "power_of_integer" else ()
        known[index] = functions[term.operation](*(known.get(one) for one in term.operands), *exponent)
    return [known[one.index] for one in of]


def run_block(block: np.ndarray, inputs: Sequence[float], time: float = 0.0) -> np.ndarray:
    """Return the results of a program whose inputs are these numbers and then the time."""
    parameters, results = np.array([len(inputs), *inputs], dtype=float), np.zeros(block[2])
    LAW(run_function.address)(block.ctypes.data, 0.0, 0.0, time, parameters.ctypes.data, results.ctypes.data)
    return results


_LAW_FOR_DUALS = ctypes.CFUNCTYPE(
    None, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)


def run_block_with_duals(block: np.ndarray, inputs: Sequence[float]) -> np.ndarray:
    """Return the results of a program at time 0, each with its derivatives with respect to the inputs."""
    parameters, results, zero = new_duals(1 + len(inputs)), new_duals(block[2]), new_duals(1)
    parameters[:, 0] = [len(inputs), *inputs]
    parameters[1:, 1 : 1 + len(inputs)] = np.eye(len(inputs))
    law, rest = _LAW_FOR_DUALS(run_function.address_for_duals), zero.ctypes.data
    law(block.ctypes.data, rest, rest, 0.0, parameters.ctypes.data, results.ctypes.data)
    return np.asarray(results[:, : 1 + len(inputs)])


NAMES = ("x", "y", "beta", "alpha", "t")
"""Inputs of drawn functions."""
_ONE: tuple[Callable[[Any], Any], ...] = (
    lambda u: -u, lambda u: np.sqrt(1.3 + u * u), lambda u: np.exp(np.sin(u)), lambda u: np.log(1.5 + u * u),
    np.sin, np.cos, lambda u: np.tan(0.9 * np.sin(u)), lambda u: np.arcsin(0.7 * np.sin(u)),
    lambda u: np.arccos(0.7 * np.cos(u)), np.arctan, lambda u: np.sinh(np.sin(u)), lambda u: np.cosh(np.cos(u)),
    np.tanh, lambda u: np.sin(u) ** 3, lambda u: (1.7 + np.sin(u)) ** -2, lambda u: (1.2 + u * u) ** 1.7,
    lambda u: 2.3 ** np.sin(u),
)  # fmt: skip
"""Operations of one operand, each where it is smooth and well conditioned."""
_TWO: tuple[Callable[[Any, Any], Any], ...] = (
    lambda u, v: u + v, lambda u, v: u - v, lambda u, v: u * v, lambda u, v: u / (1.6 + np.cos(v)),
    lambda u, v: (1.4 + np.sin(u)) ** np.cos(v), lambda u, v: np.arctan2(u, 1.2 + v * v),
    lambda u, v: np.arctan2(1.1 + v * v, u), lambda u, v: np.hypot(1.0 + u * u, v),
    lambda u, v: np.where(u < v + 0.01, u * v, np.sin(u)),
)  # fmt: skip


def drawn(recorder: Recorder, numbers: random.Random) -> Recorded:
    """Return a function of up to five inputs with several operations."""
    operands: list[Any] = [recorder.input(numbers.choice(NAMES)) for _ in range(numbers.randint(2, 4))]
    while len(operands) > 1:
        numbers.shuffle(operands)
        operands[:2] = [numbers.choice(_TWO)(*operands[:2])]
        operands[0] = numbers.choice(_ONE)(operands[0])
    return recorder.constant(operands[0])
