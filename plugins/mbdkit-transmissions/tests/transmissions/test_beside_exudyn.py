"""A five-bar linkage whose cranks are geared, beside Exudyn, which couples the angles of the cranks by a constraint."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest

import mbdkit

pytest.importorskip("exudyn", reason="Exudyn, the outside witness of this test, is not installed")

RADII = (0.1, 0.2)
ANGLES = (1.2, 1.9)
"""Angles of the cranks at the start [rad]."""
END = 0.5


def five_bar() -> mbdkit.Mechanism:
    """Return the linkage: cranks on geared wheels 0.3 m apart, and two rods that meet in a pin."""
    m = mbdkit.Mechanism(gravity=(0.0, -9.81))
    pivots = np.array([[0.0, 0.0], [sum(RADII), 0.0]])
    pins = pivots + 0.15 * np.array([[np.cos(angle), np.sin(angle)] for angle in ANGLES])
    tip = np.array([0.1, 0.6])
    for crank, rod, pivot, pin in zip("ab", "cd", pivots, pins, strict=True):
        m.body(crank, mass=1.0, inertia=0.01, position=tuple((pivot + pin) / 2))
        m.body(rod, mass=0.5, inertia=0.02, position=tuple((pin + tip) / 2))
        m.revolute(crank.upper(), m.ground, crank, at=tuple(pivot))
        m.revolute(rod.upper(), crank, rod, at=tuple(pin))
    m.revolute("T", "c", "d", at=tuple(tip))
    centers = [tuple(pivot - np.array(m.bodies[name].position)) for name, pivot in zip("ab", pivots, strict=True)]
    m.gear("G", "a", "b", radii=RADII, points=centers)
    return m


def exudyn(m: mbdkit.Mechanism, steps: int) -> tuple[np.ndarray, float]:
    """Return the end (4, 3) of Newmark's trapezoidal rule, and the torque of the gear on the first crank."""
    api, items = importlib.import_module("exudyn"), importlib.import_module("exudyn.itemInterface")
    system: Any = api.SystemContainer().AddSystem()
    number, nodes = {m.ground: system.AddObject(items.ObjectGround())}, {}
    for name, body in m.bodies.items():
        nodes[name] = system.AddNode(items.NodeRigidBody2D(referenceCoordinates=[*body.position, body.angle]))
        number[name] = system.AddObject(
            items.ObjectRigidBody2D(nodeNumber=nodes[name], mass=body.mass, inertia=body.inertia)
        )
        center = system.AddMarker(items.MarkerBodyMass(bodyNumber=number[name]))
        system.AddLoad(items.LoadMassProportional(markerNumber=center, loadVector=[*m.gravity, 0.0]))
    for joint in m.joints.values():
        if joint.type == "revolute":
            ends = [(number[name], [*point, 0.0]) for _, name, point in joint.attachments()]
            markers = [system.AddMarker(items.MarkerBodyPosition(bodyNumber=b, localPosition=at)) for b, at in ends]
            system.AddObject(items.ObjectJointRevolute2D(markerNumbers=markers))
    angles = [system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[name], coordinate=2)) for name in "ab"]
    gear = system.AddObject(items.ObjectConnectorCoordinate(markerNumbers=angles, factor1=-RADII[1] / RADII[0]))
    system.Assemble()
    settings = api.SimulationSettings()
    settings.solution.file.write = False
    times = settings.timeIntegration
    times.numberOfSteps, times.endTime, times.verboseMode = steps, END, 0
    times.newton.relativeTolerance, times.newton.absoluteTolerance = 1e-11, 1e-13
    times.generalizedAlpha.spectralRadius = 1.0
    times.generalizedAlpha.useNewmark = True
    times.generalizedAlpha.useIndex2Constraints = True
    system.SolveDynamic(settings)
    start = np.array([[*body.position, body.angle] for body in m.bodies.values()])
    end = start + np.asarray(system.systemData.GetODE2Coordinates()).reshape(-1, 3)
    return end, float(np.ravel(system.GetObjectOutput(gear, api.OutputVariableType.Force))[0])


def test_a_geared_five_bar_moves_as_in_exudyn() -> None:
    # expected: Exudyn, whose errors of second and fourth order in the step are removed by extrapolation
    m = five_bar()
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": END, "step": 1e-3})
    ours = np.array([[*run.bodies[name].position[-1], run.bodies[name].angle[-1]] for name in m.bodies])
    ends, torques = zip(*(exudyn(m, steps) for steps in (2000, 4000, 8000)), strict=True)
    for values, mine, accuracy in (
        (ends, ours, 1e-10),
        (np.abs(torques), RADII[0] * np.linalg.norm(run.joints["G"].reaction_force[-1]), 1e-8),
    ):
        first, second = ((4 * values[i + 1] - values[i]) / 3 for i in range(2))
        np.testing.assert_allclose((16 * second - first) / 15, mine, rtol=0, atol=accuracy)
