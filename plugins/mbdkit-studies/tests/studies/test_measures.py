"""Interpolation between recorded rows."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

import mbdkit
from mbdkit_studies.spec.measures import MEASURES
from mbdkit_studies.spec.reference_errors import interpolated
from tests.linkages import driven_wheel


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
