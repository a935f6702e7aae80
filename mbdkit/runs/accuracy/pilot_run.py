"""Pilot runs: trial runs of a spec with candidate methods.

A `SampledPilot` stores positions at a few times only. A `RecordedPilot` stores the ends of all steps, so that it can be
compared with other pilots at any time; the last recorded pilot is used as the run.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cached_property

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Advancing, Stretch, Timetable
from mbdkit.integrators.start import start_method
from mbdkit.methods.kinds import Method
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.preparation import make_method, plugin_failure, size_at_start, timetable
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.runs.run_seams import Progress
from mbdkit.runs.step_interpolation import StepStates
from mbdkit.spec import RunSpec

#: Number of equal intervals between the times at which a `SampledPilot` stores positions, called samples.
#:
#: The number of fixed steps of a pilot is a multiple or a divisor of it. More samples are not worth their cost,
#: because dense output takes further evaluations in every adaptive step with a sample.
SAMPLES = 16

#: Cost of an evaluation of an implicit method, including linear systems, relative to one of an explicit method.
#: Measured values are 1.8 to 2.3 for mechanisms with 1 to 6 bodies. A constant is used instead of measured times, so
#: that the same spec always leads to the same choice.
IMPLICIT_WORK = 2.0


class PilotRun:
    """A trial run of a spec with the method and setting of a candidate; see `RunSpec.with_choice`.

    - `setting`: tolerance or step [s] of the candidate.
    - `workspace`: workspace of the run. Its mechanism and start are shared; working arrays are not.
    - `table`: timetable of the pilot.
    - `progress`: called with (time reached, end time) [s].
    - `stepper`: None if the pilot could not start.
    - `steps`, `work`: number of accepted steps, and evaluations of the right-hand side, multiplied by `IMPLICIT_WORK`
      for implicit methods.
    - `failure`: code of the failure; empty if the pilot reached the end.
    - `wall`, `cpu`: wall time and processor time of the steps [s].
    """

    def __init__(
        self, spec: RunSpec, setting: float, workspace: Workspace, table: Timetable, progress: Progress | None = None
    ):
        self.setting, self.timetable = setting, table
        self.workspace = workspace.for_another_run(spec.formulated.name, spec.stabilized)
        self.stretches: list[Stretch] = []
        self.stepper: Advancing | None = None
        self.steps, self.work, self.failure = 0, 0.0, ""
        method, begin, busy = make_method(spec), time.perf_counter(), time.process_time()
        try:
            self.stepper = start_method(method, self.workspace, table)
            self._advance(self.stepper, progress)
        except SingularSystemError:
            self.failure = "singular"
        except (Exception, SystemExit) as error:  # the run itself will fail in the same way and report this
            self.failure = plugin_failure(spec, error).code
            if self.stepper is not None and (rows := self.stepper.rows_before_error()) is not None:
                self.stretches.append(rows)
        self.wall, self.cpu = time.perf_counter() - begin, time.process_time() - busy
        if self.stepper is not None:
            self.failure = self.failure or (self.stepper.failure.code if self.stepper.failure else "")
            self.steps = self.stepper.counters.steps
            self.work = work_of(method, self.stepper.counters.rhs_evaluations)

    def _advance(self, stepper: Advancing, progress: Progress | None) -> None:
        while not (stepper.finished or stepper.failure):
            stretch = stepper.advance()
            if len(stretch.time):
                self.stretches.append(stretch)
            if progress is not None:
                progress(stepper.time, self.timetable.end)


class SampledPilot(PilotRun):
    """A pilot run with positions at a few times.

    - `most_steps`: steps after which the pilot stops with the failure ``max-steps``.
    - `position`: (SAMPLES + 1, B, 3) positions [m] and angles [rad]; nan at times that the pilot did not reach.
    """

    def __init__(self, spec: RunSpec, setting: float, workspace: Workspace, most_steps: int):
        start, end, adaptive = spec.time.start, spec.time.final, spec.claims.adaptive
        dense = adaptive and spec.integrator_plugin.dense_output
        table = replace(
            timetable(spec, size_at_start(spec, workspace)),
            interval=(end - start) / SAMPLES if dense else None,
            every=1 if adaptive else max(1, (spec.time.count or 0) // SAMPLES),
            single=False,
            max_steps=min(most_steps, spec.limits.max_steps),
        )
        super().__init__(spec, setting, workspace, table)
        self.position = np.full((SAMPLES + 1, len(workspace.mechanism.bodies), 3), np.nan)
        self.position[0] = workspace.q0[:-3].reshape(-1, 3)
        samples = np.linspace(start, end, SAMPLES + 1)
        for stretch in self.stretches:
            row = np.clip(np.round((stretch.time - start) / (end - start) * SAMPLES).astype(int), 0, SAMPLES)
            met = np.abs(stretch.time - samples[row]) <= 1e-9 * (end - start)
            self.position[row[met]] = stretch.q[met, :-3].reshape(int(np.sum(met)), -1, 3)


def work_of(method: Method, evaluations: int) -> float:
    """Return the work of a number of evaluations of a method; see `PilotRun`."""
    return evaluations * (1.0 if method.traits.is_explicit else IMPLICIT_WORK)


def difference(a: SampledPilot, b: SampledPilot, measure: PositionMeasure) -> float:
    """Return the largest difference between two pilots as a share of the mechanism's size.

    It is inf if one pilot failed more than one sample before the other ended, or if they share only the start.
    """
    share = measure.share(a.position - b.position)
    common = np.isfinite(share)
    reached = [np.flatnonzero(np.all(np.isfinite(run.position), axis=(1, 2)))[-1] for run in (a, b)]
    # Both may fail at the same time, at which the run would fail too. If only one fails, its earlier states are wrong.
    if abs(reached[0] - reached[1]) > 1 or not np.any(common[1:]):
        return float("inf")
    return float(np.max(share[common]))


#: Largest number of stored positions, 320 MB with the velocities; longer runs are checked by companions.
MOST_VALUES = 20_000_000


class RecordedPilot(PilotRun):
    """A pilot run with the ends of all of its steps.

    `most_steps`: steps after which the pilot stops with the failure ``max-steps``. `is_run`: whether the pilot records
    the same rows as the spec requires, so that it can serve as the run.
    """

    def __init__(
        self, spec: RunSpec, setting: float, workspace: Workspace, most_steps: int, progress: Progress | None = None
    ):
        given = timetable(spec, size_at_start(spec, workspace))
        most = min(given.max_steps, most_steps, MOST_VALUES // len(workspace.q0))
        table = replace(given, every=1, interval=None, single=False, max_steps=most)
        self.is_run = replace(table, max_steps=given.max_steps) == given and spec.limits.wall_time is None
        super().__init__(spec, setting, workspace, table, progress)
        start = (np.array([workspace.t0]), workspace.q0[None], workspace.v0[None])
        ends = [(stretch.time, stretch.q, stretch.v) for stretch in self.stretches]
        self.time, self.q, self.v = (np.concatenate(parts) for parts in zip(start, *ends, strict=True))

    @cached_property
    def _states(self) -> StepStates:
        table = self.timetable
        return StepStates(self.workspace, self.time, self.q, self.v, table.stops, table.stop_margins)

    def positions(self, times: np.ndarray) -> np.ndarray:
        """Return positions [m] and angles [rad] of the bodies (T, B, 3) at times [s]; nan at times not reached."""
        return self._states.at(times)[0][:, :-3].reshape(len(times), -1, 3)

    def rows(self, times: np.ndarray) -> ObservedRows:
        """Return states and reactions at times (T,) [s]; nan at times not reached."""
        return ObservedRows.at(self.workspace, times, *self._states.at(times), seen=self.timetable.before(times))


def can_be_recorded(spec: RunSpec) -> bool:
    """Return whether a pilot (trial run) of a spec can store the state at the end of every step, so that states at
    other times can be interpolated.

    The method has to be explicit and adaptive, because implicit methods are for stiff mechanisms, whose accelerations
    are too inaccurate for interpolation. No driver may cause impulses, which make velocities discontinuous. The caller
    also excludes events and first-order states.
    """
    return (
        spec.claims.adaptive
        and "rtol" in type(spec.integrator).model_fields
        and make_method(spec).traits.is_explicit
        and not timetable(spec, None).impacts
    )
