"""Checks the accuracy of a run: by companion (comparison) runs, or by the pilot runs that determined its tolerance."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.headlines import MESH_ERROR
from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.table_rows import BODIES
from mbdkit.engine.workspace import Workspace
from mbdkit.expressions.jets import EPS
from mbdkit.integrators.interface import Failure, Stepper
from mbdkit.integrators.run.impulse import ReactingMemory
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.motion_corners import jet_of
from mbdkit.mechanism.values import Motion
from mbdkit.runs.accuracy.chosen_method import Candidate, Choice
from mbdkit.runs.accuracy.coarser_estimate import estimate_from_coarser
from mbdkit.runs.accuracy.companion import Budget, Companion, CompanionRows, run_companion
from mbdkit.runs.accuracy.companion_choice import Chosen, choose_companions
from mbdkit.runs.accuracy.error_estimate import AT_REST, ErrorEstimate, Units, estimate_errors
from mbdkit.runs.accuracy.pilot_run import RecordedPilot
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.corners import stops_of
from mbdkit.runs.preparation import RunSetup
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.runs.run_seams import Progress
from mbdkit.spec import RunSpec

if TYPE_CHECKING:
    from mbdkit.events.watch import Watch

#: Rounding errors of velocities at rest, in eps times the largest acceleration by a single reaction and the duration.
#:
#: Measured: two runs of a boom of 3 t to 20 t that a locked ram holds differ by up to 14, by dop853 with large steps.
ROUNDINGS = 64.0


def check_run(
    setup: RunSetup,
    rows: ObservedRows,
    steps: int,
    budget: Budget,
    progress: Progress | None = None,
    memory: ReactingMemory | None = None,
) -> Accuracy:
    """Estimate the errors of a run by comparison runs (companions).

    With fixed steps, the companions take 6 times as many steps as the run (20 times for time-stepping methods). In
    addition there is the guard, a run with another method. If the spec limits wall time, the same limit applies to all
    companions together.

    - `setup`: the run.
    - `rows`: recorded rows of the run.
    - `steps`: number of steps of the run.
    - `budget`: determines when the comparison runs must stop; the errors are then unknown.
    - `progress`: called with (time reached, end time) [s] of each companion.
    - `memory`: memory of the reactions of elements at the end of the run, with their impacts; None if the run has none.
    """
    begin, spec, workspace = time.perf_counter(), setup.spec, setup.workspace
    if len(rows.time) < 2:
        return as_accuracy(rows, _no_errors(rows), "The run recorded only its start, which has no error.", begin)
    chosen = choose_companions(setup, rows.time, steps)
    watch = watch_of(spec)
    runs = [
        run_companion(companion, workspace, rows.time, budget.stopped, progress, watch) for companion in chosen.finer
    ]
    guard, guarded = _guard(chosen, workspace, rows.time, budget, progress, watch)
    units = units_of(workspace, rows)
    errors = estimate_errors((rows, runs[0].rows, runs[1].rows), guarded.rows, units, chosen.refinement)
    pairs = [*zip(chosen.finer, runs, strict=True), (guard, guarded)]
    description, unknown = _sentence(chosen, pairs), why_unknown(errors, rows.time, spec.mechanism(), pairs)
    if memory is not None and (treated := spec.reacting) is not None:
        others = [rows.memory for _, rows in pairs if rows.memory is not None]
        until, why = memory.agrees(others, treated.section)
        unknown = _clause(why) if not until >= errors.known_until else unknown
        errors = _cut(errors, rows.time, until)
        description += why
    return as_accuracy(rows, errors, description + _excluded(spec.mechanism()), begin, unknown)


def _excluded(mechanism: Mechanism) -> str:
    """Return sentences on what all runs of a mechanism share: mesh of beams, inputs, outputs of functions; or none."""
    in_python = any(controller.python is not None for controller in mechanism.controllers.values())
    given = ["inputs"] * bool(mechanism.inputs) + ["outputs of controllers in Python"] * in_python
    of_given = f" These are errors for given {listed(given, 'and')}, which the comparison runs repeat."
    return f" {MESH_ERROR.capitalize()} is not included." * bool(mechanism.beams) + of_given * bool(given)


def why_unknown(
    errors: ErrorEstimate, time: np.ndarray, mechanism: Mechanism, runs: Sequence[tuple[Companion, CompanionRows]] = ()
) -> str:
    """Return a clause that says why errors are unknown after `errors.known_until`; empty if all are known."""
    if not errors.unknown:
        return ""
    is_begun = errors.known_until >= time[0]
    following = time[np.searchsorted(time, errors.known_until, side="right")] if is_begun else time[0]
    for companion, rows in runs:
        if rows.failure and _reached(rows) < following:
            why = f"the comparison run with {companion.run.name} ended at {_reached(rows):.6g} s: {rows.failure}"
            break
    else:
        why = f"{listed(errors.unknown, 'and')} of the comparison runs do not converge, or differ too much from the run"
    for name, beam in mechanism.beams.items():
        if not beam.damping:  # no step size resolves its fast vibrations
            return (
                f"{why}; the fast vibrations of beam '{name}' never decay, because it has no `damping`: give it a "
                f"value of about a tenth of the step (see `mbdkit guide beams`)"
            )
    return why


def _clause(sentence: str) -> str:
    text = sentence.strip().rstrip(".")
    return text[:1].lower() + text[1:]


def units_of(workspace: Workspace, rows: ObservedRows) -> Units:
    """Return the natural units of the mechanism in a run, which must have at least two rows."""
    mechanism, duration = workspace.mechanism, float(rows.time[-1] - rows.time[0])
    length, mass = mechanism.length, float(np.sum(mechanism.topology.mass[:-1, 0]))
    rounding = np.maximum(1.0, ROUNDINGS * EPS / AT_REST * _pushes(mechanism, rows) * duration**2 / length)
    return Units(length, length / duration, mass * length / duration**2, rounding)


def _pushes(mechanism: CompiledMechanism, rows: ObservedRows) -> np.ndarray:
    """Return the largest acceleration (B,) [m/s^2] that the reaction of a joint alone would give one of its bodies, in
    the part of the mechanism that joints connect with each body.

    Where a light body holds a heavy one, reactions that balance each other have rounding errors proportional to this
    acceleration, which the joints pass on.
    """
    top, bodies = mechanism.topology, len(mechanism.bodies)
    loads = np.stack([np.linalg.norm(rows.force, axis=-1), mechanism.length * np.abs(rows.torque)])
    force, torque = np.max(np.nan_to_num(loads), axis=1)[:, top.pair_joint]
    ends = top.pairs[:, BODIES]
    ends = np.where(ends < bodies, ends, ends[:, ::-1])  # the other body in place of the ground
    links = coo_array((np.ones(len(ends)), ends.T), shape=(bodies, bodies))
    _, part = connected_components(links, directed=False)
    pushes = np.zeros(bodies)
    for own in ends.T:
        np.maximum.at(pushes, part[own], np.maximum(force / top.mass[own, 0], torque / top.mass[own, 2]))
    return np.asarray(pushes[part])


def as_accuracy(rows: ObservedRows, errors: ErrorEstimate, method: str, begin: float, unknown: str = "") -> Accuracy:
    """Return the estimates in the form in which archives store them; `unknown` says why errors are unknown."""
    return Accuracy(
        rows.time,
        errors.position,
        errors.velocity,
        errors.reaction,
        errors.torque,
        errors.known_until,
        errors.order,
        method,
        time.perf_counter() - begin,
        unknown=unknown,
    )


def watch_of(spec: RunSpec) -> Callable[[Workspace, Stepper], Watch] | None:
    """Return a function that wraps the stepper of a companion so that events set states; None if none does."""
    if not spec.settings():
        return None
    from mbdkit.runs.watched_events import watch_events

    return partial(watch_events, spec, all_events=False)


def _guard(
    chosen: Chosen,
    workspace: Workspace,
    times: np.ndarray,
    budget: Budget,
    progress: Progress | None,
    watch: Callable[[Workspace, Stepper], Watch] | None,
) -> tuple[Companion, CompanionRows]:
    best: tuple[Companion, CompanionRows] | None = None
    for companion in chosen.guards:
        states = run_companion(companion, workspace, times, budget.stopped, progress, watch)
        if best is None or _reached(states) > _reached(best[1]):
            best = companion, states
        if not states.failure or budget.stopped():
            break
    assert best is not None
    return best


def _reached(states: CompanionRows) -> float:
    rows = np.flatnonzero(np.all(np.isfinite(states.rows.position), axis=(1, 2)))
    return float(states.rows.time[rows[-1]]) if len(rows) else -math.inf


def _sentence(chosen: Chosen, runs: list[tuple[Companion, CompanionRows]]) -> str:
    first, second = (companion.run.name for companion in chosen.finer)
    text = (
        f"Richardson extrapolation from comparison runs with {first} and {second}, confirmed by a run with "
        f"{runs[-1][0].run.name}; nan where the differences do not decrease with the {chosen.what} and the runs do not "
        f"converge to the last one."
    )
    for companion, rows in runs:
        if rows.failure:
            text += f" The run with {companion.run.name} ended at {_reached(rows):.6g} s: {rows.failure}."
    return text


def _no_errors(rows: ObservedRows) -> ErrorEstimate:
    position, velocity, torque = (np.zeros_like(x) for x in (rows.position, rows.velocity, rows.torque))
    return ErrorEstimate(position, velocity, torque, torque.copy(), float(rows.time[0]), math.nan)


#: Number of times in a step at which a motion is assumed to be evaluated.
#:
#: DOP853 has this number of distinct stage times.
NODES = 8

#: Approximate number of samples over a run, and smallest number of samples in one step.
LOOKS, LOOKS_OF_STEP = 20_000, 16

UNRESOLVED = 1e-3  #: Largest deviation from the polynomial, as a share of the range of the motion over the run.

#: Runs with different tolerances are assumed to differ only after this many steps.
#:
#: Their first steps are often equal, and the next ones grow by the same factor, the largest that step-size control
#: allows.
FIRST_STEPS = 5


def check_by_pilots(
    spec: RunSpec, workspace: Workspace, rows: ObservedRows, pilots: Sequence[RecordedPilot], setting: float
) -> Accuracy:
    """Estimate the errors of a run from pilot runs with larger tolerances.

    `spec`, `workspace`: the run. `rows`: recorded rows of the run. `pilots`: one or two pilot runs with the same
    method, the coarsest first. `setting`: tolerance of the run.
    """
    begin = time.perf_counter()
    tolerances = [*(pilot.setting for pilot in pilots), setting]
    coarser = [pilot.rows(rows.time) for pilot in pilots]
    equal_until = int(np.searchsorted(rows.time[:-1], pilots[-1].time[: FIRST_STEPS + 1][-1]))
    errors = estimate_from_coarser(
        rows, coarser, tolerances, units_of(workspace, rows), spec.accuracy or 0.0, equal_until
    )
    text = listed([f"{pilot.setting:.2g}" for pilot in pilots], "and")
    runs = "a coarser run" if len(pilots) == 1 else "coarser runs"
    method = f"Difference from {runs} of the same method with tolerance{'s' * (len(pilots) > 1)} {text}, extrapolated"
    method += "." if len(pilots) > 1 else " with the expected exponent of the tolerance."
    unknown = why_unknown(errors, rows.time, spec.mechanism())
    until = resolved_until(spec, pilots[-1].time)
    if until < rows.time[-1]:
        why = f" After {until:.6g} s, a motion or load changes between the evaluations of a step."
        unknown = _clause(why) if not until >= errors.known_until else unknown
        errors = _cut(errors, rows.time, until)
        method += why
    return as_accuracy(rows, errors, method + _excluded(spec.mechanism()), begin, unknown)


def resolved_until(spec: RunSpec, time: np.ndarray) -> float:
    """Return the time until which steps resolve all motions and loads, which are given functions of time [s]; inf if
    they do so to the end.

    All runs of one method can miss the same short pulse. A pulse between the evaluations of a step can be detected
    without integration: the polynomial through the values of a motion at `NODES` times of a step must agree with the
    motion between these times.

    `time`: (N,) ends of all steps, with the start [s].
    """
    varying = [motion for _, motion in spec.mechanism().motions() if not isinstance(motion, int | float)]
    if not varying or len(time) < 2:
        return math.inf
    margin = 4.0 * max(stops_of(spec).margins, default=4.0 * EPS * float(np.max(np.abs(time))))
    begin, end = time[:-1] + margin, time[1:] - margin  # a motion may be discontinuous at the ends of a step
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    samples = (np.arange(max(LOOKS_OF_STEP, LOOKS // len(begin))) + 0.5) / max(LOOKS_OF_STEP, LOOKS // len(begin))
    through = np.linalg.solve(np.vander(2 * nodes - 1, NODES).T, np.vander(2 * samples - 1, NODES).T)  # (NODES, M)
    first = math.inf
    for motion in varying:
        seen, sampled = (_values(motion, begin, end, at) for at in (nodes, samples))
        deviation = np.max(np.abs(seen @ through - sampled), axis=1)
        unresolved = np.flatnonzero(deviation > UNRESOLVED * float(np.ptp(sampled)))
        if len(unresolved):
            first = min(first, float(time[unresolved[0]]))
    return first


def _values(motion: Motion, begin: np.ndarray, end: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return a motion at the shares `at` (M,) of every step, (N, M)."""
    times = begin[:, None] + (end - begin)[:, None] * at
    return np.asarray(jet_of(motion, times.ravel()).value).reshape(times.shape)


