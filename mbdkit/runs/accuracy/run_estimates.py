"""All errors of a run that are estimated: of its states, of its measures, and by parameters that are estimates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.headlines import ROUND_OFF
from mbdkit.archive.measured_values import Integrals
from mbdkit.archive.peak_errors import errors_of_largest, expression_of_largest, missed_by_rows, missed_of_verdict
from mbdkit.base.called_functions import returning
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.integrators.interface import Failure
from mbdkit.integrators.run.impulse import ReactingMemory
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.registered_kinds import peaks_of
from mbdkit.runs.accuracy.check_run import check_by_pilots, check_run, missed_because, with_asked
from mbdkit.runs.accuracy.chosen_method import Choice
from mbdkit.runs.accuracy.companion import Budget
from mbdkit.runs.accuracy.compared_measures import compared_measures
from mbdkit.runs.accuracy.parameter_errors import with_parameter_errors
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.law_ranges import steps_are_rows
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.runs.run_record import RunRecord
from mbdkit.runs.run_seams import Progress
from mbdkit.trust.criteria import EstimatedErrors


def estimate_accuracy(
    record: RunRecord,
    rows: ObservedRows,
    steps: int,
    budget: Budget,
    progress: Progress | None,
    memory: ReactingMemory | None,
    *,
    choice: Choice | None,
    deadline: float,
    has_failed: bool,
) -> Accuracy:
    """Estimate the errors of a run that has ended.

    - `record`, `rows`: the record of the run, and its rows. `steps`: number of its steps.
    - `budget`, `progress`, `memory`: see `check_run`.
    - `choice`: how method and step were chosen; None if the spec gave them.
    - `deadline`: when the wall time of the run is over (`time.perf_counter`).
    - `has_failed`: whether the run failed, so that the errors of its measures are not estimated.
    """
    setup, measured_in = record.setup, record.request.measured_in
    spec, workspace = setup.spec, setup.workspace
    with returning(None if workspace.python is None else workspace.python.returned):
        if choice is not None and choice.pilots and len(rows.time) > 1 and not spec.check:
            accuracy = check_by_pilots(spec, workspace, rows, choice.pilots, choice.setting)
        else:
            accuracy = check_run(setup, rows, steps, budget, progress, memory)
        accuracy = with_asked(accuracy, spec, workspace, choice)
        expressions = () if has_failed else record.compared_expressions(deadline)
        measure = partial(measured_in, expressions)
        if expressions and (accuracy.is_complete or not spec.undecided):  # see `SpecMeasure`
            compared = compared_measures(setup, steps, expressions, measure, budget)
            accuracy = replace(accuracy, compared_measures=compared)
        if spec.check:
            accuracy = with_parameter_errors(accuracy, setup, steps, expressions, measure, budget, progress)
    return accuracy


def estimated_errors(
    record: RunRecord, accuracy: Accuracy, tried: Sequence[Choice], failure: Failure | None, integrals: Integrals
) -> EstimatedErrors:
    """Return the estimated errors of a checked run in the form used by the verdict.

    - `record`, `accuracy`: the record of the run, and the estimates.
    - `tried`, `failure`: see `missed_because`.
    - `integrals`: integrals and extrema of the run.
    """
    spec, mechanism = record.setup.spec, record.setup.workspace.mechanism
    rows, position = record.kept, PositionMeasure.of(spec, record.setup.workspace)
    assert rows is not None
    skips_steps = not steps_are_rows(spec) and "joints" in spec.recorded
    measures = {measure.name: measure.expression for measure in spec.defined_measures() if measure.item is None}
    joints, size = mechanism.joints, np.linalg.norm(rows.force, axis=2)
    beyond = missed_by_rows(integrals, "joints.force", joints, size, skips_steps=skips_steps)
    beyond = missed_of_verdict(beyond, joints, measures)
    figures = accuracy.figures(joints, rows.force, beyond)
    torque = float(np.max(np.abs(rows.torque), initial=0.0)) / mechanism.length
    # where joints carry torques only, their forces are rounding errors
    worst = None if np.max(size, initial=0.0) <= ROUND_OFF * torque else figures.worst_joint
    between = ""
    if worst is not None and worst.missed > worst.error:
        advice = "record more rows" if skips_steps else f"use {spec.finer}"
        between = (
            f"joint '{worst.name}' reaches {worst.peak + worst.missed:.4g} N, in the recorded rows {worst.peak:.4g} N; "
            f"{advice}"
        )
    peak, peak_of = _peak_error(mechanism, accuracy, integrals)
    return EstimatedErrors(
        position=position.known(accuracy),
        peak=peak,
        peak_of=peak_of,
        reaction=0.0 if worst is None else worst.share,
        known_until=figures.known_until,
        between=between,
        **({} if math.isnan(accuracy.asked) else {"asked": accuracy.asked, "reached": accuracy.reached}),
        missed=missed_because(accuracy, tried, failure),
        unknown=accuracy.unknown,
    )


def _peak_error(mechanism: CompiledMechanism, accuracy: Accuracy, integrals: Integrals) -> tuple[float, str]:
    """Return the largest error of the largest force of an element of a plugin's kind, relative to this force, and a
    phrase that names the force.

    Only forces that were compared with those of other runs count; without them, the result is 0 and an empty text. An
    unknown error is nan, and counts as the largest.
    """
    ratios = [(0.0, "")]
    for peaks in peaks_of(archive_names(mechanism)):
        force, kind = peaks.quantities[0], element_kinds()[peaks.of].name
        errors = errors_of_largest(integrals, accuracy.compared_measures, force, peaks.names)
        for name, error in zip(peaks.names, errors.tolist(), strict=True):
            text = expression_of_largest(force, name)
            if text in accuracy.compared_measures:
                phrase = f"the largest {force.partition('.')[2].replace('_', ' ')} of {kind} '{name}'"
                ratios.append((error / float(integrals[text]), phrase))  # type: ignore[arg-type] # not a vector
    return max(ratios, key=lambda ratio: math.inf if math.isnan(ratio[0]) else ratio[0])
