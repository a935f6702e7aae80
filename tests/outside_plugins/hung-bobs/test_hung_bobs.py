"""Tests of the key."""

import pytest

import mbdkit


def test_a_bob_hangs_from_a_pendulum_and_is_refused_without_mass():
    spec = {"mbdkit": 1, "integrator": {"name": "gauss"}, "time": {"end": 0.2, "step": 0.01}}
    model = {"name": "double-pendulum"}
    run = mbdkit.run(spec | {"model": model | {"hung_bobs": {"bob": {"body": "rod2", "mass": 0.1}}}}).check()
    assert "bob" in run.bodies
    assert run.joints["bob-rod"].misalignment_max < 1e-3
    with pytest.raises(mbdkit.SpecError, match="mass"):
        mbdkit.run(spec | {"model": model | {"hung_bobs": {"bob": {"body": "rod2", "mass": 0.0}}}})
