"""Force laws in pictures."""

from __future__ import annotations

import numpy as np

import mbdkit
from mbdkit import Mechanism
from mbdkit_report import NamedPose, draw_mechanism
from mbdkit_report.figures.mechanism_drawing import mechanism_svg
from tests.laws.walker import SWEEP, walker


def test_a_cable_is_drawn_beside_its_joints() -> None:
    # expected: thigh and shank hang straight down from the hip at the origin. To raise the angle of the hip, the cable
    # passes it on the side of +x: there its pull up along the thigh turns the thigh counter-clockwise.
    m = walker()
    m.cable("tendon", {"hip": 0.05, "knee": -0.03}, stiffness=1e4, acts="tension")
    drawing = draw_mechanism(m)
    assert len(drawing.springs) == 2
    ends = drawing.world(np.array([[0, -0.2, -np.pi / 2], [0, -0.6, -np.pi / 2]]))[np.array(drawing.springs)]
    np.testing.assert_allclose(ends, [[[0.05, 0], [-0.03, -0.4]], [[-0.03, -0.4], [-0.03, -0.6]]], atol=1e-15)


def test_the_report_draws_and_names_a_cable() -> None:
    m = walker()
    m.cable("tendon", {"hip": 0.05, "knee": -0.03}, stiffness=1e4, acts="tension")
    run = mbdkit.run(m, integrator={"name": "rk4"}, time=SWEEP)
    pose = run.array("trajectory/position")[0]
    drawn = str(mechanism_svg(NamedPose.of(m, run.bodies, pose, run.time), 600.0))
    assert "tendon" in drawn
    assert drawn.count('class="spring') == 2


def test_laws_between_two_points_are_drawn_as_springs() -> None:
    m = Mechanism()
    m.body("arm", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.body("ball", mass=1.0, position=(1.0, 0.5))
    m.law("stop", m.ground, "arm", law="one-sided", from_=(0, 1), to=(0.5, 0), stiffness=9.0, acts="tension")
    m.law("bush", "arm", "ball", law="table", along="y", table=np.array([[0.0, 0.5, 1.0], [-3.0, 0.0, 2.0]]))
    m.law("mine", m.ground, "ball", law="linear", points=((0, 0), (0, 0)), stiffness=3.0)
    drawing = draw_mechanism(m)
    assert len(drawing.springs) == 2
    ends = drawing.world(np.array([[0.5, 0.0, 0.0], [1.0, 0.5, 0.0]]))[np.array(drawing.springs)]
    np.testing.assert_allclose(ends, [[[0, 1], [0.5, 0]], [[0, 0], [1, 0.5]]], atol=1e-15)
