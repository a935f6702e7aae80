"""Short runs in memory, computed with the loops, mechanisms and settings that earlier runs have left."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import utc_now
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.engine.consistent_start import Starts
from mbdkit.measures.take import check_measures
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.finish import run_in_memory
from mbdkit.runs.lane_runs import LaneMember, LaneRuns
from mbdkit.spec.run_spec import RunSpec

#: Runs with more steps times bodies are computed by the ordinary loop.
#:
#: With a single run in the vectorized loop, the steps take up to twice as long, but the preparation 1 to 3 ms less.
MANY = 4_000

#: Runs of a kind are left to the ordinary loop after this number of consecutive ones that do not suit.
TRIES = 4

#: Largest number of kinds of runs that a process remembers, and of prepared specs.
MOST_KINDS = 32


class ShortRuns:
    """Computes short runs by the vectorized loop, as in an ensemble; for one thread at a time."""

    def __init__(self) -> None:
        self.lanes = LaneRuns(Starts(), ())
        self.work: float = 0  #: Evaluations times bodies of the latest run.
        self._members: dict[tuple[type, str], LaneMember | None] = {}  # None for a spec that was run once

    def run(self, spec: RunSpec, accepts: Callable[[LaneMember], bool] = lambda _: True) -> Run | None:
        """Return the run of a spec; None if it cannot be vectorized, or if its preparation fails or is not accepted."""
        created = utc_now()
        with one_thread_of_linear_algebra():
            member = self._member(spec)
            if member is None or not accepts(member):
                return None
            finished = next(self.lanes.finished([member]))[0][1]
            if finished is None:
                return None
            self.work = finished.stats["rhs_evaluations"] * len(finished.names.bodies)
            return run_in_memory(finished, spec, created)

    def _member(self, spec: RunSpec) -> LaneMember | None:
        """Return the prepared run of a spec; it is cached from the second run of equal specs on."""
        given: Mechanism | None = spec._mechanism
        if spec.files_read or (given is not None and (given.warnings or given.left_out or given.left_out_of_runs)):
            return self.lanes.members([spec])[0]  # these are not part of the spec
        key, begin = (type(spec), spec.canonical_json()), time.perf_counter()
        is_known, member = key in self._members, self._members.pop(key, None)
        if member is not None:
            member.seconds = time.perf_counter() - begin
        else:
            run = spec.model_copy() if is_known else spec
            if is_known:
                run._mechanism = None  # users may change the mechanism of `Run.mechanism`, which is that of `spec`
            member = self.lanes.members([run])[0]
        self._members[key] = member if is_known else None
        if len(self._members) > MOST_KINDS:
            self._members.pop(next(iter(self._members)))
        return member


_LOCK = threading.Lock()
_RUNS = ShortRuns()
_TRIES: dict[tuple[object, ...], int] = {}  #: How many runs of a kind are tried here before they are left alone.


def run_again(spec: RunSpec, report: Callable[[LaneMember], None]) -> Run | None:
    """Return a short run that differs from an earlier one of this process in numbers only, None for another run.

    The results are bitwise equal to those of `mbdkit.runs.simulation.simulate`. Runs with controlled steps may become
    long and are left to that function, which Ctrl-C can end early; `report` is called with the prepared run.
    """
    names = tuple([tuple(elements) for elements in spec.mechanism().elements.values()])
    kind = spec.model_item.id, spec.integrator_item.id, spec.time.count, tuple(spec.mechanism().bodies), names
    tries = _TRIES.pop(kind, 0)
    _TRIES[kind] = tries or TRIES  # at the end; the kind used least recently is discarded first
    if len(_TRIES) > MOST_KINDS:
        _TRIES.pop(next(iter(_TRIES)))
    if tries <= 0 or spec.gradients or not _LOCK.acquire(blocking=False):
        return None

    def accepts(member: LaneMember) -> bool:
        mechanism = member.start.mechanism
        is_long = member.table.interval is not None or member.table.steps * len(mechanism.bodies) > MANY
        if is_long or member.method.traits.tolerances is not None or mechanism.states:
            return False  # first-order states: the method may not support them
        check_measures(spec)
        _TRIES[kind] = TRIES
        report(member)
        return True

    _TRIES[kind] = tries - 1 or -1
    try:
        return _RUNS.run(spec, accepts)
    finally:
        _LOCK.release()
