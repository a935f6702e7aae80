"""`inverse`: inverse dynamics of a spec as an archive: the groups of a run, and motion, actuators and loads."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.part_file import check_target
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import Ending, Origin
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base.logs import logger_of, warn_on_stderr
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.inverse_dynamics.compute import (
    Inverse,
    InverseProblem,
    compute,
    reaction_forces_without_muscles,
    recorded_states,
)
from mbdkit.inverse_dynamics.data_verdict import doubts_about_data, verdict_on_data
from mbdkit.inverse_dynamics.error_bars import ErrorBars, error_bars
from mbdkit.inverse_dynamics.fit import raw_misalignment
from mbdkit.measures.take import check_measures, take_all
from mbdkit.quantities.names import ArchiveNames, archive_names
from mbdkit.quantities.table import RECORDED
from mbdkit.runs.provenance import model_provenance
from mbdkit.runs.recorder import shared_forces
from mbdkit.spec import InverseSpec, load_inverse_spec
from mbdkit.spec.inverse_loading import InverseSource

_LOG = logger_of(__name__)

TIMINGS = ("setup_s", "wall_s", "cpu_s")


def inverse(
    source: InverseSource, *, archive: str | Path | None = None, overwrite: bool = False, **sections: Any
) -> Run:
    """Compute the forces of actuators and joints that produce a measured motion.

    The mechanism is fitted to the measured columns at each time, with its constraints satisfied to round-off; the
    fitted motion is smoothed as the spec says; and the equations of motion are solved for the values of the actuators
    and the reactions of the joints.

    Parameters
    ----------
    source
        A file, a mapping, or an InverseSpec. Names of data files are relative to the folder of the spec, or to the
        current folder.
    archive
        File to which the result is written; by default, it is kept in memory.
    overwrite
        Whether an existing archive may be replaced.
    **sections
        Sections of the spec, such as ``motion={...}``; they replace those of `source`.

    Returns
    -------
    Run
        The result, with ``run.kind == "inverse"``: all quantities of a run, and `Run.motion`, `Run.actuators` and
        `Run.loads`, with one row for each row of the motion.

    Raises
    ------
    SpecError
        If the spec or its data are wrong: the message names the key, or the file, line and column.
    RunError
        If no pose of the mechanism fits the data, or the mechanism passes a singular position.

    Examples
    --------
    The torque that swings a pendulum by 0.5 rad:

    >>> import mbdkit, numpy as np
    >>> m = mbdkit.Mechanism()
    >>> rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.0, -0.5))
    >>> m.revolute("hip", m.ground, rod, at=(0, 0))
    >>> t = np.linspace(0.0, 2.0, 201)
    >>> motion = {"data": {"time": t, "hip": 0.5 * np.sin(3 * t)}, "columns": {"hip.angle": "hip"}}
    >>> run = mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion})
    >>> exact = -0.35 * 4.5 * np.sin(3 * t) + 0.5 * 9.81 * np.sin(0.5 * np.sin(3 * t))
    >>> bool(np.max(np.abs(run.actuators["hip"].value - exact)[2:-2]) < 1e-5)
    True
    """
    spec = load_inverse_spec(source, (), **sections)
    result = compute_run(spec, path=None if archive is None else Path(archive), overwrite=overwrite)
    warn_on_stderr(result.warnings)
    return result


def compute_run(spec: InverseSpec, *, path: Path | None = None, overwrite: bool = False) -> Run:
    """Compute a validated spec; see `inverse`.

    Parameters
    ----------
    path
        Final name of the archive; None keeps it in memory.
    overwrite
        Whether an existing archive may be replaced.
    """
    begin = time.perf_counter()
    if path is not None:
        check_target(path, overwrite=overwrite)
    problem = InverseProblem.of(spec)
    check_measures(spec)  # error bars of joints are written after those of the actuators, on which they depend
    setup, wall, cpu = time.perf_counter() - begin, time.perf_counter(), time.process_time()
    with one_thread_of_linear_algebra():
        result = compute(problem)
        timings = {"setup_s": setup, "wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        bars = error_bars(result)
        doubts = doubts_about_data(result, bars)
    for warning in (*result.warnings, *doubts):
        _LOG.warning("%s", warning)
    file = _archive_of(result, bars, doubts, path, overwrite=overwrite, timings=timings)
    if file is not None:
        return Run(file)
    assert path is not None
    return load(path)


def run_of(result: Inverse) -> Run:
    """Return a result without error bars as a run in memory."""
    file = _archive_of(result, None, (), None, overwrite=False, timings=dict.fromkeys(TIMINGS, 0.0))
    assert file is not None
    return Run(file)


def _archive_of(
    result: Inverse,
    bars: ErrorBars | None,
    doubts: tuple[str, ...],
    path: Path | None,
    *,
    overwrite: bool,
    timings: Mapping[str, float],
) -> h5py.File | None:
    """Write the result to an archive, and return its file if it is in memory (`path` is None).

    Parameters
    ----------
    bars
        Its error bars, if they are known.
    doubts
        What is implausible in the data.
    timings
        Those of `TIMINGS`.

    Raises
    ------
    SpecError
        If no archive may be written at `path`.
    ResourceError
        If it cannot be written.
    """
    spec, mechanism = result.problem.spec, result.problem.prepared.workspace.mechanism
    groups = _groups(result)
    extra = [one.path for one in layout.LAYOUT if one.group in groups and one.path not in layout.MUSCLES_OF_RUNS]
    if mechanism.solved_rows:
        extra.append("constraints/singularity_distance")
    states, names = recorded_states(result), _names(result)
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
        misalignment = states.misalignment.max(axis=0, initial=0.0)
        ending = Ending(
            "complete",
            "",
            {**counters, **timings},
            misalignment,
            judgement=verdict_on_data(result, misalignment, doubts),
            warnings=(*result.warnings, *doubts),
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
    there["muscles"] = result.recruited is not None
    return [group for group in layout.INVERSE_GROUPS if there[group]]


def _names(result: Inverse) -> ArchiveNames:
    measured, actuators = result.fitted.measured, result.problem.recorded_actuators
    return replace(
        archive_names(result.problem.prepared.workspace.mechanism),
        observed=measured.names,
        observed_units=[quantity.unit for quantity in measured.quantities.quantities],
        actuators=[actuator.name for actuator in actuators],
        actuator_units=[actuator.unit for actuator in actuators],
        muscles=() if result.problem.recruiter is None else tuple(result.problem.recruiter.muscles),
        loads=result.loads.names,
        load_bodies=result.loads.bodies,
    )


def _rows(result: Inverse, bars: ErrorBars | None) -> dict[str, np.ndarray]:
    """Return the arrays of motion, actuators, muscles and loads that are not taken from states, by key."""
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
    groups = _groups(result)
    return {path: values for path, values in rows.items() if path.partition("/")[0] in groups}
