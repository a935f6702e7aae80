"""Computes predictions, and writes the motion to an archive."""

from __future__ import annotations

import json
import math
import os
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mbdkit.archive.part_file import check_target
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import Ending
from mbdkit.base.errors import RunError, SpecError, StepError
from mbdkit.base.interrupts import interrupts_noted
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.observed_states import StateObserver
from mbdkit.mechanism.values import curve_of
from mbdkit.quantities.states import States
from mbdkit.runs.finish import finish_states
from mbdkit.runs.provenance import model_provenance
from mbdkit.trust.criteria import Judgement
from mbdkit_predict.casadi_system import CasadiSystem
from mbdkit_predict.forward_run import BESIDE, Difference, forward_difference
from mbdkit_predict.grid import weights
from mbdkit_predict.objective import objective_of
from mbdkit_predict.optimum import Optimum, find_optima
from mbdkit_predict.predict_loading import compared_spec, simpler_spec
from mbdkit_predict.predict_spec import PredictSpec
from mbdkit_predict.processes import Stop
from mbdkit_predict.transcription import Transcription

NO_OPTIMUM = "The motion is that of the best iterate: it is no optimum, and may violate conditions."
INACCURATE = "The objective is less accurate than `tolerance`."
UNKNOWN = "Too few meshes have an optimum, so that the error of the objective is not known."
SMALL = "The error of the objective is more than `tolerance`: it is nearly zero, compared with its natural size."
NO_MINIMUM = "The second-order condition does not hold: motions near it may have the same or a smaller objective."
WANDERED = "Coarse meshes have other optima, and no second first guess leads to this one: try more `starts`."
#: Verdicts on motions.
ESTIMATED = "The error of the objective is estimated, a forward run confirms the motion, and it is a local minimum."


def predicted(spec: PredictSpec, *, path: str | Path | None = None, overwrite: bool = False) -> Run:
    """Compute a validated spec; see `mbdkit_predict.prediction.predict`."""
    begin, file = time.perf_counter(), None if path is None else Path(path)
    if file is not None:
        guess = spec.folder / spec.guess if isinstance(spec.guess, str) else None
        check_target(file, overwrite=overwrite, source=guess)
    stop = Stop(np.inf if spec.limits is None else begin + spec.limits.wall_time)
    with one_thread_of_linear_algebra(), interrupts_noted(stop.interrupt):
        problems = [transcribed(spec), *([transcribed(compared_spec(spec))] if spec.compare else [])]
        setup, wall, cpu = time.perf_counter() - begin, time.perf_counter(), _processor_time()
        result, *others = find_optima(problems, stop)
    timings = {"setup_s": setup, "wall_s": time.perf_counter() - wall, "cpu_s": _processor_time() - cpu}
    return _run_of(result, others[0] if others else None, file, timings, overwrite=overwrite, is_stopped=stop.now)


def _processor_time() -> float:
    """Return the processor time of this process and of those that it has ended [s]."""
    return time.process_time() + sum(os.times()[2:4])


def transcribed(spec: PredictSpec) -> Transcription:
    """Return the optimal control problem of a spec.

    Raises
    ------
    SpecError
        If an expression is wrong, or the mechanism cannot be exported.
    """
    with SpecError.place_by(spec.placed):
        system = CasadiSystem(spec.chosen, 0.0, is_joint=spec.coordinates == "joint")
        with spec.blaming("minimize"):
            objective = objective_of(spec, system)
        with SpecError.locate("guess"):
            simpler = simpler_spec(spec)
            guessed = None if simpler is None else transcribed(simpler)
        return Transcription(spec, system, objective, guessed)


