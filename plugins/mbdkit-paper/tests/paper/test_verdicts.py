"""The paper's claims on synthetic studies that satisfy or violate them, and on runs."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.guide.pages import find_page
from mbdkit.registry.manager import registry
from mbdkit.spec import load_spec
from mbdkit_paper.paper import substitution_timing
from mbdkit_paper.paper.computation_time import SPEED_UP, times
from mbdkit_paper.paper.paper_predictions import joints, knee, steps_within
from mbdkit_paper.paper.published_results import magnitudes, ranking
from mbdkit_paper.paper.source_paper import BIBTEX, TITLE
from mbdkit_paper.wording import UNDECIDED
from mbdkit_report import Answer, Range, exceeds
from mbdkit_studies.results.judge import judge
from mbdkit_studies.spec.study_loading import load_study_spec
from tests.benchmarks.paper_page import OF_A_MACHINE, full_entry
from tests.first_party import ROOT

YES, NO, PARTLY, OPEN = Answer.YES, Answer.NO, Answer.PARTLY, Answer.OPEN
METHODS = ("RK-Gill", "Gauss 2", "Gauss 3")
TIMED = ("time-bodies", "substitution")


def study_of(family: str, points: Iterator[tuple[dict[str, Any], float]], status: str = "complete") -> Any:
    """Return a stand-in for a study: points of one family with their axes and largest misalignment [m]."""
    return SimpleNamespace(
        points=[
            SimpleNamespace(
                family=family, axes=axes, status=status, reason="", values={"misalignment_max": largest}, label=""
            )
            for axes, largest in points
        ],
        run=lambda point: None,
    )


def published(factor: float) -> Any:
    """Return the paper's four misalignments (PAPER: 1e-6, 1e-5, 1e-10, 1e-8 m) times a factor, RK-Gill's far above."""
    stated = {"single": (1e-3, 1e-6, 1e-10), "double": (1e-2, 1e-5, 1e-8)}
    return study_of(
        "published",
        (
            ({"model": model, "integrator": method}, value * (factor if method != "RK-Gill" else 1))
            for model, values in stated.items()
            for method, value in zip(METHODS, values, strict=True)
        ),
    )


@pytest.mark.parametrize(("factor", "answer"), [(1.0, YES), (2.5, YES), (0.4, YES), (5.0, NO), (0.1, NO), (3.0, OPEN)])
def test_published_magnitudes_hold_within_a_factor_of_three(factor: float, answer: Answer) -> None:
    claim, table = magnitudes(published(factor))
    assert claim.answer is answer
    assert [row[4] for row in table.rows] == pytest.approx([factor] * 4)


def test_missing_runs_leave_the_magnitudes_open() -> None:
    study = published(1.0)
    study.points[1].status = "missing"
    assert magnitudes(study)[0].answer is OPEN


def test_rk_gill_is_worst_only_where_it_is() -> None:
    assert ranking(published(1.0))[0].answer is YES
    gill, _, table = ranking(published(1e4))  # now two stages are at 1e-2 and 1e-1 m, RK-Gill at 1e-3 and 1e-2
    assert gill.answer is PARTLY
    assert "Exceptions: 1 rod of 20 m" in gill.sentence
    assert [row[5] for row in table.rows] == ["partly", "partly"]


def test_a_method_that_overflows_is_the_worse_one() -> None:
    study = published(1.0)
    study.points[0].status, study.points[0].reason = "failed", "not-finite: numbers overflowed."
    assert ranking(study)[0].answer is YES
    study.points[1].status, study.points[1].reason = "failed", "newton-failed: in step 1."
    assert "1 of 1 pairs" in ranking(study)[0].sentence


def chain(factor: Callable[[int], float]) -> Any:
    """Return chains of 1 to 10 joints whose misalignment grows by ``factor(joint)`` with each further one."""
    values = np.cumprod([1e-12, *(factor(number) for number in range(2, 11))])
    return study_of(
        "joints",
        (
            ({"model.n": number + 1, "integrator": method, "time.step": 0.1}, float(values[number]))
            for number in range(10)
            for method in METHODS
        ),
    )


def test_a_factor_of_thirty_per_joint_keeps_the_prediction() -> None:
    claim, table, _ = joints(chain(lambda number: 30.0))
    assert claim.answer is YES
    assert claim.computed.startswith("a factor of 30 to 30 for the second joint")
    assert all(row[4] == pytest.approx(30.0) for row in table.rows if row[2] != 1)


def test_a_factor_of_two_per_joint_breaks_it() -> None:
    assert joints(chain(lambda number: 2.0))[0].answer is NO


def test_a_factor_at_the_second_joint_only_is_partly() -> None:
    claim, _, _ = joints(chain(lambda number: 30.0 if number == 2 else 2.0))
    assert claim.answer is PARTLY
    assert claim.sentence.startswith("The misalignment does not grow by a factor of 10 to 100 with each further joint")
    assert ": the factor is 30 to 30" in claim.sentence


STEPS = np.geomspace(0.001, 0.2, 15)


@pytest.mark.parametrize("order", [4, 6])
def test_steps_that_keep_a_range_are_found_between_the_runs(order: int) -> None:
    # expected: c (h / 0.1)^p lies in [1e-3, 1] from h = 0.1 (1e-3 / c)^(1/p) to 0.1 (1 / c)^(1/p)
    low, high = steps_within(STEPS, 5.0 * (STEPS / 0.1) ** order, Range(1e-3, 1.0))
    assert low == pytest.approx(0.1 * (1e-3 / 5) ** (1 / order), rel=1e-9)
    assert high == pytest.approx(0.1 * (1 / 5) ** (1 / order), rel=1e-9)


def test_steps_end_where_the_runs_end() -> None:
    assert steps_within(STEPS, np.full(15, 0.1), Range(1e-3, 1.0)) == (STEPS[0], STEPS[-1])
    values = np.full(15, 0.1)
    values[10:] = math.nan
    assert steps_within(STEPS, values, Range(1e-3, 1.0)) == (STEPS[0], STEPS[9])
    assert all(map(math.isnan, steps_within(STEPS, np.full(15, 10.0), Range(1e-3, 1.0))))


def knees(at_paper: dict[str, float]) -> Any:
    """Return knees whose misalignment [mm] at a step of 0.1 s is given and falls with the method's order."""
    orders = {"RK-Gill": 4, "Gauss 2": 4, "Gauss 3": 6}
    return study_of(
        "knee",
        (
            (
                {"model.springs": springs, "integrator": method, "time.step": float(step)},
                1e-3 * at_paper[method] * (step / 0.1) ** orders[method],
            )
            for springs in ("support spring", "no spring")
            for method in METHODS
            for step in STEPS
        ),
    )


