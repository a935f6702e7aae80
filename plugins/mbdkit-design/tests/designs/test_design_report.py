"""What the report of a design shows: loads with bands, sensitivities, comparisons and fronts, against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.designs.oscillator import COARSE, distance, moved, stiffness_of_runge_kutta, tuned, tuned_stiffness
from tests.designs.swinging_shank import BRACE, T, design_of, mean, moments, swing

import mbdkit
from mbdkit_design.design_report import design_report
from mbdkit_report import Answer, ReportPage


def page_of(given: dict[str, object], folder: Path) -> ReportPage:
    mbdkit.design(given, out=folder)
    with design_report(folder) as page:
        return page


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("designs") / "brace"


@pytest.fixture(scope="module")
def brace(folder: Path) -> ReportPage:
    start = {f"{BRACE}.stiffness": {"bounds": [0.0, 200.0], "start": 20.0}, f"{BRACE}.free_angle": {"bounds": [-2, 2]}}
    return page_of(design_of(swing(step=T[1]), variables=start), folder)


def test_loads_before_and_after_lie_in_their_bands(brace: ReportPage, folder: Path) -> None:
    # expected: torque of the motor = moment - k (phi_0 - phi), at the start with k = 20 N m/rad and phi_0 = 0
    angle, moment = moments(at=T)
    figure = brace.verdict.figure("load-1-1")
    assert (figure.title, figure.y.label, figure.y.unit) == ("Torque of motor", "torque", "N m")
    before, after = figure.lines
    assert before.label == "at the start"
    np.testing.assert_allclose(before.x, T, atol=1e-12)
    np.testing.assert_allclose(before.y, moment + 20.0 * angle, atol=1e-5)
    assert np.sqrt(np.mean(after.y**2)) < np.sqrt(np.mean(before.y**2))
    for line, which in zip(figure.lines, ("start", "best"), strict=True):
        with mbdkit.load(folder / f"{which}.h5") as run:
            assert run.accuracy is not None
            error = run.accuracy.torque_error[:, run.joint_names.index("motor")]
        assert line.band is not None
        low, high = np.split(line.band[:, 1], 2)
        np.testing.assert_allclose(high[::-1] - line.y, error, atol=1e-14)
        np.testing.assert_allclose(line.y - low, error, atol=1e-14)


def test_variables_and_goals_have_units(brace: ReportPage) -> None:
    rows = brace.verdict.table("variables").rows
    assert [(row[0], row[5]) for row in rows] == [
        ("stiffness of brace", "N m/rad"), ("free angle of brace", "rad")]  # fmt: skip
    assert brace.verdict.table("goals").rows[0][:2] == ("goal", "N^2 m^2")
    assert brace.verdict.figure("cut-1").y.unit == "N^2 m^2"
    assert brace.verdict.claim("gain-goal").answer is Answer.YES
    assert brace.verdict.claim("runs").answer is Answer.YES


def test_the_landscape_is_the_parabola_around_the_regression(brace: ReportPage) -> None:
    # expected: the goal along k is a parabola with the second derivative 2 <(phi - phi_0)^2>, least at the mark
    figure = brace.verdict.figure("cut-1")
    (line,), (mark,) = figure.lines, figure.marks
    second, first, _ = np.polyfit(line.x - mark.x, line.y, 2)
    free_angle = best_of(brace, "free angle of brace")
    assert 2 * second == pytest.approx(2 * mean((moments()[0] - free_angle) ** 2), rel=1e-5)
    assert abs(first) < 1e-3 * second


def best_of(page: ReportPage, variable: str) -> float:
    (best,) = (row[3] for row in page.verdict.table("variables").rows if row[0] == variable)
    assert isinstance(best, float)
    return best


def test_sensitivities_have_signs_and_sizes(tmp_path: Path) -> None:
    # expected at (0.65, 0.35), by 1 % of the bounds of 3 m: (0.021, 0.021) m^2 for the goal, (-0.03, 0.03) m for x - y
    limits = {
        "sum": {"value": "final(point.x) + final(point.y)", "min": 1.0},
        "difference": {"value": "final(point.y) - final(point.x)", "max": 2.0},
    }
    page = page_of(moved(distance(0.3, 0), subject_to=limits), tmp_path / "out")
    (section,) = (one for one in page.sections if one.anchor == "sensitivities")
    rows = {row[0]: row[1:] for row in section.tables[0].rows}
    assert rows["goal"][0] == "m^2"
    assert rows["goal"][1:] == pytest.approx([0.021, 0.021], rel=1e-4)
    assert rows["difference"][1:] == pytest.approx([-0.03, 0.03], rel=1e-6)
    assert page.verdict.claim("limits").answer is Answer.YES


def test_a_comparison_is_a_claim_a_row_and_a_curve(tmp_path: Path) -> None:
    coarse = {"integrator": {"name": "rk-gill"}, "time.step": COARSE}
    page = page_of(tuned(compare={"RK-Gill": coarse, "rk4": {"integrator": {"name": "rk4"}}}), tmp_path / "out")
    assert page.verdict.claim("compared-1").answer is Answer.NO
    assert page.verdict.claim("compared-2").answer is Answer.YES
    assert "With RK-Gill, the optimum seems to have a goal of" in page.verdict.sentence
    rows = page.verdict.table("compared").rows
    assert [row[0] for row in rows] == ["this design", "RK-Gill", "rk4"]
    assert [row[1] for row in rows] == pytest.approx(
        [tuned_stiffness(), stiffness_of_runge_kutta(COARSE), tuned_stiffness()], rel=1e-4
    )
    figure = page.verdict.figure("cut-1")
    assert [line.label for line in figure.lines] == ["goal", "goal with RK-Gill", "goal with rk4"]
    exact, wrong, _ = figure.lines
    np.testing.assert_allclose(exact.y, np.cos(np.sqrt(exact.x)) ** 2, atol=1e-9)
    assert np.max(np.abs(wrong.y - exact.y)) > 1e-4
    assert "integrator: {name: rk-gill}, time.step: 0.5" in page.verdict.table("compared").note


def test_device_is_shown_in_motion_and_at_several_times(brace: ReportPage) -> None:
    assert [film["label"] for film in brace.films] == ["best", "start"]
    anchors = [section.anchor for section in brace.sections]
    assert anchors == ["device-start", "work-1", "sensitivities"]
    work = brace.sections[1].drawing
    assert work is not None
    assert " s</text>" in work.wide
    assert "measured loads" not in work.caption
    assert f"With stiffness of {BRACE.rpartition('.')[2]} 20 N m/rad" in brace.sections[0].sentences[0]
