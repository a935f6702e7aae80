"""Archives of inverse dynamics: the groups of a forward run, and groups of motion, actuators, muscles and loads."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from mbdkit.plugin import Run
from mbdkit.plugin.archives import (
    ArchiveNames,
    ArchiveWriter,
    Ending,
    MeasuredValues,
    Origin,
    archive_names,
    kind_of_group,
    layout,
    with_members,
)
from mbdkit.plugin.files import json_text
from mbdkit.plugin.measures import take_all
from mbdkit.plugin.runs import model_provenance, shared_forces
from mbdkit_biomech.inverse_dynamics.compute import Inverse, reaction_forces_without_muscles, recorded_states
from mbdkit_biomech.inverse_dynamics.criteria.data_verdict import DataDoubts, verdict_on_data
from mbdkit_biomech.inverse_dynamics.errors.ends_and_gaps import long_gaps
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.motion.fit import raw_misalignment
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import members_of_actuators
from mbdkit_biomech.quantities import INVERSE_GROUPS, MUSCLES_OF_RUNS

TIMINGS = ("setup_s", "wall_s", "cpu_s")


def run_of(result: Inverse) -> Run:
    """Return a result without error bars as a run in memory."""
    file = archive_of(result, None, DataDoubts(), None, overwrite=False, timings=dict.fromkeys(TIMINGS, 0.0))
    assert file is not None
    return Run(file)


def archive_of(
    result: Inverse,
    bars: ResultBars | None,
    doubts: DataDoubts,
    path: Path | None,
    *,
    overwrite: bool,
    timings: Mapping[str, float],
    errors: Mapping[str, float] | None = None,
) -> h5py.File | None:
    """Write the result to an archive. Return the file of the archive if it is in memory (`path` is None), else None.

    Parameters
    ----------
    bars
        Error bars of the result, if they are known.
    doubts
        Doubts about the data.
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
    spec, mechanism = result.problem.source, result.problem.prepared.workspace.mechanism
    states, names = recorded_states(result), _names(result)
    groups = [group for group in INVERSE_GROUPS if names.names_of(group)]
    extra = [path for group in groups for path in kind_of_group(group).by_path if path not in MUSCLES_OF_RUNS]
    if mechanism.solved_rows:
        extra.append("constraints/singularity_distance")
    writer = ArchiveWriter(
        path,
        names,
        Origin.of(spec, _provenance(result)),
        arrays=layout.recorded_by(names, layout.QUANTITIES, frozenset(extra)),
        overwrite=overwrite,
        shared=shared_forces(mechanism),
    )
    try:
        rows = {key: values for key, values in _rows(result, bars).items() if key in writer.row_keys}
        writer.append(rows | {key: array.take(states) for key, array in writer.recorded.items()})
        writer.append_steps(_intervals(result.motion.time))
        counters = dict.fromkeys(layout.COUNTERS, 0)
        misalignment = states.misalignment.max(axis=0, initial=0.0)
        ending = Ending(
            "complete",
            "",
            {**counters, **timings},
            misalignment,
            judgement=verdict_on_data(result, misalignment, doubts),
            warnings=(*result.warnings, *doubts.remarks, *doubts.open),
            accuracy=None if bars is None else bars.accuracy,
        )
        return writer.finish(ending, measured=partial(_measured, result, errors or {}) if spec.measures else None)
    finally:
        writer.abandon()


def _provenance(result: Inverse) -> dict[str, str | int | float]:
    """Return the provenance, with unused data and with gaps that are filled by means of other columns."""
    fitted = result.fitted
    gaps = {} if fitted.placed is None else {"placed_gaps": fitted.placed.to_json(fitted.measured.names)}
    person = result.problem.source.person
    own = {} if person is None else {"person": json_text(person.to_dict()), **person.lines()}
    return model_provenance(result.problem.spec) | result.problem.unused.notes | gaps | own


def _intervals(time: np.ndarray) -> dict[str, np.ndarray]:
    """Return the arrays of the group ``/steps``. All but the times are zero, because nothing is integrated."""
    none = np.zeros(len(time) - 1, dtype=np.int64)
    counted = dict.fromkeys(("steps", "iterations", "iterations_max", "rejected"), none)
    return {"time": time[1:], "size": np.zeros(len(time) - 1), **counted}


def _measured(result: Inverse, errors: Mapping[str, float], file: h5py.File) -> str:
    values = take_all(Run(file), result.problem.spec)
    cause = (
        "it depends on a gap that is longer than the smoothing can bridge"
        if long_gaps(result)
        else "the muscles cannot produce the motion in most of its samples"
    )
    unknown = {name: f"its error is unknown: {cause}" for name, error in errors.items() if math.isnan(error)}
    remarks = {**unknown, **values.remarks}
    return MeasuredValues(values, values.units, values.reasons, errors, remarks).to_json()


def _names(result: Inverse) -> ArchiveNames:
    measured, problem = result.fitted.measured, result.problem
    units = [quantity.unit for quantity in measured.quantities.quantities]
    return with_members(
        archive_names(problem.prepared.workspace.mechanism),
        motion=[(name, (unit,)) for name, unit in zip(measured.names, units, strict=True)],
        actuators=members_of_actuators(problem.recorded_actuators),
        muscles=[(name, ()) for name in ({} if problem.recruiter is None else problem.recruiter.muscles)],
        loads=[(name, (body,)) for name, body in zip(result.loads.names, result.loads.bodies, strict=True)],
    )


def _rows(result: Inverse, bars: ResultBars | None) -> dict[str, np.ndarray]:
    """Return the arrays of motion, actuators, muscles and loads that are not computed from states, by key."""
    problem, fitted, loads = result.problem, result.fitted, result.loads
    mechanism = problem.prepared.workspace.mechanism
    rows = {
        "motion/raw": fitted.measured.raw,
        "motion/fitted": fitted.values,
        "motion/residual": fitted.residual,
        "motion/raw_misalignment": raw_misalignment(
            problem.fitter.manifold, mechanism, fitted.measured.target, fitted.q
        ),
        "actuators/value_error": np.full(result.actuators.shape[:2], np.nan) if bars is None else bars.actuators,
        "loads/force": loads.force,
        "loads/point": loads.point,
        "loads/torque": loads.torque,
        "loads/power": loads.power,
    }
    if result.recruited is not None:
        rows |= {
            "muscles/force_error": np.full(result.recruited.force.shape, np.nan) if bars is None else bars.muscles,
            "muscles/certificate": result.recruited.shared.certificate,
            "muscles/reaction_force_without": reaction_forces_without_muscles(result),
        }
    return rows
