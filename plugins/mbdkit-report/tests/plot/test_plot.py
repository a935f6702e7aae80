from __future__ import annotations

import json
import math
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.path import Path as Outline
from PIL import Image

import mbdkit
from mbdkit.archive.headlines import largest_loads
from mbdkit.archive.named_columns import NotRecordedError
from mbdkit.base.errors import MbdkitError, ResourceError, SpecError
from mbdkit_report import Axis, Figure, Line, band_over_time, run_report
from mbdkit_report.figures.curves import band_along_path
from mbdkit_report.figures.quantity_text import count, duration, length, proportion
from mbdkit_report.pages.report_page import chart_data
from mbdkit_report.plot import energy_plot, save_plot
from mbdkit_report.plot.charts import chart_image
from mbdkit_report.plot.plot_kinds import plot_kinds
from mbdkit_report.plot.save_plot import figure, plot

#: Kinds of which a chain of rods has something to draw.
kinds = pytest.mark.parametrize("kind", ["trajectory", "drift", "energy", "reactions"])
ODD = {
    "title": r"$\frac{ \undefined $ _x_ 振り子 & <b>" + " longer" * 40,
    "joints": ["_a$x^$", r"$\b$"],
    "model": {"name": "acme:unknown"},
}
"""Texts of a run that Matplotlib would read as mathematics."""


def texts(picture) -> str:
    """All text of a figure."""
    found = [text.get_text() for text in picture.texts]
    for axes in picture.axes:
        found += [axes.get_title(loc="left"), axes.get_xlabel(), axes.get_ylabel()]
        found += [text.get_text() for text in axes.texts]
        if axes.get_legend():
            found += [text.get_text() for text in axes.get_legend().get_texts()]
    return "\n".join(found)


@kinds
def test_a_png_is_a_picture_of_a_thousand_dots_with_something_on_it(make_run, tmp_path, kind):
    before = dict(mpl.rcParams)
    path = plot(make_run(), kind, tmp_path / "picture.png")
    assert dict(mpl.rcParams) == before  # the settings of others are left alone
    with Image.open(path) as image:
        assert image.format == "PNG"
        assert image.width == 1080
        assert 400 < image.height < 1300
        assert image.info["dpi"][0] == pytest.approx(150, abs=0.1)
        assert len(image.convert("RGB").getcolors(1_000_000)) > 50


@pytest.mark.parametrize(("name", "first"), [("a.svg", b"<?xml"), ("a.pdf", b"%PDF"), ("a.PNG", b"\x89PNG")])
def test_the_suffix_is_the_format(make_run, tmp_path, name, first):
    assert plot(make_run(), "drift", tmp_path / name).read_bytes().startswith(first)


def test_a_kind_with_charts_alone_is_plotted_from_them(make_run, monkeypatch):
    monkeypatch.setattr(save_plot, "plot_module", lambda kind: SimpleNamespace(charts=energy_plot.charts))
    picture = figure(make_run(), "any")
    assert [axes.get_ylabel() for axes in picture.axes] == ["energy [J]", "balance [J]"]
    assert [axes.get_xlabel() for axes in picture.axes] == ["", "time [s]"]


@kinds
def test_titles_axes_and_units_are_written(make_run, kind):
    text = texts(figure(make_run(), kind))
    assert "a swinging chain" in text
    assert "n-pendulum · gauss, 2 stages · step 0.02 s · complete" in text
    units = {"trajectory": ("[m]",), "drift": ("[m]", "[m/s]"), "energy": ("[J]",), "reactions": ("[N]",)}
    for unit in (*units[kind], *(("time [s]",) if kind != "trajectory" else ())):
        assert unit in text


@kinds
def test_a_run_that_failed_says_so_in_the_picture(make_run, kind):
    run = make_run(rows=11, status="failed", reason="newton-failed: the step at t = 0.2 s")
    assert "FAILED at t = 0.2 s: newton-failed: the step at t = 0.2 s" in texts(figure(run, kind))


@kinds
def test_a_run_of_one_row_is_drawn(make_run, tmp_path, kind):
    plot(make_run(rows=1, status="failed", reason="singular: at the start"), kind, tmp_path / "a.png")


@kinds
def test_a_run_without_rows_has_nothing_to_draw(make_run, kind):
    with pytest.raises(SpecError, match="no rows"):
        figure(make_run(rows=0, status="failed", reason="singular: at the start"), kind)


@kinds
def test_numbers_that_are_not_finite_and_odd_texts_do_not_stop_a_picture(make_run, tmp_path, kind):
    def spoil(data):
        for name, values in data.items():
            if name != "time" and not name.startswith("constraints"):
                values[-3:-1] *= 1e300
                values[-1] = np.nan

    run = make_run(change=spoil, status="failed", reason="not-finite: the state is not finite", **ODD)
    plot(run, kind, tmp_path / "a.png")


@pytest.mark.parametrize("kind", ["drift", "energy", "reactions"])
def test_what_was_not_recorded_is_named(make_run, kind):
    run = make_run(quantities=frozenset())
    with pytest.raises(NotRecordedError, match=r"output\.quantities"):
        figure(run, kind)
    figure(run, "trajectory")


def test_drift_names_the_largest_misalignment(make_run):
    picture = figure(make_run(), "drift")
    assert "misalignment: largest over every step 1.8e-08 m (J2)" in texts(picture)
    assert picture.axes[0].get_yscale() == "log"


