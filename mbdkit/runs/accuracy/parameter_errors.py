"""Errors of a run by its estimated parameters, from runs with other values of these parameters.

The covariance of the estimates p has the Cholesky factor L. To first order in the deviations of the parameters, the
variance of a result y(p) is the sum over the columns L_k of ``((y(p + s L_k) - y(p - s L_k)) / (2 s))^2``. The share s
is small, such that the parameters do not leave the values that the mechanism allows if a bound is near.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.result_table import TableColumn
from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import listed
from mbdkit.quantities.array import MIXED
from mbdkit.runs.accuracy.check_run import watch_of
from mbdkit.runs.accuracy.companion import Budget, run_companion
from mbdkit.runs.accuracy.companion_choice import choose_companions
from mbdkit.runs.accuracy.compared_measures import Measure, limited, with_sections
from mbdkit.runs.preparation import RunSetup
from mbdkit.runs.run_seams import Progress

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
