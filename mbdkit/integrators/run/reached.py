"""Points of a run of a method in Python between two steps, and the rows recorded there."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from mbdkit.methods.step_methods import StepEvent, StepState, Why

NO_CORRECTION = np.zeros(4)  #: The correction of steps without stabilization.
NO_CORRECTION.setflags(write=False)

NO_HISTORY = (0.0, 0.0, 0.0, 0.0)  #: The history of a run without steps before the next one.


class IntervalSoFar(NamedTuple):
    """Statistics since the last recorded row.

    Number of steps, size of the last step [s], number of iterations, largest number of iterations in a step, number of
    rejected steps, and corrections (4,) as in `mbdkit.integrators.interface.Stretch`.
    """

    steps: int = 0
    size: float = 0.0
    iterations: int = 0
    most_iterations: int = 0
    rejected: int = 0
    correction: np.ndarray = NO_CORRECTION

    def after(self, size: float, iterations: int, rejected: int, correction: np.ndarray) -> IntervalSoFar:
        """Return the interval extended by one step."""
        largest = self.correction
        if correction is not NO_CORRECTION:
            largest = np.maximum(largest, correction)
            largest[0] = self.correction[0] + correction[0]
        most = max(self.most_iterations, iterations)
        return IntervalSoFar(
            self.steps + 1, size, self.iterations + iterations, most, self.rejected + rejected, largest
        )  # fmt: skip


class Reached(NamedTuple):
    """A point of the run between two steps, with all data needed to continue from it."""

    done: int  #: Number of steps so far.
    whole: int  #: Number of fixed steps completed; a step that is divided counts once.
    passed: int  #: Number of stops that the run has passed.
    #: Time at which the next step starts [s] if that is not `time`, because of a stop, an event or a divided step.
    restart: float | None
    time: float
    state: StepState
    #: (2,) work of loads and drivers, and dissipated energy [J]; `energy_low` has the compensation terms of these sums.
    #:
    energy: np.ndarray
    energy_low: np.ndarray
    interval: IntervalSoFar
    is_event: bool = False  #: Whether the step ended before its planned end.
    why: Why | Literal[""] = ""  #: Why the next step begins anew; empty if it continues.
    size: float = np.inf  #: Size of the next step [s], if no stop comes earlier.
    #: Errors of the last step and of the one before, relative to their tolerances, 0 if there is none; and their sizes
    #: [s].
    history: tuple[float, float, float, float] = NO_HISTORY
    order: float | None = None  #: Order of the error estimate of the next step, if the method varies it.
    event: StepEvent | None = None  #: Event that happens before the next step.

    @property
    def begin(self) -> float:
        """Time at which the next step starts [s]."""
        return self.time if self.restart is None else self.restart

    def recorded(self) -> Reached:
        """Return the same point with a new interval."""
        return self._replace(interval=IntervalSoFar())

    def row(self) -> RecordedRow:
        """Return this point as a row."""
        return RecordedRow(self.time, self.state, self.energy, self.interval)


class Planned(NamedTuple):
    """The next step.

    Its start and size [s], the time of a row at its end [s], whether it ends at a stop, whether it ends a fixed step
    or, with controlled steps, the run, and whether it is shorter than the rest of the fixed step.
    """

    begin: float
    size: float
    reached: float
    is_at_stop: bool
    is_whole: bool
    is_part: bool = False


class RecordedRow(NamedTuple):
    """A recorded state: time [s], state, (2,) work and dissipated energy [J], and statistics since the last row."""

    time: float
    state: StepState
    energy: np.ndarray
    interval: IntervalSoFar


class RejectedError(Exception):
    """A step is not accepted; `size` is that of the next attempt [s]."""

    def __init__(self, size: float, reason: Exception | None = None):
        super().__init__()
        self.size, self.reason = size, reason
