"""Values of programs with their first two derivatives, over arrays of arguments, in NumPy.

The engine has compiled kernels for this (`mbdkit.engine.kernels.motions`). This module also finds switches: the
operations, such as ``abs``, that change their form where an argument changes its sign. A derivative may jump there.
"""

from __future__ import annotations

import numpy as np

from mbdkit.base.frozen import dataclass
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

    level: int  #: Depth of nesting of switches; 1 if no operand of this operation contains a switch.
    argument: Jet


def jet_and_switches(program: Program, times: np.ndarray) -> tuple[Jet, list[Switch]]:
    """Return the value and the derivatives of a program at `times` (T,) [s], and its switches.

    The switches are in the order in which their operations are executed.
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
        return (_of_two(operation, *jets) if len(jets) == 2 else _of_one(operation, number, *jets)), level

    with np.errstate(all="ignore"):
        return execute(program, step)[0], switches


_SUB = OPERATIONS["sub"]


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
