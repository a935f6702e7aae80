"""Batches of simulations of one spec: they advance together by fixed steps, between which inputs can be set."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.file_locks import UseLock, one_thread_at_a_time
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.native.levels import WIDTH
from mbdkit.events.event_expression import RunExpression, places_of
from mbdkit.events.quantities import QuantityEvaluator
from mbdkit.integrators.lanes.lane_batch import BatchState, advance_explicit, new_lane_batch
from mbdkit.integrators.lanes.lane_mechanisms import fill_lanes, suits_lanes, topology_of
from mbdkit.integrators.lanes.lane_run import LaneRun, new_lane_run
from mbdkit.integrators.run.run_plan import guard_limits
from mbdkit.integrators.run.step_guards import new_guard_state
from mbdkit.runs.law_ranges import has_ranges
from mbdkit.runs.preparation import build, make_method, size_at_start, timetable
from mbdkit.spec import RunSpec


class SimulationBatch:
    """N simulations of one spec in lanes of SIMD vectors, with the bits of single simulations.

    All simulations take steps of `time.step` with the explicit method of the spec. Between two calls of `advance`,
    inputs may be set, and simulations started again. A simulation whose state is no longer finite, or whose joints fall
    apart, is lost until it is started again.

    Parameters
    ----------
    spec
        The spec, for which `why_not` returns no reason.
    number
        Number of simulations N.
    apart
        Whether the numbers of the mechanisms may differ; each vector then needs arrays of its own.
    threads
        Number of threads that advance vectors; by default, one for each processor that this process may use.

    Attributes
    ----------
    mechanism : CompiledMechanism
        The mechanism of the spec.
    inputs : (N, I) array
        Values of its inputs from the next `advance` on; those of a simulation that is started are the initial ones.
    in_use : UseLock
        Held by the thread that uses the batch.

    Raises
    ------
    SpecError
        If the spec cannot be batched, or its start is wrong.
    """

    def __init__(self, spec: RunSpec, number: int, *, apart: bool = False, threads: int | None = None):
        if reason := self.why_not(spec):
            raise SpecError(f"simulations of this spec cannot be batched: {reason}")
        self.spec, self.number, self.apart = spec, number, apart
        self.in_use = UseLock("another thread is using these simulations; give each thread its own")
        self._workspace, _ = build(spec)
        self.mechanism = self._workspace.mechanism
        self._topology = topology_of(self.mechanism)
        self._vectors = -(-number // WIDTH)
        count = min(threads or _processors(), self._vectors)
        self._parts = [*pairwise(self._vectors * i // count for i in range(count + 1))]
        self._pool = ThreadPoolExecutor(max(1, count - 1))
        self._batch = new_lane_batch(self._vectors)
        self._runs = self._new_runs()
        self._pinned = [PinnedBundle(run) for run in self._runs]
        self._batch.runs[:] = [pinned.address for pinned in self._pinned]
        self._bundle = PinnedBundle(self._batch)
        self._inputs, self._before = np.zeros((2, self._vectors * WIDTH, len(self.mechanism.inputs)))
        self.inputs = self._inputs[:number]
        self.start(range(self._vectors * WIDTH), self._workspace.q0, self._workspace.v0)

    @staticmethod
    def why_not(spec: RunSpec) -> str:
        """Return the reason why simulations of a spec cannot be batched, as a clause; empty if they can."""
        method = make_method(spec)
        traits = method.traits
        if traits.lanes is None or not traits.is_explicit or traits.tolerances is not None:
            return f"{spec.integrator_item.id} is not an explicit method with fixed steps"
        reasons = (
            (
                traits.tableau is None or traits.tableau.is_first_same_as_last,
                "the method reuses the last stage of a step",
            ),
            (spec.formulated.solves_multipliers, f"the formulation is {spec.formulated.name}"),
            (spec.stabilized.kind != "none", f"the stabilization is {spec.stabilized.kind}"),
            (bool(spec.events), "the spec has events"),
            (bool(spec.inputs), "its inputs are set by tables"),
            (spec.limits.energy_jump is not None, "`limits.energy_jump` watches the energies of each step"),
            (spec.limits.law_range is not None and has_ranges(spec.mechanism()), "the ranges of its laws are watched"),
        )
        if reason := next((clause for holds, clause in reasons if holds), ""):
            return reason
        workspace, _ = build(spec)
        mechanism, table = workspace.mechanism, replace(timetable(spec, None), interval=None)
        if new_guard_state(mechanism).has_loops[0]:
            return "its joints close a loop"
        if mechanism.extensions or not suits_lanes(method, mechanism, table):
            return (
                "its mechanism has controllers, discontinuous functions of time or elements that lanes do not support"
            )
        return ""

    def _new_runs(self) -> list[LaneRun]:
        method = make_method(self.spec)
        assert method.traits.lanes is not None
        bundle, workspace = method.traits.lanes().bundle, self._workspace
        example = new_lane_run(bundle(method, workspace, None, None), workspace, 1)
        self._state = BatchState.like(example, self._vectors)
        table, mechanism = timetable(self.spec, size_at_start(self.spec, workspace)), self.mechanism
        limits = guard_limits(mechanism, table.guards).squared_misalignment
        runs = []
        for number in range(self._vectors):
            if self.apart or any(number == first for first, _ in self._parts):
                work = new_lane_run(bundle(method, workspace, None, None), workspace, 1)
                for lane in range(WIDTH):
                    self._fill(work, lane, mechanism)
                work.squared_misalignment[:] = limits[:, None]
                work.times.start[0], work.times.step[0] = table.start, table.step
            runs.append(self._state.run(number, work))
        return runs

    def _fill(self, run: LaneRun, lane: int, mechanism: CompiledMechanism) -> None:
        fill_lanes(run.top, slice(lane, lane + 1), mechanism.topology)
        run.w.source[: mechanism.size - 3, lane] = mechanism.topology.mass[:-1].ravel()

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()

    @one_thread_at_a_time
    def advance(self, steps: int) -> None:
        """Advance all simulations by a number of steps; inputs that are held linearly reach their values at the end."""
        state, times, taken = self._state, self._runs[0].times, self._batch.taken
        values, before = (x.reshape(self._vectors, WIDTH, -1) for x in (self._inputs, self._before))
        for k, item in enumerate(self.mechanism.inputs):
            state.z[:, item.state] = (before if item.is_linear else values)[..., k]
            if item.is_linear:
                now, until = (times.start[0] + n * times.step[0] for n in (taken, taken + float(steps)))
                state.z[:, item.slope] = (values - before)[..., k] / (until - now)
                state.z_low[:, [item.state, item.slope]] = 0.0
        self._before[...] = self._inputs
        self._call(steps)

    def _call(self, steps: int) -> None:
        address = self._bundle.address
        further = [self._pool.submit(advance_explicit, address, *part, steps) for part in self._parts[1:]]
        advance_explicit(address, *self._parts[0], steps)
        for future in further:
            future.result()

    @one_thread_at_a_time
    def start(
        self, which: Sequence[int], q: np.ndarray, v: np.ndarray, mechanisms: Sequence[CompiledMechanism] | None = None
    ) -> None:
        """Start some simulations at the start time of the spec.

        Parameters
        ----------
        which
            The K simulations, from 0.
        q, v : (K, 3 (B + 1)) arrays
            Consistent positions and velocities, ground last.
        mechanisms
            The mechanism of each, if their numbers differ.

        Raises
        ------
        SpecError
            If a mechanism differs in more than its numbers from that of the spec.
        """
        for i, mechanism in zip(which, mechanisms or (), strict=bool(mechanisms)):
            if topology_of(mechanism) != self._topology:
                raise SpecError("mechanisms in one batch may differ in numbers only", key="parameters")
            self._fill(self._runs[i // WIDTH], i % WIDTH, mechanism)
        own = mechanisms or [self.mechanism]
        vector, lane = np.divmod(np.asarray(which, dtype=np.int64), WIDTH)
        for array in (*self._state[:-1], self._batch.taken[:, None]):
            array[vector, ..., lane] = 0.0
        self._state.q[vector, :, lane], self._state.v[vector, :, lane] = q, v
        self._state.z[vector, :, lane] = [mechanism.initial_states for mechanism in own]
        self._inputs[which] = self._before[which] = [[item.initial for item in mechanism.inputs] for mechanism in own]
        if self._batch.observed[0]:
            for number in np.unique(vector).tolist():
                advance_explicit(self._bundle.address, number, number + 1, 0)

    def _by_simulation(self, lanes: np.ndarray) -> np.ndarray:
        """Return values (G, ..., WIDTH) as an array (N, ...)."""
        last = lanes.ndim - 1
        moved = np.asarray(lanes).transpose(0, last, *range(1, last))
        return moved.reshape(self._vectors * WIDTH, *moved.shape[2:])[: self.number]

    @property
    def lost(self) -> np.ndarray:
        """(N,) whether each simulation is lost."""
        return np.asarray(self._by_simulation(self._state.lost)[:, 0] != 0.0)

    @property
    def time(self) -> np.ndarray:
        """(N,) times [s]."""
        times = self._runs[0].times
        return np.asarray(times.start[0, 0] + self._by_simulation(self._batch.taken) * times.step[0, 0])

    def reader(self, expressions: Sequence[str]) -> Callable[[], np.ndarray]:
        """Return a function that returns the values (N, K) of K expressions of events, in SI units.

        Raises
        ------
        SpecError
            If an expression is wrong.
        """
        mechanism, numbers = self.spec.mechanism(), self.spec.numbers
        parsed = [RunExpression.parse(text, mechanism, numbers, crosses=False) for text in expressions]
        places = places_of(parsed)
        evaluator = QuantityEvaluator(self._workspace, list(places), self._observed)
        functions = [one.compiled(places, of_arrays=True).value for one in parsed]

        def read() -> np.ndarray:
            state = self._state
            columns = evaluator.columns(self.time, *(self._by_simulation(x) for x in (state.q, state.v, state.z)))
            values = np.empty((self.number, len(functions)))
            with np.errstate(all="ignore"):
                for k, function in enumerate(functions):
                    values[:, k] = function(columns)
            return values

        read()  # which shows whether kernels have to observe states
        return read

    def _observed(self, *state: np.ndarray) -> Observed:
        if not self._batch.observed[0]:
            self._batch.observed[0] = 1
            self._call(0)
        return Observed(*(self._by_simulation(values)[:, 0] for values in self._state.observed))


def _processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
