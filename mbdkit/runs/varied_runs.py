"""Runs that differ in numbers only, as prepared runs and those of ensembles: lanes filled by recorded formulas.

The formulas (`mbdkit.runs.varied_numbers`) give the arrays of the mechanisms; starts, steps and results are arrays of
many runs. A single run is a lane of its own, whose spec, columns and hash are computed when they are asked for.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import utc_now
from mbdkit.base.errors import SpecError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.engine.assembly import assemble_from, search_for
from mbdkit.engine.consistent_start import CompiledForStarts, MechanismAtStart, within_double_precision
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.self_stress import looped_rows
from mbdkit.integrators.interface import Guards
from mbdkit.integrators.lane_stepper import VariedStarts
from mbdkit.integrators.lanes.lane_collocation import StagePivots
from mbdkit.integrators.lanes.lane_mechanisms import topology_of
from mbdkit.mechanism.size import mechanism_size
from mbdkit.runs.findings import StateWatchers, criteria, findings
from mbdkit.runs.finish import run_in_memory
from mbdkit.runs.lane_group import Advanced, LaneGroup, LaneMember, PreparedRuns
from mbdkit.runs.lane_runs import LaneRuns
from mbdkit.runs.preparation import guards_of
from mbdkit.runs.varied_numbers import Stacks, Variant, VariedNumbers
from mbdkit.spec.run_spec import RunSpec

TRIES = 3  #: Runs are left to the ordinary way after as many consecutive calls without a run that suits the lanes.

#: Arrays of a topology on which neither assembly nor the analysis of redundancy depends.
OF_FORCES = frozenset({"linear", "law_parameters", "spring_points", "load_points", "marker_points"})

#: Arrays on which the geometry does not depend.
OF_MOTION = OF_FORCES - {"spring_points"} | {"mass", "weight", "gravity"}

#: Arrays of functions of time and of further constraints.
OF_MOTIONS = frozenset({"motion_values", "law_parameters"})


def run_in_lane(lanes: LaneRuns, spec: RunSpec) -> tuple[Run, float] | None:
    """Return the run of a spec, and its evaluations times bodies; None if it cannot be vectorized, or if its
    preparation fails.
    """
    created = utc_now()
    with one_thread_of_linear_algebra():
        member = lanes.members([spec])[0]
        runs = None if member is None else next(lanes.finished([member]))[1]
        if runs is None:
            return None
        finished = runs.run(0)
        return run_in_memory(finished, spec, created), finished.stats["rhs_evaluations"] * len(finished.names.bodies)


class VariedRuns:
    """Runs that differ in the numbers at some key paths; for one thread at a time.

    - `lanes`: loops and compiled mechanisms of these and other runs.
    - `numbers`: the arrays of their mechanisms.
    - `accepts`: whether runs are to be computed, given a variant and one of them; by default, all are.
    """

    def __init__(
        self, lanes: LaneRuns, numbers: VariedNumbers, accepts: Callable[[Variant, LaneMember], bool] = lambda *_: True
    ):
        self._lanes, self._numbers, self._accepts = lanes, numbers, accepts
        self._base: _Base | None = None
        self._failed = 0  #: Number of the latest calls without a run that suits the lanes.
        self.work: float = 0  #: Evaluations times bodies of the latest single run.

    def finished(self, values: np.ndarray, spec: Callable[[int], RunSpec]) -> Iterator[tuple[list[int], FinishedRuns]]:
        """Carry out runs with other numbers (N, K), and yield indices and results of those that suit the lanes.

        `spec`: returns the spec of a run.
        """
        if (found := self._prepared(values, spec)) is None:
            return
        runs, group = found
        for first in range(0, len(runs), group.size):
            some = runs.of(range(first, min(len(runs), first + group.size)))
            places, results = group.concluded(some, self._advanced(group, some), self._lanes.measures)
            if results is not None:
                yield [some.indices[place] for place in places], results

    def run(self, numbers: Sequence[float]) -> Run | None:
        """Return the run with these numbers; None if it has to be computed in another way."""
        created, spec = utc_now(), partial(self._numbers.spec, numbers)
        if (found := self._prepared(np.array([numbers]), lambda _: spec())) is None:
            return None
        runs, group = found
        advanced = self._advanced(group, runs)
        self.work = int(advanced.results.counters["rhs_evaluations"][0]) * len(group.names.bodies)
        if self._failed:
            return None

        def concluded() -> FinishedRun | None:
            results = group.concluded(runs, advanced, self._lanes.measures)[1]
            return None if results is None else results.run(0)

        # None only for a run that is watched
        finished = concluded() if runs.first.watched else concluded
        return None if finished is None else run_in_memory(finished, runs.first.settings, created, spec=spec)  # type: ignore[arg-type]

    def _prepared(self, values: np.ndarray, spec: Callable[[int], RunSpec]) -> tuple[PreparedRuns, LaneGroup] | None:
        """Return runs at their starts, and their group; None if no run suits the lanes."""
        begin = time.perf_counter()
        if self._failed >= TRIES or (stacks := self._numbers.stacks(values)) is None:
            return None
        if self._base is None:
            variant = self._numbers.variants[0]
            self._base = _Base.of(self._lanes, variant, spec(int(stacks.members[0])), stacks)
            if self._base is None or not self._accepts(variant, self._base.member):
                self._failed = TRIES
                return None
        with np.errstate(all="ignore"):
            runs = self._base.runs(stacks, spec, self._lanes)
        if runs is None:
            self._failed += 1
            return None
        runs.seconds[:] = (time.perf_counter() - begin) / len(runs)
        return runs, self._lanes.group(runs.first)

    def _advanced(self, group: LaneGroup, runs: PreparedRuns) -> Advanced:
        advanced = group.advanced(runs)
        self._failed = 0 if len(advanced.sound) else self._failed + 1
        assert self._base is not None
        if not self._base.is_assembled:
            self._base.is_assembled = not runs.is_consistent(advanced.results).all()
        return advanced


class _Base:
    """What the runs share: one of them, prepared in the ordinary way, and the solver of their assembly."""

    def __init__(self, member: LaneMember, variant: Variant, given: tuple[np.ndarray, np.ndarray]):
        self.member, self._variant, self._given = member, variant, given
        compiled = variant.compiled
        top, self._has_loops = compiled.topology, len(looped_rows(compiled)) > 0
        #: Whether starts are assembled before the runs, because they may not be consistent.
        self.is_assembled = member.start.assembled.changed or self._has_loops
        has_motions = len(top.motion_start) > 1 or len(top.functions) > 0
        self._of_forces = OF_FORCES - OF_MOTIONS if has_motions else OF_FORCES
        self._checked = OF_MOTIONS if has_motions else frozenset[str]()  # motions have to be checked at the start
        self._own = {name: x.copy() for name, x in top._asdict().items() if x.dtype.kind == "f"}
        mechanism, replaced = member.settings.mechanism(), replace(compiled, topology=top._replace(**self._own))
        self._search = search_for(mechanism, replaced, member.table.start)

    @classmethod
    def of(cls, lanes: LaneRuns, variant: Variant, spec: RunSpec, stacks: Stacks) -> _Base | None:
        """Return the base of the variant of a spec, whose arrays come first in `stacks`; None if its runs cannot be
        vectorized.
        """
        with one_thread_of_linear_algebra():
            member = lanes.members([spec])[0]
        own = {criterion.name for _, criterion in criteria("start", spec)}
        if member is None or not own <= {"moved-start", "changed-velocities"}:
            return None
        watchers = [] if variant.watched else StateWatchers(spec, member.start.mechanism, member.size).of_many
        member = replace(member, watched=variant.watched, watchers=watchers or ())
        return cls(member, variant, (stacks.q[0], stacks.v[0]))

    def runs(self, stacks: Stacks, spec: Callable[[int], RunSpec], lanes: LaneRuns) -> PreparedRuns | None:
        """Return the runs whose starts suit the lanes, None if there are none; `spec` returns that of a member."""
        first, count, varying = self.member, len(stacks.members), stacks.topology.keys()
        start, longest = first.start, stacks.longest.ravel()
        moved = start.assembled.changed and "spring_points" in varying
        starts = VariedStarts(start.mechanism, stacks.topology, longest, stacks.q, stacks.v)
        if varying <= self._of_forces and not moved and self._is_given(stacks):
            starts = replace(starts, q=np.tile(start.q0, (count, 1)), v=np.tile(start.v0, (count, 1)))
            extent, size, tolerance = (np.full(count, x) for x in (first.extent, first.size, np.inf))
        elif varying & self._checked:
            return None
        else:
            extent = stacks.size.ravel()
            size = np.where(extent == 0.0, longest, extent)
            # Residuals are computed in another order than by assembly.
            tolerance = stacks.tolerance.ravel() * (1.0 - 1e-6)
        runs = PreparedRuns(
            first=first, starts=starts, tables=[first.table] * count, guards=self._guards(size),
            assembled=[start.assembled] * count, findings=[first.findings] * count, size=size, extent=extent,
            seconds=np.zeros(count), tolerance=tolerance, indices=stacks.members.tolist(), spec=spec,
        )  # fmt: skip
        is_shared = np.isinf(tolerance[0])
        if (is_shared or not self.is_assembled) and first.pivots is None:
            return runs
        return self._assembled(runs, stacks if self.is_assembled and not is_shared else None, lanes)

    def _guards(self, size: np.ndarray) -> list[Guards]:
        """Return the limits of runs of mechanisms with these sizes [m]."""
        return [guards_of(self.member.settings, one) for one in size.tolist()]

    def _is_given(self, stacks: Stacks) -> bool:
        """Return whether all runs have the same initial state before assembly as this one, to the bit."""
        states = zip((stacks.q, stacks.v), self._given, strict=True)
        return all((x.view(np.int64) == own.view(np.int64)).all() for x, own in states)

    def _assembled(self, runs: PreparedRuns, stacks: Stacks | None, lanes: LaneRuns) -> PreparedRuns | None:
        """Return those runs that have starts and pivots like `first`; starts are assembled if `stacks` are given."""
        first, kept, made = self.member, [], list[tuple[MechanismAtStart, StagePivots | None]]()
        for run in range(len(runs)):
            at_start: MechanismAtStart | None = runs.member(run).start
            with suppress(SpecError, SingularSystemError), within_double_precision(), one_thread_of_linear_algebra():
                if stacks is not None:
                    at_start = self._start(stacks, run)
                if at_start is None:
                    continue
                pivots = lanes.pivots.of(first.method, at_start, first.table)
                if (pivots and pivots.key) == (first.pivots and first.pivots.key):
                    kept.append(run)
                    made.append((at_start, pivots))
        if not kept:
            return None
        runs = runs.of(kept)
        runs.starts = VariedStarts.of_starts(*zip(*made, strict=True))
        runs.assembled = [start.assembled for start, _ in made]
        if stacks is not None:
            runs.tolerance[:] = np.inf
            moved = (runs.starts.q != stacks.q[kept]).any(axis=1)  # where only masses and forces differ
            for run in np.flatnonzero(moved).tolist():
                runs.extent[run] = mechanism_size(first.settings.mechanism(), runs.assembled[run].q)
                runs.size[run] = runs.extent[run] or runs.size[run]
            runs.guards = self._guards(runs.size)
        return runs

    def _start(self, stacks: Stacks, run: int) -> MechanismAtStart | None:
        """Return the mechanism of a run at its start.

        The result is None if the mechanism differs in more than its numbers, or if there might be other warnings about
        changed positions and velocities.
        """
        first, compiled, model = self.member, self._variant.compiled, self.member.settings.mechanism()
        arrays = {name: values[run] for name, values in stacks.topology.items()}
        for name, own in self._own.items():
            own[...] = arrays.get(name, getattr(compiled.topology, name))
        self._search.__dict__.pop("reach", None)
        q, v, tolerance = stacks.q[run], stacks.v[run], float(stacks.tolerance[run, 0])
        given_q, given_v = (x.reshape(-1, 3)[:-1] for x in (q, v))
        start, found = assemble_from(model, self._search, given_q, given_v, tolerance), self._variant.findings
        is_given = given_v != 0.0
        is_given[:, :2] = is_given[:, :2].any(axis=1, keepdims=True)
        if (start.q != given_q).any() or (start.v != given_v)[is_given].any():
            if not (stacks.topology.keys() <= OF_MOTION and self._is_given(stacks)):
                return None
            found = *found, *findings("start", first.settings, start)
        compiled = compiled.with_numbers(arrays, float(stacks.longest[run, 0]))
        at_start = CompiledForStarts(compiled, self._search, self._has_loops).checked(model, start, first.table.end)
        return at_start if found == first.findings and topology_of(at_start.mechanism) == first.topology else None
