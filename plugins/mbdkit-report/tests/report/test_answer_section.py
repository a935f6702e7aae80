"""The second section of a report: largest forces and torques with their times and errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ellipk

import mbdkit
from mbdkit_report import bands, run_report
from mbdkit_report.pages.verdict_text import markdown_text
from tests.linkages import driven_wheel


def table(document, name):
    (found,) = [table for section in document.sections for table in section.tables if table.name == name]
    return found


def column(found, label):
    place = [column.label for column in found.columns].index(label)
    return [row[place] for row in found.rows]


def test_the_force_in_the_pin_of_a_falling_rod_is_largest_at_the_bottom():
    # expected: of a uniform rod let go horizontally, 5/2 m g at the bottom (from its energy), after a quarter of the
    # period 4 sqrt(2 L / (3 g)) K(sin 45 deg)
    model = {"name": "single-pendulum"}
    with mbdkit.run({"mbdkit": 1, "model": model, "integrator": {"name": "gauss", "stages": 4},
                     "time": {"end": 1.0, "step": 0.001}, "check": True}) as run:  # fmt: skip
        document = run_report(run)
    joints = table(document, "joints")
    (force,), (time,), (error,) = (
        column(joints, label) for label in ("largest force", "time of the force", "± error of the force")
    )
    assert force == pytest.approx(2.5 * 9.81, rel=1e-5)
    assert time == pytest.approx(math.sqrt(2 / (3 * 9.81)) * ellipk(0.5), abs=0.001)
    assert abs(force - 2.5 * 9.81) <= error < 1e-4
    assert document.sections[1].sentences[0].startswith(f"The largest force of a joint is {force:.5g}"[:-2])
    assert "largest torque" not in [column.label for column in joints.columns]  # a pin carries none


def test_the_torque_and_the_power_of_a_motor():
    # expected: of a wheel on its axle that turns by 3/2 t^2, a torque of 3 J at all times, and a power of 9 J t
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("wheel", mass=1.0, inertia=0.5)
    m.revolute("hub", m.ground, "wheel", at=(0.0, 0.0))
    m.driver("motor", m.ground, "wheel", coordinate="angle", motion="1.5*t**2")
    with mbdkit.run(m, integrator={"name": "gauss"}, time={"end": 2.0, "step": 0.01}) as run:
        drivers = table(run_report(run), "drivers")
        markdown = markdown_text(run_report(run))
    assert drivers.rows[0][:2] == ("motor", "ground - wheel")
    assert column(drivers, "largest torque") == [pytest.approx(1.5)]
    assert column(drivers, "largest power") == [pytest.approx(9.0)]
    assert column(drivers, "time of the power") == [2.0]
    assert "The largest torque of a driver is 1.5 N m" in markdown
    assert "### Motors and drivers" in markdown


def test_force_elements_have_their_largest_values():
    with mbdkit.run(driven_wheel(), integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.01}) as run:
        found = table(run_report(run), "forces")
        twist, spring = (run.forces[name] for name in ("twist", "spring"))
        rows = {row[0]: row for row in found.rows}
        peaks = [float(np.max(np.abs(force.value))) for force in (twist, spring)]
        assert rows["twist"][1:6] == ("ground - wheel", None, None, peaks[0], run.time[np.argmax(np.abs(twist.value))])
        assert rows["spring"][2] == peaks[1]
        assert rows["spring"][4] is None
        assert rows["spring"][6] == np.max(np.abs(spring.power))


def test_largest_values_are_found_beyond_what_is_not_finite():
    time = np.arange(5.0)
    data = np.array([[1.0, np.nan], [-3.0, np.nan], [np.nan, np.nan], [np.inf, np.nan], [2.0, np.nan]])
    curves = bands(time, data)
    assert (curves.peaks[0], curves.peak_times[0]) == (3.0, 1.0)
    assert np.isnan([curves.peaks[1], curves.peak_times[1]]).all()
