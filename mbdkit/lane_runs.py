"""Runs specs in lanes: prepares each, advances those that differ in numbers only side by side, and finishes them."""

from __future__ import annotations

import logging
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.finished_run import ArrayHash, FinishedRun
from mbdkit.archive.run_writer import ArchiveNames
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.consistent_start import MechanismAtStart, mechanism_at_start
from mbdkit.engine.jit.lane_width import WIDTH
from mbdkit.engine.joint_sums import JointSums
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.workspace import Workspace
from mbdkit.logs import logger_of
from mbdkit.methods.kinds import ExplicitRungeKutta
from mbdkit.recorded_columns import COLUMNS, ConstraintRows, RecordedStates
from mbdkit.recorder import archive_names
from mbdkit.run_corners import check_jumps
from mbdkit.run_evidence import evidence_of_run
from mbdkit.run_preparation import caution, guards, make_method, optional_arrays, size_at_start, timetable
from mbdkit.run_warnings import center_warnings, doubts, start_warnings
from mbdkit.spec import RunSpec
from mbdkit.stepping.interface import Guards, Stretch, Timetable
from mbdkit.stepping.lane_stepper import LaneResults, LaneStepper, suits_lanes, topology_of
from mbdkit.stepping.warm_up import ensure_compiled
from mbdkit.trust.criteria import judge
from mbdkit.trust.energy_record import EnergyRecord

_LOG = logger_of(__name__)

MOST_GROUPS = 8
"""Number of mechanisms and methods whose loops are kept for the next batch."""


