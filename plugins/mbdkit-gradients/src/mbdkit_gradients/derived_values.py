"""Values with derivatives with respect to parameters, as NumPy arrays, and the arithmetic of expressions on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.base import elementary
from mbdkit.expressions.operations import OPERATIONS


@dataclass(frozen=True)
class DerivedValue:
    """Values (...) with derivatives (K, ...) with respect to K parameters."""

    value: np.ndarray
    slope: np.ndarray

    @staticmethod
    def constant(value: np.ndarray, count: int) -> DerivedValue:
        """Return values without derivatives."""
        return DerivedValue(value, np.zeros((count, *value.shape)))

    @staticmethod
    def number(value: float, slope: np.ndarray) -> DerivedValue:
        """Return a number (1,) with its derivatives (K,)."""
        return DerivedValue(np.array([value]), slope[:, None])

    @staticmethod
    def joined(x: np.ndarray) -> DerivedValue:
        """Return values and derivatives from one array (..., 1 + K)."""
        return DerivedValue(x[..., 0], np.moveaxis(x[..., 1:], -1, 0))

    def __getitem__(self, index: slice) -> DerivedValue:
        return DerivedValue(self.value[..., index], self.slope[..., index])


def of_operands(operation: str, number: float, *operands: DerivedValue) -> DerivedValue:
    """Return the result of an operation in expressions, with its derivatives.

    `number` is the exponent of ``powi``; other operations do not use it.
    """
    x, *others = operands
    if operation == "norm":
        value = elementary.hypot(x.value[0], x.value[1])
        scale = np.where(value > 0.0, value, 1.0)
        return DerivedValue(value, (x.value[0] * x.slope[:, 0] + x.value[1] * x.slope[:, 1]) / scale)
    if operation in ("along_max", "along_min"):
        index = np.argmax(x.value, axis=0) if operation == "along_max" else np.argmin(x.value, axis=0)
        columns = np.arange(x.value.shape[-1])
        return DerivedValue(x.value[index, columns], x.slope[:, index, columns])
    rule = OPERATIONS[operation].rule
    if others:
        x, other = _aligned(x, others[0])
        value, slope, _ = rule(x.value, x.slope, 0.0, other.value, other.slope, 0.0)
        return DerivedValue(value, slope)
    value, slope, _ = rule(x.value, number) if operation == "powi" else rule(x.value)
    return DerivedValue(value, slope * x.slope)


def _aligned(x: DerivedValue, y: DerivedValue) -> tuple[DerivedValue, DerivedValue]:
    """Return two values with equal numbers of axes, so that a number applies to all components of a vector."""
    axes = max(x.value.ndim, y.value.ndim)

    def widened(value: DerivedValue) -> DerivedValue:
        more = (None,) * (axes - value.value.ndim)
        return DerivedValue(value.value[more], value.slope[(slice(None), *more)])

    return widened(x), widened(y)