def test_knee_prediction_names_the_steps_at_which_both_hold() -> None:
    # expected: two stages from 0.1 (1e-3 / 0.1)^(1/4) = 0.0316 s on, three up to 0.1 (1e-4 / 1e-2)^(1/6) = 0.0464 s
    claims, table, figure = knee(knees({"RK-Gill": 10.0, "Gauss 2": 0.1, "Gauss 3": 1e-2}))
    assert [claim.answer for claim in claims] == [PARTLY, PARTLY, PARTLY]
    assert claims[-1].computed == "both hold for steps of 0.032 to 0.046 s"
    assert "1.0e-02 mm, outside it" in claims[1].sentence
    assert (len(table.rows), len(figure.lines), len(figure.bands)) == (30, 6, 2)


def test_knee_prediction_fails_where_no_step_keeps_both() -> None:
    claims, _, _ = knee(knees({"RK-Gill": 10.0, "Gauss 2": 1e-4, "Gauss 3": 1e2}))
    assert claims[-1].answer is NO


def part_of_the_paper() -> dict[str, Any]:
    """Return the packaged study `paper` without all families but the first, and bodies 1 and 2 of the third."""
    spec: dict[str, Any] = json.loads(load_study_spec("paper").canonical_json())
    families = {name: spec["families"][name] for name in ("published", "bodies")}
    families["bodies"]["axes"][0]["model.n"] = [1, 2]
    families["bodies"]["repeats"] = 2
    return spec | {"families": families}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    """Return a part of the packaged study `paper`."""
    return mbdkit.study(part_of_the_paper(), out=tmp_path_factory.mktemp("study") / "paper")


