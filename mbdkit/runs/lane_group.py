"""Similar runs that are advanced in lanes: what they record, and how they end, as arrays of many runs."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.archive.disk_space import row_bytes
from mbdkit.archive.finished_run import ArrayHash
from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.engine.input_schedule import start_settings
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.observed_states import joint_sums
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Stretch, Timetable
from mbdkit.integrators.lane_stepper import ControlledLaneStepper, LaneResults, LaneStepper
from mbdkit.quantities.array import TEXT, Recorded
from mbdkit.quantities.names import ArchiveNames, archive_names
from mbdkit.quantities.states import States
from mbdkit.runs.conclusion import EndedRun, Extremes, conclude, log_end, logs_ends
from mbdkit.runs.integrals import RunIntegrals, functionals_of
from mbdkit.runs.law_ranges import LawRanges
from mbdkit.runs.preparation import recorded_arrays
from mbdkit.runs.recorded_states import recorded_states
from mbdkit.runs.state_watchers import StateWatchers
from mbdkit.trust.criteria import Evidence, Judgement, is_inconspicuous, judge
from mbdkit.trust.energy_record import EnergyRecord, largest_energies
from mbdkit.trust.finding import Doubts

if TYPE_CHECKING:
    from mbdkit.archive.measured_values import Integrals
    from mbdkit.runs.lane_runs import LaneMember
    from mbdkit.trust.finding import Finding

#: Largest size of the recorded arrays that are computed together [bytes]; they should remain in the processor's cache.
BYTES = 1 << 22

ROWS = 200  #: Assumed number of recorded states of a run with controlled steps.

MOST_TOGETHER = 32 * WIDTH  #: Largest number of runs whose arrays are computed together.


def _stepper(first: LaneMember, workspace: Workspace) -> LaneStepper:
    """Return the loop that advances runs with the mechanism and method of `first`."""
    method: Any = first.method  # a method with a loop for lanes
    if first.method.traits.tolerances:
        return ControlledLaneStepper(method, workspace, first.pivots)
    return LaneStepper(method, workspace, _rows(first), first.pivots)


def _rows(first: LaneMember) -> int:
    """Return the number of recorded states of a run with fixed steps."""
    return 1 + -(-first.table.steps // first.table.every)


class LaneGroup:
    """Runs of one mechanism and method that differ in numbers only.

    Parameters
    ----------
    first
        The first of the runs.

    Attributes
    ----------
    size : int
        Largest number of runs that `finished` takes.
    """

    def __init__(self, first: LaneMember):
        mechanism, spec = first.start.mechanism, first.settings
        start = first.start
        workspace = Workspace(mechanism, first.table.start, start.q0, start.v0, formulation=spec.formulated.name)
        self.stepper = _stepper(first, workspace)
        self.mechanism, self.joints = mechanism, joint_sums(mechanism)
        self.names: ArchiveNames = archive_names(mechanism)
        self.layout = recorded_arrays(spec, first.method, mechanism)
        self.recorded = {one.key: one for one in self.layout if isinstance(one, Recorded)}
        self.types = {one.key: np.dtype(one.dtype) for one in self.layout if one.grows and one.dtype != TEXT}
        self.hash = ArrayHash(self.names, self.layout)
        rows = ROWS if first.method.traits.tolerances else _rows(first)
        together = min(MOST_TOGETHER, BYTES // max(1, rows * row_bytes(self.names, spec.output.recorded)))
        self.size = max(1, together // WIDTH) * WIDTH

    def finished(
        self, members: Sequence[LaneMember], measures: Sequence[str]
    ) -> tuple[Sequence[int], FinishedRuns | None]:
        """Carry out at most `size` runs of the group together.

        Returns the indices of the runs that have ended, and their results; the others must be repeated alone.
        """
        # Measured once for all: for a process with several threads, reading the processor time is slow on some systems.
        begin, cpu = time.perf_counter(), time.process_time()
        ended, runs = self.concluded(members, self.advance(members), measures)
        if runs is not None:
            spent = {"wall_s": time.perf_counter() - begin, "cpu_s": time.process_time() - cpu}
            lanes = -(-len(members) // WIDTH) * WIDTH
            each = {name: np.full(len(ended), seconds / lanes) for name, seconds in spent.items()}
            runs = replace(runs, stats={**runs.stats, **each})
        return ended, runs

    def advance(self, members: Sequence[LaneMember]) -> LaneResults:
        """Take the steps of at most `size` runs of the group."""
        vectors = [members[first : first + WIDTH] for first in range(0, len(members), WIDTH)]
        return LaneResults.joined(
            [
                self.stepper.advance(
                    [one.start for one in some], [one.table for one in some], [one.pivots for one in some]
                )
                for some in vectors
            ]
        )

    def concluded(
        self, members: Sequence[LaneMember], results: LaneResults, measures: Sequence[str]
    ) -> tuple[Sequence[int], FinishedRuns | None]:
        """Return the indices of the runs that have ended, and what they have recorded, without the times of the steps.

        The others must be repeated alone.
        """
        watches = {place: _Watch(members[place], results, place) for place in self.sound(results, members)}
        ended = [place for place, watch in watches.items() if not watch.has_stopped]
        if not ended:
            return [], None
        if len(ended) < len(members):
            results, members = results.of(np.array(ended)), [members[place] for place in ended]
        return ended, self._concluded(members, results, [watches[place] for place in ended], measures)

    def _concluded(
        self, members: Sequence[LaneMember], results: LaneResults, watches: Sequence[_Watch], measures: Sequence[str]
    ) -> FinishedRuns:
        """Return the results of runs that have reached their ends."""
        count, states = len(members), self._states(results)
        with np.errstate(all="ignore"):  # values in lanes whose run has failed may overflow
            arrays = {key: self._by_run(one.take(states), key, count) for key, one in self.recorded.items()}
        arrays |= self._intervals([member.table for member in members], results)
        extremes = _Extremes(self, results, states)
        found = [watch.findings(extremes.energies[:, run]) for run, watch in enumerate(watches)]
        begin = time.perf_counter()
        digests = self.hash.shared_digests(arrays) if results.work is None and count > 1 else {}
        settings = [start_settings(member.start.mechanism, member.table.start) for member in members]
        arrays |= {key: np.stack([own[key] for own in settings]) for key in settings[0]}
        lengths = {"time": results.rows, "interval": results.rows - 1}
        lengths |= {"set/number": np.full(count, len(values)) for values in settings[0].values()}
        hashes = self.hash.of_runs(arrays, lengths, digests)
        finish = (time.perf_counter() - begin) / count
        stats = dict(results.counters)
        stats["factorizations"] = stats["factorizations"] + int(members[0].pivots is not None)
        stats["setup_s"] = np.array([member.seconds for member in members])
        doubts = [Doubts.of(one, member.settings.accept) for one, member in zip(found, members, strict=True)]
        runs = FinishedRuns(
            status="complete", reason="", stats={**stats, "finish_s": np.full(count, finish)},
            misalignment_max=extremes.misalignment, judgements=extremes.judgements(members, doubts),
            warnings=[tuple(map(str, one)) for one in found], names=self.names, layout=self.layout, arrays=arrays,
            lengths=lengths, data_sha256=hashes, assembly=[one.start.assembled.describe() for one in members],
            sizes=np.array([member.extent for member in members]), integrals=[*_integrals(members, results, measures)],
        )  # fmt: skip
        if logs_ends():
            for run, member in enumerate(members):
                log_end(member.spec, runs.run(run))
        return runs

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

    def sound(self, results: LaneResults, members: Sequence[LaneMember]) -> list[int]:
        """Return the indices of the runs that are not lost and whose recorded states certainly exceed no limit of
        misalignment. The joints of the others must be checked one by one.
        """
        limits = [member.table.guards for member in members]
        largest = np.abs(results.observed.phi).max(axis=(1, 2, 3), initial=0.0)
        smallest = np.array([min(limit.misalignment, limit.angle_misalignment) for limit in limits])
        # The residual of a joint, which has at most three rows, is below 4 times that of its largest row.
        sound: list[int] = np.flatnonzero(~results.lost & (largest <= smallest / 4)).tolist()
        return sound

    def _intervals(self, tables: Sequence[Timetable], results: LaneResults) -> dict[str, np.ndarray]:
        """Return the statistics (R, T - 1) of the intervals between the recorded states of all runs."""
        shape = len(results.time), results.time.shape[1] - 1
        if results.work is not None:
            steps, size, rejected = np.moveaxis(results.work[:, 1:], 2, 0)
        else:  # the numbers of steps are equal for all runs
            first = tables[0]
            ends = np.minimum(first.every * np.arange(1, 1 + shape[1]), first.steps)
            steps, rejected = np.broadcast_to(np.diff(ends, prepend=0), shape), np.zeros(shape)
            size = np.repeat([[table.step] for table in tables], shape[1], axis=1)
            size[:, -1] = [table.last_step for table in tables]
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


class _Watch:
    """What watches the recorded states of a run in a lane."""

    def __init__(self, member: LaneMember, results: LaneResults, run: int):
        self._member = member
        self._ranges = self._watchers = None
        self.has_stopped = False  #: Whether the run stops where a law leaves its range.
        if not member.watched:
            return
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
        watched = () if self._watchers is None else self._watchers.findings(EnergyRecord.of(energies), {})
        return (*self._member.findings, *watched, *ranges)


class _Extremes:
    """What was largest in R runs, over all steps and in their recorded states; see `Extremes`.

    - `misalignment`, `angles`: (R, J). `energies`: (5, R) values of `EnergyRecord`.
    """

    def __init__(self, group: LaneGroup, results: LaneResults, states: States):
        shape = results.time.shape
        misalignment = states.misalignment.reshape(*shape, -1).max(axis=1)
        self.mechanism, self.results = group.mechanism, results
        self.misalignment = np.maximum(group.joints.misalignment_of_squares(results.worst), misalignment)
        self.angles = group.joints.angle_misalignment(np.abs(results.observed.phi).max(axis=1))
        kinetic, balance = results.observed.kinetic, states.balance.reshape(shape)
        others = np.stack([results.observed.potential, results.energy[:, :, 0], results.energy[:, :, 1]])
        self.energies = largest_energies(kinetic, others, balance)

    def judgements(self, members: Sequence[LaneMember], doubts: Sequence[Doubts]) -> list[Judgement]:
        """Return the verdicts on the runs; those whose numbers give a reason are judged one by one."""
        sizes = np.array([member.size for member in members])
        gap, angle = (values.max(axis=1, initial=0.0) for values in (self.misalignment, self.angles))
        kinetic, jump, _ = self.results.guards
        errors = [jump, self.energies[2]] if not self.mechanism.is_locked else [0.0 * jump] * 2
        with np.errstate(all="ignore"):
            share = np.where(sizes > 0.0, gap / sizes, gap)
            energy = self.energies[1]
            plain = is_inconspicuous(share, angle, np.maximum(self.energies[0], kinetic), energy, errors)
        return [
            _judgement_of(doubts[run]) if plain and not turns else self._judgement(run, members[run], doubts[run])
            for run, (plain, turns) in enumerate(zip(plain.tolist(), self.results.turns, strict=True))
        ]

    def _judgement(self, run: int, member: LaneMember, doubts: Doubts) -> Judgement:
        ended = EndedRun(mechanism=member.start.mechanism, size=member.size, doubts=doubts, finer=member.settings.finer)
        extremes = Extremes(
            float(self.results.time[run, -1]),
            self.misalignment[run],
            self.angles[run],
            EnergyRecord.of(self.energies[:, run]),
            self.results.evidence_of(run),
        )
        return conclude(ended, extremes).judgement


@lru_cache(maxsize=256)
def _judgement_of(doubts: Doubts) -> Judgement:
    """Return the verdict on a complete run whose numbers give no reason."""
    return judge(Evidence(warnings=doubts.open, accepted=doubts.accepted, faults=doubts.faults))


def _integrals(members: Sequence[LaneMember], results: LaneResults, measures: Sequence[str]) -> Iterator[Integrals]:
    """Yield the extrema and values of runs that their measures need; nothing if they need none.

    They are computed from the rows of the runs, which are the ends of all steps.
    """
    functionals = functionals_of(members[0].settings, measures)
    for run, member in enumerate(members if functionals else ()):
        start, rows = member.start, int(results.rows[run])
        workspace = Workspace(start.mechanism, member.table.start, start.q0, start.v0)
        stiff = member.method.traits.suits_stiff
        integrals = RunIntegrals(workspace, functionals_of(member.spec, measures), member.table, suits_stiff=stiff)
        assert integrals.continuous is not None
        time, q, v = (values[run, :rows] for values in (results.time, results.q, results.v))
        integrals.continuous.add_ends(time, q, v, np.zeros((rows, 0)))
        yield integrals.totals()
