"""Checks the accuracy of a run by the coarser runs from which its tolerance was chosen; see `coarser_estimate`."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.base.text import listed
from mbdkit.engine.workspace import Workspace
from mbdkit.runs.accuracy.check_run import as_accuracy, units_of
from mbdkit.runs.accuracy.coarser_estimate import estimate_from_coarser
from mbdkit.runs.accuracy.error_estimate import ErrorEstimate
from mbdkit.runs.accuracy.recorded_pilot import RecordedPilot
from mbdkit.runs.accuracy.resolved_loads import resolved_until
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.spec import RunSpec

FIRST_STEPS = 5
"""Number of steps after which runs with different tolerances differ. The first step is often the same, and the next
ones grow by the same largest factor."""


def check_by_pilots(
    spec: RunSpec, workspace: Workspace, rows: ObservedRows, pilots: Sequence[RecordedPilot], setting: float
) -> Accuracy:
    """Estimate the errors of a run from pilots of larger tolerance.

    Parameters
    ----------
    spec, workspace
        The run.
    rows
        Its recorded rows.
    pilots
        One or two pilots of its method, the coarsest first.
    setting
        Tolerance of the run.
    """
    begin = time.perf_counter()
    tolerances = [*(pilot.setting for pilot in pilots), setting]
    coarser = [pilot.rows(rows.time) for pilot in pilots]
    settled = int(np.searchsorted(rows.time[:-1], pilots[-1].time[: FIRST_STEPS + 1][-1]))
    errors = estimate_from_coarser(rows, coarser, tolerances, units_of(workspace, rows), spec.accuracy or 0.0, settled)
    told = listed([f"{pilot.setting:.2g}" for pilot in pilots], "and")
    runs = "a coarser run" if len(pilots) == 1 else "coarser runs"
    method = f"Difference from {runs} of the same method with tolerance{'s' * (len(pilots) > 1)} {told}, extrapolated"
    method += "." if len(pilots) > 1 else " with the expected exponent of the tolerance."
    until = resolved_until(spec, pilots[-1].time)
    if until < rows.time[-1]:
        errors = _cut(errors, rows.time, until)
        method += f" After {until:.6g} s, a motion or load changes between the evaluations of a step."
    return as_accuracy(rows, errors, method, begin)


def _cut(errors: ErrorEstimate, times: np.ndarray, until: float) -> ErrorEstimate:
    """Return estimates that are unknown after a time [s]."""
    late = times > until
    parts = {name: getattr(errors, name).copy() for name in ("position", "velocity", "reaction", "torque")}
    for values in parts.values():
        values[late] = np.nan
    known = times[~late & (times <= errors.known_until)]
    return replace(errors, **parts, known_until=float(known[-1]) if len(known) else math.nan)