def test_part_of_the_paper_decides_what_it_can_and_leaves_the_rest_open(small: mbdkit.Study) -> None:
    # expected: the four published magnitudes (PAPER, section 4). A busy machine can slow the few milliseconds of a
    # compiled run tenfold: the answer on substitution has to agree with the measured ratio, which is some 50,000 on
    # an idle machine.
    verdict = judge(small)
    answers = {claim.name: claim.answer for claim in verdict.claims}
    assert answers["magnitudes"] is answers["gill-worst"] is YES
    ratio = verdict.table("substitution").rows[1][3]
    assert isinstance(ratio, float)
    assert ratio > 1000
    assert answers["substitution"] is exceeds(ratio, SPEED_UP)
    knee = ("knee-gauss2", "knee-gauss3", "knee-both")
    for name in ("orders", "growth", *knee, "per-joint", "coordinates", "adaptive", "stages"):
        assert answers[name] is OPEN
        assert verdict.claim(name).sentence == UNDECIDED
    json.dumps(verdict.to_dict(), allow_nan=False)


@pytest.mark.slow
def test_added_methods_stand_beside_the_papers_and_leave_its_claims_alone(small: mbdkit.Study, tmp_path: Path) -> None:
    added = ("rattle, index-3", "scipy-dop853")
    plain = judge(small)
    study = mbdkit.study(part_of_the_paper(), out=tmp_path / "with", with_=["rattle", "scipy-dop853"])
    shutil.copytree(small.folder / "measured", study.folder / "measured")
    verdict = judge(study)
    claims, same = ([one for one in each.claims if one.name not in TIMED] for each in (verdict, plain))
    assert claims == same
    assert [line.label for line in verdict.figure("trajectory-double").lines] == [*METHODS, *added]
    assert [column.label for column in verdict.table("time-bodies").columns[1::2]] == [*METHODS, *added]
    rows = verdict.table("added").rows
    assert [(row[0], row[5]) for row in rows if row[1] == "published, single"] == [
        ("rattle, index-3", "1 of 5"),  # it closes the joints
        ("scipy-dop853", "3 of 5"),  # its misalignment lies between those of Gauss 3 and Gauss 2
    ]


def timed(fast: Callable[[int], float], slow: float = 1.02) -> Any:
    """Return chains of 1 to 10 bodies with the shortest of their times [s] and a ratio of upper quartile to it."""
    study = study_of(
        "bodies", (({"model.n": n, "integrator": method}, 0.0) for n in range(1, 11) for method in METHODS)
    )
    for point in study.points:
        seconds = fast(point.axes["model.n"])
        point.values = {"wall_min_s": seconds, "wall_q3_s": slow * seconds}
        point.values |= {"rhs_evaluations": 6000, "jacobian_evaluations": 0, "factorizations": 6000}
    return study


@pytest.mark.parametrize(
    ("study", "answer", "growth"),
    [
        (timed(lambda n: 1e-3 * n), NO, "n^0.9 to n^1.1"),
        (timed(lambda n: 1e-3 * n**3), YES, "n^2.9 to n^3.1"),
        (
            timed(lambda n: 1e-3 * n**2.4, slow=1.6),
            OPEN,
            "n^1.1 to n^3.7",
        ),  # +- ln 1.6 / ln(10/7), the median ratio of n
        (timed(lambda n: 1e-3 * n**2.4 * 2.0 ** (-1) ** n), OPEN, "n^"),  # every second run was slow
    ],
)
def test_growth_of_time_is_undecided_where_the_spread_of_the_times_allows_both(study, answer, growth) -> None:
    claim, table, _ = times(study)
    assert claim.answer is answer
    assert growth in claim.computed
    assert claim.computed.endswith("; operations like n^0.0, n^0.0, n^0.0")
    assert table.rows[4][2] == 12000


