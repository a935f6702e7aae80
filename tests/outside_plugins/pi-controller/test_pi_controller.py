"""Tests of the controller."""

import numpy as np

import mbdkit


def swung(**integrator):
    return mbdkit.run("pendulum", integrator=integrator, time={"end": 2.0}).check()


def test_it_chooses_other_steps_to_the_same_end():
    # expected: the end of a method with smaller tolerances
    keys = {"name": "dopri5", "adaptive": True, "rtol": 1e-8, "atol": 1e-8}
    end = swung(name="dop853", adaptive=True, rtol=1e-11, atol=1e-11)["rod1"].position[-1]
    usual, mine = swung(**keys), swung(**keys, step_control={"name": "pi42"})
    assert mine.stats["steps"] != usual.stats["steps"]
    np.testing.assert_allclose(mine["rod1"].position[-1], end, atol=1e-6)
