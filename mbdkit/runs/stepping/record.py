"""The record of an open simulation: what its steps have given, until it is written."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

from mbdkit.integrators.interface import Stretch
from mbdkit.integrators.loop.step_loop import ROW_MARGIN
from mbdkit.runs.run_record import Taken
from mbdkit.runs.simulated_run import SimulatedRun
from mbdkit.runs.stepping.input_history import InputHistory
from mbdkit.runs.stepping.simulation_state import SimulationState

FLUSH_INTERVAL = 1.0  #: Smallest wall time between two writes of the record [s].


class _Link(NamedTuple):
    """What some steps have given, and the wall time since the first step before and after them [s]."""

    taken: Taken | None
    elapsed: tuple[float, float]


class Record:
    """What the steps of an open simulation have given.

    It is passed on to the recorder of the run as late as possible, because the simulation may return to an earlier
    state.

    - `run`: the run, whose recorder receives the record.
    - `seconds`, `cpu_seconds`: wall time and processor time of the steps and their record so far [s].
    - `is_whole`: whether the record begins at the start of the run; if not, the run is repeated when it is finished.
    """

    def __init__(self, run: SimulatedRun):
        self.run = run
        #: Number of links up to a state, and the last of them.
        self._of_states: WeakKeyDictionary[SimulationState, tuple[int, _Link]] = WeakKeyDictionary()
        self.clear()

    def clear(self) -> None:
        """Discard the record, none of which has been passed on."""
        self._links = [_Link(None, (0.0, 0.0))]  # the last one that was passed on, or this one, and those after it
        self._passed, self.is_whole = 0, True
        self._is_begun, self._written = False, 0
        self.seconds, self._begin_cpu = 0.0, time.process_time()
        self._flushed = time.monotonic()

    @property
    def cpu_seconds(self) -> float:
        """Processor time since the simulation was opened [s]."""
        return time.process_time() - self._begin_cpu

    @property
    def is_untouched(self) -> bool:
        """Whether nothing has been passed on to the recorder."""
        return not self._is_begun

    @property
    def is_due(self) -> bool:
        """Whether the record should be written again."""
        return time.monotonic() - self._flushed > FLUSH_INTERVAL

    def add(self, taken: Taken, seconds: float) -> None:
        """Append what some steps have given, `seconds` after the first step."""
        if self.is_whole:
            self._links.append(_Link(taken, (self._links[-1].elapsed[1], seconds)))

    def remember(self, state: SimulationState) -> None:
        """Let `restore` return to the present record for a state."""
        if self.is_whole:
            self._of_states[state] = self._passed + len(self._links), self._links[-1]

    def _up_to(self, state: SimulationState) -> list[_Link] | None:
        """Return the links up to a state; None if it is not known, or if others have been passed on."""
        count, last = self._of_states.get(state, (0, None))
        links = self._links[: max(0, count - self._passed)]
        return links if links and links[-1] is last else None

    def restore(self, state: SimulationState) -> None:
        """Return to the record at a state. If it is not known, the run is repeated when it is finished."""
        links = self._up_to(state)
        self.is_whole = links is not None
        self._links = links or self._links

    def adopt(self, other: Record, state: SimulationState) -> None:
        """Take over the record of another simulation at a state, for a simulation in the same state."""
        if (links := other._up_to(state)) is not None and not other._passed:
            self._links, self.is_whole = links, True
            self._of_states.update({one: other._of_states[one] for one in (state, state.before) if one is not None})

    def flush(self, history: InputHistory, end: float | None = None) -> None:
        """Pass the record on to the recorder: all of it if the run ends at `end` [s].

        Otherwise, the last of the rows that dense output gives is kept back, because it changes if the run ends there.
        """
        self._flushed = time.monotonic()
        if not self.is_whole:
            return
        begin, run, links = time.perf_counter(), self.run, self._links[1:]
        if not self._is_begun:
            run.record_start()
            self._is_begun = True
        if end is not None:
            links = [*self._with_end(links, end)]
        elif run.record.table.interval is not None:
            rows = [number for number, link in enumerate(links) if len(_rows(link).time)]
            links = links[: rows[-1]] if rows else []
        until = max([run.record.recorder.last_time, *(time for link in links for time in _rows(link).time[-1:])])
        settings = history.settings(self._written, until if end is None else end, is_over=end is not None)
        run.record.recorder.record_inputs(settings)
        self._written += len(settings)
        for link in links:
            if run.failure is not None:
                break
            assert link.taken is not None
            run.add(link.taken, link.elapsed)
        self._passed += len(links)
        del self._links[: len(links)]
        self.seconds += time.perf_counter() - begin

    def _with_end(self, links: list[_Link], end: float) -> Iterator[_Link]:
        """Yield the links, with the state at the end of the run [s] as their last row."""
        run = self.run
        stepper = run.stepper
        assert stepper is not None
        rows = [number for number, link in enumerate(links) if len(_rows(link).time)]
        last = links[rows[-1]] if rows else None
        row = None if last is None else _rows(last)
        recorded = run.record.recorder.last_time if row is None else row.time[-1]
        is_cut = stepper.failure is not None or (run.watch is not None and run.watch.stopped is not None)
        interval = None if is_cut else run.record.table.interval  # a run that is cut has its last row
        if run.failure is not None or (recorded >= stepper.time and (row is None or interval is None)):
            yield from links
            return
        final = stepper.last_state()
        if row is not None and interval is not None and row.time[-1] >= end - ROW_MARGIN * interval:
            # such a row is one of the end, with the counts of the steps since the row before
            corrections = None if row.corrections is None else row.corrections[-1:].copy()
            final = replace(final, intervals=row.intervals[-1:].copy(), corrections=corrections)
            final.intervals[:, 0] = final.time
            assert last is not None
            assert last.taken is not None
            shorter = last.taken._replace(stretch=row.rows(slice(0, -1)))
            links[rows[-1]] = _Link(shorter, last.elapsed)
        yield from links
        elapsed = self._links[-1].elapsed[1]
        yield _Link(Taken(final), (elapsed, elapsed))


def _rows(link: _Link) -> Stretch:
    assert link.taken is not None
    return link.taken.stretch
