"""Tests of the number."""

import json

import h5py
import pytest

import mbdkit


def test_it_comes_first_in_the_summary_and_has_an_id_in_the_archive(tmp_path):
    # expected: a ball of 2 kg that falls 1.1 s from rest has m (g t)^2 / 2
    m = mbdkit.Mechanism(gravity=(0.0, -10.0))
    m.body("ball", mass=2.0)
    run = mbdkit.run(
        m, integrator={"name": "rk4"}, time={"end": 1.1, "step": 0.01}, archive=tmp_path / "a.h5", check=True
    ).check()
    assert "largest kinetic energy" in str(run.summary())
    run.close()
    with h5py.File(tmp_path / "a.h5") as file:
        (answer,) = (one for one in json.loads(file.attrs["answers"]) if one["id"] == "energy-front")
    assert answer["value"] == pytest.approx(121.0)
