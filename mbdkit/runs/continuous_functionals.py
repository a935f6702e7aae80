"""Integrals, extrema and values of the motion between the ends of steps, computed during a run in blocks of steps."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from types import MappingProxyType
from typing import Any

import numpy as np

from mbdkit.archive.checkpoint import StoredState
from mbdkit.archive.measured_values import Integrals
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import SAME_TIME, ConsecutiveSteps, Timetable
from mbdkit.integrators.loop.switches import PREVIOUS, ends_at_switches, switch_bundle, switching_functions
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.measures.reductions import EventTimes, Functional
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.runs.continuous_motion import MotionPart, Peak, observed_at, sampled, steps_of_extremum
from mbdkit.runs.step_interpolation import NODES_WITHOUT_ACCELERATIONS, StepEnds

#: Number of steps in a block; they are evaluated together. The number is fixed for the reason given in
#: `integrals.BLOCK`.
BLOCK = 256
#: Share of the step that ends where a force switches at which its acceleration is that before.
BEFORE_SWITCH = 1e-9
#: Steps before a switch below this share of the step before them are no nodes of polynomials.
BESIDE_SWITCH = 1e-3
#: Steps beside a switch below this share of the run are no nodes either: differences of their ends are rounding errors.
SHORTEST = 1e-9
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
    ends_at_switch: bool = False  #: Whether a force switches just before the last end.

    def add(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> None:
        """Add the states (T, ...) at times (T,)."""
        self.time += time.tolist()
        for own, given in ((self.q, q), (self.v, v), (self.z, z)):
            own.extend(np.array(given))

    @property
    def states(self) -> tuple[list[Any], ...]:
        """Times, positions, velocities and first-order states."""
        return self.time, self.q, self.v, self.z

    def end_at_switch(self, shortest: float) -> None:
        """Note that a force switches before the last end. Ends within `shortest` [s], or much closer to it than to the
        end before, are discarded.
        """
        self.ends_at_switch, time = True, self.time
        while len(time) > 2 and time[-1] - time[-2] < max(shortest, BESIDE_SWITCH * (time[-2] - time[-3])):
            for values in self.states:
                del values[-2]

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
    - `is_controlled`: whether steps end where forces switch. Polynomials do not go beyond these ends.
    """

    def __init__(
        self,
        workspace: Workspace,
        functionals: Sequence[Functional],
        timetable: Timetable,
        *,
        uses_accelerations: bool = True,
        is_controlled: bool = False,
    ):
        self._workspace, self._table, self._uses_accelerations = workspace, timetable, uses_accelerations
        self._observer = StateObserver(workspace.with_own_pivots())
        self._names = archive_names(workspace.mechanism)
        self._direct = [_Total(functional) for functional in functionals if not functional.is_nested]
        self._keeps = len(self._direct) < len(functionals)
        self._ends = self._new_part(workspace.t0, workspace.q0, workspace.v0, states_at_start(workspace))
        self._parts: list[_Ends] = [self._ends] if self._keeps else []
        self._begun = False
        span = timetable.end - timetable.start
        self._shortest = SHORTEST * span
        self._switches = switch_bundle(self._observer.workspace, span) if is_controlled else None

    def _new_part(self, time: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> _Ends:
        part = _Ends(begin=self._beside_stop(time, 1.0))
        part.add(np.array([time]), q[None], v[None], z[None])
        return part

    def _beside_stop(self, time: float, side: float) -> float:
        """Return the time just before (`side` -1) or after (1) the discontinuity at `time`; -side * inf if none."""
        stops, margins = self._table.stops, self._table.stop_margins
        after = bisect_left(stops, time)
        for place in range(max(0, after - 1), min(len(stops), after + 1)):
            if abs(time - stops[place]) <= SAME_TIME * margins[place]:
                return stops[place] + side * margins[place]
        return -side * math.inf

    def add_ends(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> None:
        """Add the ends (T,) of further steps. Motions and loads of the run must have no discontinuities."""
        new = time > self._ends.time[-1]
        self._add(time[new], q[new], v[new], z[new])
        self._take(whole=True)

    def _add(self, *states: np.ndarray) -> None:
        """Add the ends of further steps; another part of the motion begins where a force switches."""
        begin, last = 0, self._ends
        if self._switches is not None and len(states[0]):
            known = min(PREVIOUS, len(last.time))
            both = [np.concatenate([own[-known:], given]) for own, given in zip(last.states, states, strict=True)]
            values = switching_functions(self._observer.workspace, self._switches, *both)
            for at in ends_at_switches(both[0], values, known, self._shortest):
                end = at - known + 1
                self._ends.add(*(x[begin:end] for x in states))
                self._ends.end_at_switch(self._shortest)
                begin = end
                self._begin_part(*(x[end - 1] for x in states))
        begun = self._ends.time[-1] if self._switches is not None and len(self._ends.time) == 1 else -math.inf
        begin += int(np.searchsorted(states[0][begin:], begun + self._shortest))
        self._ends.add(*(x[begin:] for x in states))

    def _begin_part(self, time: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> None:
        self._close()
        self._ends = self._new_part(float(time), q, v, z)
        if self._keeps:
            self._parts.append(self._ends)

    def add_steps(self, steps: Iterable[ConsecutiveSteps]) -> None:
        """Add further steps."""
        for time, q, v, z in steps:
            ends = self._ends
            is_same = np.array_equal(v[0], ends.v[-1]) and np.array_equal(z[0], ends.z[-1])
            continues = is_same and math.isinf(self._beside_stop(time[0], 1.0))
            if not continues and len(ends.time) > 1:
                self._begin_part(time[0], q[0], v[0], z[0])
            self._add(time[1:], q[1:], v[1:], z[1:])
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
            wanted = [total for total in self._direct if total.is_changed_by(*span)]
            part = self._part(ends, first, count) if wanted else None
            for total in wanted:
                assert part is not None
                total.add(part)
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
            there = q, v
            if ends.ends_at_switch and end == len(ends.time):  # accelerations are those before the force switches
                back = BEFORE_SWITCH * (time[-1] - time[-2])
                before = q[-1:] - back * v[-1:], v[-1:] - BEFORE_SWITCH * (v[-1:] - v[-2:-1])
                there = np.concatenate([q[:-1], before[0]]), np.concatenate([v[:-1], before[1]])
            observed = observed_at(self._observer, np.clip(time, *sides), there[0], there[1], z)
            if chosen is not None or not has_states:
                accelerations = observed.acc
            else:  # the second derivatives of first-order states are not known
                q, v = np.column_stack([q, z]), np.column_stack([v, observed.state_rates])
        steps = range(first - begin, first - begin + count)
        held, is_linear = (None, False) if chosen is None else (z, chosen.item.includes_impacts)
        states = StepEnds(time, q, v, accelerations, held, is_linear=is_linear)
        return MotionPart(self._observer, self._names, states, steps, sides)

    def totals(self) -> dict[str, np.ndarray]:
        """Return the values of the functionals that are not nested, by their source text; nan where undefined."""
        self._take(whole=False)
        return {total.functional.text: total.value for total in self._direct}

    def nested(self, functional: Functional, known: Integrals, events: EventTimes, deadline: float) -> np.ndarray:
        """Return the value of a nested functional from the values of its inner functionals.

        `events`: function that returns quantities of events. `deadline`: `time.perf_counter` after which the value is
        nan.
        """
        whole = [part for part in self._parts if len(part.time) > 1]
        span = (whole[0].time[0], whole[-1].time[-1]) if whole else (math.nan, math.nan)
        total = _Total(functional, known, span, events)
        for ends in whole:
            for first in range(0, len(ends.time) - 1, BLOCK):
                last = min(first + BLOCK, len(ends.time) - 1)
                if perf_counter() > deadline:
                    return np.full(1, np.nan)
                if total.is_changed_by(ends.time[first], ends.time[last]):
                    total.add(self._part(ends, first, last - first))
        return total.value

    def stored(self) -> StoredState:
        """Return the state as plain values, for a checkpoint."""
        parts = self._parts or [self._ends]
        return {
            "totals": {total.functional.text: [total.value, total.peak_time] for total in self._direct},
            "parts": [
                [*map(np.array, x.states), [x.begin, x.end, float(x.done), float(x.ends_at_switch)]] for x in parts
            ],
        }

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if it is not valid for this run."""
        if [*state["totals"]] != [total.functional.text for total in self._direct]:
            raise ValueError("it has other integrals")
        size, states, parts = len(self._workspace.q0), len(self._workspace.mechanism.states), []
        for time, q, v, z, (begin, end, done, at_switch) in state["parts"]:
            shapes = [(len(time), size), (len(time), size), (len(time), states)]
            if not len(time) or [x.shape for x in (q, v, z)] != shapes or not 0 <= done < len(time):
                raise ValueError("its steps have other shapes")
            rows = time.tolist(), list(q), list(v), list(z)
            parts.append(_Ends(*rows, float(begin), float(end), int(done), bool(at_switch)))
        if not parts or (len(parts) > 1 and not self._keeps):
            raise ValueError("its steps have other shapes")
        for total, (value, peak_time) in zip(self._direct, state["totals"].values(), strict=True):
            total.value, total.peak_time = np.asarray(value), float(peak_time)
        self._ends, self._parts = parts[-1], parts if self._keeps else []


def no_events(quantity: Quantity) -> float:
    """Return nan for every quantity of an event, as long as no events are known."""
    return math.nan


class _Total:
    """The value of a functional over the motion so far: an integral, an extremum, or the value at a time.

    `known`, `span`, `events`: see `Functional.time`; only nested functionals need them. `value`: the value, (1,), or
    (2,) of a vector. `peak_time`: time of the extremum [s]; nan if there is none yet.
    """

    def __init__(
        self,
        functional: Functional,
        known: Integrals = MappingProxyType({}),
        span: tuple[float, float] = (math.nan, math.nan),
        events: EventTimes = no_events,
    ):
        self.functional, self._known = functional, known
        self._duration = 0.0 if math.isnan(span[0]) else span[1] - span[0]
        is_sum = not (functional.is_extremum or functional.is_value)
        self.value, self.peak_time = np.zeros(1) if is_sum else np.full(1, np.nan), math.nan
        self._time = functional.time(known, span, events) if functional.is_value else math.nan

    def is_changed_by(self, begin: float, end: float) -> bool:
        """Return whether the motion from `begin` to `end` [s] changes the value: of several values at a time, ``at`` is
        the first, ``after`` the last.
        """
        if not self.functional.is_value:
            return True
        is_new = self.functional.reduction == "after" or bool(np.isnan(self.value).any())
        return is_new and self.functional.is_given_by(self._time, begin, end)

    def add(self, part: MotionPart) -> None:
        """Take a further part of the motion into account."""
        functional, known, duration = self.functional, self._known, self._duration
        if functional.is_value:
            self.value = np.atleast_1d(
                functional.values(part.series(np.array([self._time])), known, duration).reshape(-1)
            )
        elif functional.is_extremum:
            self._add_peak(part)
        else:
            self.value = self.value + sampled(part, functional, known, duration).integral()

    def _add_peak(self, part: MotionPart) -> None:
        sign = -1.0 if self.functional.reduction == "min" else 1.0
        begins, before = math.isnan(self.peak_time), float(self.value[0])
        if not begins and math.isnan(before):
            return
        best = -math.inf if begins else sign * before
        steps, reached = steps_of_extremum(part, self.functional, self._known, self._duration, best)
        if not len(steps):
            return
        peak = sampled(part, self.functional, self._known, self._duration, steps).peak(reached)
        if math.isnan(peak.value):
            peak = Peak(math.nan, float(part.ends.time[0]))
        elif not (begins or sign * peak.value > best):
            return
        self.value, self.peak_time = np.array([peak.value]), peak.time
