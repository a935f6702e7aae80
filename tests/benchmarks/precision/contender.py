"""What takes part in the race: a code, a method, and a ladder of ever finer settings."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from .rods import Array

Result = TypeVar("Result")

TOLERANCES = tuple(10.0 ** (-k / 2) for k in range(4, 29))
"""Settings of adaptive methods: relative and absolute tolerance alike."""

OURS = "mbdkit"


@dataclass(frozen=True)
class Outcome:
    """What one run came to: seconds of the stepping alone, of the clock and of the processor, and the end.

    Parameters
    ----------
    wall, cpu
        Seconds from the first step to the last.
    centres
        Of all rods at the end (n, 2) [m]; NaN where the run stopped early.
    evaluations
        Number of evaluations of the equations of motion, or of series of `taylor`; 0 where nothing counts them.
    """

    wall: float
    cpu: float
    centres: Array
    evaluations: int = 0


@dataclass(frozen=True)
class Contender:
    """One way to the end of a motion.

    Parameters
    ----------
    code, method
        Who, and by which method.
    run
        From a setting, number of steps or tolerance, to the outcome.
    ladder
        Settings, each finer than the one before.
    has_forces
        Whether all joint forces after every step are part of what is timed.
    """

    code: str
    method: str
    run: Callable[[float], Outcome]
    ladder: tuple[float, ...]
    has_forces: bool = False

    @property
    def name(self) -> str:
        """Return code and method."""
        return f"{self.code} {self.method}"


def steps_from(first: int) -> tuple[float, ...]:
    """Return numbers of steps from `first` on, two to an octave."""
    return tuple(float(round(first * 2 ** (k / 2))) for k in range(40))


def timed(work: Callable[[], Result]) -> tuple[Result, float, float]:
    """Return what `work` returns, and its seconds of the clock and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, time.perf_counter() - wall, time.process_time() - cpu


def lost(count: int, wall: float, cpu: float) -> Outcome:
    """Return the outcome of a run that did not get to the end."""
    return Outcome(wall, cpu, np.full((count, 2), np.nan))


def centres_of(q: Any, count: int) -> Array:
    """Return the centres (n, 2) from absolute coordinates x, y, theta of every rod."""
    return np.asarray(q, dtype=float).reshape(count, 3)[:, :2]
