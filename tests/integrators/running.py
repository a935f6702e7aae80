"""Mechanisms and shortcuts for the tests of this room."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import mbdkit
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Stepper
from mbdkit.mechanism.mechanism import Mechanism

DOUBLE = {"name": "double-pendulum", "angles": [-1.0, -0.4]}
EXPLICIT = [{"name": "rk4"}, {"name": "rk-gill"}]
IMPLICIT = [{"name": "gauss", "stages": s} for s in range(1, 5)]
FIXED = EXPLICIT + IMPLICIT
EPS = float(np.finfo(float).eps)


def run(model: Any, integrator: dict[str, Any], **time: float) -> mbdkit.Run:
    """Run a model (mapping or mechanism) in memory, to its end."""
    result = spec_run(model, integrator, time)
    result.check()
    return result


def spec_run(model: Any, integrator: dict[str, Any], time: dict[str, Any], **sections: Any) -> mbdkit.Run:
    """Run a model whatever its end."""
    if isinstance(model, Mechanism):
        return mbdkit.run(model, integrator=integrator, time=time, **sections)
    return mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time, **sections})


def workspace_of(m: Mechanism, t0: float = 0.0) -> Workspace:
    """Return the workspace of a mechanism at its assembled start."""
    return workspace_at_start(m, t0)[0]


def end_of(stepper: Stepper) -> tuple[np.ndarray, np.ndarray]:
    """Advance a stepper to its end; return positions and velocities there, ground last."""
    q = v = np.zeros(0)
    while not stepper.finished:
        assert stepper.failure is None
        stretch = stepper.advance()
        if len(stretch.time):
            q, v = stretch.q[-1], stretch.v[-1]
    return q, v


def assert_same_end(ours: mbdkit.Run, theirs: mbdkit.Run) -> float:
    """Compare motion, reaction forces and torques at the end; return the largest coordinate [m], at least 1."""
    ours.check()
    for name, body in theirs.bodies.items():
        for part in ("position", "angle", "velocity", "angular_velocity"):
            expected = getattr(body, part)[-1]
            np.testing.assert_allclose(getattr(ours.bodies[name], part)[-1], expected, rtol=1e-9, atol=1e-9)
    force = max(float(np.max(np.abs(joint.reaction_force))) for joint in theirs.joints.values())
    for name, joint in theirs.joints.items():
        for part in ("reaction_force", "reaction_torque"):
            found, expected = (getattr(one, part)[-1] for one in (ours.joints[name], joint))
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * force, err_msg=name)
    return max(1.0, max(float(np.max(np.abs(body.position))) for body in ours.bodies.values()))


def driven_chain(stiffness: float = 50.0, damping: float = 1.0) -> Mechanism:
    """Return four rods, the first one driven, with a spring-damper between two that share no joint."""
    m = Mechanism()
    angles = (-1.0, -0.2, -1.8, 0.3)
    end, before = np.zeros(2), m.ground
    for i, angle in enumerate(angles):
        along = np.array([math.cos(angle), math.sin(angle)])
        m.body(f"r{i}", mass=1.0, inertia=1 / 12, position=end + along / 2, angle=angle)
        m.revolute(f"J{i}", before, f"r{i}", at=end)
        end, before = end + along, f"r{i}"
    m.driver("motor", m.ground, "r0", coordinate="angle", motion="-1.0 + 0.8*sin(2*t)")
    m.spring_damper(
        "s", "r0", "r3", points=((0.2, 0.1), (0.3, -0.1)), stiffness=stiffness, damping=damping, free_length=0.5
    )
    m.torque("t", "r3", value="0.5*cos(3*t)")
    return m
