"""Short runs of a prepared spec in memory, computed with the loops and formulas that its earlier runs have left.

The spec of a run, its columns and its hash are computed when they are asked for.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import utc_now
from mbdkit.base.errors import SpecError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.plain_data import Path
from mbdkit.engine.assembly import AssembledState, assemble_from, search_for
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.consistent_start import MechanismAtStart, Starts, consistent_states, within_double_precision
from mbdkit.engine.redundancy import without_redundancy
from mbdkit.engine.self_stress import looped_rows
from mbdkit.integrators.lane_stepper import LaneResults
from mbdkit.integrators.lanes.lane_mechanisms import topology_of
from mbdkit.runs.findings import criteria
from mbdkit.runs.finish import run_in_memory
from mbdkit.runs.lane_group import LaneGroup, LaneMember
from mbdkit.runs.lane_runs import LaneRuns
from mbdkit.runs.preparation import guards_of
from mbdkit.runs.varied_numbers import STATE, Variant, VariedNumbers
from mbdkit.spec.run_spec import RunSpec

TRIES = 3  #: Runs of a variant are left to the ordinary way after as many consecutive ones whose starts do not suit.

MOST_KINDS = 32  #: Largest number of sets of key paths whose formulas are kept.

#: Arrays of a topology on which it does not depend whether a state satisfies the constraints.
OF_MOTION = frozenset({"mass", "weight", "gravity", "linear", "spring_points", "load_points", "marker_points"})


class ShortRuns:
    """Computes short runs by the vectorized loop, as in an ensemble; for one thread at a time."""

    def __init__(self) -> None:
        self.lanes = LaneRuns(Starts(), ())
        self.work: float = 0  #: Evaluations times bodies of the latest run.
        self._kinds: dict[tuple[Path, ...], VariedRuns | None] = {}  # None for paths that were varied once

    def run(self, spec: RunSpec) -> Run | None:
        """Return the run of a spec; None if it cannot be vectorized, or if its preparation fails."""
        created = utc_now()
        with one_thread_of_linear_algebra():
            member = self.lanes.members([spec])[0]
            runs = None if member is None else next(self.lanes.finished([member]))[1]
            if runs is None:
                return None
            finished = runs.run(0)
            self.work = finished.stats["rhs_evaluations"] * len(finished.names.bodies)
            return run_in_memory(finished, spec, created)

    def varied(
        self, paths: tuple[Path, ...], numbers: Sequence[float], spec: Callable[[Sequence[float]], RunSpec]
    ) -> Run | None:
        """Return the run of the spec with these numbers at some key paths of its model or its parameters.

        `spec`: function that returns the spec, in any thread. Returns None if there are no formulas for these numbers
        (yet), or if the run cannot be vectorized.
        """
        if paths not in self._kinds:
            self._kinds[paths] = None
            return None
        kind = self._kinds.pop(paths) or VariedRuns(self.lanes, paths, spec)
        self._kinds[paths] = kind
        if len(self._kinds) > MOST_KINDS:
            self._kinds.pop(next(iter(self._kinds)))
        run = kind.run(numbers)
        self.work = kind.work
        return run


class VariedRuns:
    """Runs that differ in the numbers at some key paths; see `ShortRuns.varied`.

    `accepts`: whether runs of a variant are to be computed, given one of them; by default, all are.
    """

    def __init__(
        self,
        lanes: LaneRuns,
        paths: tuple[Path, ...],
        spec: Callable[[Sequence[float]], RunSpec],
        accepts: Callable[[Variant, LaneMember], bool] = lambda _, __: True,
    ):
        self._lanes, self._spec, self._numbers = lanes, spec, VariedNumbers(paths, spec)
        self._accepts, self._failed = accepts, 0
        self._loops: dict[Variant, _VariantLoop | None] = {}
        self.work: float = 0

    def run(self, numbers: Sequence[float]) -> Run | None:
        """Return the run with these numbers; None if it has to be computed in another way."""
        created, begin, cpu = utc_now(), time.perf_counter(), time.process_time()
        if (found := self._numbers.results(numbers)) is None:
            return None
        variant, values = found
        if variant not in self._loops:
            loop = _VariantLoop.of(self._lanes, variant, self._spec(numbers))
            self._loops[variant] = loop if loop is not None and self._accepts(variant, loop.base) else None
        loop, spec = self._loops[variant], partial(self._spec, numbers)
        with np.errstate(all="ignore"):
            member = None if loop is None else loop.member(np.array(values), spec)
        if member is None:
            self._failed += 1
            if self._failed >= TRIES:  # most starts of this kind are computed in the ordinary way
                self._loops[variant] = None
            return None
        self._failed = 0
        member.seconds = time.perf_counter() - begin
        group = self._lanes.group(member, member.key)
        results = group.advance([member])
        self.work = int(results.counters["rhs_evaluations"][0]) * len(group.names.bodies)
        spent = {"wall_s": time.perf_counter() - begin - member.seconds, "cpu_s": time.process_time() - cpu}
        if not group.sound(results, [member]):
            return None
        concluded = partial(_concluded, group, member, results, spent)
        finished = concluded() if member.watched else concluded
        return None if finished is None else run_in_memory(finished, member.settings, created, spec=spec)


def _concluded(
    group: LaneGroup, member: LaneMember, results: LaneResults, spent: Mapping[str, float]
) -> Any:  # None only for a run that is watched
    """Return the run of which these are the results; None if it must be repeated alone."""
    runs = group.concluded([member], results, ())[1]
    if runs is None:
        return None
    run = runs.run(0)
    return replace(run, stats={**run.stats, **spent})


class _VariantLoop:
    """What runs of a variant share: a run that was prepared in the ordinary way, and the solver of its assembly."""

    def __init__(self, lanes: LaneRuns, variant: Variant, base: LaneMember):
        self._lanes, self._variant, self.base = lanes, variant, base
        mechanism, compiled = base.settings.mechanism(), variant.compiled
        self._has_loops = len(looped_rows(compiled)) > 0
        own = {name: variant.base[name].copy() for name in variant.places if name not in STATE}
        self._own, self._names = own, tuple(mechanism.bodies)
        self._search = search_for(
            mechanism, replace(compiled, topology=compiled.topology._replace(**own)), base.table.start
        )
        self._moves = base.start.assembled.changed or not variant.places.keys() <= OF_MOTION

    @classmethod
    def of(cls, lanes: LaneRuns, variant: Variant, spec: RunSpec) -> _VariantLoop | None:
        """Return the loop of a variant; None if its runs cannot be vectorized, or their starts are remarkable."""
        with one_thread_of_linear_algebra():
            base = lanes.members([spec])[0]
        own = {criterion.name for _, criterion in criteria("start", spec)}
        if base is None or base.findings != variant.findings or not own <= {"moved-start", "changed-velocities"}:
            return None
        has_motions = len(variant.compiled.topology.motion_start) > 1 or len(variant.compiled.topology.functions) > 0
        if has_motions and not variant.places.keys().isdisjoint(("motion_values", "law_parameters")):
            return None  # motions have to be checked at the start
        return cls(lanes, variant, base)

    def _assembled(self, q: np.ndarray, v: np.ndarray, tolerance: float) -> AssembledState | None:
        """Return the start of a run from given positions and velocities.

        The result is None if there is no consistent state, if positions change, or if velocities change that are given,
        about which there might be warnings.
        """
        (start,) = consistent_states(q[None], v[None], [tolerance], self._names, self._search)
        if start is not None:
            return start
        given_q, given_v = (x.reshape(-1, 3)[:-1] for x in (q, v))
        try:
            with within_double_precision(), one_thread_of_linear_algebra():
                mechanism = self.base.settings.mechanism()
                start = assemble_from(mechanism, self._search, given_q, given_v, tolerance)
        except SpecError:
            return None
        is_given = given_v != 0.0
        is_given[:, :2] = is_given[:, :2].any(axis=1, keepdims=True)
        is_kept = (start.q == given_q).all() and (start.v == given_v)[is_given].all()
        return start if is_kept else None

    def member(self, values: np.ndarray, spec: Callable[[], RunSpec]) -> LaneMember | None:
        """Return a prepared run; `values` are the results of the formulas. None if its start needs assembly."""
        variant, base = self._variant, self.base
        arrays = {name: variant.base[name].copy() for name in variant.places}
        for name, (entries, columns) in variant.places.items():
            arrays[name].reshape(-1)[entries] = values[columns]
        q, v, (tolerance,), (longest,), (size,) = (arrays.pop(name, variant.base[name]) for name in STATE)
        assembled, table = base.start.assembled, base.table
        if self._moves:
            for name, array in arrays.items():
                self._own[name][...] = array
            self._search.__dict__.pop("reach", None)
            if (start := self._assembled(q, v, float(tolerance))) is None:
                return None
            assembled = start
            q, v = with_ground(start.q), with_ground(start.v)
        extent, size = float(size), float(size) or float(longest)
        if size != base.size:
            table = replace(table, guards=guards_of(base.settings, size))
        compiled, topology = variant.compiled.with_numbers(arrays, float(longest)), base.topology
        if self._has_loops:
            with one_thread_of_linear_algebra():
                compiled = without_redundancy(compiled, table.start, q[:-3], v[:-3], table.end)
            topology = topology_of(compiled)
            if topology != base.topology:
                return None
        at_start = MechanismAtStart(compiled, q, v, assembled)
        pivots = self._lanes.pivots.of(base.method, at_start, table)
        return LaneMember(
            base.settings, base.method, at_start, table, pivots, size, extent, variant.findings, topology, varied=spec,
            watched=variant.watched,
        )  # fmt: skip
