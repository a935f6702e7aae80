"""There and back: a run, then with its velocities reversed the same method in the same steps, and where that ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.stabilization import NONE
from mbdkit.engine.workspace import Workspace
from mbdkit.errors import MbdkitError, StepError
from mbdkit.run_preparation import build
from mbdkit.spec import RunSpec
from mbdkit.stepping.interface import Stretch, Timetable
from mbdkit.stepping.start import start_method

LOOKS = 16
"""States along the run at which the mechanism is asked whether it tells forwards from backwards."""
SAME = 1e-9
"""Relative difference of accelerations, and distance of joints as a share of the largest coordinate, that is none."""


@dataclass(frozen=True)
class Reversal:
    """What a run and its reversal came to.

    Parameters
    ----------
    defect
        Distance from the start [m]: sqrt(dq^T M dq / total mass); nan where there was nothing to compare.
    velocity_defect
        The same of the velocities [m/s], which should be the opposite of those at the start.
    note
        Why there was nothing to compare; empty otherwise.
    """

    defect: float
    velocity_defect: float
    note: str = ""


def reverse(spec: RunSpec, notify: Callable[[str], None]) -> Reversal:
    """Run a spec, reverse the velocities of its end, run it again, and compare with the start.

    The way back begins with exactly the state in which the way there ended, joints apart as they are: nothing is
    assembled again. A method starts anew there, without what it remembers from step to step. A shorter last step is
    left out, since the way back would have to begin with it.

    Parameters
    ----------
    spec
        The run, in the formulation and with the stabilization that it names.
    notify
        Told what takes long.

    Returns
    -------
    Reversal
        Without a defect, and with a note, where a run failed, or where the mechanism itself has a direction of time:
        dampers, drivers or forces that depend on time.

    Raises
    ------
    MbdkitError
        If the spec is wrong or a plugin fails.
    """
    workspace, _ = build(spec, notify)
    table = _timetable(spec)
    if table is None:
        return Reversal(math.nan, math.nan, "too-short: the run has no full step.")
    try:
        there = _states(spec, workspace, table)
        if _has_direction(workspace, there, table):
            note = "not-reversible: dampers, drivers or forces of time tell forwards from backwards."
            return Reversal(math.nan, math.nan, note)
        turned = replace(workspace, q0=there.q[-1].copy(), v0=-there.v[-1])
        back = _states(spec, turned, table)
    except _StoppedError as stop:
        return Reversal(math.nan, math.nan, str(stop))
    mass = workspace.mechanism.topology.mass[:-1]
    total = float(np.sum(mass[:, 0]))

    def distance(x: np.ndarray, y: np.ndarray) -> float:
        apart = (x - y)[: mass.size].reshape(mass.shape)
        return float(np.sqrt(np.sum(mass * apart**2) / total))

    return Reversal(distance(back.q[-1], workspace.q0), distance(-back.v[-1], workspace.v0))


class _StoppedError(Exception):
    """A run that stopped early, with its reason."""


def _timetable(spec: RunSpec) -> Timetable | None:
    """Return the timetable of a spec without a shorter last step; None where nothing is left."""
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


def _states(spec: RunSpec, workspace: Workspace, table: Timetable) -> Stretch:
    """Return some states along a run from the start of a workspace, the last of them its end; raises _StoppedError."""
    try:
        stepper = start_method(spec.integrator_plugin.create(spec.integrator), workspace, table)
        parts = []
        while not (stepper.finished or stepper.failure):
            parts.append(stepper.advance())
    except MbdkitError:
        raise
    except Exception as error:
        raise _StoppedError(f"error: {type(error).__name__}: {error}") from error
    if stepper.failure is not None:
        raise _StoppedError(f"{stepper.failure.code}: {stepper.failure.sentence}")
    rows = [part for part in parts if len(part.time)]
    time, q, v = (np.concatenate([getattr(part, name) for part in rows]) for name in ("time", "q", "v"))
    return Stretch(time, q, v, np.zeros(len(time)), np.zeros(len(time)), np.zeros((len(time), 6)))


def _has_direction(workspace: Workspace, there: Stretch, table: Timetable) -> bool:
    """Return whether accelerations or joints change when velocities are reversed or at another time.

    The states are compared with themselves, so that it does not matter how far the joints are apart there.
    """
    equations = EquationsOfMotion(
        replace(workspace, stabilization=NONE)
    )  # Baumgarte's terms tell forwards from backwards
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