@dataclass(frozen=True)
class LaneMember:
    """A run that is ready to be advanced in lanes."""

    spec: RunSpec
    method: ExplicitRungeKutta
    start: MechanismAtStart
    table: Timetable
    size: float
    """Size of the mechanism at its start [m]."""
    warnings: tuple[str, ...]
    seconds: float
    """Wall time of the preparation [s]."""

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Equal for runs that can be advanced side by side and have the same arrays."""
        recorded = tuple(sorted(self.spec.output.recorded))
        table, tableau = self.table, self.method.tableau
        return topology_of(self.start.mechanism), tableau, table.steps, table.every, recorded


def lane_member(spec: RunSpec, notify: Callable[[str], None]) -> LaneMember | None:
    """Prepare a run for lanes; return None if it has to be run alone.

    Parameters
    ----------
    notify
        Called with warnings, and with a message before kernels are compiled.

    Raises
    ------
    SpecError, PluginError
        As in a run alone.
    """
    begin = time.perf_counter()
    plain = spec.formulation == "index-1" and spec.stabilized.kind == "none" and not spec.events
    if not plain or spec.is_to_be_chosen or spec.estimates_errors or spec.limits.wall_time is not None:
        return None
    method = make_method(spec)
    if not isinstance(method, ExplicitRungeKutta) or spec.claims.adaptive:
        return None
    check_jumps(spec)
    cautions = caution(spec, method)
    ensure_compiled(notify)
    start = mechanism_at_start(spec.mechanism(), spec.time.start, spec.time.final)
    size = size_at_start(spec, start)
    table = timetable(spec, guards(spec, size))
    if not suits_lanes(method, start.mechanism, table):
        return None
    warnings = (*cautions, *start_warnings(spec, start.assembled))
    for warning in warnings:
        notify(f"warning: {warning}")
    return LaneMember(spec, method, start, table, size, warnings, time.perf_counter() - begin)


class LaneRuns:
    """Runs members in lanes, and keeps the loops of the mechanisms that it has met."""

    def __init__(self) -> None:
        self._groups: dict[tuple[object, ...], _Group] = {}

    def finished(self, members: Sequence[LaneMember]) -> list[FinishedRun | None]:
        """Run the members and return the results in their order; None for a run that must be repeated alone."""
        results: list[FinishedRun | None] = [None] * len(members)
        groups: dict[tuple[object, ...], list[int]] = defaultdict(list)
        for place, member in enumerate(members):
            groups[member.key].append(place)
        for key, places in groups.items():
            group = self._group(key, members[places[0]])
            for first in range(0, len(places), WIDTH):
                some = places[first : first + WIDTH]
                for place, run in zip(some, group.finished([members[place] for place in some]), strict=True):
                    results[place] = run
        return results

    def _group(self, key: tuple[object, ...], first: LaneMember) -> _Group:
        group = self._groups.pop(key, None) or _Group(first)
        self._groups[key] = group  # the last one used is kept longest
        if len(self._groups) > MOST_GROUPS:
            self._groups.pop(next(iter(self._groups)))
        return group


@dataclass(frozen=True)
class _RecordedRun:
    """What has been recorded of one run; see `mbdkit.run_evidence.Recorded`."""

    mechanism: CompiledMechanism
    largest_angle: np.ndarray
    energies: EnergyRecord
    last_time: float


class _Group:
    """Runs of one mechanism and method that differ in numbers only.

    Parameters
    ----------
    first
        The first of the runs.
    """

    def __init__(self, first: LaneMember):
        mechanism, spec = first.start.mechanism, first.spec
        start = first.start
        workspace = Workspace(mechanism, first.table.start, start.q0, start.v0)
        self.rows = 1 + -(-first.table.steps // first.table.every)
        self.stepper = LaneStepper(first.method, workspace, self.rows)
        self.constraint_rows, self.joints = ConstraintRows(mechanism), JointSums(mechanism)
        self.names: ArchiveNames = archive_names(mechanism)
        extra = frozenset(optional_arrays(spec, first.method, mechanism))
        self.layout = layout.recorded(self.names.present(spec.output.recorded), extra)
        self.row_keys = tuple(dict.fromkeys(one.key for one in self.layout if one.grows and one.dims[0] == "time"))
        self.types = {one.key: np.dtype(one.dtype) for one in self.layout if one.grows}
        self.hash = ArrayHash(self.names, self.layout)
        self.step_keys = tuple(one.key for one in self.layout if one.grows and one.dims[0] == "interval")

    def finished(self, members: Sequence[LaneMember]) -> list[FinishedRun | None]:
        """Run at most `WIDTH` members."""
        begin, cpu = time.perf_counter(), time.process_time()
        results = self.stepper.advance([one.start for one in members], [one.table for one in members])
        states = self._states(results)
        lost = results.lost | self._beyond_limits(results, [one.table.guards for one in members])
        if np.all(lost):
            return [None] * len(members)
        with np.errstate(all="ignore"):  # in lost lanes
            arrays = {key: self._by_run(COLUMNS[key](states), key, len(members)) for key in self.row_keys}
            recorded = self._recorded(members, results, states)
        seconds = (time.perf_counter() - begin) / len(members), (time.process_time() - cpu) / len(members)
        finished: list[FinishedRun | None] = []
        for lane, member in enumerate(members):
            if lost[lane]:
                finished.append(None)
                continue
            own = {key: values[lane] for key, values in arrays.items()} | self._intervals(
                member.table, results.time[lane]
            )
            finished.append(self._run(member, results, lane, own, recorded[lane], seconds))
        return finished

    def _states(self, results: LaneResults) -> RecordedStates:
        """Return the states of all runs, one run after another."""
        count = len(results.time)

        def flat(values: np.ndarray) -> np.ndarray:
            return values.reshape(count * self.rows, *values.shape[2:])

        observed = Observed(*map(flat, results.observed))
        q, v, energy = flat(results.q), flat(results.v), flat(results.energy)
        none = np.zeros((len(q), 6))
        stretch = Stretch(flat(results.time), q, v, energy[:, 0], energy[:, 1], none)
        start = results.observed.kinetic[:, 0] + results.observed.potential[:, 0]
        elapsed = np.zeros(len(q))
        return RecordedStates(
            stretch, observed, elapsed, np.repeat(start, self.rows), self.constraint_rows, self.joints
        )

    def _by_run(self, values: np.ndarray, key: str, count: int) -> np.ndarray:
        """Return the rows of all runs as (W, T, ...), contiguous and of the type of the layout."""
        shaped = values.reshape(count, self.rows, *values.shape[1:])
        return np.ascontiguousarray(shaped, self.types[key])

    def _beyond_limits(self, results: LaneResults, limits: Sequence[Guards]) -> np.ndarray:
        """Return (W,) whether a recorded state is near a limit of misalignment, so that each joint must be checked."""
        largest = np.abs(results.observed.phi).max(axis=(1, 2, 3), initial=0.0)
        smallest = np.array([min(one.misalignment, one.angle_misalignment) for one in limits])
        return np.asarray(~(largest <= smallest / 4))  # a joint has at most three rows

    def _recorded(
        self, members: Sequence[LaneMember], results: LaneResults, states: RecordedStates
    ) -> list[tuple[np.ndarray, _RecordedRun]]:
        """Return the largest misalignments (J,) of each run over all steps, and what its recorded states show."""
        shape = (len(members), self.rows)
        misalignment = states.misalignment.reshape(*shape, -1).max(axis=1)
        worst = np.maximum(self.joints.misalignment_of_squares(results.worst), misalignment)
        angles = self.joints.angle_misalignment(np.abs(results.observed.phi).max(axis=1))
        kinetic, balance = results.observed.kinetic, states.balance.reshape(shape)
        others = np.stack([results.observed.potential, results.energy[:, :, 0], results.energy[:, :, 1]])
        found = []
        for lane, member in enumerate(members):
            energies = EnergyRecord()
            if not results.lost[lane]:
                energies.add(kinetic[lane], others[:, lane], balance[lane])
            last = float(results.time[lane, -1])
            found.append((worst[lane], _RecordedRun(member.start.mechanism, angles[lane], energies, last)))
        return found

    def _intervals(self, table: Timetable, times: np.ndarray) -> dict[str, np.ndarray]:
        """Return the statistics of the intervals between the recorded states of a run."""
        ends = np.minimum(table.every * np.arange(1, self.rows), table.steps)
        sizes = np.full(len(ends), table.step)
        sizes[-1] = table.last_step
        none = np.zeros(len(ends), dtype=np.int64)
        values: Mapping[str, Any] = {
            "interval": np.arange(1, self.rows),
            "time": times[1:],
            "steps": np.diff(ends, prepend=0),
            "size": sizes,
            "iterations": none,
            "iterations_max": none,
            "rejected": none,
        }
        return {
            key: np.ascontiguousarray(values[key.removeprefix("steps/")], self.types[key]) for key in self.step_keys
        }

    def _run(
        self,
        member: LaneMember,
        results: LaneResults,
        lane: int,
        arrays: dict[str, np.ndarray],
        recorded: tuple[np.ndarray, _RecordedRun],
        seconds: tuple[float, float],
    ) -> FinishedRun:
        """Judge a run and return it."""
        begin = time.perf_counter()
        worst, extremes = recorded
        ending = "complete", ""
        angles = results.observed.joints[lane, :, :, 0]
        reached = np.stack([angles.min(axis=0), angles.max(axis=0)])
        mechanism = member.spec.mechanism()
        warnings = (*member.warnings, *center_warnings(mechanism, reached))
        questions = doubts(mechanism, warnings)
        judgement = judge(evidence_of_run(extremes, results.evidence[lane], ending, worst, member.size, questions))
        if _LOG.isEnabledFor(logging.INFO):
            _LOG.info("run %s ends: complete, verdict %s", member.spec.run_id(), judgement.level)
        timings = {"setup_s": member.seconds, "wall_s": seconds[0], "cpu_s": seconds[1]}
        made = FinishedRun(
            self.names, self.layout, arrays, None, *ending, {}, np.asarray(worst, layout.FLOAT), judgement,
            warnings, self.hash.of(arrays), member.start.assembled.describe(),
        )  # fmt: skip
        timings["finish_s"] = time.perf_counter() - begin
        return replace(made, stats={**asdict(results.counters), **timings})
