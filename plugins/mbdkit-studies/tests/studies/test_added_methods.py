"""Methods that are added to a study join it as they can; runs that are left out because something is not installed."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit import SpecError
from mbdkit_studies.compute.added_methods import with_methods
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.report.study_figures import study_figures
from mbdkit_studies.report.study_report import study_report
from mbdkit_studies.report.study_summary import outcome, summary
from mbdkit_studies.results.judge import judge
from mbdkit_studies.results.point_selection import IN_TOLERANCES, Points
from mbdkit_studies.spec.study_loading import load_study_spec
from tests.first_party import ROOT
from tests.installing import install_project, python
from tests.margins import assert_within

METHODS: dict[str, Any] = {
    "mbdkit_study": 1,
    "base": {"model": {"name": "double-pendulum", "angles": [-1.0, -0.4]}, "time": {"end": 1.0, "step": 0.02}},
    "axes": [
        {"integrator": [{"name": "rk4"}, {"label": "Gauss 2", "value": {"name": "gauss"}}]},
        {"time.step": [0.01, 0.005, 0.0025], "output.every": [1, 2, 4]},
    ],
    "reference": {"integrator": {"name": "gauss", "stages": 6}, "time.step": 0.0025, "output.every": 4},
}


def hashes(study: mbdkit.Study, methods: set[str]) -> dict[str, str]:
    """Return the hashes of the data of the runs of some methods, and of the reference runs."""
    points = [*(point for point in study.points if point.axes["integrator"] in methods), *study.references]
    return {point.run_id: point.data_sha256 for point in points}


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[mbdkit.Study, mbdkit.Study]:
    """Return the study, and the study with three further methods."""
    folder = tmp_path_factory.mktemp("added")
    further = ["dopri5", "{name: rattle}", {"name": "scipy-dop853"}]
    return mbdkit.study(METHODS, out=folder / "plain"), mbdkit.study(METHODS, out=folder / "with", with_=further)


def test_the_runs_of_the_study_stay_the_same_bits(both: tuple[mbdkit.Study, mbdkit.Study]) -> None:
    plain, added = both
    own = hashes(plain, {"rk4", "Gauss 2"})
    assert hashes(added, {"rk4", "Gauss 2"}) == own
    assert len(own) == 6 + 1


def test_added_methods_have_their_order_beside_ours(both: tuple[mbdkit.Study, mbdkit.Study]) -> None:
    # expected: orders of theory: 5 (Dormand, Prince 1980), 2 (Leimkuhler, Skeel 1994)
    added = both[1]
    assert added.spec.added == ("dopri5", "rattle, index-3", "scipy-dop853")
    assert {point.status for point in added.points} == {"complete"}
    verdict = judge(added)
    rows = {row[0]: row for row in verdict.table("added").rows}
    orders = {name: row[8] for name, row in rows.items()}
    assert orders["dopri5"] == pytest.approx(5, abs=0.3)
    assert orders["rattle, index-3"] == pytest.approx(2, abs=0.2)
    assert rows["rattle, index-3"][3:6] == pytest.approx((0, 0, "1 of 4"), abs=1e-12)  # it closes the joints
    assert [name for name, _ in study_report(added).headline[:3]] == [f"added: {name}" for name in added.spec.added]
    assert "added" not in {table.name for table in judge(both[0]).tables}


def test_a_method_joins_with_its_formulation_and_keeps_the_reference(both: tuple[mbdkit.Study, mbdkit.Study]) -> None:
    plain, added = both
    points = [point for point in added.points if point.axes["integrator"] == "rattle, index-3"]
    assert {point.spec.formulation for point in points} == {"index-3"}
    assert {point.reference_id for point in points} == {reference.run_id for reference in plain.references}


def test_an_adaptive_method_has_tolerances_where_others_have_steps(both: tuple[mbdkit.Study, mbdkit.Study]) -> None:
    # expected: a tolerance smaller by 1e7 gives an error smaller by at least 1e5
    points = Points(both[1].family("steps" + IN_TOLERANCES))
    assert {point.axes["integrator"] for point in points} == {"scipy-dop853"}
    assert {point.spec.time.step for point in points} == {None}
    tolerances, errors = points.along("integrator.rtol", "end_error")
    assert tolerances[-1] / tolerances[0] == pytest.approx(1e7)
    assert errors[0] < 1e-5 * errors[-1]
    figures = {figure.name: figure for figure in study_figures(both[1])}
    drawn = figures["steps-error-at-the-end-over-operations"].lines
    assert [(line.label, len(line.x)) for line in drawn][-2:] == [("rattle, index-3", 3), ("scipy-dop853", 8)]
    names = [row[0] for row in judge(both[1]).table("cost-at-error").rows]
    assert "steps-tolerances, scipy-dop853" in names


@pytest.mark.parametrize(("method", "family"), [("scipy-lsoda", "tolerance"), ("dopri5", "fixed")])
def test_a_method_joins_the_families_of_its_kind(method: str, family: str) -> None:
    spec = load_study_spec("textbook-four-bar")
    points = PlannedPoints(with_methods(spec, method, pytest.fail))
    added = [point for point in points if point.axes["integrator"] == method]
    assert {point.family for point in added} == {family}
    assert len(points) == len(PlannedPoints(spec)) + len(added)


def test_a_method_joins_the_families_that_lack_it() -> None:
    spec = with_methods(load_study_spec("flexible-slider-crank"), "dopri5", pytest.fail)
    assert spec.added == ("dopri5",)  # not DOPRI5, which the claims of the study are about
    assert {point.family for point in PlannedPoints(spec) if point.axes["integrator"] == "dopri5"} == {"implicit"}


def test_families_that_a_method_does_not_suit_are_named() -> None:
    told: list[str] = []
    spec = with_methods(load_study_spec("paper"), ["rattle", "scipy-radau"], told.append)
    assert "rattle, index-3 is left out of 'coordinates': integrator 'rattle' does not support" in told[0]
    assert "scipy-radau is left out of 'one-metre' and 'knee': the time span varies with the step" in told[1]
    assert not [point for point in PlannedPoints(spec) if point.family == "knee" and "scipy" in str(point.axes)]


def test_a_labelled_value_chooses_the_stabilization() -> None:
    mine = {"label": "mine", "set": {"integrator": {"name": "gauss", "stages": 4}, "stabilization": "projection"}}
    points = PlannedPoints(with_methods(load_study_spec("drift"), mine, pytest.fail))
    added = [point.spec for point in points if point.axes["method"] == "mine"]
    assert {(spec.stabilized.kind, spec.integrator.model_dump()["stages"]) for spec in added} == {("projection", 4)}


def test_a_method_takes_the_stabilization_of_the_study_if_it_can() -> None:
    projected = load_study_spec({**METHODS, "overrides": {"stabilization": "projection"}})
    points = PlannedPoints(with_methods(projected, ["dopri5", "scipy-lsoda"], pytest.fail))
    kinds = {point.axes["integrator"]: point.spec.stabilized.kind for point in points}
    own = {"rk4": "projection", "Gauss 2": "projection"}
    assert kinds == own | {"dopri5": "projection", "scipy-lsoda, not stabilized": "none"}


@pytest.mark.parametrize(
    ("study", "method", "wrong"),
    [
        ("paper", "dopri", "there is no integrator 'dopri'"),
        ("paper", "gauss", "is already in this study, as 'Gauss 2'"),
        ("contact", "moreau-jean", "is already in this study, as 'time-stepping'"),
        ("paper", "{name: gauss, stages: 40}", "stages: should be at most 6, not 40"),
        ("paper", "[rk4]", "should be the name of an integrator, or a mapping of its name and options"),
        ("knee-spring", "rk4", "no axis of this study varies the integrator alone"),
    ],
)
def test_a_method_that_cannot_be_added_is_refused(study: str, method: str, wrong: str) -> None:
    with pytest.raises(SpecError, match=wrong) as raised:
        with_methods(load_study_spec(study), method, pytest.fail)
    assert raised.value.file == f"--with {method}"


def test_a_method_with_fixed_steps_does_not_join_a_study_of_tolerances() -> None:
    axes = [{"integrator": [{"name": "scipy-radau"}]}, {"integrator.rtol": [1e-3, 1e-6]}]
    with pytest.raises(SpecError, match="has fixed steps, but this study varies the tolerance"):
        with_methods(load_study_spec({**METHODS, "axes": axes, "reference": "none"}), "rk4", pytest.fail)


def test_the_command_refuses_before_anything_runs(mbdkit, in_tmp_path):
    result = mbdkit("study", "convergence", "--with", "rk4")
    assert (result.exit_code, result.stderr) == (2, "error: --with rk4: is already in this study, as 'RK4'\n")
    assert not list(in_tmp_path.iterdir())


OWN: dict[str, Any] = METHODS | {
    "axes": [
        {"integrator": [{"name": "rk4"}, {"label": "Mine", "set": {"integrator": {"name": "rattle"}}},
                        {"label": "GGL", "set": {"integrator": {"name": "radau-iia"}, "formulation": "ggl"}}]},
        METHODS["axes"][1],
    ],
}  # fmt: skip
"""A study of methods that a user writes at the first attempt, without formulations of RATTLE and of the reference."""


def test_an_own_method_joins_an_own_study_without_its_formulation() -> None:
    """RATTLE claims index-3 alone; the reference, whose method is another one, keeps the formulation of the base."""
    points = PlannedPoints(load_study_spec(OWN))
    formulations = {point.axes["integrator"]: point.spec.formulation for point in points}
    assert formulations == {"rk4": "index-1", "Mine": "index-3", "GGL": "ggl"}
    assert len({point.reference_id for point in points}) == 1
    assert points[0].reference is not None
    assert points[0].reference.formulation == "index-1"


def test_a_formulation_of_the_base_is_not_replaced() -> None:
    given = OWN | {"base": OWN["base"] | {"formulation": "index-1"}}
    with pytest.raises(SpecError, match=r"add `formulation: index-3`|does not support the formulation 'index-1'"):
        _ = PlannedPoints(load_study_spec(given))[3].spec


def test_an_added_method_is_not_blamed_for_an_override() -> None:
    spec = load_study_spec(METHODS, ["time.steps=100"])
    with pytest.raises(SpecError, match=r"^--set time.steps=100: .*takes exactly one of `end` and `steps`"):
        with_methods(spec, ["dop853"], print)


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


@pytest.mark.slow
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
    assert_within(values[0]["reversibility_defect"], 1e-13)
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
