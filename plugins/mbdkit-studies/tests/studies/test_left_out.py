"""Runs that need a distribution that is not installed, and runs that are made there and back."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit_studies.report.study_report import study_report
from mbdkit_studies.report.study_summary import outcome, summary
from tests.first_party import ROOT
from tests.installing import install_project, python

PROJECT = ROOT / "plugins" / "mbdkit-generalized-alpha"
GAUSS = {"label": "Gauss 2", "set": {"integrator": {"name": "gauss", "stages": 2}}}
ALPHA = {
    "label": "Generalized-alpha",
    "set": {"integrator": {"name": "mbdkit-generalized-alpha:generalized-alpha"}, "formulation": "index-3"},
    "if_installed": "mbdkit-generalized-alpha",
}
STUDY: dict[str, Any] = {
    "mbdkit_study": 1,
    "title": "One of ours, one of a plugin",
    "base": {"model": {"name": "double-pendulum", "angles": [-1.0, -0.4]}, "time": {"end": 0.4, "step": 0.02}},
    "axes": [{"method": [GAUSS, ALPHA]}, {"time.step": [0.02, 0.01]}],
    "reference": {"integrator": {"name": "gauss", "stages": 5}, "formulation": "index-1", "time.step": 0.01},
    "measures": ["misalignment_max", "velocity_error", "multiplier_error", "own_multipliers", "reversibility_defect"],
}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    """The study without the plugin, told what is left out."""
    notes: list[str] = []
    found = mbdkit.study(STUDY, out=tmp_path_factory.mktemp("studies") / "partly", notify=notes.append)
    assert "2 runs left out: the distribution mbdkit-generalized-alpha is not installed" in notes
    return found


def test_what_is_not_installed_is_left_out_and_named(done: mbdkit.Study) -> None:
    assert [point.status for point in done.points] == ["complete", "complete", "left-out", "left-out"]
    assert done.status == "complete"
    assert done.points[2].run_id == ""
    assert math.isnan(done.points[2].values["misalignment_max"])
    assert "2 complete, 2 left out" in summary(done)
    assert "the distribution mbdkit-generalized-alpha is not installed" in summary(done)
    assert outcome(done)["left_out"] == 2
    document = study_report(done)
    assert document.settings.endswith("2 complete \u00b7 2 left out")
    assert [row[2] for row in document.verdict.table("runs").rows] == ["complete"] * 2 + ["left-out"] * 2
    assert document.html()


def test_with_the_plugin_what_was_left_out_is_computed_and_nothing_else(done: mbdkit.Study, tmp_path: Path) -> None:
    folder = shutil.copytree(done.folder, tmp_path / "study")
    site = tmp_path / "site"
    site.mkdir()
    install_project(site, PROJECT)
    command = ("-m", "mbdkit", "study", str(folder / "study.yaml"), "-o", str(folder), "--workers", "1")
    made = python(*command, path=(site, PROJECT / "src"), cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert "4 complete; reference runs: 1" in made.stdout
    assert "computed   2 now" in made.stdout
    study = mbdkit.load_study(folder)  # where the plugin is not installed: what was computed is still there
    values = [point.values for point in study.points]
    assert [point.status for point in study.points] == ["complete"] * 4
    assert [value["own_multipliers"] for value in values] == [0, 0, 1, 1]
    # expected: order 2 of velocities and of its own multipliers (Arnold and Bruls 2007), and no reversibility
    for name in ("velocity_error", "multiplier_error"):
        assert np.log2(values[2][name] / values[3][name]) == pytest.approx(2.0, abs=0.2)
    assert values[2]["reversibility_defect"] > 1e-8
    assert values[0]["reversibility_defect"] < 1e-13
    assert study_report(study).html()


def test_a_lost_index_costs_the_reversals_alone(done: mbdkit.Study, tmp_path: Path) -> None:
    folder = shutil.copytree(done.folder, tmp_path / "study")
    (folder / "index.h5").unlink()
    again = mbdkit.study(STUDY, out=folder)
    assert again.computed == 0
    hashes = []
    for which in (folder, done.folder):
        with h5py.File(which / "index.h5") as file:
            hashes.append(file.attrs["data_sha256"])
    assert hashes[0] == hashes[1]


def test_errors_of_velocities_and_multipliers_are_those_of_the_rows(finished: mbdkit.Study) -> None:
    point = finished.points[1]  # rk4 at the step of its reference: the same rows
    with finished.run(point) as run, finished.reference(point) as reference:
        apart = run.array("trajectory/velocity") - reference.array("trajectory/velocity")
        assert point.values["velocity_error"] == pytest.approx(np.hypot(apart[..., 0], apart[..., 1]).max(), rel=1e-12)
        assert point.values["angular_velocity_error"] == pytest.approx(np.abs(apart[..., 2]).max(), rel=1e-12)
        mine, theirs = (which.array("constraints/multiplier") for which in (run, reference))
        assert point.values["multiplier_error"] == pytest.approx(
            np.abs(mine - theirs).max() / np.abs(theirs).max(), rel=1e-12
        )
        assert point.values["mechanism_size"] == pytest.approx(1.5)  # two rods of 1 m, level; the last end has no joint
        assert point.values["duration"] == 0.5
