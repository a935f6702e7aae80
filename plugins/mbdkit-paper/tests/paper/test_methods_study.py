"""The study `methods`: its runs, methods of a stranger that fail, and the page with its figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

import mbdkit
from mbdkit import SpecError
from mbdkit_paper.methods.problems import problems
from mbdkit_paper.methods.study import study as spec_of
from mbdkit_report import Verdict
from mbdkit_report.plot.charts import write_chart_images
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.report.study_report import study_report
from mbdkit_studies.results.judge import judge
from mbdkit_studies.spec.study_loading import load_study_spec
from tests.installing import install_module, python
from tests.margins import assert_within

STRANGER = """
import time

import mbdkit
from pydantic import BaseModel


class Verlet(mbdkit.StepMethod):
    def __init__(self, options):
        pass

    def step(self, equations, t, state, h):
        a, _ = equations.accelerations(t, state.q, state.v)
        middle = state.v + h / 2 * a
        q = equations.project_positions(t + h, state.q + h * middle)
        a, _ = equations.accelerations(t + h, q, middle)
        return mbdkit.StepState(q, equations.project_velocities(t + h, q, middle + h / 2 * a))


class Broken(Verlet):
    def step(self, equations, t, state, h):
        if t > 0.05:
            raise mbdkit.StepError("newton-failed", "the stage equations were not solved on purpose")
        return super().step(equations, t, state, h)


class Slow(Verlet):
    def step(self, equations, t, state, h):
        time.sleep(0.3)
        return super().step(equations, t, state, h)


@mbdkit.hookimpl
def mbdkit_integrators():
    claims = mbdkit.Claims(order=2)
    return [mbdkit.IntegratorPlugin(kind.__name__.lower(), "A method.", BaseModel, create=kind,
            claims=lambda options: claims) for kind in (Verlet, Broken, Slow)]
