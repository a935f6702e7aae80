from __future__ import annotations

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from tests.report.conftest import STUDY

import mbdkit
from mbdkit_report import Axis, Figure, Line, key_words, report
from mbdkit_report.pages.report_page import cell_text
from mbdkit_studies.compute.carry_out import load_study
from mbdkit_studies.compute.carry_out import study as run_study
from mbdkit_studies.folder.folder_lock import Shard
from mbdkit_studies.report.study_figures import with_slope_guides
from mbdkit_studies.report.study_headlines import headlines
from mbdkit_studies.report.study_report import study_report
from mbdkit_studies.report.study_summary import summary
from mbdkit_studies.store.study_point import point_words


@pytest.fixture
def document(study_folder):
    return study_report(load_study(study_folder))


def test_every_run_is_in_the_table_and_every_failure_has_its_reason(document):
    rows = document.verdict.table("runs").rows
    assert [row[0] for row in rows] == [1, 2, 3, 4, 5, 6]
    assert [row[2] for row in rows].count("failed") == 2
    assert {row[0] for row in document.failures.rows} == {3, 6}
    assert all("max-steps" in row[2] for row in document.failures.rows)
    assert document.settings == "6 runs \u00b7 4 complete \u00b7 2 failed"


def test_a_study_without_figures_of_its_own_gets_misalignment_error_and_cost_over_its_axes(document, study_folder):
    names = [figure.name for figure in document.verdict.figures]
    assert names == [
        "misalignment-over-time-step", "misalignment-over-wall-time", "misalignment-over-operations",
        "error-at-the-end-over-time-step", "error-at-the-end-over-wall-time", "error-at-the-end-over-operations",
        "wall-time-over-time-step", "operations-over-time-step",
    ]  # fmt: skip
    figure = document.verdict.figure("misalignment-over-time-step")
    assert [line.label for line in figure.lines] == ["RK4", "Gauss 2"]
    with load_study(study_folder).run(load_study(study_folder).points[1]) as run:
        assert figure.lines[0].x.tolist() == [0.05, 0.1, 0.2]
        assert figure.lines[0].y[1] == run.misalignment_max
    assert np.isnan(figure.lines[0].y[0])  # that run failed


def test_the_film_is_of_the_run_that_comes_apart_the_most_and_still_holds(document):
    (film,) = document.films
    size = 2 * 20.0 * np.cos(0.698)  # m: two rods of 20 m, let go 40 degrees below the horizontal
    holding = [row for row in document.verdict.table("runs").rows if row[4] is not None and row[4] <= 1e-3 * size]
    worst = max(holding, key=lambda row: row[4])
    assert film["label"] == f"run {worst[0]}: {worst[1]}"


def test_runs_that_are_missing_are_said_on_top(tmp_path):
    folder = tmp_path / "half"
    document = study_report(run_study(STUDY, out=folder, shard=Shard.parse("1/2"), notify=lambda text: None))
    assert document.alarm.endswith('missing: the command "mbdkit study" computes them')
    assert document.html()


def test_pictures_of_an_unchanged_page_are_kept_and_any_that_is_missing_brings_all_anew(study_folder, tmp_path):
    folder = shutil.copytree(study_folder, tmp_path / "study")
    report(folder, overwrite=True)
    pictures = sorted((folder / "figures").iterdir())
    pictures[1].write_text("kept")
    report(folder, overwrite=True)
    assert pictures[1].read_text() == "kept"
    pictures[0].unlink()
    report(folder, overwrite=True)
    assert pictures[0].exists()
    assert pictures[1].read_bytes() != b"kept"
    pictures[1].write_text("of another page")
    (folder / "report.html").write_text("another page")
    report(folder, overwrite=True)
    assert pictures[1].read_bytes() != b"of another page"


def test_with_a_name_of_its_own_the_page_leaves_the_folder_alone(study_folder, tmp_path):
    before = sorted(study_folder.iterdir())
    assert report(study_folder, tmp_path / "page.html").exists()
    assert sorted(study_folder.iterdir()) == before


def test_a_study_writes_its_report_when_asked(study_folder, tmp_path, mbdkit_command):
    folder = tmp_path / "copy"
    shutil.copytree(study_folder, folder)
    for _ in range(2):  # anew each time
        result = mbdkit_command("study", str(folder / "study.yaml"), "-o", str(folder), "--report")
        assert result.exit_code == 0, result.stderr
        assert f"report     {folder / 'report.html'}" in result.stdout
    assert (folder / "report.html").stat().st_size < 4_000_000


def test_a_folder_that_is_no_study_is_refused_in_a_sentence(tmp_path, mbdkit_command):
    result = mbdkit_command("report", str(tmp_path))
    assert result.exit_code == 2
    assert "this folder contains no study and no design: no study.yaml, no design.yaml" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_numbers_in_tables_read_well():
    assert [cell_text(value) for value in (10_370.0, 12_000, 1.2e-5, 0.0, float("nan"), None, True, "x")] == [
        "10,370", "12,000", "1.2e-05", "0", "-", "", "yes", "x",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("time.step", "step"),
        ("integrator.rtol", "relative tolerance"),
        ("model.bodies.left foot.mass", "mass of left foot"),
        ("model.angles.0", "angles[0]"),
        ("parameters.crank", "crank"),
        ("model.springs.support.free_length", "free length of support"),
        ("model.springs.support.points.0.1", "y of point 1 of support"),
        ("model.bodies.rod.position[0]", "x of position of rod"),
        ("model.forces.strut.points.1", "point 2 of strut"),
        ("check", "check"),
    ],
)
def test_keys_of_specs_have_words(key, words):
    assert key_words(key) == words


