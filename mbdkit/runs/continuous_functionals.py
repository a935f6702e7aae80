"""Integrals, extrema and values of the motion between the ends of steps, computed during a run in blocks of steps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.checkpoint import StoredState
from mbdkit.archive.measured_values import Integrals
from mbdkit.engine.observed_states import StateObserver
from mbdkit.integrators.interface import SAME_TIME, ConsecutiveSteps, Timetable
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.measures.reductions import EventTimes, Functional
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.runs.continuous_motion import MotionPart, Peak, observed_at, sampled, steps_of_extremum
from mbdkit.runs.step_interpolation import NODES_WITHOUT_ACCELERATIONS, StepEnds

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace

#: Number of steps in a block; they are evaluated together. The number is fixed for the reason given in
#: `integrals.BLOCK`.
BLOCK = 256
#: Number of step ends before and after a block that its polynomials use.
BESIDE = NODES_WITHOUT_ACCELERATIONS // 2


@dataclass
class _Ends:
    """States at the ends of N consecutive steps: times, positions, velocities and first-order states.

    `begin` and `end` are just after the discontinuity before these steps, and just before the one after them.
    """

    time: list[float] = field(default_factory=list)
    q: list[np.ndarray] = field(default_factory=list)
    v: list[np.ndarray] = field(default_factory=list)
    z: list[np.ndarray] = field(default_factory=list)
    begin: float = -math.inf  #: Earliest time at which motions and loads are evaluated [s].
    end: float = math.inf
    done: int = 0  #: Number of steps that have been evaluated.

    def add(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> None:
        """Add the states (T, ...) at times (T,)."""
        self.time += time.tolist()
        for own, given in ((self.q, q), (self.v, v), (self.z, z)):
            own.extend(np.array(given))

    def drop(self, count: int) -> None:
        """Discard the first `count` ends, which are not needed any more."""
        del self.time[:count], self.q[:count], self.v[:count], self.z[:count]
        self.done -= count


class ContinuousFunctionals:
    """Integrals, extrema and values at given times of the motion between the ends of steps.

    - `workspace`: the mechanism at its start. Accelerations and reactions are computed with pivots that the stepper
      does not use.
    - `functionals`: the integrals, extrema and values to compute. A functional is nested if its integrand contains
      others, as in ``rms(x - mean(x))``.
    - `timetable`: the times of the run.
    - `uses_accelerations`: whether the polynomials between the ends of steps use accelerations; see `StepEnds`.
    """

    def __init__(
        self,
        workspace: Workspace,
        functionals: Sequence[Functional],
        timetable: Timetable,
        *,
        uses_accelerations: bool = True,
    ):
        self._workspace, self._table, self._uses_accelerations = workspace, timetable, uses_accelerations
        self._observer = StateObserver(workspace.with_own_pivots())
        self._names = archive_names(workspace.mechanism)
        self._direct = [functional for functional in functionals if not functional.is_nested]
        self._sums = {
            functional.text: np.zeros(1)
            for functional in self._direct
            if not (functional.is_extremum or functional.is_value)
        }
        self._values = {functional.text: np.full(1, np.nan) for functional in self._direct if functional.is_value}
        self._times = {
            functional.text: functional.time({}, (np.nan, np.nan), no_events)
            for functional in self._direct
            if functional.is_value
        }
        self._peaks = {
            functional.text: Peak(math.nan, math.nan) for functional in self._direct if functional.is_extremum
        }
        self._keeps = len(self._direct) < len(functionals)
        self._ends = self._new_part(workspace.t0, workspace.q0, workspace.v0, states_at_start(workspace))
        self._parts: list[_Ends] = [self._ends] if self._keeps else []
        self._begun = False

    def _new_part(self, time: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> _Ends:
        part = _Ends(begin=self._beside_stop(time, 1.0))
        part.add(np.array([time]), q[None], v[None], z[None])
        return part

    def _beside_stop(self, time: float, side: float) -> float:
        """Return the time just before (`side` -1) or after (1) the discontinuity at `time`; -side * inf if none."""
        for stop, margin in zip(self._table.stops, self._table.stop_margins, strict=True):
            if abs(time - stop) <= SAME_TIME * margin:
                return stop + side * margin
        return -side * math.inf

    def add_ends(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> None:
        """Add the ends (T,) of further steps. Motions and loads of the run must have no discontinuities."""
        new = time > self._ends.time[-1]
        self._ends.add(time[new], q[new], v[new], z[new])
        self._take(whole=True)

    def add_steps(self, steps: Iterable[ConsecutiveSteps]) -> None:
        """Add further steps."""
        for time, q, v, z in steps:
            ends = self._ends
            is_same = np.array_equal(v[0], ends.v[-1]) and np.array_equal(z[0], ends.z[-1])
            continues = is_same and math.isinf(self._beside_stop(time[0], 1.0))
            if not continues and len(ends.time) > 1:
                self._close()
                self._ends = self._new_part(time[0], q[0], v[0], z[0])
                if self._keeps:
                    self._parts.append(self._ends)
            self._ends.add(time[1:], q[1:], v[1:], z[1:])
        self._take(whole=True)

    def _close(self) -> None:
        """Evaluate the remaining steps before a discontinuity, at which this part of the motion ends."""
        self._ends.end = self._beside_stop(self._ends.time[-1], -1.0)
        self._take(whole=False)

    def _take(self, *, whole: bool) -> None:
        """Evaluate the waiting steps of this part of the motion.

        If `whole`, only complete blocks are evaluated, and only if they are followed by `BESIDE` further ends.
        """
        ends = self._ends
        while True:
            left = len(ends.time) - 1 - ends.done
            if left <= 0 or (whole and left < BLOCK + BESIDE):
                return
            first, count = ends.done, min(BLOCK, left)
            span = ends.time[first], ends.time[first + count]
            wanted = [
                functional for functional in self._direct if not functional.is_value or self._gives(functional, span)
            ]
            part = self._part(ends, first, count) if wanted else None
            for functional in wanted:
                assert part is not None
                self._add(functional, part)
            ends.done += count
            if not self._keeps and ends.done > BESIDE:
                ends.drop(ends.done - BESIDE)

    def _part(self, ends: _Ends, first: int, count: int) -> MotionPart:
        begin, end = max(0, first - BESIDE), min(len(ends.time), first + count + 1 + BESIDE)
        some = slice(begin, end)
        time, q, v, z = (np.array(x[some]) for x in (ends.time, ends.q, ends.v, ends.z))
        sides, has_states = (ends.begin, ends.end), z.shape[1] > 0
        accelerations, chosen = None, self._workspace.mechanism.reacting
        if self._uses_accelerations or has_states:
            observed = observed_at(self._observer, np.clip(time, *sides), q, v, z)
            if chosen is not None or not has_states:
                accelerations = observed.acc
            else:  # the second derivatives of first-order states are not known
                q, v = np.column_stack([q, z]), np.column_stack([v, observed.state_rates])
        steps = range(first - begin, first - begin + count)
        held, is_linear = (None, False) if chosen is None else (z, chosen.item.includes_impacts)
        states = StepEnds(time, q, v, accelerations, held, is_linear=is_linear)
        return MotionPart(self._observer, self._names, states, steps, sides)

    def _gives(self, functional: Functional, span: tuple[float, float]) -> bool:
        """Return whether a value is that of the motion over a span: of several, ``at`` is the first, ``after`` the
        last.
        """
        is_new = functional.reduction == "after" or bool(np.isnan(self._values[functional.text]).any())
        return is_new and functional.is_given_by(self._times[functional.text], *span)

    def _add(self, functional: Functional, part: MotionPart) -> None:
        if functional.is_value:
            self._values[functional.text] = value_at(part, functional, {}, 0.0, self._times[functional.text])
        elif functional.is_extremum:
            self._peaks[functional.text] = peak_with(part, functional, {}, 0.0, self._peaks[functional.text])
        else:
            self._sums[functional.text] = self._sums[functional.text] + sampled(part, functional, {}, 0.0).integral()

    def totals(self) -> dict[str, np.ndarray]:
        """Return the values of the functionals that are not nested, by their source text; nan where undefined."""
        self._take(whole=False)
        return self._sums | self._values | {text: np.array([peak.value]) for text, peak in self._peaks.items()}

    def nested(self, functional: Functional, known: Integrals, events: EventTimes, deadline: float) -> np.ndarray:
        """Return the value of a nested functional from the values of its inner functionals.

        `events`: function that returns quantities of events. `deadline`: `time.perf_counter` after which the value is
        nan.
        """
        whole = [part for part in self._parts if len(part.time) > 1]
        span = (whole[0].time[0], whole[-1].time[-1]) if whole else (math.nan, math.nan)
        duration = span[1] - span[0] if whole else 0.0
        total, value, peak = np.zeros(1), np.full(1, np.nan), Peak(math.nan, math.nan)
        time = functional.time(known, span, events) if functional.is_value else math.nan
        for ends in whole:
            for first in range(0, len(ends.time) - 1, BLOCK):
                last = min(first + BLOCK, len(ends.time) - 1)
                if perf_counter() > deadline:
                    return np.full(1, np.nan)
                if functional.is_value and not functional.is_given_by(time, ends.time[first], ends.time[last]):
                    continue
                part = self._part(ends, first, last - first)
                if functional.is_value:
                    value = value_at(part, functional, known, duration, time)
                    if functional.reduction == "at":
                        return value
                elif functional.is_extremum:
                    peak = peak_with(part, functional, known, duration, peak)
                else:
                    total = total + sampled(part, functional, known, duration).integral()
        if functional.is_value:
            return value
        return np.array([peak.value]) if functional.is_extremum else total

    def stored(self) -> StoredState:
        """Return the state as plain values, for a checkpoint."""
        parts = self._parts or [self._ends]
        return {
            "sums": self._sums,
            "values": self._values,
            "peaks": {text: [peak.value, peak.time] for text, peak in self._peaks.items()},
            "parts": [
                [*(np.array(values) for values in (x.time, x.q, x.v, x.z)), [x.begin, x.end, float(x.done)]]
                for x in parts
            ],
        }

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if it is not valid for this run."""
        own: dict[str, Mapping[str, object]] = {"sums": self._sums, "values": self._values, "peaks": self._peaks}
        if any(state[name].keys() != entries.keys() for name, entries in own.items()):
            raise ValueError("it has other integrals")
        size, states, parts = len(self._workspace.q0), len(self._workspace.mechanism.states), []
        for time, q, v, z, (begin, end, done) in state["parts"]:
            shapes = [(len(time), size), (len(time), size), (len(time), states)]
            if not len(time) or [x.shape for x in (q, v, z)] != shapes or not 0 <= done < len(time):
                raise ValueError("its steps have other shapes")
            parts.append(_Ends(time.tolist(), list(q), list(v), list(z), float(begin), float(end), int(done)))
        if not parts or (len(parts) > 1 and not self._keeps):
            raise ValueError("its steps have other shapes")
        self._sums, self._values = (
            {text: np.asarray(values) for text, values in state[name].items()} for name in ("sums", "values")
        )
        self._peaks = {text: Peak(float(value), float(time)) for text, (value, time) in state["peaks"].items()}
        self._ends, self._parts = parts[-1], parts if self._keeps else []


def no_events(quantity: Quantity) -> float:
    """Return nan for every quantity of an event, as long as no events are known."""
    return math.nan


def value_at(part: MotionPart, functional: Functional, known: Integrals, duration: float, time: float) -> np.ndarray:
    """Return a value at a time within a part of the motion, (1,), or (2,) of a vector."""
    values = functional.values(part.series(np.array([time])), known, duration)
    return np.atleast_1d(values.reshape(-1))


def peak_with(part: MotionPart, functional: Functional, known: Integrals, duration: float, before: Peak) -> Peak:
    """Return the extremum over a part of the motion and all motion before it.

    `before` is the extremum over the motion before the part; its time is nan if there is none.
    """
    sign = -1.0 if functional.reduction == "min" else 1.0
    begins = math.isnan(before.time)
    if not begins and math.isnan(before.value):
        return before
    best = -math.inf if begins else sign * before.value
    steps, reached = steps_of_extremum(part, functional, known, duration, best)
    if not len(steps):
        return before
    peak = sampled(part, functional, known, duration, steps).peak(reached)
    if math.isnan(peak.value):
        return Peak(math.nan, float(part.ends.time[0]))
    return peak if begins or sign * peak.value > best else before