def test_substitution_is_measured_once_for_a_folder(small: mbdkit.Study, monkeypatch: pytest.MonkeyPatch) -> None:
    first = judge(small).table("substitution").rows
    monkeypatch.setattr(substitution_timing, "measure", lambda spec: pytest.fail("measured again"))
    assert judge(small).table("substitution").rows == first


def test_a_damaged_file_of_times_is_measured_anew(tmp_path: Path) -> None:
    spec = load_spec("pendulum")
    (tmp_path / "measured").mkdir()
    (tmp_path / "measured" / "substitution.json").write_text('{"a": {"bodies": ')
    (found,) = substitution_timing.measured(tmp_path, [spec])
    assert found > 0.0
    assert substitution_timing.measured(tmp_path, [spec]) == [found]


def test_a_folder_that_cannot_be_written_costs_nothing_but_time(tmp_path: Path) -> None:
    (tmp_path / "measured").write_text("in the way")
    assert substitution_timing.measured(tmp_path, [load_spec("pendulum")])[0] > 0.0


def test_any_study_has_a_general_verdict(tmp_path: Path) -> None:
    # expected: order 4 of Gauss with two stages, in the error and in the misalignment
    spec = {
        "mbdkit_study": 1, "title": "Steps", "base": "double-pendulum",
        "overrides": {"integrator": {"name": "gauss", "stages": 2}, "time": {"end": 0.4, "step": 0.04}},
        "axes": [{"time.step": [0.02, 0.01, 0.005, 0.0025]}],
        "reference": {"integrator": {"name": "gauss", "stages": 5}, "time.step": 0.0025},
    }  # fmt: skip
    verdict = judge(mbdkit.study(spec, out=tmp_path / "study"))
    assert verdict.sentence.startswith("4 of 4 runs are complete.")
    assert "largest with step 0.02 s" in verdict.sentence
    ((_, error, drift),) = verdict.table("order").rows
    assert error == pytest.approx(4.0, abs=0.2)
    assert drift == pytest.approx(4.0, abs=0.3)


def test_an_unknown_verdict_is_refused_before_anything_runs(tmp_path: Path) -> None:
    spec = {"mbdkit_study": 1, "base": "pendulum", "axes": [{"time.step": [0.1]}], "verdict": "papr"}
    with pytest.raises(SpecError, match=r"verdict: there is no verdict 'papr' \(did you mean 'paper'\?\)"):
        mbdkit.study(spec, out=tmp_path / "study")
    assert not (tmp_path / "study").exists()


def test_a_verdict_on_a_study_of_other_axes_is_refused(tmp_path: Path) -> None:
    axes = [{"time.steps": [5], "time.step": [0.1]}]
    family = {"base": "pendulum", "axes": axes, "overrides": {"time": {"steps": 1}}}
    spec = {"mbdkit_study": 1, "families": {"published": family}, "verdict": "paper"}
    with pytest.raises(SpecError, match="requires the families and axes of the packaged study"):
        judge(mbdkit.study(spec, out=tmp_path / "study"))


