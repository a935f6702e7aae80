"""A mechanism of bodies and revolute joints, at rest, in Exudyn: the same bodies, points and gravity."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import mbdkit


def exudyn_system(mechanism: mbdkit.Mechanism) -> Any:
    """Return an assembled Exudyn system of ObjectRigidBody2D and ObjectJointRevolute2D.

    Parameters
    ----------
    mechanism
        Bodies with inertia and no velocity, revolute joints, no forces but gravity.
    """
    import exudyn

    items: Any = importlib.import_module("exudyn.itemInterface")
    system = exudyn.SystemContainer().AddSystem()
    number = {mechanism.ground: system.AddObject(items.ObjectGround())}
    for name, body in mechanism.bodies.items():
        node = system.AddNode(items.NodeRigidBody2D(referenceCoordinates=[*body.position, body.angle]))
        number[name] = system.AddObject(items.ObjectRigidBody2D(nodeNumber=node, mass=body.mass, inertia=body.inertia))
        centre = system.AddMarker(items.MarkerBodyMass(bodyNumber=number[name]))
        system.AddLoad(items.LoadMassProportional(markerNumber=centre, loadVector=[*mechanism.gravity, 0.0]))
    for joint in mechanism.joints.values():
        markers = [
            system.AddMarker(items.MarkerBodyPosition(bodyNumber=number[name], localPosition=[*point, 0.0]))
            for _, name, point in joint.attachments()
        ]
        system.AddObject(items.ObjectJointRevolute2D(markerNumbers=markers))
    system.Assemble()
    return system


def by_exudyn(
    mechanism: mbdkit.Mechanism,
    steps: int,
    end: float,
    *,
    sparse: bool,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[float, np.ndarray]:
    """Run Newmark's trapezoidal rule with index-2 constraints; return the seconds and the end (B, 3).

    Exudyn's explicit solvers refuse joints between rigid bodies, so that this implicit one is what there is. It takes
    as long as generalized-alpha with index-3 constraints, or less. With sparse matrices the modified Newton
    method is the faster one, with small dense ones the full one needs fewer iterations.

    Parameters
    ----------
    mechanism
        As for `exudyn_system`.
    steps, end
        Number of steps and end time [s].
    sparse
        Whether to use sparse matrices and the modified Newton method, or dense ones and the full Newton method.
    clock
        What takes the time [s].
    """
    import exudyn

    system = exudyn_system(mechanism)
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    solver = exudyn.LinearSolverType
    settings.linearSolver.solverType = solver.EigenSparse if sparse else solver.EXUdense
    times = settings.timeIntegration
    times.numberOfSteps, times.endTime, times.verboseMode = steps, end, 0
    times.newton.useModifiedNewton = sparse
    times.generalizedAlpha.spectralRadius = 1.0
    times.generalizedAlpha.useNewmark = True
    times.generalizedAlpha.useIndex2Constraints = True
    start = clock()
    system.SolveDynamic(settings)
    taken = clock() - start
    given = np.array([[*body.position, body.angle] for body in mechanism.bodies.values()])
    return taken, given + np.asarray(system.systemData.GetODE2Coordinates()).reshape(-1, 3)