def test_driven_angles_have_a_panel_of_their_own_with_the_joints_that_they_concern(make_run):
    def drive(data):
        data["joints/angle_misalignment"][:, 1] = 1e-7

    assert len(figure(make_run(), "drift").axes) == 2
    axes = figure(make_run(change=drive), "drift").axes
    assert len(axes) == 3
    assert "[rad]" in axes[2].get_ylabel()
    assert [line.get_label() for line in axes[2].get_lines()] == ["J2"]


def test_reaction_torques_have_a_panel_where_they_are_more_than_round_off(make_run):
    def twist(size):
        def change(data):
            data["joints/reaction_torque"][:, 0] = -size

        return change

    assert len(figure(make_run(change=twist(1e-13)), "reactions").axes) == 1
    axes = figure(make_run(change=twist(2.0)), "reactions").axes
    assert axes[1].get_title(loc="left") == "reaction torque: largest 2 N m (J1)"


def test_a_mechanism_without_joints_is_drawn(make_run, tmp_path):
    model = {"name": "mechanism", "bodies": {"ball": {"mass": 1.0}}}
    time = 0.02 * np.arange(151)
    poses = np.stack([time, 3 * time - 4.9 * time**2, 0 * time], axis=-1)[:, None]
    run = make_run(model=model, bodies=["ball"], joints=[], poses=poses)
    for kind in ("trajectory", "energy"):
        plot(run, kind, tmp_path / "a.png")
    for kind in plot_kinds().keys() - {"trajectory", "energy"}:
        with pytest.raises(MbdkitError, match=r"no (joint|force element|beams)|force elements"):
            plot(run, kind, tmp_path / "a.png")


def test_a_picture_that_cannot_be_finished_leaves_the_old_one_and_nothing_else(make_run, tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def fail(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", fail)
    with pytest.raises(ResourceError, match="No space left"):
        plot(make_run(), "energy", path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_drawing_needs_neither_pyplot_nor_sympy_nor_numba():
    code = (
        "import sys, mbdkit_report.plot.save_plot, mbdkit_report.pages.animate\n"
        "from mbdkit_report.figures.drawing_geometry import draw_mechanism\n"
        "from mbdkit.archive.stored_mechanism import built_mechanism, mechanism_json, read_mechanism\n"
        "built = built_mechanism({'model': {'name': 'double-pendulum'}}).mechanism\n"
        "draw_mechanism(read_mechanism(mechanism_json(built), list(built.bodies)).mechanism)\n"
        "print([name for name in ('matplotlib.pyplot', 'sympy', 'numba') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_axes_end_at_the_limits(make_run, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(save_plot, "save", lambda picture, target: drawn.append(picture))
    plot(make_run(), "drift", tmp_path / "a.png", size=(85.0, 60.0), x_limits=(0.01, 0.02), y_limits=(1e-9, 1.0))
    (axes,) = drawn[0].axes
    assert axes.get_xlim() == (0.01, 0.02)
    assert axes.get_ylim() == (1e-9, 1.0)
    with pytest.raises(SpecError, match="the x limits should be two different numbers, not 1 and 1"):
        plot(make_run(), "drift", tmp_path / "a.png", x_limits=(1.0, 1.0))
    with pytest.raises(SpecError, match="the y axis is logarithmic"):
        plot(make_run(), "drift", tmp_path / "a.png", size=(85.0, 60.0), y_limits=(0.0, 1.0))


def test_a_curve_that_is_exactly_zero_is_named_on_a_logarithmic_axis_and_long_captions_are_wrapped() -> None:
    x = np.array([0.0, 1.0])
    lines = (Line("closed", x, 0 * x), Line("open", x, 1e-6 + x))
    chart = Figure("drift", "Drift", "word " * 60, Axis("time", "s"), Axis("misalignment", "m", log=True), lines)
    assert [line.label for line in chart.lines] == ["closed (exactly 0)", "open"]
    drawn = [text.get_text() for text in chart_image(chart).texts]
    assert sum(text.count("word") for text in drawn) == 60


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
    place = [column.label for column in joints.columns].index("± of the force")
    joint = run.accuracy.of_joints(run.joint_names, run.array("joints/reaction_force"))[0]
    (error,) = (one.bar.upper for one in largest_loads(run) if one.label == f"largest force in {joint.name}")
    assert joints.rows[0][place] == error
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


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (1.234, "1.23 m"), (0.9999, "1 m"), (0.0125, "12.5 mm"), (7.87e-6, "7.87 \u00b5m"), (3.1e-9, "3.1 nm"),
        (1.36e-14, "1.4e-14 m"), (0.0, "0 m"), (math.nan, "not finite"),
    ],
)  # fmt: skip
def test_a_length_comes_in_the_unit_that_suits_it(value, words):
    assert length(value) == words


def test_times_proportions_and_counts_read_well():
    assert [duration(value) for value in (75.0, 0.00921, 1.15e-5)] == ["75 s", "9.21 ms", "11.5 \u00b5s"]
    assert [proportion(value) for value in (0.173, 0.0012, 3e-7)] == ["17 %", "0.12 %", "3e-07"]
    assert [count(1, "body", "bodies"), count(12_000, "step")] == ["1 body", "12,000 steps"]


def test_latex_that_is_not_installed_is_named(lost: mbdkit.Run, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PATH", "")
    with mpl.rc_context({"text.usetex": True}), pytest.raises(mbdkit.MbdkitError, match="cannot draw text with LaTeX"):
        plot(lost, "energy", tmp_path / "energy.png")
