"""Estimated errors in plots and reports: bands around curves and paths, and values with plus-minus."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Outline

import mbdkit
from mbdkit.archive.headlines import largest_loads
from mbdkit_report import band_over_time, run_report
from mbdkit_report.figures.curves import band_along_path
from mbdkit_report.pages.report_page import chart_data

CHAOTIC = {"name": "double-pendulum", "angles": [1.2, 0.3]}
REGULAR = {"name": "double-pendulum", "angles": [-1.0, -0.4]}


def checked(model: dict[str, Any], end: float, **sections: Any) -> mbdkit.Run:
    integrator = {"name": "gauss", "stages": 2}
    spec = {"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": end, "step": 0.02}, "check": True}
    return mbdkit.run({**spec, **sections})


@pytest.fixture(scope="module")
def lost() -> mbdkit.Run:
    run = checked(CHAOTIC, 10.0)
    assert run.accuracy is not None
    assert 1.0 < run.accuracy.known_until < 10.0
    return run


def test_a_band_over_time_is_as_wide_as_the_error_and_ends_with_it() -> None:
    time, value = np.arange(4.0), np.array([1.0, 2.0, 1.0, 0.0])
    band = band_over_time(time, value, value, np.array([0.0, 0.1, 0.2, np.nan]))
    assert band is not None
    np.testing.assert_allclose(band[:3], [[0, 1.0], [1, 1.9], [2, 0.8]])
    np.testing.assert_allclose(band[3:], [[2, 1.2], [1, 2.1], [0, 1.0]])
    assert band_over_time(time, value, value, np.full(4, np.nan)) is None


def test_a_band_along_a_circle_lies_on_both_sides_of_it() -> None:
    # expected: the ring between two circles
    angle = np.linspace(0.0, 2 * np.pi, 200)
    path = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    band = band_along_path(path, np.full(200, 0.1))
    assert band is not None
    radius = np.hypot(*band.T)
    assert set(np.round(radius, 3)) == {0.9, 1.1}
    assert Outline(band).contains_point((1.05, 0.3)) != Outline(band).contains_point((0.0, 0.0))


def test_charts_of_a_checked_run_have_bands_up_to_the_time_until_which_errors_are_known(lost: mbdkit.Run) -> None:
    assert lost.accuracy is not None
    charts = {chart.name: chart for chart in run_report(lost).verdict.figures}
    forces = charts["reactions"]
    for line, name in zip(forces.lines, ("J1", "J2"), strict=True):
        assert line.label == name
        assert line.band is not None
        assert np.max(line.band[:, 0]) == pytest.approx(lost.accuracy.known_until)
    assert [(mark.label, mark.x) for mark in forces.marks] == [("errors unknown afterwards", lost.accuracy.known_until)]
    assert chart_data(forces)["lines"][0]["band"]["x"][0] == 0.0
    paths = charts["trajectory"].lines
    assert [line.label for line in paths if line.band is None] == ["rod2 end, error unknown", "J2, error unknown"]
    assert len([line for line in paths if line.band is not None]) == 2
    json.dumps(chart_data(charts["trajectory"]))


def test_charts_of_an_unchecked_run_have_no_bands() -> None:
    charts = run_report(checked(REGULAR, 1.0, check=False)).verdict.figures
    assert all(line.band is None for chart in charts for line in chart.lines)


def test_marks_of_events_do_not_replace_the_mark_of_unknown_errors() -> None:
    low = {"when": "rod1.angle + 1.2", "direction": "falling", "action": "note"}
    run = checked(CHAOTIC, 10.0, events={"low": low})
    chart = next(one for one in run_report(run).verdict.figures if one.name == "reactions")
    assert {"errors unknown afterwards", "low"} <= {mark.label for mark in chart.marks}


def test_tables_say_plus_minus() -> None:
    run = checked(REGULAR, 1.0)
    assert run.accuracy is not None
    joints = run_report(run).sections[1].tables[0]
    assert joints.columns[-1].label == "± error of the force"
    joint = run.accuracy.of_joints(run.joint_names, run.array("joints/reaction_force"))[0]
    (error,) = (one.error for one in largest_loads(run) if one.label == f"largest force in {joint.name}")
    assert joints.rows[0][-1] == error
    assert error >= joint.error  # it covers peaks between the recorded rows, too
    bodies = run_report(run).verdict.table("errors")
    assert bodies.rows[0][:2] == ("rod1", pytest.approx(np.hypot(*run.accuracy.position_error[-1, 0, :2])))


def test_tables_say_until_when_errors_are_known(lost: mbdkit.Run) -> None:
    assert lost.accuracy is not None
    table = run_report(lost).sections[1].tables[0]
    assert f"largest force until {lost.accuracy.known_until:.4g} s" in [column.label for column in table.columns]
    joint = lost.accuracy.of_joints(lost.joint_names, lost.array("joints/reaction_force"))[0]
    peak, error = table.rows[0][-2:]
    assert peak == pytest.approx(joint.peak_known)
    assert isinstance(error, float)
    assert error >= joint.error
