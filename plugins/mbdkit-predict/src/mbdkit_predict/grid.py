"""Meshes of intervals in one or several phases, and the discontinuities of functions of time at which they end."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mbdkit.events.state_program import state_program
from mbdkit.mechanism.motion_corners import corners_of
from mbdkit.mechanism.switching_times import switching_times
from mbdkit_predict.predict_spec import PredictSpec

CLOSEST = 1e-12  #: Least length of an interval that is cut, as a share of the motion.
NEAR = 0.25  #: Largest distance, as a share of an interval, by which its end is moved to a given time.


@dataclass(frozen=True)
class IntervalGrid:
    """N intervals of a motion with P phases, and the s collocation points in each of them.

    Attributes
    ----------
    phase : (N,) array of int
        Phase of each interval, in ascending order.
    share : (N,) array
        Length of each interval as a share of the duration of its phase.
    c : (s,) array
        Collocation points, as shares of an interval.
    """

    phase: np.ndarray
    share: np.ndarray
    c: np.ndarray

    @classmethod
    def uniform(cls, counts: Sequence[int], c: np.ndarray) -> IntervalGrid:
        """Return intervals of equal length, given their number in each phase."""
        return cls(np.repeat(np.arange(len(counts)), counts), np.repeat(1.0 / np.array(counts), counts), c)

    def with_ends(self, phase: int, shares: Iterable[float]) -> IntervalGrid:
        """Return a grid in which intervals of a phase also end at given shares of its duration, in ascending order.

        The nearest end moves there from at most `NEAR` of an interval; otherwise, an interval is divided.
        """
        own = self.phase == phase
        ends = [0.0, *np.cumsum(self.share[own]).tolist()]
        free = {*ends[1:-1]}
        for share in shares:
            nearest = min(ends, key=lambda end: abs(end - share))
            if nearest in free and abs(nearest - share) * own.sum() <= NEAR:
                free.discard(nearest)
                ends.remove(nearest)
            ends = sorted({*ends, share})
        first, last = np.flatnonzero(own)[[0, -1]]
        parts = [self.share[:first], np.diff(ends), self.share[last + 1 :]]
        phases = [self.phase[:first], np.full(len(ends) - 1, phase), self.phase[last + 1 :]]
        return IntervalGrid(np.concatenate(phases), np.concatenate(parts), self.c)

    def cut(self, durations: np.ndarray, times: Iterable[float]) -> IntervalGrid:
        """Return a finer grid whose intervals also end at given times, for given durations of the phases."""
        ends = durations @ self.ends
        inside = [
            time for time in times if abs(ends - time).min() > CLOSEST * ends[-1] and CLOSEST < time / ends[-1] < 1
        ]
        lengths = np.diff(np.union1d(ends, inside), prepend=0.0)
        of = np.searchsorted(ends, np.cumsum(lengths) - 0.5 * lengths)
        return IntervalGrid(self.phase[of], self.share[of] * lengths / (durations @ self.lengths)[of], self.c)

    def divided(self, parts: np.ndarray) -> IntervalGrid:
        """Return a finer grid, given the number of parts (N,) of each interval."""
        return IntervalGrid(np.repeat(self.phase, parts), np.repeat(self.share / parts, parts), self.c)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of intervals of each phase."""
        return tuple(np.bincount(self.phase).tolist())

    @cached_property
    def lengths(self) -> np.ndarray:
        """Matrix (P, N), which turns durations (P,) into the lengths of the intervals."""
        return np.asarray((np.arange(self.phase[-1] + 1)[:, None] == self.phase) * self.share)

    @cached_property
    def ends(self) -> np.ndarray:
        """Matrix (P, N), which turns durations into the ends of the intervals, from the start of the motion on."""
        return np.cumsum(self.lengths, axis=1)

    @cached_property
    def points(self) -> np.ndarray:
        """Matrix (P, N s), which turns durations into the times of the collocation points."""
        return np.repeat(self.ends - self.lengths, len(self.c), axis=1) + np.kron(self.lengths, self.c)

    def ends_of_phases(self) -> list[int]:
        """Return the index of the last interval of each phase."""
        return [int(end) - 1 for end in np.cumsum(self.counts)]


def weights(points: np.ndarray, at: Any) -> np.ndarray:
    """Return the weights (s,) of values at `points` in the value of the polynomial through them at another point, or
    (s, K) at K points.
    """
    ones = np.ones_like(at, dtype=np.float64)
    return np.array([np.prod([ones, *((at - c) / (own - c) for c in points if c != own)], axis=0) for own in points])


#: If there are more of them, such as the points of a measured table with linear interpolation, none is returned.
MOST = 100


def breaks_of(spec: PredictSpec, end: float) -> list[float]:
    """Return the times between 0 and `end` [s] at which the value, the rate or the acceleration of a table or an
    expression of time jumps, and those at which ``abs``, ``min`` or ``max`` of time switch in an expression of the
    state.
    """
    mechanism = spec.mechanism()
    motions = [*(motion for _, motion in mechanism.motions()), *spec.tables.values()]
    times = {corner.time for motion in motions for corner in corners_of(motion, 0.0, end) if not corner.is_smooth}
    for _, text in mechanism.expressions():
        # quantities are unknown numbers here, so that switches that depend on them are left out
        program, _ = state_program(text, mechanism)
        program = tuple(("const", math.nan) if name == "get" else (name, x) for name, x in program)
        times |= {time for time, _ in switching_times(program, 0.0, end)}
    inside = sorted(time for time in times if 0.0 < time < end)
    return inside if len(inside) <= MOST else []
