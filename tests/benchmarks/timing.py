"""Fair timing: contenders take turns within one process, and the median counts."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """What repeated runs of one contender took [s]."""

    median: float
    least: float
    most: float


def take_turns(contenders: Mapping[str, Callable[[], float]], repeats: int) -> dict[str, Timing]:
    """Return the timings of contenders that each return the seconds they took; one unrecorded turn warms up."""
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(repeats + 1):
        for name, contender in contenders.items():
            taken = contender()
            if turn > 0:
                seconds[name].append(taken)
    return {name: Timing(statistics.median(taken), min(taken), max(taken)) for name, taken in seconds.items()}


def duration(seconds: float) -> str:
    """Return seconds in a unit that suits them."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"
