"""Measures of a run with their derivatives by parameters: the same expressions, on values with derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from mbdkit.errors import SpecError
from mbdkit.events.event_expression import Quantity
from mbdkit.gradients.differentiated_run import DifferentiatedRun, States
from mbdkit.measures.measure_expression import REDUCE, MeasureExpression
from mbdkit.measures.measured_quantities import component_of

OF_NODES = ("integral", "mean", "rms")
"""Reductions that are integrals over time, by the weights of the method at the stages of its steps."""

UNIQUE = 1e-9
"""Two extrema that differ by less than this share of the range of a quantity count as equal."""


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
    def joined(x: np.ndarray) -> Value:
        """Return values and derivatives from one array (..., 1 + K)."""
        return Value(x[..., 0], np.moveaxis(x[..., 1:], -1, 0))

    def chained(self, value: np.ndarray, slope: np.ndarray) -> Value:
        """Return a function of these values, from its own value and its derivative."""
        return Value(value, slope * self.slope)

    def __getitem__(self, index: slice) -> Value:
        return Value(self.value[..., index], self.slope[..., index])


@dataclass(frozen=True)
class _Operand:
    """An operand of an expression on the recorded rows, and on the nodes of integrals, where that is known."""

    rows: Value
    nodes: Value | None


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


def uses_nodes(expression: MeasureExpression) -> bool:
    """Return whether a measure is, or contains, an integral over time."""
    return any(operation.removeprefix(REDUCE) in OF_NODES for operation, _ in expression.program)


class MeasureOfRun:
    """Evaluates measures of one differentiated run.

    Parameters
    ----------
    run
        The run.

    Attributes
    ----------
    doubts
        Sentences on extrema that are not unique, by their expression.
    """

    def __init__(self, run: DifferentiatedRun):
        self.run = run
        self.count = run.rows.q.shape[-1] - 1
        self.doubts: list[str] = []

    def of(self, expression: MeasureExpression) -> tuple[float, np.ndarray]:
        """Return the value of a measure and its derivatives (K,), in its unit."""
        stack: list[_Operand] = []
        self.doubts = []
        with np.errstate(all="ignore"):
            for operation, number in expression.program:
                self._execute(operation, number, stack, expression)
        found = stack.pop().rows
        return float(found.value.reshape(-1)[0]) / expression.unit.factor, (
            found.slope.reshape(self.count, found.value.size)[:, 0] / expression.unit.factor
        )

    def _execute(self, operation: str, number: float, stack: list[_Operand], expression: MeasureExpression) -> None:
        """Apply an instruction to the stack; see `MeasureExpression`."""
        if operation == "const":
            one = Value.constant(np.array([number]), self.count)
            stack.append(_Operand(one, one))
        elif operation == "t":
            rows, nodes = self.run.rows.time, self.run.nodes.time
            stack.append(_Operand(Value.constant(rows, self.count), Value.constant(nodes, self.count)))
        elif operation == "get":
            quantity = expression.quantities[int(number)]
            known = quantity.attribute not in ("work", "dissipated", "balance")
            nodes_of = quantity_of(self.run.nodes, quantity) if known else None
            stack.append(_Operand(quantity_of(self.run.rows, quantity), nodes_of))
        elif operation == REDUCE + "at":
            time, operand = stack.pop().rows, stack.pop().rows
            one = self._at(time, operand)
            stack.append(_Operand(one, one))
        elif operation.startswith(REDUCE):
            one = self._reduced(operation.removeprefix(REDUCE), stack.pop(), expression)
            stack.append(_Operand(one, one))
        elif operation in _BINARY:
            right, left = stack.pop(), stack.pop()
            function = _BINARY[operation]
            known_there = left.nodes is not None and right.nodes is not None
            inner = function(left.nodes, right.nodes) if known_there else None  # type: ignore[arg-type]
            stack.append(_Operand(function(left.rows, right.rows), inner))
        else:
            given = stack.pop()
            inner = None if given.nodes is None else _of_one(operation, number, given.nodes)
            stack.append(_Operand(_of_one(operation, number, given.rows), inner))

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
        slope = slope + np.multiply.outer(moved, rate)
        return Value(value[..., None], slope[..., None])

    def _reduced(self, name: str, operand: _Operand, expression: MeasureExpression) -> Value:
        """Return an operand reduced over time."""
        rows = operand.rows
        if name == "final":
            return rows[-1:]
        if name in ("max", "min"):
            return self._extremum(name, rows, expression)
        square = name == "rms"
        if operand.nodes is not None:
            values = _product(operand.nodes, operand.nodes) if square else operand.nodes
            weight = self.run.nodes.weight
            assert weight is not None
            total = Value((values.value @ weight)[..., None], (values.slope @ weight)[..., None])
        else:
            values = _product(rows, rows) if square else rows
            time = self.run.rows.time
            total = Value(
                np.trapezoid(values.value, time, axis=-1)[..., None],
                np.trapezoid(values.slope, time, axis=-1)[..., None],
            )
        if name == "integral":
            return total
        duration = self.run.rows.time[-1] - self.run.rows.time[0]
        mean = Value(total.value / duration, total.slope / duration)
        return _of_one("sqrt", 0.0, mean) if square else mean

    def _extremum(self, name: str, rows: Value, expression: MeasureExpression) -> Value:
        """Return the largest or smallest value; note where that is not unique."""
        values = rows.value if name == "max" else -rows.value
        place = int(np.argmax(values))
        spread = float(np.max(values) - np.min(values))
        near = np.flatnonzero(values >= values[place] - UNIQUE * spread) if np.isfinite(spread) else np.array([place])
        apart = near[np.abs(near - place) > 1]
        if len(apart) and not np.allclose(rows.slope[:, apart[0]], rows.slope[:, place], rtol=1e-6, atol=0.0):
            times = self.run.rows.time
            self.doubts.append(
                f"the {'largest' if name == 'max' else 'smallest'} value in '{expression.text}' is taken at several "
                f"times, such as t = {times[place]:.6g} s and {times[apart[0]]:.6g} s, so that it has no derivative; "
                "a p-norm is a smooth maximum: mean(x**8)**(1/8)"
            )
        return rows[place : place + 1]


def _of_one(operation: str, number: float, x: Value) -> Value:
    """Apply a function of one operand."""
    if operation == "norm":
        return _norm(x)
    if operation == "powi":
        slope = np.zeros(x.value.shape) if number == 0.0 else number * x.value ** (number - 1.0)
        return x.chained(x.value**number, slope)
    function, derivative = _SLOPES[operation]
    return x.chained(function(x.value), derivative(x.value))


def quantity_of(states: States, quantity: Quantity) -> Value:
    """Return a quantity of states with derivatives: (T,), or (2, T) of a vector.

    Raises
    ------
    SpecError
        If it has no derivative.
    """
    column, component, is_vector = component_of(quantity)
    found = _columns(states, quantity)
    if column not in found:
        redundant = quantity.kind == "joints" and states.workspace.mechanism.redundancy.rows
        why = ", because redundant joints share their reactions" if redundant else ""
        what = ".".join(filter(None, (quantity.kind, quantity.name, quantity.attribute)))
        raise SpecError(f"{what} has no derivative by parameters{why}", key="measures")
    x = found[column]()
    if is_vector:
        return Value.joined(np.moveaxis(x[:, :2], 1, 0))
    return Value.joined(x if component is None else x[:, component])


def _columns(states: States, quantity: Quantity) -> Mapping[str, Callable[[], np.ndarray]]:
    """Return functions that give the columns of the element of a quantity, by name, (T, ..., 1 + K)."""
    mechanism, observed = states.workspace.mechanism, states.observed
    if quantity.kind == "bodies":
        first = 3 * mechanism.bodies.index(quantity.name)
        place, angle = slice(first, first + 2), first + 2
        return {
            "position": lambda: states.q[:, place],
            "angle": lambda: states.q[:, angle],
            "velocity": lambda: states.v[:, place],
            "angular_velocity": lambda: states.v[:, angle],
            "acceleration": lambda: observed.acc[:, place],
            "angular_acceleration": lambda: observed.acc[:, angle],
        }
    if quantity.kind == "joints":
        return _of_joint(states, mechanism.joints.index(quantity.name))
    if quantity.kind == "forces":
        f = [one.name for one in mechanism.forces].index(quantity.name)
        return {name: partial(_part, observed.forces, f, i) for i, name in enumerate(_FORCE_COLUMNS)}
    if quantity.kind == "markers":
        k = [name for name, _ in mechanism.markers].index(quantity.name)
        return {
            "position": lambda: observed.markers[:, k, :2],
            "velocity": lambda: observed.markers[:, k, 2:],
        }
    return _energies(states)


_FORCE_COLUMNS = ("length", "rate", "value", "power", "potential")


def _part(x: np.ndarray, element: int, part: int | slice) -> np.ndarray:
    return np.asarray(x[:, element, part])


def _of_joint(states: States, j: int) -> Mapping[str, Callable[[], np.ndarray]]:
    """Return the columns of joint `j`; only its coordinate if redundant joints share their reactions."""
    joints = states.observed.joints
    if states.workspace.mechanism.redundancy.rows:
        return {"angle": partial(_part, joints, j, 0)}
    return {
        "angle": partial(_part, joints, j, 0),
        "driver_power": partial(_part, joints, j, 1),
        "reaction_force": lambda: _part(states.reactions, j, slice(0, 2)),
        "reaction_torque": lambda: _part(states.reactions, j, 2),
        "reaction_force_first": partial(_part, joints, j, slice(2, 4)),
        "reaction_force_second": partial(_part, joints, j, slice(4, 6)),
    }


def _energies(states: States) -> Mapping[str, Callable[[], np.ndarray]]:
    observed, energy = states.observed, states.energy

    def total() -> np.ndarray:
        return np.asarray(observed.kinetic + observed.potential)

    found: dict[str, Callable[[], np.ndarray]] = {
        "kinetic": lambda: observed.kinetic,
        "potential": lambda: observed.potential,
        "total": total,
    }
    if energy is not None:
        found["work"] = lambda: energy[:, 0]
        found["dissipated"] = lambda: energy[:, 1]
        found["balance"] = lambda: total() + energy[:, 1] - energy[:, 0] - total()[:1]
    return found
