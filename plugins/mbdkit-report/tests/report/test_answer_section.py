"""The second section of a report: largest loads with times and errors, also of inverse dynamics; and the door."""

from __future__ import annotations

import math
import re
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipk

import mbdkit
import mbdkit_report
from mbdkit_biomech.inverse_dynamics.results.load_sections import inverse_sections
from mbdkit_report import Section, Table, bands, run_report
from mbdkit_report.pages.run_report import mechanism_of
from mbdkit_report.pages.verdict_text import markdown_text
from tests.linkages import driven_wheel
from tests.margins import assert_within


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
        column(joints, label) for label in ("largest force", "time of the force", "± of the force")
    )
    assert force == pytest.approx(2.5 * 9.81, rel=1e-5)
    assert time == pytest.approx(math.sqrt(2 / (3 * 9.81)) * ellipk(0.5), abs=0.001)
    assert_within(force - 2.5 * 9.81, error)  # margin: an error bar of mbdkit
    assert_within(error, 3e-4)
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


T = np.linspace(0.0, 1.0, 51)


@pytest.fixture(scope="module")
def run() -> mbdkit.Run:
    """A pendulum at rest whose angle and tip are measured, the tip 4 mm too far to the right at one time."""
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=2.0, inertia=0.2, position=(0.0, -0.5))
    m.revolute("hip", m.ground, rod, at=(0, 0))
    m.marker("tip", rod, point=(0.0, -0.5))
    data: dict[str, Any] = {"time": T, "hip.angle": 0.0 * T, "tip.x": np.where(T[30] == T, 0.004, 0.0)}
    data |= {"tip.y": 0.0 * T - 1.0, "fx": 0.0 * T}
    columns = {name: {"column": name, "weight": 1e9 if name == "hip.angle" else 1.0} for name in list(data)[1:4]}
    load = {"push": {"body": "rod", "force": [10.0, 0.0], "point": [0.0, -1.0]}}
    return mbdkit.inverse(
        {"mbdkit": 1, "model": m.to_spec(), "motion": {"data": data, "columns": columns}, "loads": load}
    )


def section(run: mbdkit.Run, anchor: str) -> Section:
    return next(one for one in inverse_sections(run, mechanism_of(run)) if one.anchor == anchor)


def cells(table: Table, row: str) -> dict[str, Any]:
    found = next(one for one in table.rows if one[0] == row)
    return {column.label: cell for column, cell in zip(table.columns, found, strict=True)}


def test_workload_has_the_numbers_of_statics(run: mbdkit.Run) -> None:
    table = section(run, "workload").tables[0]
    # expected: the pin carries the weight and the push; the actuator holds against the push, at an arm of 1 m
    assert cells(table, "hip")["peak"] == pytest.approx(np.hypot(2.0 * 9.81, 10.0), rel=1e-6)
    actuator = next(row for row in table.rows if row[1] == "actuator")
    assert actuator[3] == pytest.approx(10.0, rel=1e-3)


def test_the_largest_residual_is_named_with_its_time(run: mbdkit.Run) -> None:
    found = section(run, "data")
    residuals = cells(found.tables[0], "tip.x")
    assert residuals["largest residual"] == pytest.approx(0.004, rel=1e-6)
    assert residuals["time of the largest"] == T[30]
    assert residuals["rms of the residual"] == pytest.approx(0.004 / np.sqrt(51), rel=1e-6)
    assert "0.004 m (tip.x, at 0.6 s)" in found.sentences[0]


def test_arrows_are_to_scale(run: mbdkit.Run) -> None:
    drawing = section(run, "loads").drawing
    assert drawing is not None
    lengths = {}
    for kind in ("joint", "load"):
        shafts = re.findall(rf'class="arrow of-{kind}" d="M([\d.]+) ([\d.]+)L([\d.]+) ([\d.]+)"', drawing.wide)
        sizes = [np.hypot(float(x1) - float(x0), float(y1) - float(y0)) for x0, y0, x1, y1 in shafts]
        lengths[kind] = max(size for size in sizes if size != pytest.approx(20.0))  # the key is 20 pixels long
    assert lengths["joint"] / lengths["load"] == pytest.approx(np.hypot(2.0 * 9.81, 10.0) / 10.0, rel=0.01)


def test_the_player_has_the_arrows_of_its_frames(run: mbdkit.Run) -> None:
    film = run_report(run).films[0]
    arrows = film["arrows"]
    values = np.reshape(arrows["values"], (len(film["time"]), 2, 4))
    assert arrows["kinds"] == ["joint", "load"]
    # expected: the pin carries the weight and the push on the rod; the push acts at the tip
    np.testing.assert_allclose(values[:, 0], np.broadcast_to([0, 0, -10.0, 2.0 * 9.81], (len(values), 4)), atol=1e-3)
    np.testing.assert_allclose(values[:, 1], np.broadcast_to([0, -1.0, 10.0, 0], (len(values), 4)), atol=1e-3)
    assert arrows["longest"] == pytest.approx(np.hypot(2.0 * 9.81, 10.0), rel=1e-3)
    left, right, bottom, top = film["view"]
    ends = values[..., :2] + arrows["scale"] * values[..., 2:]
    assert left < ends[..., 0].min() < ends[..., 0].max() < right
    assert bottom < ends[..., 1].min() < ends[..., 1].max() < top


def test_frames_are_those_of_a_cycle_if_a_load_has_one() -> None:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    wheel = m.body("wheel", mass=1.0, inertia=0.5)
    m.revolute("hub", m.ground, wheel, at=(0, 0))
    data: dict[str, Any] = {"time": T, "hub.angle": T, "fx": 100.0 * (np.mod(T - 0.25, 0.4) < 0.2)}
    load = {"push": {"body": "wheel", "force": ["fx", 0.0]}}
    run = mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": {"data": data}, "loads": load})
    drawing = section(run, "loads").drawing
    assert drawing is not None
    # expected: contacts from 0.25 and 0.65 s; the middles of sixths of the cycle, at the nearest rows of 0.02 s
    times = [float(text) for text in re.findall(r">([\d.]+) s</text>", drawing.wide)]
    assert times == pytest.approx(0.25 + 0.4 * (np.arange(6) + 0.5) / 6, abs=0.021)  # margin: resolution of the rows


def test_the_page_has_the_sections_and_charts(run: mbdkit.Run) -> None:
    page = run_report(run)
    assert {"residual-angles", "residual-lengths"} <= {figure.name for figure in page.verdict.figures}
    assert "mbdkit inverse run.yaml" in page.commands
    assert [one.anchor for one in page.sections][:4] == ["model", "loads", "workload", "data"]
    assert "Differences between model and data" in page.html()


def test_no_name_of_the_door_is_that_of_a_module() -> None:
    modules = {path.stem for path in Path(mbdkit_report.__file__).parent.iterdir()}
    assert not modules & set(mbdkit_report.__all__)
    assert not [name for name in dir(mbdkit_report) if isinstance(getattr(mbdkit_report, name), types.ModuleType)]
