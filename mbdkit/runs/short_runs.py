"""Short runs of a prepared spec in memory, computed with the loops and mechanisms that its earlier runs have left."""

from __future__ import annotations

import time

from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import utc_now
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.engine.consistent_start import Starts
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.finish import run_in_memory
from mbdkit.runs.lane_group import LaneMember
from mbdkit.runs.lane_runs import LaneRuns
from mbdkit.spec.run_spec import RunSpec

#: Largest number of prepared specs that are remembered.
MOST_KINDS = 32


class ShortRuns:
    """Computes short runs by the vectorized loop, as in an ensemble; for one thread at a time."""

    def __init__(self) -> None:
        self.lanes = LaneRuns(Starts(), ())
        self.work: float = 0  #: Evaluations times bodies of the latest run.
        self._members: dict[tuple[type, str], LaneMember | None] = {}  # None for a spec that was run once

    def run(self, spec: RunSpec) -> Run | None:
        """Return the run of a spec; None if it cannot be vectorized, or if its preparation fails."""
        created = utc_now()
        with one_thread_of_linear_algebra():
            member = self._member(spec)
            if member is None:
                return None
            runs = next(self.lanes.finished([member]))[1]
            if runs is None:
                return None
            finished = runs.run(0)
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
