"""`inverse`: computes the inverse dynamics of a spec, and returns or writes them as an archive.

The archive has the groups of a forward run, and additional groups of the motion, actuators, muscles and loads.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from mbdkit.archive.part_file import check_target
from mbdkit.archive.run import Run
from mbdkit.base.errors import RunError
from mbdkit.base.logs import logger_of, warn_on_stderr
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.measures.take import check_measures
from mbdkit.runs.angles_in_degrees import angles_in_degrees
from mbdkit.runs.run_seams import computed_run
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, compute
from mbdkit_biomech.inverse_dynamics.criteria.column_criteria import suspicious_columns
from mbdkit_biomech.inverse_dynamics.criteria.data_verdict import doubts_about_data
from mbdkit_biomech.inverse_dynamics.criteria.marker_distances import changed_axes, exchanged_markers
from mbdkit_biomech.inverse_dynamics.errors.error_bars import error_bars
from mbdkit_biomech.inverse_dynamics.motion.fit import FitError
from mbdkit_biomech.inverse_dynamics.results.measure_samples import errors_of_measures
from mbdkit_biomech.inverse_dynamics.results.record import run_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSource, InverseSpec, load_inverse_spec

_LOG = logger_of(__name__)

MOST_NAMED = 3  #: Largest number of angles and columns that are named as possible causes of an error.


def inverse(
    source: InverseSource, *, archive: str | Path | None = None, overwrite: bool = False, **sections: object
) -> Run:
    """Compute the forces of actuators and joints that produce a measured motion.

    The mechanism is fitted to the measured columns at each time, with its constraints satisfied to round-off. The
    fitted motion is smoothed according to the spec. Then the equations of motion are solved for the values of the
    actuators and the reactions of the joints.

    Parameters
    ----------
    source
        A file, a mapping, or an InverseSpec. Names of data files are relative to the folder of the spec, or to the
        current folder.
    archive
        File to which the result is written; by default, the result stays in memory.
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


@contextmanager
def causes_named(problem: InverseProblem) -> Iterator[None]:
    """Add angles of the model, columns and markers that may be the cause to the message of a `RunError`."""
    try:
        yield
    except RunError as error:
        length, no_pose = problem.fitter.manifold.length, isinstance(error, FitError)
        of_markers = _cause_in_markers(problem, error.time) if isinstance(error, FitError) else None
        suspicious = [of_markers] if of_markers else suspicious_columns(problem.measured, length, no_pose=no_pose)
        angles = angles_in_degrees(problem.spec)
        raise RunError("; ".join([str(error), *[*angles, *suspicious][:MOST_NAMED]])) from error


def _cause_in_markers(problem: InverseProblem, time: float) -> str | None:
    """Return a clause on markers that are probably exchanged at a time without a pose, or on wrong axes of all."""
    row = int(np.argmin(np.abs(problem.measured.time - time)))
    exchanged = exchanged_markers(problem.fitter, problem.measured, row, problem.prepared.equations.q0)
    return exchanged or changed_axes(problem)


@computed_run
def compute_run(
    spec: InverseSpec, *, path: Path | None = None, overwrite: bool = False, progress: object = None
) -> Run:
    """Compute a validated spec; see `inverse`. The computation has no steps whose progress could be told.

    Parameters
    ----------
    path
        Final name of the archive; None for an archive in memory.
    overwrite
        Whether an existing archive may be replaced.
    """
    begin = time.perf_counter()
    if path is not None:
        check_target(path, overwrite=overwrite)
    problem = InverseProblem.of(spec)
    check_measures(spec)  # before the computation, so that wrong expressions are found early
    setup, wall, cpu = time.perf_counter() - begin, time.perf_counter(), time.process_time()
    with one_thread_of_linear_algebra():
        with causes_named(problem):
            result = compute(problem)
        timings = {"setup_s": setup, "wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        bars = error_bars(result)
        doubts = doubts_about_data(result, bars)
        errors = {} if bars is None else errors_of_measures(result)
    for warning in (*result.warnings, *doubts.remarks, *doubts.faults, *doubts.open):
        _LOG.warning("%s", warning)
    return run_of(result, bars, doubts, path, overwrite=overwrite, timings=timings, errors=errors)
