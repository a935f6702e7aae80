"""All errors of a run that are estimated: of its states, of its measures, and by parameters that are estimates."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.measured_values import Integrals
from mbdkit.archive.peak_errors import errors_of_largest, expression_of_largest, missed_by_rows, missed_of_verdict
from mbdkit.archive.result_table import TableColumn
from mbdkit.base.called_functions import returning
from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.integrators.interface import Failure
from mbdkit.integrators.run.impulse import ReactingMemory
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.quantities.array import MIXED
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.registered_kinds import peaks_of
from mbdkit.runs.accuracy.check_run import check_by_pilots, check_run, missed_because, watch_of, with_asked
from mbdkit.runs.accuracy.chosen_method import Choice
from mbdkit.runs.accuracy.companion import Budget, run_companion
from mbdkit.runs.accuracy.companion_choice import choose_companions
from mbdkit.runs.accuracy.compared_measures import Measure, compared_measures, limited, with_sections
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.law_ranges import steps_are_rows
from mbdkit.runs.preparation import RunSetup
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
    worst = figures.worst_joint
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


#: Ratio of errors to standard deviations. The error of a number holds with a probability of 95 %; that of the norm of a
#: vector with 95 to 98 %, because the deviation of a norm is that of the whole vector.
COVERAGE = 1.959964
SHARE = 0.25  #: Distance of the other runs from the estimates, in standard deviations.


def with_parameter_errors(
    accuracy: Accuracy,
    setup: RunSetup,
    steps: int,
    expressions: Sequence[str],
    measure: Measure,
    budget: Budget,
    progress: Progress | None = None,
) -> Accuracy:
    """Return the errors of a run with those by its estimated parameters added, if it has any.

    The covariance of the estimates p has the Cholesky factor L. To first order in the deviations of the parameters, the
    variance of a result y(p) is the sum over the columns L_k of ``((y(p + s L_k) - y(p - s L_k)) / (2 s))^2``. The
    share s is small, such that the parameters do not leave the values that the mechanism allows if a bound is near.

    - `accuracy`: errors of the integration.
    - `setup`, `steps`: the run, and the number of its steps.
    - `expressions`, `measure`: expressions of measures, and the function that evaluates them in another run.
    - `budget`: determines when the other runs must stop; the errors are then unknown.
    - `progress`: called with (time reached, end time) [s] of each run.
    """
    if (estimated := setup.spec.estimated) is None or len(accuracy.time) < 2:
        return accuracy
    begin = time.perf_counter()

    def results(values: np.ndarray) -> list[np.ndarray]:
        parameters = setup.spec.parameters | dict(zip(estimated.names, values.tolist(), strict=True))
        varied = with_sections(setup.spec, check=False, accuracy=None, choose=None, gradients=[], parameters=parameters)
        other = RunSetup.of(varied, method=setup.method)
        companion = choose_companions(other, accuracy.time, steps).finer[0]
        watch = watch_of(other.spec)
        rows = run_companion(companion, other.workspace, accuracy.time, budget.stopped, progress, watch).rows
        measured = measure(limited(other.spec, budget)) if expressions and not budget.stopped() else None
        return [rows.position, rows.force, np.array(measured or [math.nan] * len(expressions))]

    shapes = accuracy.position_error.shape, accuracy.reaction_error.shape, (len(expressions),)
    variances = [np.zeros(shape) for shape in shapes]
    how = f"Bounds of 95 % on the errors by the estimates of {listed(estimated.names, 'and')}"
    try:
        for column in estimated.factor.T:
            low, high = (results(estimated.values + side * SHARE * column) for side in (-1.0, 1.0))
            position, force, measured = ((b - a) / (2.0 * SHARE) for a, b in zip(low, high, strict=True))
            squares = position**2, np.sum(force**2, axis=-1), measured**2
            variances = [variance + square for variance, square in zip(variances, squares, strict=True)]
        how += f" from {2 * len(estimated.names)} runs, each {SHARE:g} standard deviations from the estimates."
    except MbdkitError as error:  # the mechanism does not exist there, for example because a mass would be negative
        variances = [np.full(shape, np.nan) for shape in shapes]
        how += f" are unknown, because a run with other values is not possible: {error}"
    position, force, measured = (COVERAGE * np.sqrt(variance) for variance in variances)
    about = "bound of 95 % on the error of {} at this time by the estimates of parameters, nan where unknown"
    further = {
        "position_error_parameters": TableColumn(
            position, ("time", "body", "coordinate"), MIXED, about.format("position and angle"), "row_units"
        ),
        "reaction_error_parameters": TableColumn(force, ("time", "joint"), "N", about.format("reaction_force")),
    }
    return replace(
        accuracy,
        further={**accuracy.further, **further},
        measured_parameters=dict(zip(expressions, measured[:, None].tolist(), strict=True)),
        method=f"{accuracy.method} {how}",
        check_s=accuracy.check_s + time.perf_counter() - begin,
    )
