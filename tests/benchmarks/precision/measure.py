"""Errors first, then times: all settings of all contenders take turns, so that what else the machine does hits all."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from .contender import Contender
from .motions import Motion

TARGETS = tuple(10.0**-k for k in range(3, 13))  # m
ENOUGH = 0.3 * TARGETS[-1]
"""An error below which nothing finer is tried [m]."""

PATIENCE = 4  # finer settings without a smaller error, after which round-off is believed to reign
TURNS, FEWEST = 9, 2
BUDGET = 0.4  # s of the processor for all turns of one setting, or `FEWEST` turns


@dataclass
class Point:
    """One setting of a contender: its error [m], and the seconds of all its turns."""

    setting: float
    error: float
    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)
    whole: list[float] = field(default_factory=list)
    """The whole call: the model built, stepped and read."""

    @property
    def seconds(self) -> float:
        """Return the least seconds of the processor that the steps took."""
        return min(self.cpu)


@dataclass
class Curve:
    """A contender with its points, from coarse to fine."""

    contender: Contender
    points: list[Point]

    @property
    def front(self) -> list[tuple[float, float]]:
        """Return (error, seconds) from coarse to fine: errors that only fall, times that only grow.

        An error that is small by luck at one setting is raised to the largest that follows, up to the smallest of all,
        and where a finer setting takes less time, as when too large steps need many iterations, that time stands.
        Settings that did not get to the end, and all coarser ones, are left out.
        """
        errors = [point.error for point in self.points]
        if not any(map(math.isfinite, errors)):
            return []
        best = int(np.nanargmin(errors))
        first = max((k + 1 for k in range(best) if not math.isfinite(errors[k])), default=0)
        timed = [k for k in range(first, best + 1) if self.points[k].cpu]
        seconds = [self.points[k].seconds for k in timed]
        return [(max(errors[k : best + 1]), min(seconds[place:])) for place, k in enumerate(timed)]

    def time_at(self, target: float) -> float | None:
        """Return the seconds for an error, on a line between neighbours in logarithms; None where not reached.

        Where the coarsest setting is better already, its time stands: nothing is extrapolated.
        """
        front = self.front
        for k, (error, seconds) in enumerate(front):
            if error > target:
                continue
            if k == 0 or error == front[k - 1][0]:
                return seconds
            before, earlier = front[k - 1]
            part = math.log(before / target) / math.log(before / error)
            return math.exp((1 - part) * math.log(earlier) + part * math.log(seconds))
        return None


def climb(contender: Contender, motion: Motion) -> Curve:
    """Return the errors of a contender's settings from coarse to fine, until it is exact enough or takes too long."""
    points: list[Point] = []
    best, since, slow = math.inf, 0, 0
    for setting in contender.ladder:
        outcome = contender.run(setting)
        error = motion.miss(outcome.centres)
        points.append(Point(setting, error))
        if error < best:
            best, since = error, 0
        elif best < TARGETS[0]:
            since += 1
        slow = slow + 1 if outcome.cpu > motion.limit else 0  # once may be a tolerance too coarse to be fast
        if slow == 2 or best <= ENOUGH or since >= PATIENCE:
            break
    return Curve(contender, points)


def take_times(curves: Sequence[Curve], say: Callable[[str], None]) -> None:
    """Time every setting that can matter, all in turns; the run that told the error has warmed everything up."""
    waiting = [(curve, point) for curve in curves for point in _that_matter(curve)]
    turn = 0
    while waiting:
        for curve, point in waiting:
            begin = time.perf_counter()
            outcome = curve.contender.run(point.setting)
            point.whole.append(time.perf_counter() - begin)
            point.cpu.append(outcome.cpu)
            point.wall.append(outcome.wall)
        turn += 1
        say(f"turn {turn}: {len(waiting)} settings")
        waiting = [
            (curve, point)
            for curve, point in waiting
            if turn < FEWEST or (turn < TURNS and turn * statistics.median(point.whole) < BUDGET)
        ]


def _that_matter(curve: Curve) -> list[Point]:
    """Return the points from the last one coarser than all targets to the one with the smallest error."""
    errors = [point.error for point in curve.points]
    if not any(map(math.isfinite, errors)):
        return []
    best = int(np.nanargmin(errors))
    first = max((k for k in range(best) if not errors[k] <= TARGETS[0]), default=0)
    return [point for point in curve.points[first : best + 1] if math.isfinite(point.error)]
