"""Archives of inverse dynamics: the groups of a forward run, and groups of motion, actuators, muscles and loads."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from mbdkit.archive.measured_values import MeasuredValues
from mbdkit.archive.run import Run
from mbdkit.base.plain_data import json_text
from mbdkit.measures.take import take_all
from mbdkit.quantities.names import ArchiveNames, archive_names
from mbdkit.quantities.registered_kinds import kind_of_group
from mbdkit.runs.conclusion import EndedRun, Extremes, conclude
from mbdkit.runs.finish import finish_states
from mbdkit.runs.provenance import model_provenance
from mbdkit.trust.finding import Doubts
from mbdkit_biomech.inverse_dynamics.compute import (
    Inverse,
    reaction_forces_without_muscles,
    recorded_states,
    without_followers,
)
from mbdkit_biomech.inverse_dynamics.errors.ends_and_gaps import long_gaps
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.motion.fit import raw_misalignment
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import members_of_actuators
from mbdkit_biomech.quantities import INVERSE_GROUPS, MUSCLES_OF_RUNS

TIMINGS = ("setup_s", "wall_s", "cpu_s")


def run_of(
    result: Inverse,
    bars: ResultBars | None = None,
    doubts: Doubts | None = None,
    path: Path | None = None,
    *,
    overwrite: bool = False,
    timings: Mapping[str, float] | None = None,
    errors: Mapping[str, float] | None = None,
) -> Run:
    """Return a result as a run, and write it to an archive.

    Parameters
    ----------
    bars
        Error bars of the result, if they are known.
    doubts
        Doubts about the data, if they were examined.
    path, overwrite
        Final name of the archive, None for a run in memory, and whether an existing file may be replaced.
    timings
        Durations, named as in `TIMINGS` [s].
    errors
        Errors of the measures by name, if they are known.

    Raises
    ------
    SpecError
        If no archive may be written at `path`.
    ResourceError
        If the archive cannot be written.
    """
    states = recorded_states(result, None if bars is None else bars.knees)
    names, is_sample = _names(result), doubts is None
    doubts = doubts or Doubts()
    groups = [group for group in INVERSE_GROUPS if names.names_of(group)]
    # The verdict is unknown at best: error bars do not cover wrong data, masses and lengths.
    ended = EndedRun(
        mechanism=states.mechanism,
        size=result.problem.fitter.manifold.length,
        doubts=doubts,
        warnings=(*result.warnings, *doubts.remarks, *doubts.faults, *doubts.open),
        timings=timings or dict.fromkeys(TIMINGS, 0.0),
    )
    ending = conclude(ended, Extremes.of_states(states))
    return finish_states(
        result.problem.source,
        states,
        replace(ending, accuracy=None if bars is None else bars.accuracy),
        _provenance(result),
        path=path,
        overwrite=overwrite,
        names=names,
        rows=_rows(result, bars, is_sample=is_sample),
        optional=[path for group in groups for path in kind_of_group(group).by_path if path not in MUSCLES_OF_RUNS],
        measured=partial(_measured, result, errors or {}),
    )


def _provenance(result: Inverse) -> dict[str, str | int | float]:
    """Return the provenance, with unused data and with gaps that are filled by means of other columns."""
    fitted = result.fitted
    gaps = {} if fitted.placed is None else {"placed_gaps": fitted.placed.to_json(fitted.measured.names)}
    person = result.problem.source.person
    own = {} if person is None else {"person": json_text(person.to_dict()), **person.lines()}
    return model_provenance(result.problem.spec) | result.problem.unused.notes | gaps | own


def _measured(result: Inverse, errors: Mapping[str, float], run: Run) -> MeasuredValues:
    values = take_all(run, result.problem.source)
    cause = "the muscles cannot produce the motion in most of its samples"
    if long_gaps(result):
        cause = "it depends on a gap that is longer than the smoothing can bridge"
    unknown = {
        name: f"its error is unknown: {cause}"
        for name, error in errors.items()
        if math.isnan(error) and not math.isnan(values[name])
    }
    return MeasuredValues(values, values.units, values.reasons, errors, {**unknown, **values.remarks})


def _names(result: Inverse) -> ArchiveNames:
    measured, problem = result.fitted.measured, result.problem
    units = [quantity.unit for quantity in measured.quantities.quantities]
    return archive_names(problem.prepared.workspace.mechanism).with_members(
        motion=[(name, (unit,)) for name, unit in zip(measured.names, units, strict=True)],
        actuators=members_of_actuators(problem.recorded_actuators),
        muscles=[(name, ()) for name in ({} if problem.recruiter is None else problem.recruiter.muscles)],
        knees=[(name, ()) for name in problem.source.result_names["knees"]],
        loads=[(name, (body,)) for name, body in zip(result.loads.names, result.loads.bodies, strict=True)],
        followers=[(name, ()) for name in problem.followers],
    )


def _rows(result: Inverse, bars: ResultBars | None, *, is_sample: bool) -> dict[str, np.ndarray]:
    """Return the arrays of motion, actuators, muscles and loads that are not computed from states, by key.

    `is_sample`: whether the result is a sample for error bars, for which no second result without followers is needed.
    """
    problem, fitted, loads = result.problem, result.fitted, result.loads
    mechanism, target = problem.prepared.workspace.mechanism, fitted.measured.target
    rows = {
        "motion/raw": fitted.measured.raw,
        "motion/fitted": fitted.values,
        "motion/residual": fitted.residual,
        "motion/raw_misalignment": raw_misalignment(problem.fitter.manifold, mechanism, target, fitted.q),
        "actuators/value_error": np.full(result.actuators.shape[:2], np.nan) if bars is None else bars.actuators,
        **{f"loads/{name}": getattr(loads, name) for name in ("force", "point", "torque", "power")},
    }
    if problem.followers:
        other = result if is_sample else without_followers(result)
        rows["followers/reaction_force_without"] = recorded_states(other).reactions[..., :2]
    if result.recruited is not None:
        rows |= {
            "muscles/force_error": np.full(result.recruited.force.shape, np.nan) if bars is None else bars.muscles,
            "muscles/certificate": result.recruited.shared.certificate,
            "muscles/reaction_force_without": reaction_forces_without_muscles(result),
        }
    return rows
