"""The packaged examples with a leg that stands, squats and jumps; what all examples have is tested with the core."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.interpolate

import mbdkit
from mbdkit.spec import load_spec
from tests.models.example_runs import of_all_bodies


@pytest.mark.parametrize("name", ["sit-to-stand", "squat", "sway"])
def test_people_who_stand_push_below_the_foot(name):
    # expected: the moment of the ground's force about the ankle, 0.0702 m above it, is x F_y + 0.0702 F_x
    run = mbdkit.run(name)
    force, torque = run.joints["floor"].reaction_force, run.joints["floor"].reaction_torque
    pressure = (torque - 0.0702 * force[:, 0]) / force[:, 1]
    assert np.all(force[:, 1] > 0)
    assert run.markers["heel"].position[0, 0] < pressure.min() < pressure.max() < run.markers["toe"].position[0, 0]


def test_ground_of_the_squat_gives_the_impulse_of_the_weight():
    # expected: the body is at rest at the start and at the end; half of 75 kg by Winter's fractions
    run = mbdkit.run("squat")
    time, force = np.asarray(run.time), run.joints["floor"].reaction_force
    impulse = scipy.interpolate.CubicSpline(time, force).integrate(time[0], time[-1])
    assert impulse == pytest.approx([0.0, 0.5 * 75.0 * 9.81 * 3.0], abs=1e-5)


def test_jump_pushes_off_flies_and_lands():
    # expected: Newton's law for all bodies together, free flight between take-off and landing, and a centre of
    # pressure between heel and toe; the largest knee torque is that of the first squat, up to the error of the
    # interpolation between steps (3.6e-7, 2.5e-10 and 1e-13 N m for steps of 10, 5 and 2.5 ms)
    run = mbdkit.run("jump")
    foot = run.ground_reactions["foot"]
    mass = sum(body.mass for body in load_spec("jump").mechanism().bodies.values())
    needed = of_all_bodies(run, "jump", "acceleration") + mass * np.array([0.0, 9.81])
    np.testing.assert_allclose(foot.force, needed, rtol=0, atol=1e-7)
    torque = run.joints["knee_motor"].reaction_torque
    assert run.measures["knee_torque"] == pytest.approx(abs(torque[0]), abs=1e-6)
    (up, down), time = (event.time for event in run.events), np.asarray(run.time)
    flies = (time > up) & (time < down)
    np.testing.assert_array_equal(np.isnan(foot.center_of_pressure[:, 0]), flies)
    place, speed = (of_all_bodies(run, "jump", name)[flies] / mass for name in ("position", "velocity"))
    left = time[flies] - time[flies][0]
    fall = place[0] + np.outer(left, speed[0]) - np.outer(left**2, [0.0, 9.81 / 2])
    np.testing.assert_allclose(place, fall, rtol=0, atol=1e-12)
    assert down - up > 0.3
    stands = time < up
    heel, toe = (run.markers[name].position[0, 0] for name in ("heel", "toe"))
    pressure = foot.center_of_pressure[stands, 0]
    assert heel - 1e-9 < pressure.min() < 0.0 < 0.15 < pressure.max() < toe
