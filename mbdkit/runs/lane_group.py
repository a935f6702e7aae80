"""Similar runs that are advanced in lanes: what they record, and how they end, as arrays of many runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbdkit.archive.disk_space import row_bytes
from mbdkit.archive.finished_run import ArrayHash
from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.engine.consistent_start import MechanismAtStart
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.input_schedule import start_settings
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.observed_states import joint_sums
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Stretch
from mbdkit.integrators.lane_stepper import ControlledLaneStepper, LaneResults, LaneStepper, VariedStarts
from mbdkit.quantities.array import TEXT, Recorded
from mbdkit.quantities.names import ArchiveNames, archive_names
from mbdkit.quantities.states import States
from mbdkit.runs.coarse_steps import Start, coarse_step
from mbdkit.runs.conclusion import EndedRun, Extremes, conclude, log_end, logs_ends
from mbdkit.runs.findings import StateWatchers
from mbdkit.runs.integrals import RunIntegrals, functionals_of
from mbdkit.runs.law_ranges import LawRanges
from mbdkit.runs.preparation import recorded_arrays
from mbdkit.runs.recorded_states import recorded_states
from mbdkit.trust.criteria import Evidence, Judgement, is_inconspicuous, judge
from mbdkit.trust.energy_record import EnergyRecord, largest_energies
from mbdkit.trust.finding import Doubts

if TYPE_CHECKING:
    from mbdkit.archive.measured_values import Integrals
    from mbdkit.engine.assembly import AssembledState
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.integrators.interface import Guards, Timetable
    from mbdkit.integrators.lanes.lane_collocation import StagePivots
    from mbdkit.methods.kinds import Method
    from mbdkit.runs.findings import WatcherOfMany
    from mbdkit.spec.run_spec import RunSpec
    from mbdkit.trust.finding import Finding

#: Largest size of the recorded arrays that are computed together [bytes]: smaller ones would remain in the processor's
#: cache, but each group takes some milliseconds whatever its number of runs.
BYTES = 1 << 24

ROWS = 200  #: Assumed number of recorded states of a run with controlled steps.

MOST_TOGETHER = 32 * WIDTH  #: Largest number of runs whose arrays are computed together.


@dataclass(eq=False)
class LaneMember:
    """A prepared run that can be vectorized.

    If `varied` is given, `settings` is the spec of a run that differs in numbers of its model only, and `varied`
    returns the spec of this run.
    """

    settings: RunSpec
    method: Method
    start: MechanismAtStart
    table: Timetable
    pivots: StagePivots | None  #: Pivots of the stage matrix; None if the method is explicit.
    size: float  #: Size of the mechanism at its start [m]; its characteristic length if all points coincide.
    extent: float  #: Size of the mechanism at its start [m].
    findings: tuple[Finding, ...]
    topology: tuple[object, ...]  #: Key that is equal for mechanisms that differ only in numbers.
    seconds: float = 0.0  #: Wall time of the preparation [s].
    varied: Callable[[], RunSpec] | None = None
    watched: bool = True  #: Whether criteria may look at recorded states, and at the spec at the end, of each run.
    watchers: Sequence[WatcherOfMany] = ()  #: Other criteria that look at the recorded states of all runs at once.

    @property
    def spec(self) -> RunSpec:
        """The spec of the run."""
        return self.settings if self.varied is None else self.varied()

    @property
    def key(self) -> tuple[object, ...]:
        """Key that is equal for runs that can share a loop and whose archives have the same arrays."""
        table, pivots = self.table, None if self.pivots is None else self.pivots.key
        steps = table.interval if self.method.traits.tolerances else table.steps
        settings = self.settings.output.recorded, tuple(self.settings.accept)
        return self.topology, self.method, pivots, steps, table.every, settings

    def workspace(self) -> Workspace:
        """Return the mechanism at its start."""
        start, formulation = self.start, self.settings.formulated.name
        return Workspace(start.mechanism, self.table.start, start.q0, start.v0, formulation=formulation)


def _stepper(first: LaneMember, workspace: Workspace) -> LaneStepper:
    """Return the loop that advances runs with the mechanism and method of `first`."""
    method: Any = first.method  # a method with a loop for lanes
    if first.method.traits.tolerances:
        return ControlledLaneStepper(method, workspace, first.pivots)
    return LaneStepper(method, workspace, _rows(first), first.pivots)


def _rows(first: LaneMember) -> int:
    """Return the number of recorded states of a run with fixed steps."""
    return 1 + -(-first.table.steps // first.table.every)


class Watch:
    """What watches the recorded states of a run in a lane."""

    def __init__(self, member: LaneMember, results: LaneResults, run: int):
        self._member = member
        self.has_stopped = False  #: Whether the run stops where a law leaves its range.
        mechanism, rows, spec = member.start.mechanism, int(results.rows[run]), member.spec
        self._ranges = LawRanges.of(spec.mechanism(), mechanism, stops=spec.limits.law_range == "stop")
        if self._ranges is not None:
            left = self._ranges.add(results.time[run, :rows], results.observed.forces[run, :rows])
            self.has_stopped = left is not None and self._ranges.stops
        self._watchers = StateWatchers(spec, mechanism, member.size)
        if self._watchers:
            observed = Observed(*(values[run, :rows] for values in results.observed))
            time, q, v = (values[run, :rows] for values in (results.time, results.q, results.v))
            self._watchers.add(States(mechanism, time, q, v, lambda: observed))

    def findings(self, energies: np.ndarray) -> tuple[Finding, ...]:
        """Return what is found in the run, from the values of its `EnergyRecord`."""
        ranges = () if self._ranges is None else self._ranges.findings()
        return (*self._member.findings, *self._watchers.findings(EnergyRecord.of(energies), {}), *ranges)


@dataclass(eq=False)
class PreparedRuns:
    """Prepared runs that can share a loop, and that differ in numbers only.

    - `first`: one of the runs.
    - `starts`: the mechanisms and their starts.
    - `tables`, `guards`: the timetable of each run, and its limits, which replace those of the timetable.
    - `assembled`, `findings`: how the start of each run was made consistent, and what was found about its spec and its
      start.
    - `size`, `extent`, `seconds`: (R,) arrays; see `LaneMember`.
    - `tolerance`: (R,) largest residual of constraints with which assembly certainly changes nothing; infinite if the
      start is known to be consistent.
    - `indices`, `spec`: index of each run among those that were asked for, and function that returns the spec of the
      run with an index.
    """

    first: LaneMember
    starts: VariedStarts
    tables: Sequence[Timetable]
    guards: Sequence[Guards]
    assembled: Sequence[AssembledState]
    findings: Sequence[tuple[Finding, ...]]
    size: np.ndarray
    extent: np.ndarray
    seconds: np.ndarray
    tolerance: np.ndarray
    indices: Sequence[int]
    spec: Callable[[int], RunSpec]

    @classmethod
    def of_members(cls, members: Sequence[LaneMember]) -> PreparedRuns:
        """Return runs that were prepared one by one."""
        size, extent, seconds = (
            np.array([getattr(member, name) for member in members]) for name in ("size", "extent", "seconds")
        )
        return cls(
            first=members[0],
            starts=VariedStarts.of_starts([one.start for one in members], [one.pivots for one in members]),
            tables=[member.table for member in members],
            guards=[member.table.guards for member in members],
            assembled=[member.start.assembled for member in members],
            findings=[member.findings for member in members],
            size=size, extent=extent, seconds=seconds, tolerance=np.full(len(members), np.inf),
            indices=range(len(members)), spec=lambda index: members[index].spec,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.tables)

    def member(self, run: int) -> LaneMember:
        """Return one of the runs."""
        mechanism, q, v = self.starts.mechanism_of(run), self.starts.q[run], self.starts.v[run]
        return replace(
            self.first,
            varied=partial(self.spec, self.indices[run]),
            start=MechanismAtStart(mechanism, q, v, self.assembled[run]),
            table=replace(self.tables[run], guards=self.guards[run]),
            size=float(self.size[run]), extent=float(self.extent[run]), findings=self.findings[run],
        )  # fmt: skip

    def of(self, runs: Sequence[int]) -> PreparedRuns:
        """Return some of the runs."""
        places, kept = [*runs], ("first", "starts", "spec")
        own: dict[str, Any] = {name: values for name, values in vars(self).items() if name not in kept}
        for name, values in own.items():
            own[name] = values[places] if isinstance(values, np.ndarray) else [values[run] for run in places]
        return replace(self, starts=self.starts.of(places), **own)

    def is_consistent(self, results: LaneResults) -> np.ndarray:
        """Return whether assembly certainly changes nothing, (R,)."""
        residuals = results.observed.phi[:, 0], results.observed.phi_rate[:, 0]
        gap, rate = (np.abs(x).max(axis=(1, 2), initial=0.0) for x in residuals)
        return np.asarray((gap <= self.tolerance) & (rate <= self.tolerance))

    def sound(self, results: LaneResults) -> np.ndarray:
        """Return the indices of the runs that need not be repeated alone: because of a limit or a finding, or because
        assembly may change their starts.
        """
        smallest = np.array([min(limit.misalignment, limit.angle_misalignment) for limit in self.guards])
        largest = np.abs(results.observed.phi).max(axis=(1, 2, 3), initial=0.0)
        # Joints whose states may exceed a limit of misalignment must be checked one by one. The residual of a joint,
        # which has at most three rows, is below 4 times that of its largest row.
        sound = np.flatnonzero(~results.lost & (largest <= smallest / 4))
        for watcher in self.first.watchers:
            sound = sound[~watcher.found_in(results.time, results.observed.forces)[sound]]
        return np.asarray(sound[self.is_consistent(results)[sound]])

    def watched(self, results: LaneResults) -> list[Watch] | None:
        """Return what watches the recorded states of each run; None if nothing does."""
        return [Watch(self.member(run), results, run) for run in range(len(self))] if self.first.watched else None

    def settings(self) -> dict[str, np.ndarray]:
        """Return the arrays of the settings of inputs."""
        if not self.first.start.mechanism.inputs:
            return {}
        own = [start_settings(self.starts.mechanism_of(run), table.start) for run, table in enumerate(self.tables)]
        return {key: np.stack([one[key] for one in own]) for key in own[0]}

    def assembly(self) -> list[str]:
        """Return sentences on how the starts were made consistent."""
        texts = {id(one): one.describe() for one in {id(one): one for one in self.assembled}.values()}
        return [texts[id(one)] for one in self.assembled]

    def integrals(self, results: LaneResults, measures: Sequence[str]) -> list[Integrals]:
        """Return the extrema and values that the measures of the runs need; nothing if they need none.

        They are computed from the rows of the runs, which are the ends of all steps.
        """
        integrals: list[Integrals] = []
        for run in range(len(self) if functionals_of(self.first.settings, measures) else 0):
            member, rows = self.member(run), int(results.rows[run])
            own = RunIntegrals(
                member.workspace(), functionals_of(member.spec, measures), member.table,
                suits_stiff=member.method.traits.suits_stiff, is_controlled=member.spec.claims.adaptive,
            )  # fmt: skip
            assert own.continuous is not None
            time, q, v = (values[run, :rows] for values in (results.time, results.q, results.v))
            own.continuous.add_ends(time, q, v, np.zeros((rows, 0)))
            integrals.append(own.totals())
        return integrals


class Advanced(NamedTuple):
    """The results of the steps of runs, the indices of the sound ones (see `PreparedRuns.sound`), and the wall and
    processor times that they took [s].
    """

    results: LaneResults
    sound: np.ndarray
    spent: np.ndarray


def _clocks() -> np.ndarray:
    # the processor time of a process with several threads takes 0.3 ms to read on some systems
    return np.array([time.perf_counter(), time.thread_time()])


class LaneGroup:
    """Runs of one mechanism and method that differ in numbers only.

    Parameters
    ----------
    first
        The first of the runs.

    Attributes
    ----------
    size : int
        Largest number of runs that are advanced together.
    """

    def __init__(self, first: LaneMember):
        mechanism, spec = first.start.mechanism, first.settings
        self.stepper = _stepper(first, first.workspace())
        self.mechanism, self.joints = mechanism, joint_sums(mechanism)
        self.names: ArchiveNames = archive_names(mechanism)
        self.layout = recorded_arrays(spec, first.method, mechanism)
        self.recorded = {one.key: one for one in self.layout if isinstance(one, Recorded)}
        self.types = {one.key: np.dtype(one.dtype) for one in self.layout if one.grows and one.dtype != TEXT}
        self.hash = ArrayHash(self.names, self.layout)
        self._latest: tuple[CompiledMechanism, EquationsOfMotion] | None = None
        rows = ROWS if first.method.traits.tolerances else _rows(first)
        together = min(MOST_TOGETHER, BYTES // max(1, rows * row_bytes(self.names, spec.output.recorded)))
        self.size = max(1, together // WIDTH) * WIDTH

    def advanced(self, runs: PreparedRuns) -> Advanced:
        """Take the steps of at most `size` runs of the group."""
        begin, results = _clocks(), self.stepper.advance(runs.starts, runs.tables, runs.guards)
        return Advanced(results, runs.sound(results), _clocks() - begin)

    def start_of(self, member: LaneMember) -> Start:
        """Return the start of a run; runs that share their mechanism share its equations."""
        mechanism, (q, v) = member.start.mechanism, (member.start.q0[:-3], member.start.v0[:-3])
        if self._latest is None or self._latest[0] is not mechanism:
            self._latest = mechanism, EquationsOfMotion(member.workspace())
        return Start(self._latest[1], q, v, member.size)

    def concluded(
        self, runs: PreparedRuns, advanced: Advanced, measures: Sequence[str]
    ) -> tuple[list[int], FinishedRuns | None]:
        """Return the indices of the runs that have ended, and what they have recorded, None if there are none.

        The others must be repeated alone.
        """
        begin, results, ended, count = _clocks(), advanced.results, advanced.sound, len(runs)
        if len(ended) < len(runs):
            results, runs = results.of(ended), runs.of(ended.tolist()) if len(ended) else runs
        watches = runs.watched(results) if len(ended) else None
        if watches is not None and any(watch.has_stopped for watch in watches):
            kept = [run for run, watch in enumerate(watches) if not watch.has_stopped]
            ended, watches = ended[kept], [watches[run] for run in kept]
            results, runs = results.of(np.array(kept, int)), runs.of(kept) if kept else runs
        if not len(ended):
            return [], None
        finished = self._concluded(runs, results, watches, measures)
        spent = (advanced.spent + _clocks() - begin) / count
        shares = {name: np.full(len(ended), share) for name, share in zip(("wall_s", "cpu_s"), spent, strict=True)}
        return ended.tolist(), replace(finished, stats={**finished.stats, **shares})

    def _concluded(
        self, runs: PreparedRuns, results: LaneResults, watches: list[Watch] | None, measures: Sequence[str]
    ) -> FinishedRuns:
        """Return the results of runs that have reached their ends."""
        count, states, first = len(runs), self._states(results), runs.first
        with np.errstate(all="ignore"):  # values in lanes whose run has failed may overflow
            arrays = {key: self._by_run(one.take(states), key, count) for key, one in self.recorded.items()}
        arrays |= self._intervals(runs, results)
        extremes = _Extremes(self, results, states)
        found = runs.findings
        if watches is not None:
            found = [watch.findings(extremes.energies[:, run]) for run, watch in enumerate(watches)]
        begin = time.perf_counter()
        digests = self.hash.shared_digests(arrays) if results.work is None and count > 1 else {}
        settings = runs.settings()
        arrays |= settings
        lengths = {"time": results.rows, "interval": results.rows - 1}
        if settings:
            lengths["set/number"] = np.full(count, settings["inputs/set/number"].shape[1])
        hashes = self.hash.of_runs(arrays, lengths, digests)
        finish = (time.perf_counter() - begin) / count
        stats = dict(results.counters)
        stats["factorizations"] = stats["factorizations"] + int(first.pivots is not None)
        known = {one: (Doubts.of(one, first.settings.accept), tuple(map(str, one))) for one in dict.fromkeys(found)}
        finished = FinishedRuns(
            status="complete", reason="",
            stats={**stats, "setup_s": runs.seconds, "finish_s": np.full(count, finish)},
            misalignment_max=extremes.misalignment,
            judgements=extremes.judgements(runs, [known[one][0] for one in found]),
            warnings=[known[one][1] for one in found], names=self.names, layout=self.layout, arrays=arrays,
            lengths=lengths, data_sha256=hashes, assembly=runs.assembly(), sizes=runs.extent,
            integrals=runs.integrals(results, measures),
        )  # fmt: skip
        if logs_ends():
            for run in range(count):
                log_end(runs.member(run).spec, finished.run(run))
        return finished

    def _states(self, results: LaneResults) -> States:
        """Return the states of all runs, one run after another."""
        count, rows = results.time.shape

        def flat(values: np.ndarray) -> np.ndarray:
            return values.reshape(count * rows, *values.shape[2:])

        observed = Observed(*map(flat, results.observed))
        q, v, energy = flat(results.q), flat(results.v), flat(results.energy)
        none = np.zeros((len(q), 6))
        stretch = Stretch(flat(results.time), q, v, energy[:, 0], energy[:, 1], none, z=flat(results.z))
        start = results.observed.kinetic[:, 0] + results.observed.potential[:, 0]
        return recorded_states(self.mechanism, stretch, observed, np.repeat(start, rows), np.zeros(len(q)))

    def _by_run(self, values: np.ndarray, key: str, count: int) -> np.ndarray:
        """Return the rows of all runs as a contiguous array (R, T, ...) with the type of the layout."""
        shaped = values.reshape(count, len(values) // count, *values.shape[1:])
        return np.ascontiguousarray(shaped, self.types[key])

    def _intervals(self, runs: PreparedRuns, results: LaneResults) -> dict[str, np.ndarray]:
        """Return the statistics (R, T - 1) of the intervals between the recorded states of all runs."""
        shape = len(results.time), results.time.shape[1] - 1
        if results.work is not None:
            steps, size, rejected = np.moveaxis(results.work[:, 1:], 2, 0)
        else:  # the numbers of steps are equal for all runs
            first = runs.first.table
            ends = np.minimum(first.every * np.arange(1, 1 + shape[1]), first.steps)
            steps, rejected = np.broadcast_to(np.diff(ends, prepend=0), shape), np.zeros(shape)
            size = np.repeat([[table.step] for table in runs.tables], shape[1], axis=1)
            size[:, -1] = [table.last_step for table in runs.tables]
        values = {
            "interval": np.broadcast_to(np.arange(1, 1 + shape[1]), shape),
            "time": results.time[:, 1:],
            "steps": steps,
            "size": size,
            "rejected": rejected,
            "iterations": results.iterations[:, 1:, 0],
            "iterations_max": results.iterations[:, 1:, 1],
        }
        typed = {f"steps/{name}": array for name, array in values.items() if f"steps/{name}" in self.types}
        return {key: np.ascontiguousarray(array, self.types[key]) for key, array in typed.items()}


class _Extremes:
    """What was largest in R runs, over all steps and in their recorded states; see `Extremes`.

    - `misalignment`, `angles`: (R, J). `energies`: (5, R) values of `EnergyRecord`.
    """

    def __init__(self, group: LaneGroup, results: LaneResults, states: States):
        shape = results.time.shape
        misalignment = states.misalignment.reshape(*shape, -1).max(axis=1)
        self._group, self.results = group, results
        self.misalignment = np.maximum(group.joints.misalignment_of_squares(results.worst), misalignment)
        self.angles = group.joints.angle_misalignment(np.abs(results.observed.phi).max(axis=1))
        kinetic, balance = results.observed.kinetic, states.balance.reshape(shape)
        others = np.stack([results.observed.potential, results.energy[:, :, 0], results.energy[:, :, 1]])
        self.energies = largest_energies(kinetic, others, balance)

    def judgements(self, runs: PreparedRuns, doubts: Sequence[Doubts]) -> list[Judgement]:
        """Return the verdicts on the runs; those whose numbers give a reason are judged one by one."""
        sizes = runs.size
        gap, angle = (values.max(axis=1, initial=0.0) for values in (self.misalignment, self.angles))
        kinetic, jump, _ = self.results.guards.T
        errors = [jump, self.energies[2]] if not self._group.mechanism.is_locked else [0.0 * jump] * 2
        with np.errstate(all="ignore"):
            share = np.where(sizes > 0.0, gap / sizes, gap)
            energy = self.energies[1]
            plain = is_inconspicuous(share, angle, np.maximum(self.energies[0], kinetic), energy, errors)
        return [
            _judgement_of(doubts[run]) if plain and not turns else self._judgement(run, runs.member(run), doubts[run])
            for run, (plain, turns) in enumerate(zip(plain.tolist(), self.results.turns, strict=True))
        ]

    def _judgement(self, run: int, member: LaneMember, doubts: Doubts) -> Judgement:
        ended = EndedRun(
            mechanism=member.start.mechanism, size=member.size, doubts=doubts, finer=member.settings.finer,
            coarse=lambda: coarse_step(member.settings, lambda: self._group.start_of(member)),
        )  # fmt: skip
        last, energies = float(self.results.time[run, -1]), EnergyRecord.of(self.energies[:, run])
        steps = self.results.evidence_of(run)
        extremes = Extremes(last, self.misalignment[run], self.angles[run], energies, steps)
        return conclude(ended, extremes).judgement


@lru_cache(maxsize=256)
def _judgement_of(doubts: Doubts) -> Judgement:
    """Return the verdict on a complete run whose numbers give no reason."""
    return judge(Evidence(warnings=doubts.open, accepted=doubts.accepted, faults=doubts.faults))
