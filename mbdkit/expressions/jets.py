"""Values of programs with their first two derivatives, over arrays of arguments, in NumPy.

The engine has compiled kernels for this (`mbdkit.engine.kernels.motions`). This module also finds switches: the
operations, such as ``abs``, that change their form where an argument changes its sign. A derivative may jump there. It
also may where an operand of an operation such as ``sqrt`` or ``asin`` has a zero or an extremum (`SHARP`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.expressions.operations import OPERATIONS, Operation
from mbdkit.expressions.program import Program, execute

EPS = float(np.finfo(float).eps)


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
    """An operation that changes its form where `argument` changes its sign; see `mbdkit.expressions.operations`.

    The operation ``atan2`` has a jump at such a point only if its second operand is not positive.
    """

    level: int
    """Depth of nesting of switches; 1 if no operand of this operation contains a switch."""
    argument: Jet


SHARP = dict.fromkeys(("pow", "powi", "asin", "acos", "atan", "exp", "log", "sqrt", "tanh"), 0) | {
    "div": 1,
    "tan": None,
}
"""Operations that may have a corner, a pole, or a feature far shorter than those of their operand, such as the pulse
``exp(-(t/1e-6)**2)``, at zeros and extrema of the operand with this index; ``tan`` has poles.
"""

LARGEST_POWER = 8
"""Exponents of powers up to this one, from 0 on, have no features shorter than those of their operand."""


def is_sharp(name: str, number: float) -> bool:
    """Return whether an operation may have corners or short features at zeros and extrema of its operand."""
    return name in SHARP and not (name == "powi" and 0 <= number <= LARGEST_POWER)


def jet_and_switches(program: Program, times: np.ndarray, *, sharp: bool = False) -> tuple[Jet, list[Switch]]:
    """Return the value and the derivatives of a program at `times` (T,) [s], and its switches.

    The switches are in the order in which their operations are executed. If `sharp`, they include the zeros and extrema
    of the operands of sharp operations.
    """
    none = np.zeros(len(times))
    switches: list[Switch] = []

    def step(name: str, number: float, *operands: tuple[Jet, int]) -> tuple[Jet, int]:
        if name == "const":
            return Jet(none + number, none, none, none), 0
        if name == "t":
            return Jet(times, none + 1.0, none, none), 0
        operation = OPERATIONS[name]
        jets = [jet for jet, _ in operands]
        level = max(level for _, level in operands)
        if operation.switch:
            level += 1
            switches.append(Switch(level, jets[0] if operation.switch == "first" else _of_two(_SUB, *jets)))
        jet = _of_two(operation, *jets) if len(jets) == 2 else _of_one(operation, number, *jets)
        if sharp and is_sharp(name, number):
            level += 1
            index = SHARP[name]
            x = _of_two(_DIV, Jet(none + 1.0, none, none, none), jet) if index is None else jets[index]
            rate = Jet(x.rate, x.acceleration, none, EPS * np.abs(x.rate))
            switches.extend([Switch(level, x), Switch(level, rate)])
        return jet, level

    with np.errstate(all="ignore"):
        return execute(program, step)[0], switches


_SUB, _DIV = OPERATIONS["sub"], OPERATIONS["div"]


def _of_one(operation: Operation, number: float, a: Jet) -> Jet:
    value, d1, d2 = operation.rule(a.value, number) if operation.name == "powi" else operation.rule(a.value)
    rounding = np.abs(d1) * a.rounding + operation.roundings * EPS * np.abs(value)
    return Jet(value, d1 * a.rate, d2 * a.rate * a.rate + d1 * a.acceleration, rounding)


def _of_two(operation: Operation, a: Jet, b: Jet) -> Jet:
    jet = operation.rule(a.value, a.rate, a.acceleration, b.value, b.rate, b.acceleration)
    rounding = operation.roundings * EPS * np.abs(jet[0])
    for error, a1, b1 in ((a.rounding, 1.0, 0.0), (b.rounding, 0.0, 1.0)):
        if error.any():
            rounding = rounding + np.abs(operation.rule(a.value, a1, 0.0, b.value, b1, 0.0)[1]) * error
    return Jet(*jet, rounding)
