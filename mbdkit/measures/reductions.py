"""Functions over time in expressions of measures, and the integrals and extrema that they need."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from mbdkit.archive.measured_values import Integrals
from mbdkit.base import elementary
from mbdkit.base.frozen import dataclass
from mbdkit.expressions.operations import OF_PARTS, OPERATIONS, REDUCE
from mbdkit.expressions.program import Program, execute
from mbdkit.integrators.interface import closeness
from mbdkit.quantities.quantity import Quantity


@dataclass(frozen=True)
class Series:
    """Quantities of a run over time, at the recorded times or at other times of its motion.

    `time`: (T,) times [s]. `of`: function that returns the values of a quantity: (T,), (2, T) for a vector, or
    (elements, T) along a beam.
    """

    time: np.ndarray
    of: Callable[[Quantity], np.ndarray]


def _mean(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    duration = time[-1] - time[0]
    return np.trapezoid(values, time, axis=-1) / duration if duration > 0 else values[..., 0]


#: Reductions: functions of times (T,) and values (..., T) that return one value for all rows, (...).
#:
#: ``mean``, ``rms`` and ``integral`` use the trapezoidal rule on the recorded rows. Where possible, measures use
#: integrals and extrema of the continuous motion instead, which are computed during the run; see `Functional`.
REDUCTIONS: Mapping[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "max": lambda time, values: np.max(values, axis=-1),
    "min": lambda time, values: np.min(values, axis=-1),
    "mean": _mean,
    "rms": lambda time, values: np.sqrt(_mean(time, values * values)),
    "final": lambda time, values: values[..., -1],
    "integral": lambda time, values: np.trapezoid(values, time, axis=-1),
}
#: Reductions as functions of the value of a `Functional` and of the duration [s].
#:
#: For ``rms``, the functional is the integral of the square.
OF_FUNCTIONAL: Mapping[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "mean": lambda integral, duration: integral / duration,
    "rms": lambda integral, duration: np.sqrt(integral / duration),
    "integral": lambda integral, duration: integral,
    "max": lambda extremum, duration: extremum,
    "min": lambda extremum, duration: extremum,
    "at": lambda value, duration: value,
}
EXTREMA = ("max", "min")
INTEGRALS = ("mean", "rms", "integral")
#: Values at one time: before a discontinuity there, and after it. In programs, both are ``at``; the `Functional` tells
#: which one it is.
VALUES = ("at", "after")

#: Function that returns a quantity of an event, such as the time of its first crossing.
EventTimes = Callable[[Quantity], float]


def from_functional(name: str, value: float | tuple[float, ...], duration: float, values: np.ndarray) -> np.ndarray:
    """Return a reduction of values (..., T), given the functional that was computed during the run."""
    result = OF_FUNCTIONAL[name](np.atleast_1d(value), duration)[:, None]
    return np.broadcast_to(result if len(result) > 1 else result[0], (*values.shape[:-1], 1))


@dataclass(frozen=True)
class Functional:
    """An integral over time, an extremum, or a value at a given time, which a measure needs.

    - `text`: key of the functional: the integrand as an expression, or ``max(...)``, ``min(...)``, ``at(...)`` or
      ``after(...)`` of an expression.
    - `reduction`: ``integral``, ``max``, ``min``, ``at`` or ``after``.
    - `program`, `quantities`: the quantity over time; see `mbdkit.measures.measure_expression.MeasureExpression`.
    - `inner`: inner functionals, as in ``x - mean(x)``, to which reductions of the program refer by their index, from
      1.
    - `when`: for ``at`` and ``after``, the time of the value, which may depend on inner functionals and on the times of
      events.
    """

    text: str
    reduction: str
    program: Program
    quantities: tuple[Quantity, ...]
    inner: tuple[Functional, ...] = ()
    when: Program = ()

    @property
    def is_value(self) -> bool:
        """Whether this is a value at a given time."""
        return self.reduction in VALUES

    def is_given_by(self, time: float, begin: float, end: float) -> bool:
        """Return whether a value at a time is that of the motion from `begin` to `end` [s].

        At a discontinuity, where one part of the motion ends and another one begins, ``at`` is the value at the end of
        the first, and ``after`` the value at the start of the second. There is no value after the end of a run.
        """
        near = closeness(time)
        if self.reduction == "after":
            return begin - near <= time < end - near
        return begin <= time <= end + near

    @property
    def is_extremum(self) -> bool:
        """Whether this is an extremum."""
        return self.reduction in EXTREMA

    @cached_property
    def is_nested(self) -> bool:
        """Whether it depends on other functionals or on events, so that it can be computed only at the end of a run."""
        return any(operation.startswith(REDUCE) or operation == "get" for operation, _ in self.when) or any(
            operation.startswith(REDUCE) for operation, _ in self.program
        )

    @cached_property
    def has_switches(self) -> bool:
        """Whether an operation, such as ``abs`` or ``max``, may change its form inside steps.

        Where the form changes, the quantity or its derivative may be discontinuous.
        """
        return not any(quantity.recorded.array.is_of_steps for quantity in self.read) and any(
            operation in OF_PARTS or (operation in OPERATIONS and OPERATIONS[operation].switch != "")
            for operation, _ in self.program
        )

    @property
    def is_of_stages(self) -> bool:
        """Whether it is an integral computed as a weighted sum over the stages of the steps.

        The weights assume a smooth integrand.
        """
        return not self.is_extremum and not self.is_value and not self.has_switches

    @property
    def read(self) -> list[Quantity]:
        """The quantities that the program reads."""
        return [self.quantities[int(number)] for operation, number in self.program if operation == "get"]

    def time(self, known: Integrals, span: tuple[float, float], events: EventTimes) -> float:
        """Return the time [s] at which this functional takes the value of its quantity, if it is a value at one time.

        `known`: values of the functionals in `inner`, by their source texts. `span`: first and last time of the run
        [s]. `events`: function that returns quantities of events.
        """

        def step(operation: str, number: float, *operands: np.ndarray) -> np.ndarray:
            if operation == REDUCE + "final":  # of t
                return np.array([span[1]])
            if operation.startswith(REDUCE):
                known_value = known[self.inner[int(number) - 1].text]
                return from_functional(operation.removeprefix(REDUCE), known_value, span[1] - span[0], operands[0])
            if operation == "get":  # other quantities are operands of functionals
                quantity = self.quantities[int(number)]
                return np.array([events(quantity) if quantity.kind == "events" else np.nan])
            return applied(operation, number, operands, self.quantities, Series(np.zeros(1), lambda _: np.zeros(1)))

        with np.errstate(all="ignore"):
            return float(execute(self.when, step)[0])

    def values(self, series: Series, known: Integrals, duration: float) -> np.ndarray:
        """Return the values at T times: (T,), or (2, T) for a vector.

        `known`: values of the functionals in `inner`, by their source texts. `duration`: duration of the run [s].
        """
        return self.values_and_switches(series, known, duration, 1)[0]

    def values_and_switches(
        self, series: Series, known: Integrals, duration: float, groups: int
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the values at T times, and the scalars at whose sign changes the operations change their form.

        `groups`: number G of groups of P = T / G times. Only sign changes within a group count. For the norm of a
        vector, the scalar is the product of the vector with the first vector of the group. Returns (T,) or (2, T), and
        one array (G, P) for each operation with a switch.
        """
        switches: list[np.ndarray] = []
        count = len(series.time)

        def step(operation: str, number: float, *operands: np.ndarray) -> np.ndarray:
            if operation.startswith(REDUCE):
                known_value = known[self.inner[int(number) - 1].text]
                return from_functional(operation.removeprefix(REDUCE), known_value, duration, operands[0])
            argument = _switch_of(operation, operands, groups)
            if argument is not None and argument.shape[-1] * groups == count:
                switches.append(np.broadcast_to(argument, (groups, count // groups)))
            return applied(operation, number, operands, self.quantities, series)

        with np.errstate(all="ignore"):
            return execute(self.program, step), switches


def _switch_of(operation: str, operands: Sequence[np.ndarray], groups: int) -> np.ndarray | None:
    """Return the scalar (G, P) whose sign determines the form of an operation; None if the form is fixed."""
    kind = OPERATIONS[operation].switch if operation in OPERATIONS else ""
    if kind:
        x = operands[0] if kind == "first" else operands[0] - operands[1]
        return x.reshape(groups, -1) if x.ndim == 1 and x.size % groups == 0 else None
    if operation not in OF_PARTS or operands[0].shape[-1] % groups:
        return None
    x = operands[0].reshape(len(operands[0]), groups, -1)
    if operation == "norm":
        return np.asarray(np.sum(x * x[:, :, :1], axis=0))
    x = x if operation == "along_max" else -x
    best = np.argmax(x[:, :, 0], axis=0)[None, :, None]
    others = np.where(np.arange(len(x))[:, None, None] == best, -np.inf, x)
    return np.asarray(np.take_along_axis(x, best, axis=0)[0] - np.max(others, axis=0))


def applied(
    operation: str, number: float, operands: Sequence[np.ndarray], quantities: Sequence[Quantity], series: Series
) -> np.ndarray:
    """Return the value of an instruction that does not reduce over time.

    Values have the shapes (T,) or (1,); vectors (2, T) or (2, 1); values along a beam (elements, T).
    """
    if operation == "const":
        return np.array([number])
    if operation == "t":
        return series.time
    if operation == "get":
        return series.of(quantities[int(number)])
    if operation == "powi":
        return np.asarray(elementary.pow(operands[0], number))
    return (OF_PARTS.get(operation) or OPERATIONS[operation].array)(*operands)


def interpolated(at: float, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values (..., T) at a time, interpolated linearly between the neighbouring rows, (..., 1); nan outside the
    rows.
    """
    if not time[0] <= at <= time[-1]:
        return np.full((*values.shape[:-1], 1), np.nan)
    return np.apply_along_axis(lambda row: np.interp([at], time, row), -1, values)