"""
OWN = ("gauss, stages 3, index-1", "dop853, adaptive, index-1, projected", "radau-iia, stages 3, ggl")
CHOSEN = ("pendulum-tolerances", "floating-slider-crank", "floating-slider-crank-tolerances")
"""Families; strangers with fixed steps have two runs, because each slow one takes as long as its limit."""


def selection() -> dict[str, Any]:
    """Return the short form of the study with two problems and three methods of mbdkit."""
    spec: dict[str, Any] = dict(spec_of(True)) | {"verdict": "methods"}
    spec["overrides"]["limits"]["wall_time"] = 1.5
    families = {name: spec["families"][name] for name in CHOSEN}
    for family in families.values():
        methods, settings = family["axes"]
        chosen = [value for value in methods["method"] if value["label"] in OWN]
        family["axes"] = [{"method": chosen}, settings]
    return spec | {"families": families}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    """Run the selection by the command, with three methods of a stranger."""
    folder = tmp_path_factory.mktemp("methods")
    install_module(folder / "site", "stranger", STRANGER)
    (folder / "tiny.yaml").write_text(yaml.safe_dump(selection(), sort_keys=False))
    methods = [word for name in ("verlet", "broken", "slow") for word in ("--with", name)]
    command = ("-m", "mbdkit", "study", "tiny.yaml", "-o", "out", "--workers", "1", *methods)
    result = python(*command, path=(folder / "site",), cwd=folder)
    assert result.returncode == 0, result.stderr
    return mbdkit.load_study(folder / "out")


@pytest.fixture(scope="module")
def verdict(done: mbdkit.Study) -> Verdict:
    """The verdict on the runs of the selection."""
    return judge(done)


def test_every_method_has_each_formulation_that_it_claims_and_the_problem_allows() -> None:
    families = load_study_spec("methods", quick=True).families
    assert {name.removesuffix("-tolerances") for name in families} == set(problems())
    labels = {name: [value["label"] for value in family.axes[0]["method"]] for name, family in families.items()}
    ways = ("index-1", "index-1, projected", "index-2", "index-3", "ggl", "joint-coordinates")
    assert {f"radau-iia, stages 3, {way}" for way in ways} < set(labels["andrews"])
    assert {f"radau-iia, stages 3, {way}" for way in ways[:-1]} == {
        label for label in labels["pendulum"] if label.startswith("radau")
    }
    assert "scipy-lsoda, index-1" in labels["andrews-tolerances"]
    assert "light-cart-pole" not in families  # it has no fixed step
    whole = load_study_spec("methods")
    further = [len(labels[f"{name}-tolerances"]) for name, problem in problems().items() if problem.tightest]
    assert len(PlannedPoints(whole)) == 2 * sum(len(names) * 2 for names in labels.values()) + sum(further)


def test_only_studies_with_a_short_form_have_one() -> None:
    with pytest.raises(SpecError, match=r"^--quick: only packaged studies"):
        load_study_spec("convergence", quick=True)


def test_a_stranger_joins_in_the_formulation_that_it_claims(done: mbdkit.Study) -> None:
    assert done.spec.added == ("verlet, index-1", "broken, index-1", "slow, index-1")
    runs = [point for point in done.points if point.axes["method"] == "verlet, index-1"]
    assert [(point.family, point.status) for point in runs] == [("floating-slider-crank", "complete")] * 2


def test_errors_are_those_of_the_problem(verdict: Verdict) -> None:
    # expected: a run of the problem by itself; references of forces are right to many more digits than Verlet's method
    problem = problems()["floating-slider-crank"]
    names = [column.label for column in verdict.table("results").columns]
    rows = {row[:2]: dict(zip(names, row, strict=True)) for row in verdict.table("results").rows}
    row = rows["floating-slider-crank", "gauss, stages 3, index-1"]
    run = mbdkit.run(problem.spec(0.0025, integrator={"name": "gauss", "stages": 3}))
    assert row["error"] == pytest.approx(max(problem.errors(run).values()), rel=1e-3)  # all results are smaller than 1
    assert row["evaluations"] == run.stats["rhs_evaluations"]
    assert row["by mbdkit"] == 0
    stranger = rows["floating-slider-crank", "verlet, index-1"]
    assert row["error of forces"] < 1e-6 < stranger["error of forces"] < 0.1
    assert_within(stranger["misalignment"], 1e-12)  # it projects every step
    assert stranger["by mbdkit"] > 0


def test_published_results_are_reached_by_families_of_integrators(verdict: Verdict) -> None:
    # expected: the source is right to 6e-9, which Gauss and Radau IIA, one family, and DOP853 reach
    (row,) = verdict.table("published").rows
    assert row[:5] == ("floating-slider-crank", "sum", "0.5916491633788333", 6.0e-9, 2)
    assert set(row[5].split(", ")) == {"gauss", "radau-iia", "dop853"}
    assert row[6] == ""  # SciPy and SUNDIALS took no part
    (claim,) = verdict.claims
    assert claim.computed == "3 integrators of 2 families: implicit Runge-Kutta, explicit Runge-Kutta"


def test_methods_that_fail_are_shown_with_their_reason(verdict: Verdict) -> None:
    failures = {row[:2]: row[2:] for row in verdict.table("failures").rows}
    runs, names, reason = failures["broken, index-1", "newton-failed"]
    assert (runs, names) == (2, "floating-slider-crank")
    assert "the stage equations were not solved on purpose" in reason
    runs, names, reason = failures["slow, index-1", "wall-time"]
    assert (runs, names) == (2, "floating-slider-crank")
    assert "limits.wall_time" in reason


def test_the_page_has_each_problem_with_its_source_and_figure(
    done: mbdkit.Study, verdict: Verdict, tmp_path: Path
) -> None:
    page = study_report(done).html()
    for name, lines in (("pendulum", OWN[1:2]), ("floating-slider-crank", ("verlet, index-1", *OWN))):
        problem = problems()[name]
        assert problem.source in page
        assert problem.title in page
        assert {*lines} == {line.label for line in verdict.figure(f"work-precision-{name}").lines}
    assert "a limit of 1.5 s of wall time" in page
    files = write_chart_images(verdict.figures, tmp_path / "figures")
    pictures = [file for file in files if file.suffix == ".png"]
    assert len(pictures) == 2
    assert all(file.read_bytes().startswith(b"\x89PNG\r\n\x1a\n") and file.stat().st_size > 5000 for file in pictures)
