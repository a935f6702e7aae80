"""Prepared runs: equal to single runs to the bit, whatever was run before, and starts in which quantities are given."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.spec import RunSpec, load_spec
from mbdkit.spec.reading import parse_key, put

DOUBLE = {
    "mbdkit": 1, "model": {"name": "double-pendulum", "angles": [0.3, -0.2]}, "integrator": {"name": "rk4"},
    "time": {"end": 0.2, "step": 0.01},
}  # fmt: skip
CASES: list[tuple[Any, dict[str, Any], str, float]] = [
    (DOUBLE, {}, "model.angles.0", 1.2),
    (
        DOUBLE, {"measures": {"peak": "max(abs(joints.J1.force))", "mean": "mean(energy.kinetic)"}}, "model.masses.1",
        3.0,
    ),
    (DOUBLE, {"formulation": "index-3", "integrator": {"name": "radau-iia"}}, "model.lengths.0", 2.0),
    (DOUBLE, {"stabilization": "projection", "integrator": {"name": "dop853"}}, "model.lengths.0", 2.0),
    (DOUBLE, {"integrator": {"name": "dop853"}, "check": True}, "model.rates.1", -1.0),
    (DOUBLE, {"integrator": {"name": "gauss"}, "time": {"end": 0.2, "step": 0.02}}, "time.step", 0.01),
    (DOUBLE, {"integrator": {"name": "radau-iia", "adaptive": True}}, "model.lengths.0", 2.0),
    ("knee", {"time": {"end": 0.02, "step": 0.0025}}, "model.springs.support.stiffness", 900.0),
    ("jump", {"time": {"end": 0.02, "step": 0.005}}, "duration", 0.2),  # rigid contacts, events, named parameters
    ("delayed-balance", {"time": {"end": 0.1, "step": 0.002}}, "lean", 0.02),  # a sampled controller
    ("limit-stop", {"time": {"end": 0.5}}, "model.bodies.thigh.angle", 0.2),  # a method of SciPy
]  # fmt: skip


def alone(spec: RunSpec, key: str, value: float) -> mbdkit.Run:
    """Run a spec with a value, without preparation."""
    data = json.loads(spec.canonical_json())
    put(data, parse_key(key) if "." in key else ("parameters", key), value)
    return mbdkit.run(data)


@pytest.mark.parametrize(("source", "sections", "key", "value"), CASES)
def test_prepared_runs_equal_single_ones_to_the_bit(source: Any, sections: Any, key: str, value: float) -> None:
    spec = load_spec(source, **sections)
    prepared = mbdkit.prepare(spec)
    for number in (value, 0.9 * value, value):  # the second run leaves nothing behind
        made, single = prepared.run({key: number}), alone(spec, key, number)
        assert made.data_sha256 == single.data_sha256
        for one in ("run_id", "spec_json", "status_reason", "verdict", "verdict_reasons", "warnings"):
            assert getattr(made, one) == getattr(single, one), one
        np.testing.assert_equal(dict(made.measures), dict(single.measures))
        assert (made.accuracy is None) == (single.accuracy is None)


def test_a_start_with_given_values_closes_all_joints_and_is_that_of_the_spec_of_the_run() -> None:
    prepared = mbdkit.prepare("knee", time={"end": 0.02, "step": 0.0025})
    given = {"acl.angle": 0.5, "shank.angular_velocity": 2.0}
    with prepared.run(initial=given) as run:
        assert (run.bodies["acl"].angle[0], run.bodies["shank"].angular_velocity[0]) == (0.5, pytest.approx(2.0))
        assert run.array("joints/misalignment")[0].max() < 1e-14
        assert run.array("joints/velocity_misalignment")[0].max() < 1e-13
        assert mbdkit.run(run.run_spec).data_sha256 == run.data_sha256
    # closed form: rods of 1 m from the ground outwards; the second one keeps its angle only if nothing else is nearer
    with mbdkit.prepare(DOUBLE).run(initial={"rod1.angle": -2.0, "rod2.angle": 0.5, "rod1.angular_velocity": 3}) as run:
        tip = np.array([math.cos(-2.0) + 0.5 * math.cos(0.5), math.sin(-2.0) + 0.5 * math.sin(0.5)])
        assert run.bodies["rod2"].position[0] == pytest.approx(tip, abs=1e-12)
        assert run.bodies["rod1"].velocity[0] == pytest.approx([-1.5 * math.sin(-2.0), 1.5 * math.cos(-2.0)], abs=1e-12)


@pytest.mark.parametrize(
    ("parameters", "initial", "message"),
    [
        ({"mass": 2.0}, {}, "the spec has no parameter 'mass'; numbers of the model have dotted keys"),
        ({"model.mases.0": 2.0}, {}, "did you mean 'masses'"),
        ({"model.masses.0": -1.0}, {}, "should be greater than 0"),
        ({}, {"rod9.angle": 1.0}, "no quantity 'rod9.angle'"),
        ({}, {"rod1.angle": math.nan}, "finite number"),
        ({}, {"rod1.x": 3.0}, "cannot be assembled with these initial values: rod1.x = 3"),
        ({}, {"rod1.vx": 1.0, "rod1.angular_velocity": 0.0}, "no velocities satisfy the joints"),
    ],
)
def test_wrong_numbers_are_refused(parameters: Any, initial: Any, message: str) -> None:
    with pytest.raises(SpecError, match=message):
        mbdkit.prepare(DOUBLE).run(parameters, initial)