def _rows(result: Optimum, *, is_beside: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return times (T,), positions and velocities (T, n), and first-order states with controls (T, Z).

    The rows are the start, the collocation points, and the end if it is no such point. Rows at jumps are just before.
    With `is_beside`, the states at the start and the end, where expressions may have no value, are those just beside.
    """
    mesh, method = result.mesh, result.transcription
    values, nodes, s = dict(mesh.values), method.nodes(mesh), len(method.c)
    times = mesh.times.copy()
    if is_beside:
        outer = np.array([0, len(mesh.grid.phase) - 1])
        inside = np.array([BESIDE, 1.0 - BESIDE])
        nodes[:, [0, -1]] = np.vstack([method.values_at(mesh, name, inside, outer) for name in "qvz"])
    if (method.sides.size or is_beside) and not method.has_nodes:
        jumping = np.array(mesh.grid.ends_of_phases())
        columns, lengths = (jumping + 1) * s - 1, values["duration"] @ mesh.grid.lengths[:, jumping]
        times[columns] -= BESIDE * lengths
        for name in "qvz":
            values[name] = values[name].copy()
            values[name][:, columns] = method.values_at(mesh, name, np.full(len(jumping), 1.0 - BESIDE), jumping)
    at_end = [nodes[:, -1]] * method.has_nodes
    own = np.column_stack([nodes[:, 0], np.vstack([values[name] for name in "qvz"]), *at_end])
    time = np.concatenate([[0.0], times, [values["duration"].sum()] * method.has_nodes])
    size = 3 * len(method.system.bodies)
    q, v, z = np.split(method.states_of_bodies(mesh, own, time), [size, 2 * size])
    low, high, _ = method.limits["u"]
    first, last = (
        np.clip(values["u"][:, points] @ weights(method.c, at), low, high)
        for points, at in ((slice(s), 0.0), (slice(-s, None), 1.0))
    )
    u = np.column_stack([first, values["u"], *[last] * method.has_nodes])
    by_name = dict(zip([*method.system.state_names, *result.spec.chosen.control_states], [*z, *u], strict=True))
    by_name |= {f"measured.{name}": curve_of(table)(time) for name, table in result.spec.tables.items()}
    states = [by_name[name] for name in method.system.compiled_states]
    return time, q.T, v.T, np.reshape(states, (len(states), len(time))).T


def _powers(equations: EquationsOfMotion, rows: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the powers (T, 2) of what does work and what loses it, in rows of times and states."""
    each = zip(*rows, strict=True)
    return np.array([equations.powers(t, q, v, equations.derivatives(t, q, v, z)[1]) for t, q, v, z in each])


def _run_of(
    result: Optimum,
    rival: Optimum | None,
    path: Path | None,
    timings: dict[str, float],
    *,
    overwrite: bool,
    is_stopped: bool,
) -> Run:
    """Return the motion as a run, and write it to an archive."""
    spec, method = result.spec, result.transcription
    spec.adopt(spec.chosen.with_parameters(result.mesh.values["p"].tolist()))
    workspace, _ = workspace_at_start(spec.mechanism())
    mechanism, equations = workspace.mechanism, EquationsOfMotion(workspace)
    time, q, v, z = rows = _rows(result)
    if not all(np.all(np.isfinite(x)) for x in rows):
        raise RunError(f"no motion was found: {result.reason}")
    is_beside = method.sides.size > 0
    try:
        powers = _powers(equations, rows)
    except StepError:
        is_beside = True
        time, q, v, z = rows = _rows(result, is_beside=True)
        try:
            powers = _powers(equations, rows)
        except StepError as error:
            raise RunError(f"no motion was found: {'; '.join(filter(None, (str(error), result.reason)))}") from None
    observer, still = StateObserver(workspace), np.zeros((len(time), 3))
    observed = observer.arrays(len(time))
    whole = np.column_stack([q, still]), np.column_stack([v, still])
    singular = observer.observe(time, *whole, observed, z=np.ascontiguousarray(z))
    if singular is not None:
        raise RunError(f"the motion passes a singular position at t = {time[singular.row]:.6g} s")
    work, lost = method.integrated(powers[1 : 1 + result.mesh.values["u"].shape[1]].T, result.mesh)
    start = float(observed.kinetic[0] + observed.potential[0])
    states = States(
        mechanism, time, *whole, lambda: observed, work=work, dissipated=lost, start_energy=start,
        elapsed=np.zeros(len(time)), z=z,
    )  # fmt: skip
    is_checked = result.is_optimum and not is_stopped
    forward = Difference()
    if is_checked:
        forward = forward_difference(equations, method, result.mesh, is_beside=is_beside)
    status = result.reason.partition(":")[0] if result.reason.startswith("interrupted") else "failed"
    ending = Ending(
        status if result.reason else "complete",
        result.reason,
        {"newton_iterations": result.mesh.iterations, **timings},
        states.misalignment.max(axis=0, initial=0.0),
        _judgement(result, rival, forward if is_checked else None),
    )
    provenance = model_provenance(spec) | _results(result, rival, forward)
    return finish_states(spec, states, ending, provenance, path=path, overwrite=overwrite, sizes=np.diff(time))


def _results(result: Optimum, rival: Optimum | None, forward: Difference) -> dict[str, str | int | float]:
    principle = result.principle
    optimized = dict(zip(result.transcription.system.parameter_names, result.mesh.values["p"].tolist(), strict=True))
    texts = {
        "mesh": [row._asdict() for row in result.rows],
        "durations": result.mesh.values["duration"].tolist(),
        "optimized": {name: optimized[name] for name in result.spec.optimized},
        "starts": [None if np.isnan(value) else value for value in result.starts],
        "sensitivities": result.sensitivities if result.is_optimum else {},
        "forward_run": vars(forward),
        "costates": {name: row.tolist() for name, row in result.costates.items()},
        "pontryagin": None
        if principle is None
        else {
            "violation": principle.gain,
            "time": principle.time,
            "starts": principle.starts,
        },
    }
    numbers = {"objective": result.objective, "objective_error": float(result.error)}
    if rival is not None:
        numbers |= {"compared_objective": rival.objective, "compared_error": float(rival.error)}
    return {"casadi": version("casadi"), **numbers, **{name: json.dumps(value) for name, value in texts.items()}}


def _judgement(result: Optimum, rival: Optimum | None, forward: Difference | None) -> Judgement:
    if not result.is_optimum:
        return Judgement("bad", (NO_OPTIMUM,))
    # the objective of a minimum changes with the square of a change of the motion
    limit = math.sqrt(result.spec.tolerance)
    doubts = list[str]()
    automatic = "" if result.spec.switching else " give `switching: auto`,"
    for jump in [jump for jump in result.jumps if jump.name][:1]:
        doubts.append(
            f"{jump.name} jumps, or almost jumps, at t = {jump.time:.4g} s, and the optimizer does not know how this "
            f"time changes with the motion: make it smooth,{automatic} or begin one of the `phases` there."
        )
    if result.doubt:
        doubts.append(result.doubt)
    if result.reason:
        doubts.append(UNKNOWN if np.isnan(result.error) else INACCURATE)
    elif result.spec.tolerance * abs(result.objective) < result.error < abs(result.objective):
        doubts.append(SMALL)
    if not result.is_minimum:
        doubts.append(NO_MINIMUM)
    principle = result.principle
    if principle is not None and principle.gain > result.limit:
        doubts.append(
            f"Pontryagin's minimum principle is violated, most at t = {principle.time:.4g} s: controls with a smaller "
            f"Hamiltonian would change the objective by {-principle.gain:.2g} to first order."
        )
    free, moves = result.undetermined
    if moves:
        doubts.append(f"{free}, and so may the motion.")
    if result.wandered and result.ending_here < 2:
        doubts.append(f"{WANDERED} {result.basin}")
    if forward is None:
        doubts.append("The optimization was stopped, so that no forward run confirms the motion.")
    elif not forward.of_intervals <= limit:
        doubts.append(
            f"A forward run with the controls differs by {forward.of_intervals:.2g} of the range of the motion in the "
            f"sum of all intervals; `tolerance` explains {limit:.2g}."
        )
    elif not forward.largest <= limit:
        doubts.append(
            f"The motion is unstable: in a forward run, differences of {forward.of_intervals:.2g} of its range in the "
            f"sum of all intervals grow to {forward.largest:.2g}; without feedback, the controls do not reproduce it."
        )
    if result.spec.compare and (rival is None or rival.reason or rival.is_doubtful):
        doubts.append("The motion that is compared has no accurate optimum, so that the gain is not known.")
    unmoved = f"{free} or the motion, so that they have no error bar." if free and not moves else ""
    known = tuple(filter(None, (ESTIMATED, result.basin, unmoved)))
    return Judgement("doubtful", tuple(doubts)) if doubts else Judgement("good", known)
