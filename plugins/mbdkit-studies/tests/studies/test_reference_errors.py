"""Errors against a reference, with distances chosen by hand; interpolation between rows; the cost at a given error."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import MbdkitError
from mbdkit_studies.report.study_summary import summary
from mbdkit_studies.results.cost_at_error import cost_at_error, error_headlines
from mbdkit_studies.spec.measures import MEASURES
from mbdkit_studies.spec.reference_errors import LAST_ROW, interpolated, offsets
from tests.linkages import driven_wheel


def falling(start: float, angle: float = 0.0, end: float = 1.0, step: float = 0.1, **sections: Any) -> mbdkit.Run:
    """Return a body that falls freely from the height `start`: a method of order 4 has no error there."""
    bodies = {"stone": {"mass": 1.0, "inertia": 1.0, "position": [0.0, start], "angle": angle}}
    run = {"integrator": {"name": "rk4"}, "time": {"end": end, "step": step}}
    spec = {"mbdkit": 1, "model": {"name": "mechanism", "bodies": bodies}, **run}
    return mbdkit.run(spec | sections)


def test_bodies_at_a_constant_distance_are_at_that_distance() -> None:
    # expected: 3 m and 0.25 rad apart at all times
    found = offsets(falling(3.0, 0.25), falling(0.0))
    np.testing.assert_allclose(found, np.tile([0.0, 3.0, 0.25], (11, 1, 1)), rtol=0, atol=1e-12)
    assert np.array_equal(offsets(falling(3.0, 0.25), falling(0.0), LAST_ROW), found[-1:])


def test_a_reference_of_other_rows_is_read_between_them() -> None:
    # expected: steps of 0.1 s and of 0.15 s; a fall is a parabola, which the polynomial between two rows is exactly
    found = offsets(falling(1.0, end=0.9), falling(0.0, end=0.9, step=0.15))
    np.testing.assert_allclose(found, np.tile([0.0, 1.0, 0.0], (10, 1, 1)), rtol=0, atol=1e-12)


def test_runs_of_other_bodies_or_lengths_are_refused() -> None:
    other = mbdkit.run("pendulum", time={"end": 1.0, "step": 0.1})
    with pytest.raises(MbdkitError, match="the reference has the bodies"):
        offsets(falling(0.0), other)
    with pytest.raises(MbdkitError, match=r"the reference ends at 2 s, but the run at 1 s"):
        offsets(falling(0.0), falling(0.0, end=2.0))


def test_the_cost_at_an_error_lies_between_the_runs_that_miss_and_reach_it(tmp_path: Path) -> None:
    # expected: runs that cost less have larger errors, the others smaller ones
    study = mbdkit.study(
        {
            "mbdkit_study": 1, "base": "double-pendulum", "overrides": {"time": {"end": 1.0, "step": 0.1}},
            "axes": [
                {"integrator": [{"name": "rk4"}, {"name": "gauss", "stages": 3}]}, {"time.step": [0.2, 0.1, 0.05]},
            ],
            "reference": {"integrator": {"name": "gauss", "stages": 6}, "time.step": 0.01},
        },
        out=tmp_path / "out",
    )  # fmt: skip
    table = cost_at_error(study)
    assert table is not None
    costs = {row[0]: row[1] for row in table.rows}
    frame = study.to_frame()
    columns = ["rhs_evaluations", "jacobian_evaluations", "factorizations"]
    for name, cost in costs.items():
        own = frame[frame["integrator"] == name]
        assert isinstance(cost, int)
        pairs = zip(own[columns].sum(axis=1), own["end_error"], strict=True)
        assert all((error > 1e-6) == (work < cost) for work, error in pairs)
    assert [row[0] for row in table.rows] == sorted(costs, key=lambda name: costs[name])
    (_, errors), (question, answer) = error_headlines(study)
    assert "6 of 6 runs stay within 1% of the mechanism's size" in errors
    assert question == "fewest operations for an error of 1e-06 m"
    assert answer.startswith(f"{table.rows[0][0]} ({table.rows[0][1]})")
    assert "without the reference" in summary(study)


def recorded(function, time):
    """A run of one body whose coordinates are `function` (a NumPy polynomial) at `time`."""
    arrays = {
        f"trajectory/{name}": np.repeat(function.deriv(order)(time)[:, None, None], 3, axis=2)
        for order, name in enumerate(("position", "velocity", "acceleration"))
    }
    return SimpleNamespace(time=time, array=arrays.__getitem__)


def test_a_motion_of_degree_five_is_met_exactly_on_uneven_rows():
    motion = np.polynomial.Polynomial([1.0, -2.0, 3.0, 0.5, -1.0, 2.0])
    run = recorded(motion, np.array([0.0, 0.3, 0.4, 1.0, 1.7]))
    time = np.linspace(0.0, 1.7, 52)
    assert interpolated(run, time)[:, 0, 2] == pytest.approx(motion(time), abs=1e-13)


def test_recorded_rows_are_met_to_the_bit():
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.01, 0.1, 30))
    values = {name: rng.standard_normal((30, 2, 3)) for name in ("position", "velocity", "acceleration")}
    run = SimpleNamespace(time=time, array=lambda path: values[path.rpartition("/")[2]])
    assert np.array_equal(interpolated(run, time), values["position"])
    late = time * (1 + 1e-14)  # the same instants, rounded otherwise
    assert np.allclose(interpolated(run, late[:-1]), values["position"][:-1], rtol=0, atol=1e-10)


def test_a_run_that_an_event_ended_has_no_error_against_a_reference_that_ended_elsewhere():
    stop = {"low": {"when": "rod1.angle + pi/2", "action": "stop"}}
    time = {"end": 1.0, "step": 0.01}
    with mbdkit.run("pendulum", time=time) as whole, mbdkit.run("pendulum", time=time, events=stop) as stopped:
        assert math.isnan(MEASURES["end_error"].of(stopped, whole))
        assert MEASURES["end_error"].of(whole, whole) == 0.0
        assert MEASURES["misalignment_max"].of(stopped, whole) > 0.0


def test_forces_and_powers_are_measured_where_they_are_recorded() -> None:
    m = driven_wheel()
    taken = ("reaction_force_max", "element_force_max", "element_torque_max", "driver_power_max")
    time = {"end": 1.0, "step": 0.01}
    with mbdkit.run(m, integrator={"name": "rk4"}, time=time) as run:
        found = [MEASURES[name].of(run, None) for name in taken]
        assert found == [
            pytest.approx(np.max(np.linalg.norm(run.array("joints/reaction_force"), axis=-1)), rel=1e-14),
            np.max(np.abs(run.forces["spring"].value)),
            np.max(np.abs(run.forces["twist"].value)),
            np.max(np.abs(run.joints["motor"].driver_power)),
        ]
    with mbdkit.run(m, integrator={"name": "rk4"}, time=time, output={"quantities": []}) as run:
        assert all(math.isnan(MEASURES[name].of(run, None)) for name in taken)
