"""MuJoCo and Exudyn: models in compiled code, stepped there."""

from __future__ import annotations

import functools
import importlib.util
import time
from typing import Any

import numpy as np

from mbdkit.spec import load_spec
from tests.benchmarks.exudyn_model import by_exudyn

from .contender import TOLERANCES, Contender, Outcome, lost, steps_from, timed
from .motions import Motion
from .rods import GRAVITY

FIRST = {2: 40, 100: 25}


def compiled(motion: Motion) -> tuple[list[Contender], list[str]]:
    """Return what is installed of both, and what is not."""
    found, missing = [], []
    ladder = steps_from(FIRST[motion.rods.count])
    if importlib.util.find_spec("mujoco"):
        found.append(Contender("MuJoCo", "RK4", functools.partial(_mujoco, motion), ladder))
    else:
        missing.append("MuJoCo")
    if importlib.util.find_spec("exudyn"):
        found.append(Contender("Exudyn", "trapezoidal, joints", functools.partial(_joints, motion), ladder[8:]))
        for method in (
            ("RK44", "RK67") if motion.rods.count == 2 else ("RK44",)
        ):  # one takes 3 ms for a step of the chain
            run = functools.partial(_tree, motion, method, False)
            found.append(Contender("Exudyn", f"{method}, tree", run, ladder))
        if motion.rods.count == 2:  # finer tolerances make its steps vanish
            run = functools.partial(_tree, motion, "DOPRI5", True)
            found.append(Contender("Exudyn", "DOPRI5, tree, adaptive", run, TOLERANCES[:-2]))
    else:
        missing.append("Exudyn")
    return found, missing


def mujoco_model(motion: Motion, step: float) -> Any:
    """Return the rods in joint coordinates, without MuJoCo's constraints, contacts and sensors.

    RK4 is MuJoCo's only method of an order above one.
    """
    import mujoco

    rods = motion.rods
    inertia = rods.mass * rods.length**2 / 12
    body = (
        f'<body pos="{{place}} 0 0"><inertial pos="{rods.length / 2!r} 0 0" mass="{rods.mass!r}" '
        f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"/><joint type="hinge" axis="0 -1 0"/>'
    )
    bodies = "".join(body.format(place=repr(rods.length) if k else "0") for k in range(rods.count))
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option integrator="RK4" timestep="{step!r}" gravity="0 0 {-GRAVITY!r}">'
        '<flag constraint="disable" contact="disable" sensor="disable" actuation="disable"/></option>'
        f"<worldbody>{bodies}{'</body>' * rods.count}</worldbody></mujoco>"
    )


def _mujoco(motion: Motion, steps: float) -> Outcome:
    import mujoco

    mujoco.set_mju_user_warning(lambda text: None)  # or else it writes a log into the folder where it runs
    model = mujoco_model(motion, motion.end / steps)
    data = mujoco.MjData(model)
    data.qpos[0] = motion.angle
    _, wall, cpu = timed(lambda: mujoco.mj_step(model, data, nstep=round(steps)))
    if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or abs(data.time - motion.end) > 1e-6 * motion.end:
        return lost(motion.rods.count, wall, cpu)  # MuJoCo starts anew where numbers run away
    return Outcome(wall, cpu, motion.rods.centres(np.cumsum(data.qpos)))


def _joints(motion: Motion, steps: float) -> Outcome:
    """Run rigid bodies with joints; Exudyn's explicit solvers refuse these."""
    mechanism = load_spec(
        {
            "mbdkit": 1,
            "model": motion.model,
            "integrator": {"name": "rk4"},
            "time": {"end": motion.end, "step": motion.end},
        }
    ).mechanism()
    sparse, clock = motion.rods.count > 10, time.process_time
    try:
        (cpu, ends), wall, _ = timed(
            lambda: by_exudyn(mechanism, round(steps), motion.end, sparse=sparse, clock=clock)  # assembled before
        )
    except RuntimeError:
        return lost(motion.rods.count, 0.0, 0.0)
    return Outcome(wall, cpu, ends[:, :2])


def exudyn_tree(motion: Motion) -> Any:
    """Return the rods as a kinematic tree: joint coordinates, for which the explicit solvers are."""
    import exudyn
    from exudyn.itemInterface import NodeGenericODE2, ObjectKinematicTree

    rods = motion.rods
    count, length = rods.count, rods.length
    inertia = rods.mass * length**2 / 12
    system = exudyn.SystemContainer().AddSystem()
    node = system.AddNode(
        NodeGenericODE2(
            referenceCoordinates=[0.0] * count,
            initialCoordinates=[motion.angle] + [0.0] * (count - 1),
            initialCoordinates_t=[0.0] * count,
            numberOfODE2Coordinates=count,
        )
    )
    system.AddObject(
        ObjectKinematicTree(
            nodeNumber=node,
            gravity=[0.0, -GRAVITY, 0.0],
            jointTypes=[exudyn.JointType.RevoluteZ] * count,
            linkParents=list(range(-1, count - 1)),
            jointTransformations=exudyn.Matrix3DList([np.eye(3)] * count),
            jointOffsets=exudyn.Vector3DList([[0.0] * 3] + [[length, 0.0, 0.0]] * (count - 1)),
            linkInertiasCOM=exudyn.Matrix3DList([inertia * np.eye(3)] * count),
            linkCOMs=exudyn.Vector3DList([[length / 2, 0.0, 0.0]] * count),
            linkMasses=[rods.mass] * count,
        )
    )
    system.Assemble()
    return system


def _tree(motion: Motion, method: str, adaptive: bool, setting: float) -> Outcome:
    import exudyn

    system = exudyn_tree(motion)
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    times = settings.timeIntegration
    times.endTime, times.verboseMode, times.automaticStepSize = motion.end, 0, adaptive
    times.explicit.computeEndOfStepAccelerations = False
    if adaptive:
        times.numberOfSteps, times.minimumStepSize = 100, 1e-7 * motion.end
        times.relativeTolerance = times.absoluteTolerance = setting
    else:
        times.numberOfSteps = round(setting)
    exudyn.config.suppressWarnings = True
    solver = getattr(exudyn.DynamicSolverType, method)
    failed: list[Exception] = []

    def work() -> None:
        try:
            system.SolveDynamic(settings, solverType=solver)
        except RuntimeError as error:
            failed.append(error)

    _, wall, cpu = timed(work)
    if failed:
        return lost(motion.rods.count, wall, cpu)
    return Outcome(wall, cpu, motion.rods.centres(np.cumsum(system.systemData.GetODE2Coordinates())))
