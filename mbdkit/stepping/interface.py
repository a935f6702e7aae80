"""What every stepper shares: the timetable of a run, what a stretch of it yields, and how it can fail."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Protocol

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
        Whether `Stepper.advance` takes one accepted step a call, to be looked into before the next.
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

    def rows(self, part: slice | np.ndarray) -> Stretch:
        """Return some of the rows: a slice, or a mask (T,)."""
        chosen: dict[str, Any] = {}
        for field in fields(self):
            values = getattr(self, field.name)
            chosen[field.name] = None if values is None else values[part]
        return Stretch(**chosen)


def joined(stretches: Sequence[Stretch]) -> Stretch:
    """Return stretches that follow each other as one; what one of them lacks is left out."""
    if len(stretches) == 1:
        return stretches[0]
    whole: dict[str, Any] = {}
    for field in fields(Stretch):
        parts = [getattr(stretch, field.name) for stretch in stretches]
        whole[field.name] = None if any(part is None for part in parts) else np.concatenate(parts)
    return Stretch(**whole)


@dataclass(frozen=True)
class StepTaken:
    """One accepted step: its times [s], and the states (3 (B + 1),) where it began and ended, ground last."""

    t0: float
    t1: float
    q0: np.ndarray
    v0: np.ndarray
    q1: np.ndarray
    v1: np.ndarray

    def time(self, theta: float) -> float:
        """Return the time [s] at the share `theta` of the step; exact at its ends."""
        return self.t1 if theta == 1.0 else self.t0 + theta * (self.t1 - self.t0)

    def hermite(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities of the cubic through both ends and their velocities: of order 3."""
        h, square = self.t1 - self.t0, theta * theta
        powers = [[1.0, theta, square, theta * square], [0.0, 1.0 / h, 2.0 * theta / h, 3.0 * square / h]]
        q, v = np.array(powers) @ self._cubic
        return q, v

    @cached_property
    def _cubic(self) -> np.ndarray:
        """(4, 3 (B + 1)) coefficients of the powers of theta."""
        h = self.t1 - self.t0
        change, slope0, slope1 = self.q1 - self.q0, h * self.v0, h * self.v1
        return np.array([self.q0, slope0, 3 * change - 2 * slope0 - slope1, slope0 + slope1 - 2 * change])


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


class Advancing(Protocol):
    """What advances a run: a stepper, or what watches one; see `Stepper`."""

    @property
    def counters(self) -> Counters:
        """Cost so far."""
        ...

    @property
    def finished(self) -> bool:
        """Whether the run has come to its end."""
        ...

    @property
    def failure(self) -> Failure | None:
        """Why it stopped early, or None."""
        ...

    @property
    def worst_pairs(self) -> np.ndarray:
        """(P,) largest square of the norm of each pair's Phi, over all steps so far."""
        ...

    @property
    def time(self) -> float:
        """Time reached [s]."""
        ...

    def advance(self) -> Stretch:
        """Go on for about `STRETCH` seconds, to the end or to a failure, and return the states to be recorded."""
        ...

    def last_state(self) -> Stretch:
        """Return the state reached as one row, for a run that is stopped between two recorded ones."""
        ...


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
    last_step
        The step that the last `advance` took, or None where it took none; only under ``Timetable.single``, as are
        `inside`, `within` and `cut`, which tell of that step.
    """

    counters: Counters
    finished: bool
    failure: Failure | None
    worst_pairs: np.ndarray
    time: float
    last_step: StepTaken | None

    def advance(self) -> Stretch:
        """Go on for about `STRETCH` seconds, to the end or to a failure, and return the states to be recorded.

        Under ``Timetable.single`` go on for one accepted step instead.
        """
        ...

    def last_state(self) -> Stretch:
        """Return the state reached as one row, for a run that is stopped between two recorded ones."""
        ...

    def inside(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities (3 (B + 1),) at the share `theta` of the last step, by dense output."""
        ...

    def within(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """Return what `inside` does by the method itself: a step of that size from where the last one began.

        The run goes on as if it had not been asked, but the work counts. Where such a step fails, and for methods that
        cannot take it, the dense output stands in.
        """
        ...

    def cut(self, theta: float) -> Stretch:
        """End the run at the share `theta` of the last step, as `within` has it, and return that state as a row.

        Rows that `advance` returned for that time and later ones are void.
        """
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
