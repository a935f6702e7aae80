"""Pilot runs: trial runs of a spec with candidate methods, of which some positions are kept."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.workspace import Workspace
from mbdkit.methods.kinds import Method
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.preparation import guards, make_method, plugin_failure, timetable
from mbdkit.spec import RunSpec
from mbdkit.stepping.interface import Failure
from mbdkit.stepping.start import start_method

SAMPLES = 16
"""Intervals of equal length between the kept positions; fixed steps of pilots divide them. Dense output takes further
evaluations in every adaptive step with a sample, so that more samples would not be worth their cost."""

IMPLICIT_WORK = 2.0
"""Work of an implicit method for each of its evaluations, in evaluations of an explicit one: its linear systems cost as
much again. Measured on mechanisms of 1 to 6 bodies, 1.8 to 2.3. A constant instead of measured times, so that the same
spec always leads to the same choice."""


@dataclass(frozen=True)
class PilotRun:
    """A pilot run.

    Attributes
    ----------
    setting
        Its tolerance, or its step [s].
    position
        (SAMPLES + 1, B, 3) positions [m] and angles [rad], nan where it has none.
    steps
        Number of accepted steps.
    work
        Evaluations of the right-hand side, multiplied by `IMPLICIT_WORK` for implicit methods.
    failure
        Code of its failure; empty if it reached the end.
    """

    setting: float
    position: np.ndarray
    steps: int
    work: float
    failure: str


def run_pilot(spec: RunSpec, setting: float, workspace: Workspace, most_steps: int) -> PilotRun:
    """Run a pilot.

    Parameters
    ----------
    spec
        The spec with the candidate: `RunSpec.settled`.
    setting
        Tolerance or step, for `PilotRun.setting`.
    workspace
        Workspace of the run. Its mechanism and start are shared; working arrays are not.
    most_steps
        Steps after which the pilot stops with the failure ``max-steps``.
    """
    own = workspace.for_another_run(spec.formulation, spec.stabilized)
    method = make_method(spec)
    start, end = spec.time.start, spec.time.final
    samples = np.linspace(start, end, SAMPLES + 1)
    adaptive = spec.claims.adaptive
    dense = adaptive and spec.integrator_plugin.dense_output
    steps = spec.time.count or 0
    table = replace(
        timetable(spec, guards(spec, PositionMeasure.of(spec, workspace).size)),
        interval=(end - start) / SAMPLES if dense else None,
        every=1 if adaptive else max(1, steps // SAMPLES),
        single=False,
        max_steps=min(most_steps, spec.limits.max_steps),
    )
    position = np.full((SAMPLES + 1, len(workspace.mechanism.bodies), 3), np.nan)
    position[0] = workspace.q0[:-3].reshape(-1, 3)
    try:
        stepper = start_method(method, own, table)
    except SingularSystemError:
        return PilotRun(setting, position, 0, 0.0, "singular")
    except (Exception, SystemExit) as error:
        return PilotRun(setting, position, 0, 0.0, plugin_failure(spec, error).code)
    failure: Failure | None = None
    while not (stepper.finished or stepper.failure):
        try:
            stretch = stepper.advance()
        except (Exception, SystemExit) as error:  # the run itself will fail and report this in the same way
            failure = plugin_failure(spec, error)
            break
        if not len(stretch.time):
            continue
        row = np.clip(np.round((stretch.time - start) / (end - start) * SAMPLES).astype(int), 0, SAMPLES)
        met = np.abs(stretch.time - samples[row]) <= 1e-9 * (end - start)
        position[row[met]] = stretch.q[met, :-3].reshape(int(np.sum(met)), -1, 3)
    failure = failure or stepper.failure
    code = failure.code if failure else ""
    counters = stepper.counters
    return PilotRun(setting, position, counters.steps, work_of(method, counters.rhs_evaluations), code)


def work_of(method: Method, evaluations: int) -> float:
    """Return the work of a number of evaluations of a method; see `PilotRun.work`."""
    return evaluations * (1.0 if method.traits.is_explicit else IMPLICIT_WORK)


def difference(a: PilotRun, b: PilotRun, measure: PositionMeasure) -> float:
    """Return the largest difference of two pilots as a share of the mechanism's size; inf if only one has failed."""
    share = measure.share(a.position - b.position)
    common = np.isfinite(share)
    reached = [np.flatnonzero(np.all(np.isfinite(run.position), axis=(1, 2)))[-1] for run in (a, b)]
    # beyond an event that would stop the run, both may fail; if only one fails, its states before are wrong
    if abs(reached[0] - reached[1]) > 1 or not np.any(common[1:]):
        return float("inf")
    return float(np.max(share[common]))
