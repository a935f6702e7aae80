"""Compiles the functions of time and of angles of a mechanism to programs for kernels."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from mbdkit.base.traced_numbers import as_float
from mbdkit.engine.kernels.motions import OPCODES
from mbdkit.expressions.parser import Expression
from mbdkit.expressions.program import Program, derivative_of
from mbdkit.mechanism.angle_function import AngleFunction, Center, expression_of
from mbdkit.mechanism.state_values import is_of_state
from mbdkit.mechanism.values import Motion, Table, curve_of


class CompiledMotions:
    """Collects the programs of all motions of a mechanism in flat lists. Equal motions share one program.

    A program is a list of operations with constants, see `mbdkit.engine.kernels.motions`. The programs of moving
    centers come last.
    """

    def __init__(self) -> None:
        self.numbers: dict[Motion, int] = {}
        self.start, self.ops, self.constants = [0], [], []  # type: list[int], list[int], list[float]
        self.tables: list[float] = []

    def add(self, motion: Motion) -> int:
        """Return the index of the program of a motion; a motion that equals an earlier one is not compiled again."""
        if motion not in self.numbers:
            self.numbers[motion] = self._append(self._program(motion))
        return self.numbers[motion]

    def add_center(self, center: Center) -> int:
        """Append the programs of both components of a moving centre and of their derivatives; return the index of the
        first.
        """
        first = len(self.start) - 1
        for _, function in center.functions:
            for derivative in (False, True):
                self._append(self._function_of_angle(function, derivative))
        return first

    def _append(self, program: Program) -> int:
        self.ops += [OPCODES[name] for name, _ in program]
        self.constants += [as_float(value) for _, value in program]
        self.start.append(len(self.ops))
        return len(self.start) - 2

    def _function_of_angle(self, function: AngleFunction, derivative: bool) -> Program:
        if isinstance(function, str):
            program = expression_of(function).program
            return derivative_of(program) if derivative else program
        if not isinstance(function, Table):
            return (("const", 0.0 if derivative else as_float(function)),)
        return self._table(function, derivative=derivative)

    def _table(self, table: Table, *, derivative: bool = False) -> Program:
        begin = len(self.tables)
        self.tables += _piecewise_polynomial(table, derivative=derivative)
        return (("table", float(begin)),)

    def _program(self, motion: Motion) -> Program:
        if is_of_state(motion):
            return (("const", 0.0),)  # placeholder; kernels compute the value from the state
        if isinstance(motion, str):
            return Expression.parse(motion).program
        if not isinstance(motion, Table):
            return (("const", as_float(motion)),)
        return self._table(motion)

    @property
    def values(self) -> list[float]:
        """The constants of the programs, followed by the numbers of the tables.

        The constant of a ``table`` operation is the index at which the table begins in this list.
        """
        ops = zip(self.ops, self.constants, strict=True)
        return [x + len(self.ops) if op == OPCODES["table"] else x for op, x in ops] + self.tables


def _piecewise_polynomial(table: Table, *, derivative: bool) -> list[float]:
    """Return the curve of a table, or its derivative, as the list of numbers that kernels read.

    The list contains the number of pieces, the number of coefficients of each piece, the period, the times (or angles)
    at which pieces begin and end, and the coefficients of each piece, those of the highest power last. All coefficients
    are nan if no curve passes through the points.
    """
    times = np.array(table.table[0])
    coefficients = np.full((len(times) - 1, 4), np.nan)  # stays if there is no curve; `check_motions` reports it
    with np.errstate(all="ignore"), suppress(ValueError, np.linalg.LinAlgError):
        curve = curve_of(table).derivative() if derivative else curve_of(table)
        if np.all(np.isfinite(curve.c)):
            times, coefficients = curve.x, curve.c[::-1].T
    pieces, terms = coefficients.shape
    return [float(pieces), float(terms), table.period, *times.tolist(), *coefficients.ravel().tolist()]