SPRINGS = {
    "mbdkit_study": 1, "base": "gravity-balanced-arm", "overrides": {"time": {"end": 0.1, "step": 0.02}},
    "axes": [{"model.forces.upper spring.stiffness": [900.0, 1000.0]}],
    "measures": ["reaction_force_max", "energy_balance_end"], "repeats": 3,
}  # fmt: skip


def test_the_measures_that_a_study_asks_for_are_drawn_and_listed(tmp_path):
    study = run_study(SPRINGS, out=tmp_path / "springs", notify=lambda text: None)
    document = study_report(study)
    assert point_words(study.points[0]) == "stiffness of upper spring 900 N/m"
    figure = document.verdict.figures[0]
    assert figure.title == "Reaction force against stiffness of upper spring"
    assert (figure.x.unit, figure.y.unit) == ("N/m", "N")
    assert figure.lines[0].y.tolist() == [point.values["reaction_force_max"] for point in study.points]
    table = document.verdict.table("runs")
    labels = [column.label for column in table.columns]
    assert {"largest reaction force", "Jacobians", "factorizations", "upper quartile"} <= set(labels)
    assert "wall time, shortest" in labels
    wall = document.verdict.figure("wall-time-over-model-forces-upper-spring-stiffness").lines[0]
    rows = [sorted(point.repeats) for point in study.points]
    assert wall.y.tolist() == [row[0] for row in rows]  # the shortest of three
    assert wall.band.shape == (4, 2)
    work = document.verdict.figure("operations-over-model-forces-upper-spring-stiffness").lines[0]
    names = ("rhs_evaluations", "jacobian_evaluations", "factorizations")
    assert work.y.tolist() == [sum(point.values[name] for name in names) for point in study.points]


def test_rounding_errors_are_not_ranked(tmp_path):
    spec = {**SPRINGS, "measures": ["misalignment_max"], "repeats": 1}
    spec["overrides"] = {"time": {"end": 0.02, "step": 0.002}, "integrator": {"name": "gauss", "stages": 4}}
    study = run_study(spec, out=tmp_path / "still", notify=lambda text: None)
    sentence = study_report(study).verdict.sentence
    assert "The joints stay closed to rounding errors in all runs" in sentence
    assert "smallest" not in sentence


def test_a_guide_has_the_slope_of_the_order_of_its_curve():
    step = np.array([0.1, 0.05, 0.025, 0.0125])
    lines = (Line("four", step, 3.0 * step**4), Line("two", step, 5.0 * step**2), Line("noise", step, 1e-15 + 0 * step))
    figure = Figure("f", "F", "", Axis("step", "s", log=True), Axis("error", "m", log=True), lines)
    guides = with_slope_guides(figure).guides
    assert [guide.label for guide in guides] == ["order 2", "order 4"]
    for guide, slope in zip(guides, (2.0, 4.0), strict=True):
        assert np.diff(np.log(guide.y)) / np.diff(np.log(guide.x)) == pytest.approx(slope)
    for other in (replace(figure, x=Axis("time", "s", log=True)), replace(figure, y=Axis("error", "m"))):
        assert with_slope_guides(other).guides == ()


def test_a_study_answers_with_mean_spread_causes_and_extreme_runs(tmp_path):
    base = {"mbdkit": 1, "model": {"name": "single-pendulum", "angle": -math.pi / 2}, "integrator": {"name": "rk4"},
            "time": {"end": 0.02, "step": 0.01}, "measures": {"Weight_N": "max(abs(joints.J1.force))"}}  # fmt: skip
    variables = {"model.mass": {"uniform": [1.0, 20.0]}, "model.inertia": {"uniform": [0.1, 0.2]}}
    sample = {"n": 64, "method": "sobol", "seed": 3, "variables": variables}
    study = mbdkit.study({"mbdkit_study": 1, "base": base, "sample": sample}, out=tmp_path / "s")
    ((name, told),) = headlines(study)
    mass = study.to_frame()["model.mass"]  # the force is 9.81 m/s^2 times the mass
    assert name == "Weight_N"
    half = scipy.stats.t.ppf(0.975, 63) * 9.81 * mass.std() / 8
    assert told.startswith(
        f"{9.81 * mass.mean():.0f} +- {half:.0f} N on average; standard deviation {9.81 * mass.std():.0f} ("
    )
    assert "mass explains 100 % (linear fit)" in told
    assert "inertia" not in told.partition("explains")[2].partition(";")[0]
    assert f"smallest {9.81 * mass.min():.4g} N in run {mass.argmin() + 1} (" in told
    page = study_report(study)
    assert page.headline[0] == (name, told.replace("+-", "±"))
    assert [label for label, _ in page.remarks] == ["intervals", "errors"]
    titles = [figure.title for figure in page.verdict.figures]
    assert titles[0] == "Weight_N: histogram of the runs"
    assert not any("isalignment" in title for title in titles)  # rounding errors
    (over,) = [figure for figure in page.verdict.figures if figure.title == "Weight_N against mass"]
    assert not over.x.log  # the distribution is uniform
    assert all(part in summary(study) for part in told.split("; "))
