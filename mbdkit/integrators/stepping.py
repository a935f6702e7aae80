"""What every stepper shares: the timetable of a run, what a stretch of it yields, and how it can fail."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np

STRETCH = 0.1
"""Seconds after which a compiled loop is meant to return to Python; it stays well below 0.2 s."""


@dataclass(frozen=True)
class Timetable:
    """When a run starts and ends, in which steps, and which states are recorded.

    Parameters
    ----------
    start, end
        Time span [s].
    step
        Fixed step, or first step of an adaptive method; None: the method chooses.
    steps
        Number of fixed steps N.
    every
        Record every k-th step, the start and the end.
    interval
        Instead of `every`: record at these distances in time [s], by dense output.
    max_steps
        Steps after which the run stops.
    single
        Advance by one accepted step at a time, so that somebody can look inside each.
    """

    start: float
    end: float
    step: float | None = None
    steps: int = 0
    every: int = 1
    interval: float | None = None
    max_steps: int = 10_000_000
    single: bool = False

    @property
    def last_step(self) -> float:
        """Size of the last fixed step [s]: ``step`` unless it would pass the end."""
        assert self.step is not None
        rest = self.end - (self.start + (self.steps - 1) * self.step)
        return self.step if abs(rest - self.step) <= 1e-9 * self.step else rest


@dataclass
class Stretch:
    """The recorded states of one stretch of a run: T rows."""

    time: np.ndarray
    q: np.ndarray
    """(T, 3 (B + 1)) positions, ground last."""
    v: np.ndarray
    work: np.ndarray
    dissipated: np.ndarray
    intervals: np.ndarray
    """(T, 6) float: time, steps, size, iterations, iterations_max, rejected of the interval that ends at each row."""
    multipliers: np.ndarray | None = None
    """(T, m) the multipliers that the method itself carries, if it does."""
    corrections: np.ndarray | None = None
    """(T, 4) of the interval that ends at each row, if the run is stabilized: projections made, largest correction of
    positions [m] and of velocities [m/s] in the mass metric, largest of Baumgarte's terms [m/s^2, rad/s^2]."""


@dataclass(frozen=True)
class Failure:
    """Why a run stopped early: a code of the archive's status_reason, and a sentence."""

    code: str
    sentence: str


@dataclass
class Counters:
    """Cost of a run, counted where it arises."""

    steps: int = 0
    accepted: int = 0
    rejected: int = 0
    rhs_evaluations: int = 0
    jacobian_evaluations: int = 0
    factorizations: int = 0
    newton_iterations: int = 0
    projections: int = 0


class Stepper(Protocol):
    """Advances one run; what a method's `start` returns.

    Attributes
    ----------
    counters
        Cost so far.
    finished
        Whether the end time has been reached.
    failure
        Why it stopped early, or None.
    worst_pairs
        (P,) largest square of the norm of each pair's Phi, over all steps so far.
    time
        Time reached [s].
    """

    counters: Counters
    finished: bool
    failure: Failure | None
    worst_pairs: np.ndarray
    time: float

    def advance(self) -> Stretch:
        """Go on for about `STRETCH` seconds, to the end or to a failure, and return the states to be recorded."""
        ...

    def last_state(self) -> Stretch:
        """Return the state reached as one row, for a run that is stopped between two recorded ones."""
        ...


@dataclass
class Pace:
    """Chooses how many steps fit into a stretch, from the steps done so far."""

    steps: int

    def timed(self, done: int, since: float) -> None:
        """Take note that `done` steps took the time since `since` (`time.perf_counter`)."""
        elapsed = max(time.perf_counter() - since, 1e-7)
        if done:
            self.steps = max(1, min(int(done * STRETCH / elapsed), 8 * self.steps))