def reduced() -> dict[str, Any]:
    """Return the packaged study `paper` with all families, but fewer runs in each."""
    spec: dict[str, Any] = json.loads(load_study_spec("paper").canonical_json())
    families = spec["families"]
    families["one-metre"]["axes"][2] = {"time.step": [0.1]}
    families["bodies"]["axes"][0] = {"model.n": [1, 2, 5, 10]}
    families["bodies"]["repeats"] = 2
    families["joints"]["axes"][2] = {"time.step": [0.1], "time.steps": [150]}
    families["knee"]["axes"][0]["model.springs"] = families["knee"]["axes"][0]["model.springs"][:1]
    families["knee"]["axes"][2] = {"time.step": [0.2, 0.1, 0.07, 0.05, 0.035, 0.025, 0.018, 0.0125]}
    kept = ("RK-Gill", "Gauss 2", "Gauss 3", "Gauss 6", "Radau IIA 3")
    methods = families["precision"]["axes"][0]["integrator"]
    families["precision"]["axes"][0]["integrator"] = [entry for entry in methods if entry["label"] in kept]
    tolerances = [1e-4, 1e-6, 1e-8, 1e-10]
    families["adaptive"]["axes"][0] = {"integrator.rtol": tolerances, "integrator.atol": tolerances}
    families["long"]["axes"][0]["model"] = families["long"]["axes"][0]["model"][:1]
    return spec


@pytest.mark.slow
def test_the_paper_is_decided_and_its_second_call_decides_the_same(tmp_path: Path) -> None:
    # expected: published magnitudes and orders of theory; every claim is decided except the one on time,
    # which a busy machine may leave open
    first, second = (judge(mbdkit.study(reduced(), out=tmp_path / "paper", workers=2)) for _ in range(2))
    answers = {claim.name: claim.answer for claim in first.claims}
    assert OPEN not in {name: answer for name, answer in answers.items() if name != "time-bodies"}.values()
    assert answers["magnitudes"] is answers["orders"] is answers["substitution"] is answers["gauss3-better"] is YES
    assert second.claims == first.claims
    names = {figure.name for figure in first.figures}
    assert names >= {"knee-prediction", "work-precision", "work-drift", "time-bodies"}


def test_every_packaged_verdict_has_a_packaged_study() -> None:
    judged = [item.name for item in registry().only("mbdkit").of_kind("study") if item.plugin.verdict is not None]
    own = {"paper", "contact", "drift", "flexible-slider-crank", "methods", "no-drift", "textbook-four-bar"}
    assert own <= set(judged)  # other parts have studies, too
    for name in judged:
        assert load_study_spec(name).verdict == name


README = (ROOT / "README.md").read_text(encoding="utf-8")


def flat(text: str) -> str:
    """Return text on one line, without the marks of quotations."""
    return " ".join(text.replace("\n> ", "\n").split())


def test_the_citation_has_the_title() -> None:
    assert TITLE in flat(README)
    assert TITLE in flat(BIBTEX)


def paper_study(families: tuple[str, ...], folder: Path, workers: int) -> mbdkit.Study:
    """Run some families of the packaged study."""
    spec = json.loads(load_study_spec("paper").canonical_json())
    spec["families"] = {name: family for name, family in spec["families"].items() if name in families}
    return mbdkit.study(spec, out=folder, workers=workers)


def test_the_page_on_the_paper_agrees_with_the_study_on_the_published_misalignments(tmp_path: Path) -> None:
    claim, _ = magnitudes(paper_study(("published",), tmp_path / "paper", workers=1))
    assert claim.answer is Answer.YES
    assert full_entry(claim) in find_page("paper").text


@pytest.mark.slow
def test_the_page_on_the_paper_agrees_with_the_study(tmp_path: Path) -> None:
    # otherwise run: mbdkit study paper -o FOLDER, and python -m tests.benchmarks.paper_page FOLDER
    told = ("published", "one-metre", "joints", "knee", "steps", "precision", "long", "coordinates")
    verdict = judge(paper_study(told, tmp_path / "paper", workers=2))
    assert TITLE in verdict.notes[0]
    decided = [claim for claim in verdict.claims if claim.answer is not Answer.OPEN and claim.name not in OF_A_MACHINE]
    assert len(decided) >= 8
    for claim in decided:
        assert full_entry(claim) in find_page("paper").text