def _cut(errors: ErrorEstimate, times: np.ndarray, until: float) -> ErrorEstimate:
    """Return the estimates with all values after a time [s] set to unknown."""
    late = times > until
    parts = {name: getattr(errors, name).copy() for name in ("position", "velocity", "reaction", "torque")}
    for values in parts.values():
        values[late] = np.nan
    known = times[~late & (times <= errors.known_until)]
    return replace(errors, **parts, known_until=float(known[-1]) if len(known) else math.nan)


#: Reason that is stored if the spec gives method and step.
AS_GIVEN = "The spec gives method and step (`choose: nothing`)."


def with_asked(accuracy: Accuracy, spec: RunSpec, workspace: Workspace, choice: Choice | None) -> Accuracy:
    """Return the estimates with the requested accuracy, the accuracy reached, and the choice of method and step added.

    `accuracy`: estimates of the check. `spec`, `workspace`: the run, whose spec gives method and step. `choice`: how
    method and step were chosen; None if the spec gave them.
    """
    if spec.accuracy is None:
        return accuracy
    reached = PositionMeasure.of(spec, workspace).known(accuracy)
    if choice is None:
        given, why = Candidate.of(spec), AS_GIVEN
        setting = given.integrator.get("rtol") if given.adaptive else spec.time.step
        chosen = given.name(float(setting)) if setting is not None else str(given.integrator["name"])
    else:
        chosen, why = choice.chosen, choice.why
    return replace(accuracy, asked=spec.accuracy, reached=reached, chosen=chosen, why=why)


def missed_because(accuracy: Accuracy, tried: Sequence[Choice], failure: Failure | None = None) -> str:
    """Return the reason why the requested accuracy is not reached, as a clause.

    Empty if the accuracy is reached, or if nothing was chosen. `failure` says why the run ended early; None if it did
    not.
    """
    if accuracy.is_reached or not tried:
        return ""
    if failure is not None:
        return f"the run ended early: {failure.sentence.rstrip('.')}"
    methods = list(dict.fromkeys(str(choice.candidate.integrator["name"]) for choice in tried))
    limits = [choice.limited for choice in tried if choice.limited]
    attempts = "one attempt" if len(tried) == 1 else f"{len(tried)} attempts with smaller steps"
    why = limits[-1] if limits else f"{attempts} did not suffice"
    if len(methods) > 1:
        why += f"; the best of {listed(methods, 'and')} is returned"
    if not accuracy.is_complete:
        until = "at any time" if math.isnan(accuracy.known_until) else f"after t = {accuracy.known_until:.4g} s"
        return f"no estimate is confirmed {until}, as is the case in chaotic motions, which amplify errors; {why}"
    return why
