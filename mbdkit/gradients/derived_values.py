"""Values with derivatives by parameters, as NumPy arrays, and the arithmetic of expressions on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Value:
    """Values (...) with derivatives (K, ...) by K parameters."""

    value: np.ndarray
    slope: np.ndarray

    @staticmethod
    def constant(value: np.ndarray, count: int) -> Value:
        """Return values without derivatives."""
        return Value(value, np.zeros((count, *value.shape)))

    @staticmethod
    def number(value: float, slope: np.ndarray) -> Value:
        """Return a number (1,) with its derivatives (K,)."""
        return Value(np.array([value]), slope[:, None])

    @staticmethod
    def joined(x: np.ndarray) -> Value:
        """Return values and derivatives from one array (..., 1 + K)."""
        return Value(x[..., 0], np.moveaxis(x[..., 1:], -1, 0))

    def chained(self, value: np.ndarray, slope: np.ndarray) -> Value:
        """Return a function of these values, from its own value and its derivative."""
        return Value(value, slope * self.slope)

    def __getitem__(self, index: slice) -> Value:
        return Value(self.value[..., index], self.slope[..., index])


def _product(x: Value, y: Value) -> Value:
    return Value(x.value * y.value, x.slope * y.value + x.value * y.slope)


def _quotient(x: Value, y: Value) -> Value:
    value = x.value / y.value
    return Value(value, (x.slope - value * y.slope) / y.value)


def _power(x: Value, y: Value) -> Value:
    value = np.power(x.value, y.value)
    by_base = np.where(y.value == 0.0, 0.0, y.value * np.power(x.value, y.value - 1.0))
    slope = by_base * x.slope
    if np.any(y.slope):
        slope = slope + value * np.log(x.value) * y.slope
    return Value(value, slope)


def _angle(y: Value, x: Value) -> Value:
    square = x.value**2 + y.value**2
    return Value(np.arctan2(y.value, x.value), (x.value * y.slope - y.value * x.slope) / square)


def _chosen(is_first: np.ndarray, x: Value, y: Value) -> Value:
    return Value(np.where(is_first, x.value, y.value), np.where(is_first, x.slope, y.slope))


_BINARY: Mapping[str, Callable[[Value, Value], Value]] = {
    "add": lambda x, y: Value(x.value + y.value, x.slope + y.slope),
    "sub": lambda x, y: Value(x.value - y.value, x.slope - y.slope),
    "mul": _product,
    "div": _quotient,
    "pow": _power,
    "atan2": _angle,
    "min": lambda x, y: _chosen(x.value <= y.value, x, y),
    "max": lambda x, y: _chosen(x.value >= y.value, x, y),
}


def _norm(x: Value) -> Value:
    value = np.hypot(x.value[0], x.value[1])
    scale = np.where(value > 0.0, value, 1.0)
    return Value(value, (x.value[0] * x.slope[:, 0] + x.value[1] * x.slope[:, 1]) / scale)


def _extreme(place: np.ndarray, x: Value) -> Value:
    """Return, of values (E, T), that of the element `place` (T,) in each column."""
    columns = np.arange(x.value.shape[-1])
    return Value(x.value[place, columns], x.slope[:, place, columns])


_SLOPES: Mapping[str, tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]] = {
    "neg": (np.negative, lambda x: np.full(x.shape, -1.0)),
    "sin": (np.sin, np.cos),
    "cos": (np.cos, lambda x: -np.sin(x)),
    "tan": (np.tan, lambda x: 1.0 + np.tan(x) ** 2),
    "asin": (np.arcsin, lambda x: 1.0 / np.sqrt(1.0 - x * x)),
    "acos": (np.arccos, lambda x: -1.0 / np.sqrt(1.0 - x * x)),
    "atan": (np.arctan, lambda x: 1.0 / (1.0 + x * x)),
    "exp": (np.exp, np.exp),
    "log": (np.log, lambda x: 1.0 / x),
    "sqrt": (np.sqrt, lambda x: 0.5 / np.sqrt(x)),
    "abs": (np.abs, np.sign),
    "tanh": (np.tanh, lambda x: 1.0 - np.tanh(x) ** 2),
}
"""Functions of one number with their derivatives."""


def of_one(operation: str, number: float, x: Value) -> Value:
    """Apply a function of one operand."""
    if operation == "norm":
        return _norm(x)
    if operation in ("along_max", "along_min"):
        place = np.argmax(x.value, axis=0) if operation == "along_max" else np.argmin(x.value, axis=0)
        return _extreme(place, x)
    if operation == "powi":
        slope = np.zeros(x.value.shape) if number == 0.0 else number * x.value ** (number - 1.0)
        return x.chained(x.value**number, slope)
    function, derivative = _SLOPES[operation]
    return x.chained(function(x.value), derivative(x.value))


def of_two(operation: str, x: Value, y: Value) -> Value:
    """Apply a function of two operands."""
    return _BINARY[operation](x, y)


IS_BINARY = frozenset(_BINARY)
"""Operations of two operands."""
