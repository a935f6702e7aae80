"""The report of an identification shows what the result contains, and nothing that the data do not determine."""

from __future__ import annotations

import html
import re
from pathlib import Path

import numpy as np
import pytest
from tests.identify.hand_made import NOISE, result

import mbdkit
from mbdkit.plugin.reports import ReportPage
from mbdkit_identify.archive import write_identification
from mbdkit_identify.identification import Identification, Profile
from mbdkit_identify.report import autocorrelation, identification_report, smooth_profile
from mbdkit_report import write_report


def page_of(folder: Path, given: Identification) -> ReportPage:
    with identification_report(write_identification(given, folder / "fit.h5")) as page:
        return page


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> ReportPage:
    return page_of(tmp_path_factory.mktemp("report"), result())


def test_data_fit_and_band_are_those_of_the_result(page: ReportPage) -> None:
    signal = result().residuals[0]
    figure = page.verdict.figure("fit-1")
    measured, fitted = figure.lines
    assert (figure.x.unit, figure.y.unit, measured.kind, fitted.label) == ("s", "rad", "points", "fitted")
    np.testing.assert_array_equal(measured.y, signal.measured)
    np.testing.assert_array_equal(fitted.y, signal.fitted)
    assert fitted.band is not None
    low, high = np.split(fitted.band[:, 1], 2)
    np.testing.assert_allclose(high[::-1] - low, 2 * 1.96 * NOISE, atol=1e-14)
    assert "did not affect" not in figure.caption
    held_out = page.verdict.figure("fit-2")
    assert held_out.title == "Measured and predicted: leg.angle in second, <b>"
    assert "did not affect the parameters" in held_out.caption
    np.testing.assert_array_equal(page.verdict.figure("residuals-2").lines[0].y, result().residuals[1].white)


def test_no_limit_is_shown_of_what_the_data_do_not_determine(page: ReportPage) -> None:
    rows = {row[0]: row for row in page.verdict.table("estimates").rows}
    assert rows["mass"] == ("mass", "not determined by the data", "", "", "kg")
    assert rows["stiffness"][1:4] == ("12.0 \u00b1 0.2", "11.6", "12.4")
    assert rows["ratio"][2:4] == ("5.8", "no limit")
    assert ("mass", "not determined by the data") in page.headline
    assert ("damping", "0.00 \u00b1 0.05 N m s/rad") in page.headline


def test_the_first_page_has_what_was_asked_the_main_doubt_and_the_mechanism_with_names(page: ReportPage) -> None:
    assert page.glance is not None
    asked, doubt = page.glance.sentences
    assert asked.startswith("Asked: stiffness")
    assert "residuals depend on the direction of motion" in doubt.lower()
    assert {">leg<", ">hip<", ">coil<"} <= set(re.findall(">[a-z]+<", page.glance.drawing.narrow))


def test_doubts_signals_combinations_and_candidates_are_shown(page: ReportPage) -> None:
    assert page.headline[0] == ("verdict", "doubtful")
    assert (page.tone, page.alarm) == ("warn", "VERDICT: DOUBTFUL")
    (doubt,) = page.verdict.table("doubts").rows
    assert doubt == ("residuals depend on the direction of motion", "friction in the joint 'hip'", 9.1, 3.84)
    assert [row[:3] for row in page.verdict.table("signals").rows] == [
        ("first", "leg.angle", "fit"), ("second, <b>", "leg.angle", "prediction")]  # fmt: skip
    determined, following = page.sections
    assert determined.sentences == ("the data determine mass*length^2, not mass and length",)
    assert following.tables[0].rows == (("present", 0.4, 0.1), ("swing: further", 0.2, "no limit"))
    assert page.verdict.notes == ("the noise of inputs was neglected",)


def test_good_results_without_profiles_and_candidates_have_no_empty_parts(tmp_path: Path) -> None:
    bare = result(verdict="good", doubts=(), notes=(), combinations=(), profiles={}, next_experiment=None, title="")
    page = page_of(tmp_path, bare)
    assert (page.title, page.alarm, page.tone, page.sections) == ("fit", "", "good", ())
    assert [table.name for table in page.verdict.tables] == ["estimates", "signals"]
    assert page.verdict.sentence == "The result is good."


def test_the_page_is_whole_and_safe(tmp_path: Path) -> None:
    path = write_identification(result(), tmp_path / "fit.h5")
    target, _ = write_report(path)
    text = target.read_text(encoding="utf-8")
    assert target.name == "fit-report.html"
    assert "second, <b>" not in html.unescape(text.replace("&lt;b&gt;", ""))
    assert "src=" not in text.partition("<body>")[2].partition("<script")[0]
    assert "mbdkit_identify: 1" in text
    marks = write_report(path, tmp_path / "fit.md")[0].read_text(encoding="utf-8")
    assert "| mass | not determined by the data |  |  | kg |" in marks


def test_the_autocorrelation_of_alternating_values_decreases_linearly() -> None:
    # of N values +1, -1, ... with mean 0: r_k = (-1)^k (N - k)/N
    values = np.tile([1.0, -1.0], 60)
    lags = np.arange(1, 31)
    np.testing.assert_allclose(autocorrelation(values), (-1.0) ** lags * (120 - lags) / 120, atol=1e-14)
    assert np.array_equal(autocorrelation(np.ones(20)), np.zeros(5))


def test_profiles_of_linear_models_are_parabolas_between_their_points(page: ReportPage) -> None:
    values = np.array([-2.0, -0.4, 1.0, 3.5])
    x, y = smooth_profile(Profile("a", values, 3.0 * (values - 1.0) ** 2, 3.84), 1.0)
    np.testing.assert_allclose(y, 3.0 * (x - 1.0) ** 2, atol=1e-12)
    assert smooth_profile(Profile("a", values[:1], np.zeros(1), 3.84), 1.0)[0] == [-2.0]
    figure = page.verdict.figure("profile-1")
    assert [mark.x for mark in figure.marks] == [11.6, 12.0, 12.4]
    assert (figure.x.unit, figure.guides[0].y.tolist()) == ("N m/rad", [3.84, 3.84])


def test_notebooks_show_estimates_and_doubts() -> None:
    shown = result()._repr_html_()
    assert shown is not None
    assert "Identification: A leg" in shown
    assert "residuals depend on the direction of motion" in shown
    assert "&lt;b&gt;" in shown


@pytest.mark.end_to_end
def test_the_page_works_in_a_browser(tmp_path: Path) -> None:
    from axe_playwright_python.sync_playwright import Axe

    from tests.browser import executable, launched, opened, until

    path = executable()
    if path is None:
        pytest.skip("there is no Chromium: install chromium, or name one in MBDKIT_TEST_BROWSER")
    page, _ = write_report(write_identification(result(), tmp_path / "fit.h5"))
    with launched(path) as browser:
        watched = opened(browser, page)
        until(watched.page, "document.querySelectorAll('.chart .main-svg').length >= 7")
        assert (watched.console, watched.outside) == ([], [])
        assert Axe().run(watched.page).violations_count == 0
        narrow = opened(browser, page, width=390).page
        assert narrow.evaluate("document.documentElement.scrollWidth") == 390


def test_loading_is_public(tmp_path: Path) -> None:
    path = write_identification(result(), tmp_path / "fit.h5")
    assert isinstance(mbdkit.load_identification(path), Identification)
