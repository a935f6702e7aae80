"""Values of functions of time with their first two derivatives, over arrays of times, in NumPy.

The engine has compiled kernels for this (`mbdkit.engine.kernels.motions`). Here the arguments of ``abs``, ``min``,
``max`` and ``atan2`` are returned as well, whose changes of sign are the corners of a function.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.mechanism.time_expression import Expression
from mbdkit.mechanism.values import Motion, Table

if TYPE_CHECKING:
    from mbdkit.mechanism.time_expression import Program

EPS = float(np.finfo(float).eps)

QUINTIC_ENDS = {
    "natural": ([(3, 0.0), (4, 0.0)], [(3, 0.0), (4, 0.0)]),
    "clamped": ([(1, 0.0), (2, 0.0)], [(1, 0.0), (2, 0.0)]),
}
"""Derivatives of a quintic spline that vanish at its two ends; SciPy has names for the other conditions."""


@dataclass(frozen=True)
class Jet:
    """A function of time at T times: value, rate and acceleration, and a bound of the rounding error of the value."""

    value: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray
    rounding: np.ndarray

    @property
    def derivatives(self) -> np.ndarray:
        """(T, 3) value, rate and acceleration."""
        return np.column_stack([self.value, self.rate, self.acceleration])


@dataclass(frozen=True)
class Switch:
    """An operation that changes its form where `argument` changes sign: ``abs``, ``min``, ``max`` or ``atan2``.

    The argument is that of ``abs``, the difference of the operands of ``min`` and ``max``, and the first one of
    ``atan2``, which jumps if the second one is not positive.
    """

    operation: str
    level: int
    """Number of such operations inside each other, 1 for an innermost one."""
    argument: Jet


def jet_of(motion: Motion, times: np.ndarray) -> Jet:
    """Return a motion at `times` (T,)."""
    if isinstance(motion, str):
        return jet_and_switches(Expression.parse(motion).program, times)[0]
    none = np.zeros(len(times))
    if not isinstance(motion, Table):
        return Jet(none + motion, none, none, none)
    curve = curve_of(motion)
    value = curve(times)
    return Jet(value, curve(times, 1), curve(times, 2), EPS * np.abs(value))


@lru_cache(maxsize=64)
def curve_of(table: Table) -> Any:
    """Return the curve of a table, as ``scipy.interpolate.PPoly``; its outer pieces, or its periods, continue it.

    Raises ValueError or LinAlgError if it cannot be computed in double precision.
    """
    from scipy.interpolate import CubicSpline, PPoly, make_interp_spline

    times, values = (np.array(column) for column in table.table)
    beyond: Any = "periodic" if table.ends == "periodic" else True
    if beyond == "periodic":
        values[-1] = values[0]  # equal to rounding, which `Table` checks
    if table.interpolation == "linear":
        return PPoly(np.array([np.diff(values) / np.diff(times), values[:-1]]), times, extrapolate=beyond)
    if table.interpolation == "cubic":
        return CubicSpline(times, values, bc_type=table.ends, extrapolate=beyond)
    spline = make_interp_spline(times, values, k=5, bc_type=QUINTIC_ENDS.get(table.ends, table.ends))
    curve = PPoly.from_spline(spline)
    # without the five pieces at either end that are empty, or beyond the period
    return PPoly(curve.c[:, 5:-5], curve.x[5:-5], extrapolate=beyond)


def jet_and_switches(program: Program, times: np.ndarray) -> tuple[Jet, list[Switch]]:
    """Return the value of a program at `times` (T,), and its switches in the order of their operations."""
    none = np.zeros(len(times))
    stack: list[tuple[Jet, int]] = []
    switches: list[Switch] = []
    with np.errstate(all="ignore"):
        for operation, number in program:
            if operation == "const":
                stack.append((Jet(none + number, none, none, none), 0))
            elif operation == "t":
                stack.append((Jet(times, none + 1.0, none, none), 0))
            elif operation in ("add", "sub", "mul", "div", "pow", "atan2", "min", "max"):
                b, level_b = stack.pop()
                a, level_a = stack.pop()
                level = max(level_a, level_b)
                if operation in ("atan2", "min", "max"):
                    level += 1
                    switches.append(Switch(operation, level, a if operation == "atan2" else _sum(a, b, -1.0)))
                stack.append((_binary(operation, a, b), level))
            else:
                a, level = stack.pop()
                if operation == "abs":
                    level += 1
                    switches.append(Switch(operation, level, a))
                stack.append((_unary(operation, number, a), level))
    return stack.pop()[0], switches


def _sum(a: Jet, b: Jet, sign: float) -> Jet:
    value = a.value + sign * b.value
    rounding = a.rounding + b.rounding + EPS * np.abs(value)
    return Jet(value, a.rate + sign * b.rate, a.acceleration + sign * b.acceleration, rounding)


def _product(a: Jet, b: Jet) -> Jet:
    value = a.value * b.value
    return Jet(
        value,
        a.rate * b.value + a.value * b.rate,
        a.acceleration * b.value + 2.0 * a.rate * b.rate + a.value * b.acceleration,
        np.abs(a.value) * b.rounding + np.abs(b.value) * a.rounding + EPS * np.abs(value),
    )


def _chained(a: Jet, value: np.ndarray, first: np.ndarray, second: np.ndarray) -> Jet:
    """Return f(a) from f and its first two derivatives by its argument."""
    rounding = np.abs(first) * a.rounding + EPS * np.abs(value)
    return Jet(value, first * a.rate, second * a.rate**2 + first * a.acceleration, rounding)


def _power(a: Jet, n: float | np.ndarray) -> Jet:
    """Return ``a**n`` for a constant exponent; the derivatives of n = 0 and n = 1 would be 0 * inf at 0."""
    x = a.value
    first = np.where(n == 0.0, 0.0, n * x ** (n - 1.0))
    second = np.where((n == 0.0) | (n == 1.0), 0.0, n * (n - 1.0) * x ** (n - 2.0))
    return _chained(a, x**n, first, second)


def _binary(operation: str, a: Jet, b: Jet) -> Jet:
    if operation in ("add", "sub"):
        return _sum(a, b, 1.0 if operation == "add" else -1.0)
    if operation == "mul":
        return _product(a, b)
    if operation == "div":
        return _product(a, _power(b, -1.0))
    if operation in ("min", "max"):
        first = a.value <= b.value if operation == "min" else a.value >= b.value
        return Jet(
            np.where(first, a.value, b.value),
            np.where(first, a.rate, b.rate),
            np.where(first, a.acceleration, b.acceleration),
            np.where(first, a.rounding, b.rounding),
        )
    if operation == "atan2":
        square = a.value**2 + b.value**2
        cross = b.value * a.rate - a.value * b.rate
        turning = b.value * a.acceleration - a.value * b.acceleration
        inward = a.value * a.rate + b.value * b.rate
        value = np.arctan2(a.value, b.value)
        rounding = (np.abs(b.value) * a.rounding + np.abs(a.value) * b.rounding) / square + EPS * np.abs(value)
        return Jet(value, cross / square, turning / square - 2.0 * cross * inward / square**2, rounding)
    if not (b.rate.any() or b.acceleration.any()):
        return _power(a, b.value)
    return _unary("exp", 0.0, _product(b, _unary("log", 0.0, a)))


def _unary(operation: str, number: float, a: Jet) -> Jet:
    x = a.value
    one = np.ones_like(x)
    match operation:
        case "neg":
            return Jet(-x, -a.rate, -a.acceleration, a.rounding)
        case "powi":
            return _power(a, number)
        case "sqrt":
            return _power(a, 0.5)
        case "abs":
            sign = np.where(x >= 0.0, 1.0, -1.0)
            return Jet(np.abs(x), sign * a.rate, sign * a.acceleration, a.rounding)
        case "sin":
            return _chained(a, np.sin(x), np.cos(x), -np.sin(x))
        case "cos":
            return _chained(a, np.cos(x), -np.sin(x), -np.cos(x))
        case "tan":
            f = np.tan(x)
            return _chained(a, f, 1.0 + f * f, 2.0 * f * (1.0 + f * f))
        case "asin":
            d = 1.0 / np.sqrt(1.0 - x * x)
            return _chained(a, np.arcsin(x), d, x * d**3)
        case "acos":
            d = 1.0 / np.sqrt(1.0 - x * x)
            return _chained(a, np.arccos(x), -d, -x * d**3)
        case "atan":
            d = 1.0 / (1.0 + x * x)
            return _chained(a, np.arctan(x), d, -2.0 * x * d * d)
        case "exp":
            f = np.exp(x)
            return _chained(a, f, f, f)
        case "log":
            return _chained(a, np.log(x), one / x, -one / x**2)
        case "tanh":
            f = np.tanh(x)
            return _chained(a, f, 1.0 - f * f, -2.0 * f * (1.0 - f * f))
    raise ValueError(f"unknown operation {operation!r}")
