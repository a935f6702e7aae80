"""Writes the result of inverse dynamics to an archive: the groups of a run, and motion, actuators and loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import Ending, Origin
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.inverse_dynamics.compute import Inverse, recorded_states
from mbdkit.inverse_dynamics.error_bars import ErrorBars, error_bars
from mbdkit.inverse_dynamics.raw_misalignment import raw_misalignment
from mbdkit.measures.take import take_all
from mbdkit.quantities.names import ArchiveNames, archive_names
from mbdkit.quantities.table import RECORDED
from mbdkit.runs.provenance import model_provenance
from mbdkit.runs.recorder import shared_forces


def archive_of(
    result: Inverse, path: Path | None, *, overwrite: bool, timings: Mapping[str, float]
) -> h5py.File | None:
    """Write the result to an archive, and return its file if it is in memory (`path` is None).

    Parameters
    ----------
    timings
        ``setup_s``, ``wall_s`` and ``cpu_s``.

    Raises
    ------
    SpecError
        If no archive may be written at `path`.
    ResourceError
        If it cannot be written.
    """
    spec, mechanism = result.problem.spec, result.problem.prepared.workspace.mechanism
    extra = [array.path for array in layout.LAYOUT if array.group in _groups(result)]
    if mechanism.solved_rows:
        extra.append("constraints/singularity_distance")
    states, bars, names = recorded_states(result), error_bars(result), _names(result)
    writer = ArchiveWriter(
        path,
        names,
        Origin.of(spec, model_provenance(spec)),
        arrays=layout.recorded_by(names, layout.QUANTITIES, frozenset(extra)),
        overwrite=overwrite,
        shared=shared_forces(mechanism),
    )
    try:
        rows = _rows(result, bars)
        writer.append(rows | {key: RECORDED[key].take(states) for key in writer.row_keys if key not in rows})
        writer.append_steps(_intervals(result.motion.time))
        counters = dict.fromkeys(layout.COUNTERS, 0)
        ending = Ending(
            "complete",
            "",
            {**counters, **timings},
            states.misalignment.max(axis=0, initial=0.0),
            warnings=result.warnings,
            accuracy=None if bars is None else bars.accuracy,
        )
        return writer.finish(ending, measured=partial(_measured, result) if spec.measures else None)
    finally:
        writer.abandon()


def _intervals(time: np.ndarray) -> dict[str, np.ndarray]:
    """Return the rows of ``/steps``: there is no integration, hence no steps."""
    none = np.zeros(len(time) - 1, dtype=np.int64)
    counted = dict.fromkeys(("steps", "iterations", "iterations_max", "rejected"), none)
    return {"time": time[1:], "size": np.zeros(len(time) - 1), **counted}


def _measured(result: Inverse, file: h5py.File) -> str:
    return take_all(Run(file), result.problem.spec).to_json()


def _groups(result: Inverse) -> list[str]:
    """Return the groups of inverse dynamics that have elements."""
    there = {"motion": True, "actuators": result.problem.actuators, "loads": result.loads.names}
    return [group for group in layout.INVERSE_GROUPS if there[group]]


def _names(result: Inverse) -> ArchiveNames:
    measured, actuators = result.fitted.measured, result.problem.actuators
    return replace(
        archive_names(result.problem.prepared.workspace.mechanism),
        observed=measured.names,
        observed_units=[one.unit for one in measured.quantities.quantities],
        actuators=[one.name for one in actuators],
        actuator_units=[one.unit for one in actuators],
        loads=result.loads.names,
        load_bodies=result.loads.bodies,
    )


def _rows(result: Inverse, bars: ErrorBars | None) -> dict[str, np.ndarray]:
    """Return the arrays of motion, actuators and loads, by key."""
    problem, fitted, loads, dynamics = result.problem, result.fitted, result.loads, result.dynamics
    mechanism = problem.prepared.workspace.mechanism
    rows = {
        "motion/raw": fitted.measured.raw,
        "motion/fitted": fitted.values,
        "motion/residual": fitted.residual,
        "motion/raw_misalignment": raw_misalignment(
            problem.fitter.manifold, mechanism, fitted.measured.target, fitted.q
        ),
        "actuators/value_error": np.full(dynamics.value.shape, np.nan) if bars is None else bars.actuators,
        "loads/force": loads.force,
        "loads/point": loads.point,
        "loads/torque": loads.torque,
        "loads/power": loads.power,
    }
    groups = _groups(result)
    return {path: values for path, values in rows.items() if path.partition("/")[0] in groups}
