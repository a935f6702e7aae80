"""Computes predictions: refines the mesh until the objective is accurate, and writes the motion to an archive."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.part_file import check_target
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import UNJUDGED, Ending, Origin
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base.errors import RunError, SpecError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.observed_states import StateObserver
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.states import States
from mbdkit.runs.provenance import model_provenance
from mbdkit.runs.recorder import shared_forces
from mbdkit.trust.criteria import Judgement
from mbdkit_predict.objective import objective_of
from mbdkit_predict.predict_spec import PredictSpec
from mbdkit_predict.symbolic_mechanism import SymbolicMechanism
from mbdkit_predict.transcription import SUCCESSES, Mesh, Transcription, statuses

ROUNDING = 1e-8
"""Smallest error of the objective, relative to its size, due to the tolerance of the optimizer."""
NOTHING = 1e-9
"""Changes of the objective below this count as zero."""
NO_OPTIMUM = "The motion is that of the last iterate: it is no optimum, and may violate conditions."
INACCURATE = "The objective is less accurate than `tolerance`."
"""Verdicts on motions whose optimization failed."""
MOST_INTERVALS = 640
"""Largest number of intervals of a refined mesh; every first mesh is refined once."""


@dataclass(frozen=True)
class Prediction:
    """A predicted motion.

    Attributes
    ----------
    spec, transcription
        The spec, and its optimal control problem.
    mesh
        The solution on the last mesh.
    objectives
        Number of intervals and objective of each mesh.
    error
        Estimated error of the objective: its change by the last refinement; nan without an optimum on the last mesh.
    reason
        Code and sentence saying why the optimum was not found; empty if it was.
    """

    spec: PredictSpec
    transcription: Transcription
    mesh: Mesh
    objectives: tuple[tuple[int, float], ...]
    error: float
    reason: str


def predicted(spec: PredictSpec, *, path: str | Path | None = None, overwrite: bool = False) -> Run:
    """Compute a validated spec; see `mbdkit_predict.prediction.predict`."""
    begin, file = time.perf_counter(), None if path is None else Path(path)
    if file is not None:
        check_target(file, overwrite=overwrite)
    transcription = transcribed(spec)
    setup, wall, cpu = time.perf_counter() - begin, time.perf_counter(), time.process_time()
    with one_thread_of_linear_algebra():
        result = _optimum(spec, transcription)
    timings = {"setup_s": setup, "wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    held = _archive_of(result, file, timings, overwrite=overwrite)
    if held is not None:
        return Run(held)
    assert file is not None
    return load(file)


def transcribed(spec: PredictSpec) -> Transcription:
    """Return the optimal control problem of a spec.

    Raises
    ------
    SpecError
        If an expression is wrong, or the mechanism cannot be exported.
    """
    try:
        symbolic = SymbolicMechanism(spec.chosen, 0.0)
        return Transcription(spec, symbolic, objective_of(spec, symbolic.quantity, symbolic.time))
    except SpecError as error:
        raise spec.placed(error) from None


def _optimum(spec: PredictSpec, transcription: Transcription) -> Prediction:
    """Return the optimum on a mesh that is fine enough."""
    mesh = transcription.solved(transcription.guess())
    meshes, error, change = [mesh], np.nan, 0.0
    while mesh.status in SUCCESSES and (len(meshes) == 1 or 2 * mesh.intervals <= MOST_INTERVALS):
        finer = transcription.solved(transcription.refined(mesh))
        meshes.append(finer)
        change, mesh = abs(finer.objective - mesh.objective), finer
        if finer.status not in SUCCESSES:
            error = np.nan
            break
        error = max(change, ROUNDING * abs(finer.objective))
        if change <= spec.tolerance * abs(finer.objective) + NOTHING:
            break
    else:
        change = np.inf
    reason = ""
    if mesh.status in SUCCESSES and change == np.inf:
        reason = (
            f"mesh-limit: the objective still changes by {error:.2g} on a mesh of {mesh.intervals} intervals, which is "
            "more than `tolerance`"
        )
    if mesh.status not in SUCCESSES:
        code, sentence = statuses().get(mesh.status, ("not-solved", f"the optimizer stopped: {mesh.status}"))
        reason = f"{code}: {sentence}, on a mesh of {mesh.intervals} intervals{_cause(mesh) * (code == 'infeasible')}"
    return Prediction(
        spec, transcription, mesh, tuple((solved.intervals, solved.objective) for solved in meshes), error, reason
    )


def _cause(mesh: Mesh) -> str:
    """Return a clause on the condition that is violated most."""
    name, size = mesh.violated
    if name.startswith("the "):
        return "; motion does not lead from the start to the end within the bounds"
    return f"; the largest violation is that of `{name}`, {size:.3g}"


def _rows(result: Prediction) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return times (T,), positions and velocities (T, n), and first-order states with controls (T, Z).

    The rows are the start, the collocation points, and the end if it is no such point.
    """
    mesh, method = result.mesh, result.transcription
    values, n = mesh.values, len(mesh.values["q"])
    begin, own_states = values["start"], slice(2 * n, None)
    ends = [values["nodes"][:, -1]] if method.has_nodes else []
    low, high = np.array([result.spec.control(name)[:2] for name in method.system.control_names]).T
    first, last = values["u"][:, : len(method.c)], values["u"][:, -len(method.c) :]
    columns = {
        "q": (begin[:n], [end[:n] for end in ends]),
        "v": (begin[n : 2 * n], [end[n : 2 * n] for end in ends]),
        "z": (begin[own_states], [end[own_states] for end in ends]),
        "u": (
            np.clip(first @ _weights(method.c, 0.0), low, high),
            [np.clip(last @ _weights(method.c, 1.0), low, high) for _ in ends],
        ),
    }
    q, v, z, u = (np.column_stack([columns[name][0], values[name], *columns[name][1]]).T for name in "qvzu")
    shares = np.concatenate([[0.0], method.points(mesh.intervals), [1.0] * len(ends)])
    own, controls = iter(z.T), dict(zip(result.spec.chosen.control_states, u.T, strict=True))
    compiled = [state.name for state in method.states]
    states = [controls[name] if name in controls else next(own) for name in compiled]
    return shares * values["duration"][0], q, v, np.array(states).reshape(len(compiled), len(q)).T


