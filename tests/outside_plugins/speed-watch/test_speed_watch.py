"""Tests of the items."""

import pytest
from speed_watch import fastest

import mbdkit


def test_attribute_summary_and_command_know_the_speed(tmp_path, capsys):
    # expected: v = v0 - g t, from 5 m/s to -6 m/s
    m = mbdkit.Mechanism(gravity=(0.0, -10.0))
    m.body("ball", mass=1.0, velocity=(0.0, 5.0))
    run = mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 1.1, "step": 0.01}, archive=tmp_path / "a.h5").check()
    assert run.peak_speeds == {"ball": pytest.approx(6.0)}
    assert "ball reaches 6 m/s" in str(run.summary())
    run.close()
    fastest(str(tmp_path / "a.h5"))
    assert capsys.readouterr().out == "ball\n"
