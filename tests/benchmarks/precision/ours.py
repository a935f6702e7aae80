"""mbdkit's methods; one that this version does not have is left out by name."""

from __future__ import annotations

import functools
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.engine.observed_states import StateObserver
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.start import start_method
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec

from .contender import OURS, TOLERANCES, Contender, Outcome, centres_of, lost, steps_from, timed
from .motions import Motion
from .rods import Array

METHODS: dict[str, dict[str, Any]] = {
    "rk4": {"name": "rk4"},
    "dopri5": {"name": "dopri5"},
    "dop853": {"name": "dop853"},
    **{f"gauss-{stages}": {"name": "gauss", "stages": stages} for stages in (2, 3, 4, 5, 6)},
    **{f"radau-iia-{stages}": {"name": "radau-iia", "stages": stages} for stages in (2, 3, 5)},
}
"""In fixed steps, by the name in the tables; implicit ones iterate to round-off."""

METHODS |= {
    f"gauss-{stages}, {solver}{f' to {tolerance:.0e}' if tolerance else ''}": {
        "name": "gauss",
        "stages": stages,
        "stage_solver": solver,
        **({"tolerance": tolerance} if tolerance else {}),
    }
    for stages in (4, 6)
    for solver in ("newton", "fixed-point")
    for tolerance in (None, 1e-7, 1e-10)
    if tolerance or solver == "fixed-point"
}
"""How far to iterate is a matter of the error that is asked for, and without stiffness tangents do not pay."""

ADAPTIVE: dict[str, dict[str, Any]] = {
    "dopri5, adaptive": {"name": "dopri5", "adaptive": True},
    "dop853, adaptive": {"name": "dop853", "adaptive": True},
    "gauss-3, adaptive": {"name": "gauss", "stages": 3, "adaptive": True},
    "radau-iia-3, adaptive": {"name": "radau-iia", "stages": 3, "adaptive": True},
    "radau-iia-5, adaptive": {"name": "radau-iia", "stages": 5, "adaptive": True},
}
"""In steps that follow a tolerance."""

IN_JOINTS: dict[str, dict[str, Any]] = {
    "dop853, joints, adaptive": {"name": "dop853", "adaptive": True},
    "taylor, joints, adaptive": {"name": "taylor", "adaptive": True},
}
"""The same in joint coordinates."""
WITH_FORCES = "taylor, joints, adaptive, with joint forces"
"""The last one, with all joint forces after every step among what is timed."""
AT_END = f"{WITH_FORCES} at the end"
"""The same, with the joint forces of the last state only."""
ADAPTIVE |= IN_JOINTS | dict.fromkeys((WITH_FORCES, AT_END), IN_JOINTS["taylor, joints, adaptive"])

FIRST = {2: 40, 100: 25}
MOST_STEPS = 10_000_000


def ours(motion: Motion) -> tuple[list[Contender], list[str]]:
    """Return mbdkit's contenders, and the names of those that this version does not have."""
    found, missing = [], []
    for method, integrator in (METHODS | ADAPTIVE).items():
        adaptive = method in ADAPTIVE
        ladder = TOLERANCES if adaptive else steps_from(FIRST[motion.rods.count])
        forces = {WITH_FORCES: 1, AT_END: MOST_STEPS}.get(method, 0)
        in_joints = method in IN_JOINTS or forces > 0
        run = functools.partial(_run, motion, integrator, adaptive, in_joints, forces)
        try:
            load_spec(_spec(motion, integrator, adaptive, in_joints, ladder[0]))
        except SpecError:
            missing.append(f"{OURS} {method}")
        else:
            found.append(Contender(OURS, method, run, ladder, has_forces=forces == 1))
    return found, missing


def _spec(
    motion: Motion, integrator: dict[str, Any], adaptive: bool, in_joints: bool, setting: float
) -> dict[str, Any]:
    if adaptive:
        integrator = {**integrator, "rtol": setting, "atol": setting}
        times, every = {"end": motion.end}, MOST_STEPS
    else:
        times, every = {"end": motion.end, "step": motion.end / setting}, round(setting)
    return {
        "mbdkit": 1,
        "model": motion.model,
        "integrator": integrator,
        "formulation": "joint-coordinates" if in_joints else "index-1",
        "time": times,
        "output": {"every": every, "quantities": []},
    }


def _run(
    motion: Motion, integrator: dict[str, Any], adaptive: bool, in_joints: bool, forces: int, setting: float
) -> Outcome:
    """Drive the stepper by hand: as for the others only steps are timed, not the recorder.

    `forces`: number of steps between states with joint forces, which are timed, too; 0 for none.
    """
    spec = load_spec(_spec(motion, integrator, adaptive, in_joints, setting))
    problem, _ = build(spec)
    timetable = Timetable(
        start=0.0,
        end=motion.end,
        step=spec.time.step,
        steps=spec.time.count or 0,
        every=forces or spec.output.every or MOST_STEPS,
        max_steps=MOST_STEPS,
    )
    stepper = start_method(spec.integrator_plugin.create(spec.integrator), problem, timetable)
    states: list[Array] = []
    observer = StateObserver(problem)
    row = observer.arrays(1)

    def work() -> None:
        while not (stepper.finished or stepper.failure):
            stretch = stepper.advance()
            states.extend(stretch.q)
            if forces == 1:
                observer.observe(stretch.time, stretch.q, stretch.v, observer.arrays(len(stretch.time)))
        if forces > 1:
            observer.observe(stretch.time[-1:], stretch.q[-1:], stretch.v[-1:], row)

    _, wall, cpu = timed(work)
    count = motion.rods.count
    if stepper.failure is not None or not states:
        return lost(count, wall, cpu)
    ends = centres_of(states[-1][: 3 * count], count)
    return Outcome(wall, cpu, ends, stepper.counters.rhs_evaluations)