def _weights(points: np.ndarray, at: float) -> np.ndarray:
    """Return the weights of values at points in the value at another one of the polynomial through them."""
    return np.array([np.prod([(at - c) / (own - c) for c in points if c != own]) for own in points])


def _archive_of(
    result: Prediction, path: Path | None, timings: dict[str, float], *, overwrite: bool
) -> h5py.File | None:
    """Write the motion to an archive; return the file of the archive if it is in memory, else None."""
    spec, method = result.spec, result.transcription
    spec.adopt(spec.chosen.with_parameters(result.mesh.values["p"].tolist()))
    workspace, _ = workspace_at_start(spec.mechanism())
    mechanism, equations = workspace.mechanism, EquationsOfMotion(workspace)
    time, q, v, z = _rows(result)
    if not all(np.all(np.isfinite(x)) for x in (time, q, v, z)):
        raise RunError(f"no motion was found: {result.reason}")
    observer, still = StateObserver(workspace), np.zeros((len(time), 3))
    observed = observer.arrays(len(time))
    whole = np.column_stack([q, still]), np.column_stack([v, still])
    singular = observer.observe(time, *whole, observed, z=np.ascontiguousarray(z))
    if singular is not None:
        raise RunError(f"the motion passes a singular position at t = {time[singular.row]:.6g} s")
    powers = [
        equations.powers(at, x, rate, equations.derivatives(at, x, rate, state)[1])
        for at, x, rate, state in zip(time, q, v, z, strict=True)
    ]
    points = slice(1, 1 + result.mesh.values["u"].shape[1])
    work, lost = method.integrated(np.array(powers)[points].T, time[-1])
    start = float(observed.kinetic[0] + observed.potential[0])
    states = States(
        mechanism, time, *whole, lambda: observed, work=work, dissipated=lost, start_energy=start,
        elapsed=np.zeros(len(time)), z=z,
    )  # fmt: skip
    names = archive_names(mechanism)
    optional = [*layout.of_elements(names), *(["constraints/singularity_distance"] if mechanism.solved_rows else [])]
    optional += layout.FRICTION if mechanism.friction else ()
    results: dict[str, str | int | float] = {
        "casadi": version("casadi"),
        "objective": result.mesh.objective,
        "objective_error": float(result.error),
        "mesh": json.dumps(result.objectives),
        "optimized": json.dumps(
            dict(zip(method.system.parameter_names, result.mesh.values["p"].tolist(), strict=True))
        ),
    }
    writer = ArchiveWriter(
        path,
        names,
        Origin.of(spec, model_provenance(spec) | results),
        arrays=layout.recorded_by(names, layout.QUANTITIES, frozenset(optional)),
        overwrite=overwrite,
        shared=shared_forces(mechanism),
    )
    try:
        writer.append({key: array.take(states) for key, array in writer.recorded.items()})
        none = np.zeros(len(time) - 1, dtype=np.int64)
        counted = dict.fromkeys(("steps", "iterations", "iterations_max", "rejected"), none)
        writer.append_steps({"time": time[1:], "size": np.diff(time), **counted})
        counters = dict.fromkeys(layout.COUNTERS, 0) | {"newton_iterations": result.mesh.iterations}
        status = "failed" if result.reason else "complete"
        misalignment = states.misalignment.max(axis=0, initial=0.0)
        judgement = UNJUDGED
        if result.reason:  # an error is known if there is an optimum on the last mesh, the limit of meshes
            known = np.isfinite(result.error)
            judgement = Judgement("doubtful", (INACCURATE,)) if known else Judgement("bad", (NO_OPTIMUM,))
        return writer.finish(Ending(status, result.reason, {**counters, **timings}, misalignment, judgement))
    finally:
        writer.abandon()
