"""Workload of joints and actuators against analytic values, and cycles of a motion."""

from __future__ import annotations

import numpy as np
import pytest

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.signals.cycles import crossings, normalized

T = np.linspace(0.0, 2.0, 2001)


def rotor() -> mbdkit.Run:
    """Return a wheel of 0.5 kg m^2 that swings as sin(2 pi t) about its centre, under a ground force of three steps."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("wheel", mass=1.0, inertia=0.5)
    m.revolute("hub", m.ground, "wheel", at=(0, 0))
    data = {"time": T, "angle": np.sin(2 * np.pi * T), "fx": 100.0 * np.maximum(np.sin(3 * np.pi * T), 0.0)}
    motion = {"data": data, "columns": {"hub.angle": "angle"}, "smooth": "quintic"}
    loads = {"push": {"body": "wheel", "force": ["fx", 0.0]}}
    return mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion, "loads": loads})


def test_numbers_of_a_swinging_wheel_are_the_analytic_ones() -> None:
    one = mbdkit.workload(rotor())["hub"]
    peak = 0.5 * (2 * np.pi) ** 2  # torque = -peak sin(2 pi t)
    assert one.kind == "actuator"
    assert one.load.peak == pytest.approx(peak, rel=1e-3)
    assert one.load.rms == pytest.approx(peak / np.sqrt(2), rel=1e-3)
    assert one.load.impulse == pytest.approx(peak * 2 * 2 / np.pi, rel=1e-3)
    inner = mbdkit.workload(rotor(), cycles=[0.5, 1.5]).phases[0].elements[1]  # away from the ends of the spline
    assert inner.load.loading_rate == pytest.approx(peak * 2 * np.pi, rel=1e-3)
    # the kinetic energy falls and rises four times between 0.25 (2 pi)^2 J and zero
    assert one.work is not None
    assert one.work.positive == pytest.approx(4 * 0.25 * (2 * np.pi) ** 2, rel=1e-3)
    assert one.work.negative == pytest.approx(-4 * 0.25 * (2 * np.pi) ** 2, rel=1e-3)


def test_contacts_begin_cycles_and_end_at_the_threshold() -> None:
    found = mbdkit.workload(rotor(), load="push", threshold=50.0)
    phases = {phase.name: (phase.start, phase.end) for phase in found.phases}
    first, period = 1 / 18, 2 / 3  # sin(3 pi t) is a half at 1/18 s and 5/18 s
    assert phases["contact 1"] == pytest.approx((first, 5 / 18), abs=1e-5)
    assert phases["swing 1"] == pytest.approx((5 / 18, first + period), abs=1e-5)
    assert phases["cycle 1"] == pytest.approx((first, first + period), abs=1e-5)
    assert list(phases) == ["contact 1", "swing 1", "cycle 1", "contact 2", "swing 2", "cycle 2", "contact 3"]
    curve = found.cycles["hub"]
    assert curve.cycles.shape == (2, 101)
    begin = -0.5 * (2 * np.pi) ** 2 * np.sin(2 * np.pi * (first + period * np.arange(2)))
    assert curve.cycles[:, 0] == pytest.approx(begin, rel=1e-4)
    assert curve.deviation[0] == pytest.approx(abs(begin[1] - begin[0]) / np.sqrt(2), rel=1e-3)


def test_cycles_outside_the_run_and_loads_that_never_act_are_refused() -> None:
    run = rotor()
    with pytest.raises(SpecError, match="cycles should begin at increasing times within the run"):
        mbdkit.workload(run, cycles=[0.0, 3.0])
    with pytest.raises(SpecError, match="the load 'push' never rises above 500 N; its maximum is 100 N"):
        mbdkit.workload(run, load="push", threshold=500.0)


def test_crossings_and_normalized_cycles_are_interpolated() -> None:
    values = np.array([0.0, 2.0, 0.0, 2.0, 0.0])
    time = np.arange(5.0)
    assert crossings(time, values, 1.0).tolist() == [0.5, 2.5]
    assert crossings(time, values, 1.0, rising=False).tolist() == [1.5, 3.5]
    assert normalized(time, time, np.array([0.5, 2.5])).cycles[0] == pytest.approx(np.linspace(0.5, 2.5, 101))


@pytest.mark.slow
def test_residual_loads_come_last_and_a_number_has_one_error_everywhere() -> None:
    run = mbdkit.inverse("walking")
    found = mbdkit.workload(run)
    kinds = {one.name: one.kind for one in found.elements}
    assert list(kinds)[-3:] == [name for name, kind in kinds.items() if kind == "residual"]
    assert {name: one.kind for name, one in run.actuators.items()}["hip_y"] == "residual"
    summary = run.summary()
    assert "hip_y" in next(line for line in summary.splitlines() if line.startswith("residuals"))
    for joint in ("hip", "knee", "ankle"):
        assert found[joint].load.peak_error.upper == run.measure_errors[f"{joint}_force"]
