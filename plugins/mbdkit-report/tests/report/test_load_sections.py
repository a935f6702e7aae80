"""Loads, workload and residuals in the report of inverse dynamics."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_biomech.inverse_dynamics.results.load_sections import inverse_sections
from mbdkit_report import Section, Table, run_report
from mbdkit_report.pages.run_report import mechanism_of

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
    assert times == pytest.approx(0.25 + 0.4 * (np.arange(6) + 0.5) / 6, abs=0.021)


def test_the_page_has_the_sections_and_charts(run: mbdkit.Run) -> None:
    page = run_report(run)
    assert {"residual-angles", "residual-lengths"} <= {figure.name for figure in page.verdict.figures}
    assert "mbdkit inverse run.yaml" in page.commands
    assert [one.anchor for one in page.sections][:4] == ["model", "loads", "workload", "data"]
    assert "Differences between model and data" in page.html()
