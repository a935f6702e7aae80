"""Tests of the criteria."""

import numpy as np
import pytest

import mbdkit


@pytest.mark.parametrize(
    ("gravity", "accept", "word"), [(0.0, [], "doubtful"), (0.0, ["weightless"], "unknown"), (-9.81, [], "unknown")]
)
def test_a_run_without_gravity_is_doubtful_unless_accepted(gravity, accept, word):
    m = mbdkit.Mechanism(gravity=(0.0, gravity))
    m.body("ball", mass=1.0, velocity=(1.0, 1.0))
    run = mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.01}, accept=accept)
    assert run.verdict == word


def test_a_short_record_is_doubtful(tmp_path):
    m = mbdkit.Mechanism()
    m.body("bob", mass=1.0, inertia=0.1, position=(0.0, -1.0))
    m.revolute("pivot", "ground", "bob", at=(0.0, 0.0))
    for seconds, count in ((1.0, 1), (3.0, 0)):
        time = np.arange(0.0, seconds, 0.01)
        table = np.column_stack([time, 0.1 * np.cos(3.0 * time)])
        np.savetxt(tmp_path / "swing.csv", table, delimiter=",", header="time,pivot", comments="")
        columns = {"pivot.angle": "pivot"}
        motion = {"file": str(tmp_path / "swing.csv"), "columns": columns, "smooth": {"name": "none"}}
        with mbdkit.inverse(m, motion=motion) as run:
            assert sum(reason.startswith("short-record") for reason in run.verdict_reasons) == count
