"""Measures of a run with their derivatives by parameters: the expressions are evaluated on values with derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.expressions.operations import REDUCE
from mbdkit.expressions.program import execute
from mbdkit.gradients.derived_values import Value, of_operands
from mbdkit.gradients.differentiated_run import DifferentiatedRun
from mbdkit.gradients.differentiated_states import quantity_of
from mbdkit.measures.measure_expression import ALONG, MeasureExpression
from mbdkit.measures.reductions import OF_INTEGRAL
from mbdkit.quantities.quantity import Quantity

UNIQUE = 1e-9
"""Two extrema that differ by less than this share of the range of a quantity count as equal."""


@dataclass(frozen=True)
class _Operand:
    """An operand of an expression on the recorded rows, and on the nodes of integrals.

    It is None on the nodes if the integrals of runs use the recorded rows as well (see `mbdkit.runs.integrals`), so
    that a run and its gradient give the same values.
    """

    rows: Value
    nodes: Value | None


def _same(one: Value) -> _Operand:
    return _Operand(one, one)


def uses_nodes(expression: MeasureExpression) -> bool:
    """Return whether a measure is, or contains, an integral over time."""
    return any(operation.removeprefix(REDUCE) in OF_INTEGRAL for operation, _ in expression.program)


class MeasureOfRun:
    """Evaluates measures of one differentiated run.

    Parameters
    ----------
    run
        The run.

    Attributes
    ----------
    doubts
        Warnings about extrema that are not unique, for the measure evaluated last.
    size
        Largest absolute value that the functions over time of this measure were applied to, in its unit.
    """

    def __init__(self, run: DifferentiatedRun):
        self.run = run
        self.count = run.rows.q.shape[-1] - 1
        self.doubts: list[str] = []
        self.size = 0.0

    def of(self, expression: MeasureExpression, constants: np.ndarray | None = None) -> tuple[float, np.ndarray]:
        """Return the value of a measure and its derivatives (K,), in its unit.

        Parameters
        ----------
        constants
            (I, K) derivatives of the numbers of its I instructions; None: zero.
        """
        self.doubts, self.size = [], 0.0
        slopes = iter(np.zeros((len(expression.program), self.count)) if constants is None else constants)

        def step(operation: str, number: float, *operands: _Operand) -> _Operand:
            slope = next(slopes)
            if operation == "const":
                return _same(Value.number(number, slope))
            return self._applied(operation, number, operands, expression)

        with np.errstate(all="ignore"):
            found = execute(expression.program, step).rows
        return float(found.value.reshape(-1)[0]) / expression.unit.factor, (
            found.slope.reshape(self.count, found.value.size)[:, 0] / expression.unit.factor
        )

    def _applied(
        self, operation: str, number: float, operands: Sequence[_Operand], expression: MeasureExpression
    ) -> _Operand:
        """Return the value of an instruction; see `MeasureExpression`."""
        if operation == "t":
            rows = Value.constant(self.run.rows.time, self.count)
            rows.slope[:, -1] = self.run.end
            nodes = self.run.nodes
            return _Operand(rows, None if nodes is None else Value.constant(nodes.time, self.count))
        if operation == "get":
            quantity = expression.quantities[int(number)]
            if quantity.kind == "events":
                return _Operand(self._of_event(quantity), None)
            rows, nodes = quantity_of(self.run.rows, quantity), self.run.nodes
            known = nodes is not None and not quantity.recorded.array.accumulates
            return _Operand(rows, quantity_of(nodes, quantity) if known else None)  # type: ignore[arg-type]
        if operation == REDUCE + "at":
            return _Operand(self._at(operands[1].rows, operands[0].rows), None)
        if operation.startswith(REDUCE):
            name = operation.removeprefix(REDUCE)
            reduced = self._reduced(name, operands[0], expression)
            return _Operand(reduced, reduced if name in OF_INTEGRAL and operands[0].nodes is not None else None)
        if operation in ALONG.values():
            self._note_equal_elements(operation, operands[0].rows, expression)
        on_nodes = [operand.nodes for operand in operands if operand.nodes is not None]
        inner = of_operands(operation, number, *on_nodes) if len(on_nodes) == len(operands) else None
        return _Operand(of_operands(operation, number, *(operand.rows for operand in operands)), inner)

    def _of_event(self, quantity: Quantity) -> Value:
        """Return a quantity of an event: the time of its first or last crossing, or their number."""
        found = [crossing for crossing in self.run.crossings if crossing.name == quantity.name]
        if quantity.attribute == "count":
            return Value.constant(np.array([float(len(found))]), self.count)
        if not found:
            self.doubts.append(f"the event '{quantity.name}' does not happen, so that its time has no derivative")
            return Value.number(np.nan, np.full(self.count, np.nan))
        one = found[0 if quantity.attribute == "time" else -1]
        return Value.number(one.time, one.slope)

    def _at(self, time: Value, operand: Value) -> Value:
        """Return an operand at a time, interpolated linearly between the rows around it."""
        rows, at = self.run.rows.time, float(time.value.reshape(-1)[0])
        if not rows[0] <= at <= rows[-1]:
            return Value.constant(np.full((*operand.value.shape[:-1], 1), np.nan), self.count)
        k = int(np.clip(np.searchsorted(rows, at, side="right") - 1, 0, len(rows) - 2))
        share = (at - rows[k]) / (rows[k + 1] - rows[k])
        rate = (operand.value[..., k + 1] - operand.value[..., k]) / (rows[k + 1] - rows[k])
        value = (1.0 - share) * operand.value[..., k] + share * operand.value[..., k + 1]
        slope = (1.0 - share) * operand.slope[..., k] + share * operand.slope[..., k + 1]
        moved = time.slope.reshape(self.count, time.value.size)[:, 0]
        if k == len(rows) - 2:  # the time of the last row depends on the parameters
            moved = moved - share * self.run.end
        slope = slope + np.multiply.outer(moved, rate)
        return Value(value[..., None], slope[..., None])

    def _reduced(self, name: str, operand: _Operand, expression: MeasureExpression) -> Value:
        """Return an operand reduced over time."""
        rows = operand.rows
        self.size = max(self.size, float(np.max(np.abs(rows.value))) / expression.unit.factor)
        if name == "final":
            return rows[-1:]
        if name in ("max", "min"):
            return self._extremum(name, rows, expression)
        square = name == "rms"
        weight = None if self.run.nodes is None else self.run.nodes.weight
        if operand.nodes is not None and weight is not None:
            values = of_operands("mul", 0.0, operand.nodes, operand.nodes) if square else operand.nodes
            moved = np.moveaxis(values.value @ weight[:, 1:], -1, 0)
            total = Value((values.value @ weight[:, 0])[..., None], (values.slope @ weight[:, 0] + moved)[..., None])
            last = of_operands("mul", 0.0, rows, rows)[-1:].value if square else rows[-1:].value
            total = Value(total.value, total.slope + np.multiply.outer(self.run.end, last))
        else:
            values = of_operands("mul", 0.0, rows, rows) if square else rows
            time = self.run.rows.time
            total = Value(
                np.trapezoid(values.value, time, axis=-1)[..., None],
                np.trapezoid(values.slope, time, axis=-1)[..., None],
            )
            last = 0.5 * (values.value[..., -2:-1] + values.value[..., -1:])
            total = Value(total.value, total.slope + np.multiply.outer(self.run.end, last))
        if name == "integral":
            return total
        duration = self.run.rows.time[-1] - self.run.rows.time[0]
        mean = of_operands("div", 0.0, total, Value(np.array([duration]), self.run.end[:, None]))
        return of_operands("sqrt", 0.0, mean) if square else mean

    def _note_equal_elements(self, operation: str, rows: Value, expression: MeasureExpression) -> None:
        """Add a warning if elements with different derivatives share the extreme value along a beam, over time or at
        the end.
        """
        values = rows.value if operation == "along_max" else -rows.value
        for row in {int(np.argmax(np.max(values, axis=0))), values.shape[1] - 1}:
            near = np.flatnonzero(values[:, row] >= np.max(values[:, row]) - UNIQUE * np.max(np.abs(values)))
            slopes = rows.slope[:, near, row]
            if not np.allclose(slopes, slopes[:, :1], rtol=1e-6, atol=0.0):
                self.doubts.append(
                    f"the elements {near[0]} and {near[-1]} share the extreme value along the beam in "
                    f"'{expression.text}' at t = {self.run.rows.time[row]:.6g} s, so that it has no derivative; name "
                    "an element, as in beams.NAME.moment[0]"
                )

    def _extremum(self, name: str, rows: Value, expression: MeasureExpression) -> Value:
        """Return the largest or smallest value; add a warning if it is not unique."""
        values = rows.value if name == "max" else -rows.value
        index = int(np.argmax(values))
        spread = float(np.max(values) - np.min(values))
        near = np.flatnonzero(values >= values[index] - UNIQUE * spread) if np.isfinite(spread) else np.array([index])
        apart = near[np.abs(near - index) > 1]
        same = np.isclose(rows.slope[:, apart], rows.slope[:, [index]], rtol=1e-6, atol=0.0).all(axis=0)
        if not np.all(same):
            times, apart = self.run.rows.time, apart[~same]
            self.doubts.append(
                f"the {'largest' if name == 'max' else 'smallest'} value in '{expression.text}' is attained at "
                f"several times, such as t = {times[index]:.6g} s and {times[apart[0]]:.6g} s, so that it has no "
                f"derivative; "
                "a p-norm is a smooth maximum: mean(x**8)**(1/8)"
            )
        return rows[index : index + 1]
