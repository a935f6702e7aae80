"""A leg in a hinge orthosis, beside Exudyn, where each cuff is built of slides, springs and a pin.

There, a nearly massless slider moves along the normal on the limb, and another along the tangential direction on the
first one, both against springs; a pin joins the second slider with the device. This has the convention of a cuff: axes
that turn with the limb, and forces at the device's point.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within

pytest.importorskip("exudyn", reason="Exudyn, the outside witness of this test, is not installed")

END, REST, SLIDER = 0.4, 0.5, 1e-7
"""Duration [s], length of the springs at rest [m], mass of the sliders [kg]."""
STIFFNESS = {"normal": 4e3, "tangential": 1.5e3, "rotation": 8.0}
DAMPING = {"normal": 20.0, "tangential": 12.0, "rotation": 0.05}
CUFFS = {"thigh": ("upper", (0.06, 0.02), (0.3, 1.0)), "shank": ("lower", (-0.07, 0.03), (-0.2, 1.0))}
"""Device, point and axis of the cuff of each limb."""


def leg() -> mbdkit.Mechanism:
    """Return a leg that swings in an orthosis whose hinge is 25 mm behind and 15 mm above the knee."""
    m = mbdkit.Mechanism(gravity=(0.0, -9.81))
    down = -np.pi / 2
    m.body("thigh", mass=7.0, inertia=0.12, position=(0.0, -0.2), angle=down, angular_velocity=1.0, velocity=(0.2, 0.0))
    m.body(
        "shank", mass=4.0, inertia=0.08, position=(0.0, -0.6), angle=down, velocity=(-0.3, 0.0), angular_velocity=-4.0
    )
    m.body("upper", mass=0.8, inertia=0.004, position=(-0.025, -0.3), angle=down, velocity=(0.21, 0.0))
    m.body("lower", mass=0.7, inertia=0.004, position=(-0.025, -0.5), angle=down)
    m.revolute("hip", m.ground, "thigh", at=(0.0, 0.0))
    m.revolute("knee", "thigh", "shank", at=(0.0, -0.42))
    m.revolute("hinge", "upper", "lower", at=(-0.025, -0.405))
    for limb, (device, at, axis) in CUFFS.items():
        m.cuff(limb, bodies=(limb, device), at=at, axis=axis, stiffness=STIFFNESS, damping=DAMPING)
    return m


class _Exudyn:
    def __init__(self, m: mbdkit.Mechanism, start: mbdkit.Run):
        self.api, self.items = importlib.import_module("exudyn"), importlib.import_module("exudyn.itemInterface")
        self.system: Any = self.api.SystemContainer().AddSystem()
        self.m, self.sensors = m, list[int]()
        self.number = {m.ground: self.system.AddObject(self.items.ObjectGround())}
        self.node: dict[str, int] = {}
        for name, body in m.bodies.items():
            pose = [*start[name].position[0], start[name].angle[0]]
            speed = [*start[name].velocity[0], start[name].angular_velocity[0]]
            self.add(name, body.mass, float(body.inertia or 0.0), pose, speed)
            self.system.AddLoad(
                self.items.LoadMassProportional(markerNumber=self.mass(name), loadVector=[*m.gravity, 0.0])
            )
        for joint in m.joints.values():
            ends = [self.point(name, point) for _, name, point in joint.attachments()]
            self.system.AddObject(self.items.ObjectJointRevolute2D(markerNumbers=ends))

    def add(self, name: str, mass: float, inertia: float, pose: list[float], speed: list[float]) -> None:
        """Add a rigid body at a pose (x, y, angle), with a velocity."""
        node = self.items.NodeRigidBody2D(referenceCoordinates=pose, initialVelocities=speed)
        self.node[name] = self.system.AddNode(node)
        body = self.items.ObjectRigidBody2D(nodeNumber=self.node[name], mass=mass, inertia=inertia)
        self.number[name] = self.system.AddObject(body)

    def mass(self, name: str) -> int:
        """Return the marker of the mass of a body."""
        return int(self.system.AddMarker(self.items.MarkerBodyMass(bodyNumber=self.number[name])))

    def point(self, name: str, at: tuple[float, ...]) -> int:
        """Return the marker of a point of a body."""
        place = self.items.MarkerBodyRigid if name != self.m.ground else self.items.MarkerBodyPosition
        return int(self.system.AddMarker(place(bodyNumber=self.number[name], localPosition=[*at, 0.0])))

    def slide(self, name: str, on: tuple[str, np.ndarray], along: np.ndarray, spring: str) -> None:
        """Add a slider without an offset at the start that moves along a direction of a body against a spring."""
        body, at = on
        across = np.array([-along[1], along[0]])
        ends = [self.point(body, tuple(at)), self.point(name, (0.0, 0.0))]
        self.system.AddObject(
            self.items.ObjectJointPrismatic2D(
                markerNumbers=ends, axisMarker0=[*along, 0.0], normalMarker1=[*across, 0.0], constrainRotation=True
            )
        )
        held = [self.point(body, tuple(at - REST * along)), self.point(name, (0.0, 0.0))]
        self.sensor(
            self.items.ObjectConnectorSpringDamper(
                markerNumbers=held, stiffness=STIFFNESS[spring], damping=DAMPING[spring], referenceLength=REST
            )
        )

    def sensor(self, connector: Any) -> None:
        """Add a connector whose force is recorded."""
        number = self.system.AddObject(connector)
        kind = self.api.OutputVariableType.ForceLocal
        if isinstance(connector, self.items.ObjectConnectorCoordinateSpringDamper):
            kind = self.api.OutputVariableType.Force
        sensor = self.items.SensorObject(objectNumber=number, storeInternal=True, outputVariableType=kind)
        self.sensors.append(self.system.AddSensor(sensor))

    def cuff(self, limb: str, start: mbdkit.Run) -> None:
        """Add the cuff of a limb."""
        device, at, axis = CUFFS[limb]
        cuff, angle = self.m.cuffs[limb], float(start[limb].angle[0])
        normal = np.array(axis) / np.linalg.norm(axis)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        speed = float(start[limb].angular_velocity[0])
        arm = turn @ np.array(at)
        place = [*(start[limb].position[0] + arm), angle]
        rate = [*(start[limb].velocity[0] + speed * np.array([-arm[1], arm[0]])), speed]
        # the second slider moves with the device's point, the first one only across
        tip = np.array(start[device].position[0]) + _turned(float(start[device].angle[0]), cuff.on)
        fast = np.array(start[device].velocity[0]) + float(start[device].angular_velocity[0]) * np.array(
            [-(tip - start[device].position[0])[1], (tip - start[device].position[0])[0]]
        )
        along = turn @ normal
        first = np.array(rate[:2]) + along * (along @ (fast - np.array(rate[:2])))
        self.add(f"{limb}.n", SLIDER, SLIDER, place, [*first, speed])
        self.add(f"{limb}.t", SLIDER, SLIDER, place, [*fast, speed])
        self.slide(f"{limb}.n", (limb, np.array(at)), normal, "normal")
        self.slide(f"{limb}.t", (f"{limb}.n", np.zeros(2)), np.array([-normal[1], normal[0]]), "tangential")
        ends = [self.point(f"{limb}.t", (0.0, 0.0)), self.point(device, cuff.on)]
        self.system.AddObject(self.items.ObjectJointRevolute2D(markerNumbers=ends))
        angles = [
            self.system.AddMarker(self.items.MarkerNodeCoordinate(nodeNumber=self.node[name], coordinate=2))
            for name in (limb, device)
        ]
        self.sensor(
            self.items.ObjectConnectorCoordinateSpringDamper(
                markerNumbers=angles, stiffness=STIFFNESS["rotation"], damping=DAMPING["rotation"]
            )
        )

    def forces(self, steps: int) -> np.ndarray:
        """Return the recorded forces (T, S) of the sensors, by Newmark's trapezoidal rule."""
        self.system.Assemble()
        settings = self.api.SimulationSettings()
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = END / 40
        times = settings.timeIntegration
        times.numberOfSteps, times.endTime, times.verboseMode = steps, END, 0
        times.newton.relativeTolerance, times.newton.absoluteTolerance = 1e-10, 1e-12
        times.generalizedAlpha.spectralRadius = 1.0
        times.generalizedAlpha.useNewmark = True
        times.generalizedAlpha.useIndex2Constraints = True
        self.system.SolveDynamic(settings)
        return np.stack([np.atleast_2d(self.system.GetSensorStoredData(one))[:, 1] for one in self.sensors], axis=1)


def _turned(angle: float, point: tuple[float, float]) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])


def test_forces_of_cuffs_are_those_of_exudyn() -> None:
    m = leg()
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": END, "step": END / 400},
                     output={"every": 10})  # fmt: skip
    other = _Exudyn(m, run)
    for limb in CUFFS:
        other.cuff(limb, run)
    theirs = other.forces(8000)
    ours = np.stack(
        [getattr(run.cuffs[limb], name) for limb in CUFFS for name in ("normal_force", "shear_force", "moment")], axis=1
    )
    peak = np.abs(ours).max(axis=0)
    error = np.abs(theirs[1 - len(ours) :] - ours[1:]).max(axis=0) / peak
    assert peak.min() > 0.2
    assert_within(error, 1e-5)
