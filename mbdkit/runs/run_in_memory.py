"""Runs in memory, with their measures."""

from __future__ import annotations

from functools import partial

from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.measured_values import MeasuredValues
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import ArrayContents
from mbdkit.base.logs import logger_of
from mbdkit.measures.take import take_all
from mbdkit.runs.provenance import provenance
from mbdkit.spec import RunSpec

_LOG = logger_of("mbdkit.runs.simulation")


def run_in_memory(finished: FinishedRun, spec: RunSpec, created_utc: str, gradients: str = "") -> Run:
    """Return a finished run with its measures.

    Parameters
    ----------
    spec
        Spec of the run.
    created_utc
        Time at which the run began, ISO 8601.
    gradients
        Gradients of the measures as JSON; empty if there are none.
    """
    contents = partial(
        ArrayContents, finished, spec, run_id=spec.run_id(), created_utc=created_utc, provenance=provenance(spec)
    )
    if not spec.measures:
        return Run(contents())
    return Run(contents(measured=measured_values(Run(contents()), spec), gradients=gradients))


def measured_values(run: Run, spec: RunSpec) -> MeasuredValues:
    """Return the measures of a run, and log the reasons why some have no value."""
    values = take_all(run, spec)
    for name, reason in values.reasons.items():
        _LOG.warning("measure %s: %s", name, reason)
    return values
