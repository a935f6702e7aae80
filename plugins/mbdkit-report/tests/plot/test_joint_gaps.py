from __future__ import annotations

import numpy as np
import pytest

import mbdkit
from mbdkit_report.figures.drawing_geometry import draw_run
from mbdkit_report.figures.player_data import film_data, gaps

ROUND_OFF = 1e-14  # m, of lengths of some metres


@pytest.mark.parametrize("example", ["knee", "double-pendulum", "slider-crank", "watt-six-bar", "car-axis"])
def test_the_length_of_a_gap_is_the_recorded_misalignment(example):
    with mbdkit.run(example, integrator={"name": "rk4"}) as run:
        drawing, poses = draw_run(run), run.array("trajectory/position")
        found = gaps(run, drawing, poses)
        assert found.joints
        for column, name in enumerate(found.joints):
            length = np.hypot(*found.vectors[:, column].T)
            np.testing.assert_allclose(length, run.joints[name].misalignment, rtol=1e-9, atol=ROUND_OFF)


def test_the_gap_of_a_moving_center_is_the_recorded_misalignment():
    m = mbdkit.Mechanism()
    base = m.body("base", mass=1.0, inertia=0.3, position=(0.4, 0.0))
    disc = m.body("disc", mass=1.0, inertia=0.1, position=(0.9, 0.1), angle=0.3, angular_velocity=4.0)
    m.revolute("pivot", m.ground, base, at=(0.0, 0.0))
    m.revolute("rolls", base, disc, at=(0.9, 0.0), center={"x": "-0.2*angle", "y": "0.1*cos(angle)"})
    with mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 2, "step": 0.02}) as run:
        drawing, poses = draw_run(run), run.array("trajectory/position")
        length = np.hypot(*gaps(run, drawing, poses).vectors[:, 1].T)
        assert length.max() > 1e-6
        np.testing.assert_allclose(length, run.joints["rolls"].misalignment, rtol=1e-8, atol=ROUND_OFF)


def test_the_ends_of_a_gap_are_the_joints_points(make_run):
    run = make_run(rods=3)
    drawing, poses = draw_run(run), run.array("trajectory/position")
    found = gaps(run, drawing, poses)
    world = drawing.world(poses)
    for (a, b), vector in zip(found.ends, np.moveaxis(found.vectors, 1, 0), strict=True):
        np.testing.assert_allclose(world[:, b] - world[:, a], vector, rtol=0, atol=ROUND_OFF)


def test_of_many_joints_those_that_come_apart_the_most_are_magnified(make_run):
    def pull(data):
        data["trajectory/position"][:, 50:, 0] += 1e-3

    data = film_data(make_run(rods=80, rows=40, change=pull), numbers=10_000)
    assert len(data["gaps"]["joints"]) == 40
    assert "J51" in data["gaps"]["joints"]
    assert data["gaps"]["largest"] == pytest.approx(1e-3, rel=1e-9)


def test_a_model_that_is_not_installed_has_no_gaps(make_run):
    data = film_data(make_run(model={"name": "acme:crane"}), numbers=10_000)
    assert data["gaps"] == {"joints": [], "ends": [], "largest": 0.0, "vectors": []}
