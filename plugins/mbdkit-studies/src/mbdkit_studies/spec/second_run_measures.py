"""Measures that cannot be computed from the archive of a run: they need a second run, or a reversed run."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.base.errors import MbdkitError, StepError
from mbdkit.base.text import one_line
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.stabilization import NONE
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Stretch, Timetable
from mbdkit.runs.preparation import RunSetup
from mbdkit.runs.simulation import simulate
from mbdkit.spec.run_spec import RunSpec

REVERSALS = ("reversibility_defect", "reversibility_velocity_defect")


def second_run(spec: RunSpec, names: Sequence[str]) -> tuple[dict[str, float], str]:
    """Compute measures by a second run.

    Parameters
    ----------
    spec
        Spec of a run that is complete.

    Returns
    -------
    dict, str
        The measures by name, which are nan if they could not be computed; and the reason for this, or an empty string.
    """
    values: dict[str, float] = {}
    notes = []
    if set(names) & set(REVERSALS):
        reversal = reverse(spec)
        values |= dict(zip(REVERSALS, (reversal.defect, reversal.velocity_defect), strict=True))
        notes.append(reversal.note)
    if "velocity_misalignment_every_step" in names:
        values["velocity_misalignment_every_step"], note = velocity_misalignment(spec)
        notes.append(note)
    return {name: values[name] for name in names}, " ".join(filter(None, notes))


def velocity_misalignment(spec: RunSpec) -> tuple[float, str]:
    """Return the largest velocity misalignment of any joint over every step [m/s].

    The run is repeated in memory with every step recorded.

    Returns
    -------
    float, str
        The measure, which is nan if the run fails; and the reason of the failure, or an empty string.
    """
    every_step = json.loads(spec.canonical_json()) | {"output": {"every": 1, "quantities": ["joints"]}}
    try:
        with simulate(RunSpec(**every_step)) as run:
            if run.status != "complete":
                return math.nan, run.status_reason
            return float(np.max(run.array("joints/velocity_misalignment"), initial=0.0)), ""
    except MbdkitError as error:  # for example, there are too many rows for the memory
        return math.nan, f"error: {error}"


LOOKS = 16  #: Number of states along the run at which the mechanism is tested for reversibility.
#: Tolerance for equal accelerations, relative to the largest one, and for equal values of the constraints, relative to
#: the largest coordinate.
SAME = 1e-9


@dataclass(frozen=True)
class Reversal:
    """Result of a reversibility test.

    Parameters
    ----------
    defect
        Distance from the start position [m]: sqrt(dq^T M dq / total mass), with the difference dq of the coordinates
        and the mass matrix M; nan if the test was not possible.
    velocity_defect
        The same measure for the velocities [m/s]; the exact final velocities are the negated velocities of the start.
    note
        Reason why the test was not possible; empty otherwise.
    """

    defect: float
    velocity_defect: float
    note: str = ""


def reverse(spec: RunSpec) -> Reversal:
    """Integrate a run, reverse its final velocities, integrate back with the same steps, and compare with the start.

    The backward run starts from exactly the final state of the forward run, including its joint misalignment; the
    mechanism is not assembled again. The method is restarted there, without its history of earlier steps. If the last
    step is shorter than the others, it is omitted, since the backward run would have to begin with it.

    Parameters
    ----------
    spec
        The run, with its formulation and stabilization.

    Returns
    -------
    Reversal
        The defects. They are nan, and the note gives the reason, if a run failed or if the mechanism itself is not
        reversible because of dampers, drivers or time-dependent forces.

    Raises
    ------
    MbdkitError
        If the spec is invalid or a plugin fails.
    """
    setup = RunSetup.of(spec)
    workspace = setup.workspace
    if (table := _timetable(spec)) is None:
        return Reversal(math.nan, math.nan, "too-short: the run has no full step.")
    try:
        there = _states(setup, table)
        if _has_direction(workspace, there, table):
            note = "not-reversible: the mechanism has dampers, drivers or time-dependent forces."
            return Reversal(math.nan, math.nan, note)
        turned = replace(workspace, q0=there.q[-1].copy(), v0=-there.v[-1])
        back = _states(replace(setup, workspace=turned), table)
    except _StoppedError as stop:
        return Reversal(math.nan, math.nan, str(stop))
    mass = workspace.mechanism.topology.mass[:-1]
    total = float(np.sum(mass[:, 0]))

    def distance(x: np.ndarray, y: np.ndarray) -> float:
        return float(np.sqrt(np.sum(mass * (x - y)[: mass.size].reshape(mass.shape) ** 2) / total))

    return Reversal(distance(back.q[-1], workspace.q0), distance(-back.v[-1], workspace.v0))


class _StoppedError(Exception):
    """A run stopped early; the message is the reason."""


def _timetable(spec: RunSpec) -> Timetable | None:
    """Return the timetable of a spec without a shorter last step; None if no step is left."""
    time, limits = spec.time, spec.limits
    if spec.claims.adaptive:
        return Timetable(time.start, time.final, time.step, max_steps=limits.max_steps)
    assert time.step is not None
    assert time.count is not None
    steps, end = time.count, time.final
    if abs(time.start + steps * time.step - end) > 1e-9 * time.step:
        steps -= 1
        end = time.start + steps * time.step
    every = max(1, steps // LOOKS)
    return Timetable(time.start, end, time.step, steps, every, max_steps=limits.max_steps) if steps else None


def _states(setup: RunSetup, table: Timetable) -> Stretch:
    """Integrate from the start of a workspace, and return the recorded states with the last one; raise _StoppedError on
    failure.
    """
    try:
        stepper = setup.stepper(table)
        parts = []
        while not (stepper.finished or stepper.failure):
            parts.append(stepper.advance())
    except MbdkitError:
        raise
    except (Exception, SystemExit) as error:
        raise _StoppedError(f"error: {one_line(error)}") from error
    if stepper.failure is not None:
        raise _StoppedError(f"{stepper.failure.code}: {stepper.failure.sentence}")
    rows = [part for part in parts if len(part.time)]
    time, q, v = (np.concatenate([getattr(part, name) for part in rows]) for name in ("time", "q", "v"))
    return Stretch(time, q, v, np.zeros(len(time)), np.zeros(len(time)), np.zeros((len(time), 6)))


def _has_direction(workspace: Workspace, there: Stretch, table: Timetable) -> bool:
    """Return whether accelerations or constraints depend on the sign of the velocities or on time.

    Only values at the same positions are compared, so that joint misalignment has no influence.
    """
    equations = EquationsOfMotion(replace(workspace, stabilization=NONE))  # Baumgarte stabilization is not reversible
    middle = table.start + 0.381966 * (table.end - table.start)
    size = float(np.max(np.abs(there.q), initial=1e-300))
    for row in np.unique(np.linspace(0, len(there.time) - 1, LOOKS).astype(int)):
        t, q, v = float(there.time[row]), there.q[row][: equations.n].copy(), there.v[row][: equations.n].copy()
        try:
            forth, _ = equations.accelerations(t, q, v)
            for other in (table.start, middle, table.end):
                back, _ = equations.accelerations(other, q, -v)
                moved = equations.constraints(other, q) - equations.constraints(t, q)
                if np.max(np.abs(moved), initial=0.0) > SAME * size:
                    return True
                if np.max(np.abs(forth - back), initial=0.0) > SAME * np.max(np.abs(forth), initial=1e-300):
                    return True
        except StepError as error:
            raise _StoppedError(f"{error.code}: {error}") from error
    return False
