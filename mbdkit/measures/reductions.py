"""Functions over time in expressions of measures, and their integrands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbdkit.archive.measured_values import Integrals
from mbdkit.expressions.operations import OF_PARTS, OPERATIONS, REDUCE
from mbdkit.expressions.program import Program, execute
from mbdkit.quantities.quantity import Quantity


@dataclass(frozen=True)
class Series:
    """Quantities of a run over time: at the recorded times, or at the quadrature nodes of integrals.

    Parameters
    ----------
    time
        (T,) times [s].
    of
        Returns the values of a quantity: (T,), (2, T) of a vector, or (elements, T) along a beam.
    """

    time: np.ndarray
    of: Callable[[Quantity], np.ndarray]


def _mean(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the mean over time by the trapezoidal rule; the value itself if there is only one row."""
    duration = time[-1] - time[0]
    return np.trapezoid(values, time, axis=-1) / duration if duration > 0 else values[..., 0]


REDUCTIONS: Mapping[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "max": lambda time, values: np.max(values, axis=-1),
    "min": lambda time, values: np.min(values, axis=-1),
    "mean": _mean,
    "rms": lambda time, values: np.sqrt(_mean(time, values * values)),
    "final": lambda time, values: values[..., -1],
    "integral": lambda time, values: np.trapezoid(values, time, axis=-1),
}
"""Functions of times (T,) and values (..., T) that return a value for all rows together, (...).

``mean``, ``rms`` and ``integral`` use the trapezoidal rule on the recorded rows. In measures of a run, their integrals
are computed with the run instead, by the weights of its method; see `Integrand`.
"""
OF_INTEGRAL: Mapping[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "mean": lambda integral, duration: integral / duration,
    "rms": lambda integral, duration: np.sqrt(integral / duration),
    "integral": lambda integral, duration: integral,
}
"""Reductions as functions of an integral over time, of the square for ``rms``, and of the duration [s]."""


def from_integral(name: str, integral: float | tuple[float, ...], duration: float, values: np.ndarray) -> np.ndarray:
    """Return ``mean``, ``rms`` or ``integral`` of values (..., T) from the integral that was computed with the run."""
    return OF_INTEGRAL[name](np.atleast_1d(integral), duration).reshape(*values.shape[:-1], 1)


@dataclass(frozen=True)
class Integrand:
    """A quantity over time whose integral a measure needs.

    Attributes
    ----------
    text
        The quantity as an expression.
    program, quantities
        See `mbdkit.measures.measure_expression.MeasureExpression`.
    inner
        Inner integrands, as in ``x - mean(x)``, to which reductions of the program refer by their index, from 1.
    """

    text: str
    program: Program
    quantities: tuple[Quantity, ...]
    inner: tuple[Integrand, ...] = ()

    @cached_property
    def is_nested(self) -> bool:
        """Whether it contains other integrals, so that its values are known only at the end of a run."""
        return any(operation.startswith(REDUCE) for operation, _ in self.program)

    @property
    def read(self) -> list[Quantity]:
        """The quantities that it reads."""
        return [self.quantities[int(number)] for operation, number in self.program if operation == "get"]

    def values(self, series: Series, integrals: Integrals, duration: float) -> np.ndarray:
        """Return the values at T times: (T,), or (2, T) for a vector.

        Parameters
        ----------
        integrals
            The integrals of `inner`, by their texts.
        duration
            Duration of the run [s].
        """

        def step(operation: str, number: float, *operands: np.ndarray) -> np.ndarray:
            if operation.startswith(REDUCE):
                integral = integrals[self.inner[int(number) - 1].text]
                return from_integral(operation.removeprefix(REDUCE), integral, duration, *operands)
            return applied(operation, number, operands, self.quantities, series)

        with np.errstate(all="ignore"):
            return execute(self.program, step)


def applied(
    operation: str, number: float, operands: Sequence[np.ndarray], quantities: Sequence[Quantity], series: Series
) -> np.ndarray:
    """Return the value of an instruction that does not reduce over time.

    Values have the shapes (T,) or (1,), those of vectors (2, T) or (2, 1), and those along a beam (elements, T).
    """
    if operation == "const":
        return np.array([number])
    if operation == "t":
        return series.time
    if operation == "get":
        return series.of(quantities[int(number)])
    if operation == "powi":
        return np.asarray(operands[0] ** number)
    return (OF_PARTS.get(operation) or OPERATIONS[operation].array)(*operands)


def interpolated(at: float, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values (..., T) at a time, interpolated linearly between the rows around it, (..., 1); nan outside."""
    if not time[0] <= at <= time[-1]:
        return np.full((*values.shape[:-1], 1), np.nan)
    return np.apply_along_axis(lambda row: np.interp([at], time, row), -1, values)
