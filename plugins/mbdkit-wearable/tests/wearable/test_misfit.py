"""The study of misfit, the design of an orthosis, and the coverage of bars of the force that a device adds."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tests.wearable.misfit_coverage import coverage

import mbdkit
from mbdkit.guide.pages import pages
from mbdkit.plugin.reports import Answer
from mbdkit_wearable.misfit.study import MOTIONS, base, squat, study
from mbdkit_wearable.misfit.verdict import verdict

PAGES = pages()


def test_a_hinge_that_fits_passes_the_torque_of_its_spring() -> None:
    """Without gravity, and with stiff tissue, device and knee turn about one axis, and the whole help arrives."""
    spec = base(squat(), "hinge")
    spec["model"]["gravity"] = [0.0, 0.0]
    spec["parameters"] |= {"tissue": 100.0}
    spec["time"]["step"] = 0.002
    run = mbdkit.run(spec)
    assert run.measures["transmitted"] == pytest.approx(1.0, abs=0.01)
    knee = run.joints["flexion"]
    middle = int(np.argmin(np.abs(run.time - 1.5)))
    assert abs(knee.reaction_torque[middle]) == pytest.approx(10.0 * np.radians(95), rel=0.01)


def test_the_force_of_a_hinge_grows_with_its_offset_along_the_limb() -> None:
    """The pins of device and knee part by 2 e sin(flexion/2): stiff tissue takes it up with a proportional force."""
    spec, added = base(squat(), "hinge"), {}
    for upward in (0.0, 0.01, 0.02):
        spec["parameters"] |= {"upward": upward}
        added[upward] = float(mbdkit.run(spec).measures["added"])
    assert added[0.0] < added[0.01] < added[0.02]


def test_the_spec_has_each_device_in_each_motion() -> None:
    families = study(quick=True)["families"]
    assert list(families) == [  # type: ignore[call-overload]
        f"{motion}-{device}" for motion in MOTIONS for device in ("hinge", "four-bar", "self-aligning")
    ]


@pytest.mark.slow
def test_the_short_form_of_the_study_has_a_verdict_and_figures(tmp_path: Path) -> None:
    found = mbdkit.study("misfit", quick=True, out=tmp_path / "misfit", workers=2)
    judged = verdict(found)
    answers = {claim.name: claim.answer for claim in judged.claims}
    assert answers["self-alignment"] is answers["tissue"] is Answer.YES
    assert len(judged.figures) == 24
    assert list(found.columns()["status"]) == 144 * ["complete"]


@pytest.mark.end_to_end
def test_the_page_prints_the_numbers_that_it_shows(capsys: pytest.CaptureFixture[str]) -> None:
    text = PAGES["device"].text
    code, shown = (re.search(rf"```{name}\n(.*?)```", text, re.DOTALL) for name in ("python", "text"))
    assert code is not None
    assert shown is not None
    exec(code[1], {"__name__": "guide"})
    printed = capsys.readouterr().out
    pairs = zip(*(re.findall(r"[\d.]+", lines) for lines in (printed, shown[1])), strict=True)
    assert [(a, b) for a, b in pairs if float(a.rstrip(".")) != pytest.approx(float(b.rstrip(".")), rel=0.03)] == []


@pytest.mark.slow
def test_bars_of_the_added_force_contain_the_true_force_in_95_percent_of_the_cases() -> None:
    """Of 200 independent cases, 91 to 99 % are within three standard deviations of 95 %."""
    assert 0.90 <= coverage(4, 50, seed=1) <= 0.99


@pytest.mark.slow
def test_the_design_of_an_orthosis_is_a_minimum() -> None:
    found = mbdkit.design("fitted-orthosis", optimum_only=True)
    best, start = (point.goals["goal"] for point in (found.best, found.start))
    assert best < 0.5 * start
