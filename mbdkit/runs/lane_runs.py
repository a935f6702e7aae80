"""Vectorized runs: prepares specs, advances runs that differ only in numbers together, and finishes them.

Each run is computed in a lane, an element of the SIMD vectors with which one loop advances several runs at once.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from mbdkit.archive.finished_run import ArrayHash, FinishedRun
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.consistent_start import CompiledForStarts, MechanismAtStart, Starts
from mbdkit.engine.input_schedule import start_settings
from mbdkit.engine.joint_sums import joint_sums
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.lane_starts import at_starts
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Guards, Stretch, Timetable
from mbdkit.integrators.lane_stepper import (
    ControlledLaneStepper,
    LaneResults,
    LaneStepper,
    PivotsAtStart,
)
from mbdkit.integrators.lanes.lane_collocation import StagePivots
from mbdkit.integrators.lanes.lane_mechanisms import suits_lanes, topology_of
from mbdkit.mechanism.size import mechanism_sizes
from mbdkit.methods.kinds import Method
from mbdkit.quantities.array import TEXT, Recorded
from mbdkit.quantities.names import ArchiveNames, archive_names
from mbdkit.quantities.states import States
from mbdkit.runs.conclusion import EndedRun, Extremes, conclude, log_end
from mbdkit.runs.corners import check_jumps
from mbdkit.runs.findings import findings
from mbdkit.runs.integrals import RunIntegrals, functionals_of
from mbdkit.runs.law_ranges import LawRanges, has_ranges, steps_are_rows
from mbdkit.runs.preparation import guards_of, make_method, recorded_arrays, timetable
from mbdkit.runs.recorded_states import recorded_states
from mbdkit.runs.state_watchers import StateWatchers
from mbdkit.spec.run_spec import RunSpec
from mbdkit.trust.energy_record import EnergyRecord
from mbdkit.trust.finding import Doubts, Finding

#: Largest number of loops that are stored for later batches; each loop is for one mechanism and method.
MOST_GROUPS = 8


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
    size: float  #: Size of the mechanism at its start [m].
    findings: tuple[Finding, ...]
    topology: tuple[object, ...]  #: Key that is equal for mechanisms that differ only in numbers.
    seconds: float = 0.0  #: Wall time of the preparation [s].
    varied: Callable[[], RunSpec] | None = None
    watched: bool = True  #: Whether criteria may look at recorded states, and at the spec at the end.

    @property
    def spec(self) -> RunSpec:
        """The spec of the run."""
        return self.settings if self.varied is None else self.varied()

    @property
    def key(self) -> tuple[object, ...]:
        """Key that is equal for runs that can share a loop and whose archives have the same arrays."""
        table, pivots = self.table, None if self.pivots is None else self.pivots.key
        steps = table.interval if self.method.traits.tolerances else table.steps
        return self.topology, self.method, pivots, steps, table.every, self.settings.output.recorded


@dataclass(frozen=True)
class _Compiled:
    """A run whose settings can be vectorized, and its mechanism, which has not been assembled yet."""

    spec: RunSpec
    method: Method
    cautions: Sequence[Finding]
    compiled: CompiledForStarts


def why_alone(spec: RunSpec, measures: Sequence[str] = ()) -> str:
    """Return the reason why runs with these settings are not vectorized, as a clause; empty if they can be.

    Parameters
    ----------
    measures
        See `LaneRuns`.
    """
    reasons = (
        (spec.formulated.solves_multipliers, f"their formulation is {spec.formulated.name}"),
        (spec.stabilized.kind != "none", f"their stabilization is {spec.stabilized.kind}"),
        (bool(spec.events), "they have events"),
        (bool(spec.inputs), "their inputs are set by tables"),
        (spec.impacts == "allow", "their drivers may have impacts"),
        (spec.is_to_be_chosen, "`accuracy` chooses a method or step for each of them"),
        (spec.estimates_errors, "their errors are estimated"),
        (spec.limits.wall_time is not None, "their wall time is limited"),
    )
    if found := next((clause for holds, clause in reasons if holds), ""):
        return found
    functionals = functionals_of(spec, measures)
    if not all(
        (functional.is_extremum or functional.is_value) and not functional.is_nested for functional in functionals
    ):
        return "their measures contain integrals over time"
    if has_ranges(spec.mechanism()) and not steps_are_rows(spec):
        return "the ranges of their force laws are watched between the recorded states"
    if functionals and not steps_are_rows(spec):
        return "their measures contain extrema or `at`, and they do not record every step"
    mechanism = spec.mechanism()
    if functionals and (mechanism.state_names() or mechanism.controllers or mechanism.inputs):
        return "their measures contain extrema or `at`, and their mechanism has first-order states or inputs"
    method = make_method(spec)
    if method.traits.lanes is None or spec.claims.adaptive != (method.traits.tolerances is not None):
        return f"{spec.integrator_item.id} cannot be vectorized with these options"
    if spec.formulated.coordinates == "joint" and not method.traits.is_explicit:
        return f"{spec.integrator_item.id} cannot be vectorized in joint coordinates"
    return ""


def _starts(runs: Sequence[_Compiled | None]) -> Iterator[tuple[int, _Compiled, MechanismAtStart, float]]:
    """Yield index, mechanism at its start, and its size [m], of all runs with a consistent initial state."""
    alike: dict[CompiledForStarts, list[tuple[int, _Compiled]]] = defaultdict(list)
    for place, run in enumerate(runs):
        if run is not None:
            alike[run.compiled].append((place, run))
    for compiled, members in alike.items():
        mechanisms = [run.spec.mechanism() for _, run in members]
        starts = at_starts(compiled, mechanisms, [run.spec.time.final for _, run in members])
        some = [
            (member, model, start) for member, model, start in zip(members, mechanisms, starts, strict=True) if start
        ]
        if some:
            sizes = mechanism_sizes(
                [model for _, model, _ in some], np.stack([start.assembled.q for *_, start in some])
            )
            for ((place, run), _, start), size in zip(some, sizes.tolist(), strict=True):
                yield place, run, start, size


class LaneRuns:
    """Computes vectorized runs, and stores their loops for later runs.

    Parameters
    ----------
    starts
        Computes consistent initial states, and stores compiled mechanisms.
    measures
        Expressions that will be evaluated for the runs, in addition to the measures of their specs.
    """

    def __init__(self, starts: Starts, measures: Sequence[str]) -> None:
        self._measures = measures
        self._groups: dict[tuple[object, ...], LaneGroup] = {}
        self.starts, self.pivots = starts, PivotsAtStart()
        self._topology: tuple[CompiledMechanism, tuple[object, ...]] | None = None
        self._settings: tuple[tuple[object, ...], Method | None] | None = None
        self._table: tuple[tuple[object, ...], Timetable] | None = None

    def members(self, specs: Iterable[RunSpec]) -> list[LaneMember | None]:
        """Prepare runs for vectorization; None for a run that has to be computed alone.

        A run is computed alone if it cannot be vectorized, or if its preparation fails.
        """
        begin = time.perf_counter()
        runs = []
        for spec in specs:
            try:
                runs.append(self._compiled(spec))
            except (Exception, SystemExit):
                runs.append(None)
        members: list[LaneMember | None] = [None] * len(runs)
        for place, run, start, size in _starts(runs):
            with suppress(Exception, SystemExit):
                members[place] = self._member(run, start, size)
        seconds = (time.perf_counter() - begin) / max(1, len(members))
        for member in members:
            if member is not None:
                member.seconds = seconds
        return members

    def _compiled(self, spec: RunSpec) -> _Compiled | None:
        """Compile the mechanism of a run; None if it cannot be vectorized.

        Raises the same errors as a single run.
        """
        method = self._method(spec)
        if method is None:
            return None
        check_jumps(spec)
        cautions = findings("spec", spec, self._measures)
        return _Compiled(spec, method, cautions, self.starts.compiled(spec.mechanism(), spec.time.start))

    def _method(self, spec: RunSpec) -> Method | None:
        """Return the method of a run; None if a run with these settings cannot be vectorized.

        Results are cached, because specs often share settings.
        """
        settings = (
            spec.formulation, spec.stabilization, spec.events, spec.check, spec.accuracy, spec.choose, spec.limits,
            spec.integrator, spec.measures, spec.inputs, spec.impacts,
        )  # fmt: skip
        if self._settings is None or any(
            a is not b and a != b for a, b in zip(settings, self._settings[0], strict=True)
        ):
            self._settings = settings, None if why_alone(spec, self._measures) else make_method(spec)
        return self._settings[1]

    def _member(self, run: _Compiled, start: MechanismAtStart, size: float) -> LaneMember | None:
        """Return the `LaneMember` of a run with its initial state; None if it cannot be vectorized."""
        spec, method = run.spec, run.method
        size = size or start.mechanism.length
        table = self._timetable(run, size)
        # Quantities of contacts and of plugins' elements are computed from numbers of the mechanism that all runs in a
        # vector would share.
        if start.mechanism.extensions or not suits_lanes(method, start.mechanism, table):
            return None
        pivots = self.pivots.of(method, start, table)
        found = (*run.cautions, *findings("start", spec, start.assembled))
        return LaneMember(spec, method, start, table, pivots, size, found, self._topology_of(start.mechanism))

    def _timetable(self, run: _Compiled, size: float) -> Timetable:
        """Return the timetable of a run.

        Apart from the limits of its states, it is that of the run before if only initial states differ.
        """
        spec = run.spec
        depends = run.compiled, spec.time, spec.output, spec.limits, spec.integrator, spec.events, spec.inputs
        if self._table is None or any(a is not b for a, b in zip(depends, self._table[0], strict=True)):
            self._table = depends, timetable(spec, None)
        return replace(self._table[1], guards=guards_of(spec, size))

    def _topology_of(self, mechanism: CompiledMechanism) -> tuple[object, ...]:
        if self._topology is None or self._topology[0] is not mechanism:
            self._topology = mechanism, topology_of(mechanism)
        return self._topology[1]

    def finished(self, members: Sequence[LaneMember]) -> Iterator[list[tuple[int, FinishedRun | None]]]:
        """Carry out runs, and yield the index and the result of each run of a vector when its loop has ended.

        The result is None for a run that must be repeated alone.
        """
        groups: dict[tuple[object, ...], list[int]] = defaultdict(list)
        for place, member in enumerate(members):
            groups[member.key].append(place)
        for key, places in groups.items():
            group = self.group(members[places[0]], key)
            if members[places[0]].method.traits.tolerances:
                places = _by_cost(members, places)
            for first in range(0, len(places), WIDTH):
                some = places[first : first + WIDTH]
                # Measured once for all runs of a vector: for a process with several threads, reading the processor time
                # is slow on some systems.
                begin, cpu = time.perf_counter(), time.process_time()
                results = [
                    None if run is None else with_functionals(run, members[place], self._measures)
                    for place, run in zip(some, group.finished([members[place] for place in some]), strict=True)
                ]
                all_stats: list[Any] = [run.stats for run in results if run is not None]
                apart = sum(stats["finish_s"] for stats in all_stats)
                spent = time.perf_counter() - begin - apart, time.process_time() - cpu
                for stats in all_stats:
                    stats.update(wall_s=spent[0] / len(some), cpu_s=spent[1] / len(some))
                yield list(zip(some, results, strict=True))

    def group(self, first: LaneMember, key: tuple[object, ...]) -> LaneGroup:
        """Return the group of runs with the key of `first`."""
        group = self._groups.pop(key, None) or LaneGroup(first)
        self._groups[key] = group  # moves the group to the end; the group used least recently is discarded first
        if len(self._groups) > MOST_GROUPS:
            self._groups.pop(next(iter(self._groups)))
        return group


def with_functionals(run: FinishedRun, member: LaneMember, measures: Sequence[str]) -> FinishedRun:
    """Return a run to which the extrema and values that its measures need have been added.

    They are computed from the rows of the run, which are the ends of all steps.
    """
    start, functionals = member.start, functionals_of(member.settings, measures)
    if not functionals:
        return run
    time = run.arrays["trajectory/time"] if "trajectory/time" in run.arrays else run.arrays["time"]
    q, v = np.tile(start.q0, (len(time), 1)), np.tile(start.v0, (len(time), 1))
    q[:, :-3], v[:, :-3] = (
        run.arrays[f"trajectory/{name}"].reshape(len(time), -1) for name in ("position", "velocity")
    )
    workspace = Workspace(start.mechanism, member.table.start, start.q0, start.v0)
    stiff = member.method.traits.suits_stiff
    integrals = RunIntegrals(workspace, functionals, member.table, suits_stiff=stiff)
    assert integrals.continuous is not None
    integrals.continuous.add_ends(time, q, v, np.zeros((len(time), 0)))
    return replace(run, integrals=integrals.totals())


def _by_cost(members: Sequence[LaneMember], places: Sequence[int]) -> list[int]:
    """Return the indices of similar runs, sorted by their initial kinetic and gravitational energy.

    A loop ends when the run with the most steps does, so that runs in the same loop should have similar numbers of
    steps. In ensembles of double pendulums with different starts, this order keeps lanes busy in 83 to 87 % of the
    iterations, compared with 75 to 77 % without sorting. Sorting by the numbers of steps, which are not known in
    advance, would give 94 %.
    """
    starts = [members[place].start for place in places]
    mass, gravity, q, v = (
        np.stack(values)
        for values in (
            [start.mechanism.topology.mass.ravel() for start in starts],
            [start.mechanism.topology.gravity for start in starts],
            [start.q0 for start in starts],
            [start.v0 for start in starts],
        )
    )
    with np.errstate(all="ignore"):
        fall = np.einsum("mbi,mi->m", (mass * q).reshape(len(places), -1, 3)[:, :-1, :2], gravity)
        energy = 0.5 * np.sum((mass * v * v)[:, :-3], axis=1) - fall
    return [places[place] for place in np.argsort(energy, kind="stable")]


def _states_of_lane(mechanism: CompiledMechanism, results: LaneResults, lane: int, rows: int) -> States:
    """Return the recorded states of the run in a lane, as far as watchers need them."""
    observed = Observed(*(values[lane, :rows] for values in results.observed))
    time, q, v = (values[lane, :rows] for values in (results.time, results.q, results.v))
    return States(mechanism, time, q, v, lambda: observed)


def _stepper(first: LaneMember, workspace: Workspace) -> LaneStepper:
    """Return the loop that advances runs with the mechanism and method of `first`."""
    method: Any = first.method  # a method with a loop for lanes
    if first.method.traits.tolerances:
        return ControlledLaneStepper(method, workspace, first.pivots)
    return LaneStepper(method, workspace, 1 + -(-first.table.steps // first.table.every), first.pivots)


class LaneGroup:
    """Runs of one mechanism and method that differ in numbers only.

    Parameters
    ----------
    first
        The first of the runs.
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

    def finished(self, members: Sequence[LaneMember]) -> list[FinishedRun | None]:
        """Carry out at most `WIDTH` runs of the group together."""
        results = self.results(members)
        return self.concluded(members, results, self.lost(members, results))

    def results(self, members: Sequence[LaneMember]) -> LaneResults:
        """Take the steps of at most `WIDTH` runs of the group together."""
        starts, tables, pivots = zip(*((one.start, one.table, one.pivots) for one in members), strict=True)
        return self.stepper.advance(starts, tables, pivots)

    def lost(self, members: Sequence[LaneMember], results: LaneResults) -> np.ndarray:
        """Return (W,) whether a run must be repeated alone."""
        return np.asarray(results.lost | self._beyond_limits(results, [one.table.guards for one in members]))

    def concluded(
        self, members: Sequence[LaneMember], results: LaneResults, lost: np.ndarray
    ) -> list[FinishedRun | None]:
        """Return the runs of which these are the results; None for each that must be repeated alone."""
        if np.all(lost):
            return [None] * len(members)
        tables, states = [one.table for one in members], self._states(results)
        with np.errstate(all="ignore"):  # values in lanes whose run has failed may overflow
            arrays = {key: self._by_run(one.take(states), key, len(members)) for key, one in self.recorded.items()}
            intervals = self._intervals(tables, results)
            extremes = self._extremes(results, states)
            is_shared = results.work is None and len(members) > 1
            digests = self.hash.shared_digests(arrays | intervals) if is_shared else {}
        ended: dict[int, EndedRun] = {}
        for lane in np.flatnonzero(~lost).tolist():
            member, watched = members[lane], self._watched(members[lane], results, lane, extremes.energies[lane])
            if watched is not None:
                found = (*member.findings, *watched)
                ended[lane] = EndedRun(
                    mechanism=member.start.mechanism,
                    size=member.size,
                    doubts=Doubts.of(found, member.settings.accept),
                    warnings=tuple(map(str, found)),
                    counters=results.counters[lane],
                    pivotings=int(member.pivots is not None),
                    timings={"setup_s": member.seconds},
                    finer=member.settings.finer,
                )
        endings = conclude([*ended.values()], extremes.of_runs([*ended]))
        finished: list[FinishedRun | None] = [None] * len(members)
        for lane, ending in zip(ended, endings, strict=True):
            begin, rows, start = time.perf_counter(), int(results.rows[lane]), members[lane].start
            log_end(partial(getattr, members[lane], "spec"), ending)
            own = {key: values[lane, :rows] for key, values in arrays.items()}
            own |= {key: values[lane, : rows - 1] for key, values in intervals.items()}
            own |= start_settings(start.mechanism, members[lane].table.start)
            data_sha256 = self.hash.of(own, digests)
            stats = {**ending.stats, "finish_s": time.perf_counter() - begin}
            finished[lane] = FinishedRun(
                **vars(ending) | {"stats": stats}, names=self.names, layout=self.layout, arrays=own, shared=None,
                data_sha256=data_sha256, assembly=start.assembled.describe(),
            )  # fmt: skip
        return finished

    def _watched(
        self, member: LaneMember, results: LaneResults, lane: int, energies: EnergyRecord
    ) -> list[Finding] | None:
        """Return what is found in the recorded states of a run; None if it stops where a law leaves its range."""
        if not member.watched:
            return []
        mechanism, rows, spec = member.start.mechanism, int(results.rows[lane]), member.spec
        ranges = LawRanges.of(spec.mechanism(), mechanism, stops=spec.limits.law_range == "stop")
        if ranges is not None:
            left = ranges.add(results.time[lane, :rows], results.observed.forces[lane, :rows])
            if left is not None and ranges.stops:
                return None
        watchers = StateWatchers(spec, mechanism, member.size)
        if watchers:
            watchers.add(_states_of_lane(mechanism, results, lane, rows))
        return [*watchers.findings(energies, {}), *(() if ranges is None else ranges.findings())]

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
        """Return the rows of all runs as a contiguous array (W, T, ...) with the type of the layout."""
        shaped = values.reshape(count, len(values) // count, *values.shape[1:])
        return np.ascontiguousarray(shaped, self.types[key])

    def _beyond_limits(self, results: LaneResults, limits: Sequence[Guards]) -> np.ndarray:
        """Return (W,) whether a recorded state of a run may exceed a limit of misalignment.

        The joints of such runs must be checked one by one.
        """
        largest = np.abs(results.observed.phi).max(axis=(1, 2, 3), initial=0.0)
        smallest = np.array([min(limit.misalignment, limit.angle_misalignment) for limit in limits])
        # The residual of a joint, which has at most three rows, is below 4 times that of its largest row.
        return np.asarray(~(largest <= smallest / 4))

    def _extremes(self, results: LaneResults, states: States) -> Extremes:
        """Return what was largest in each run, over all steps and in its recorded states."""
        shape = results.time.shape
        misalignment = states.misalignment.reshape(*shape, -1).max(axis=1)
        worst = np.maximum(self.joints.misalignment_of_squares(results.worst), misalignment)
        angles = self.joints.angle_misalignment(np.abs(results.observed.phi).max(axis=1))
        kinetic, balance = results.observed.kinetic, states.balance.reshape(shape)
        others = np.stack([results.observed.potential, results.energy[:, :, 0], results.energy[:, :, 1]])
        energies = EnergyRecord.of_runs(kinetic, others, balance)
        return Extremes(results.time[:, -1], worst, angles, energies, results.evidence)

    def _intervals(self, tables: Sequence[Timetable], results: LaneResults) -> dict[str, np.ndarray]:
        """Return the statistics (W, T - 1) of the intervals between the recorded states of all runs."""
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
