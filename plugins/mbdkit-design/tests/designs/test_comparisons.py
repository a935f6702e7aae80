"""What other settings of the runs would have made of a design, with a method whose errors are known in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.designs.oscillator import (
    COARSE,
    STIFFNESS,
    distance,
    moved,
    stiffness_of_runge_kutta,
    tuned,
    tuned_stiffness,
)

import mbdkit
from mbdkit import SpecError
from mbdkit_design.design_loading import load_design_spec

GILL = {"integrator": {"name": "rk-gill"}, "time.step": COARSE}
RADAU = {"integrator": {"name": "radau-iia", "stages": 3}}


def test_a_coarse_method_believes_in_its_own_optimum_and_the_truth_is_beside_it() -> None:
    # expected: the zero of the amplitude of four-stage methods; in fact, the angle is cos(omega t)
    found = mbdkit.design(tuned(compare={"coarse": GILL, "Radau": RADAU}))
    coarse, radau = found.compared
    assert coarse.believed is not None
    assert coarse.actual is not None
    wrong = stiffness_of_runge_kutta(COARSE)
    assert abs(wrong - tuned_stiffness()) > 1e-3
    assert found.best.variables[STIFFNESS] == pytest.approx(tuned_stiffness(), rel=1e-6)
    assert coarse.believed.variables[STIFFNESS] == pytest.approx(wrong, rel=1e-6)
    assert coarse.believed.goals["goal"] < 1e-12
    assert coarse.actual.goals["goal"] == pytest.approx(np.cos(np.sqrt(wrong)) ** 2, rel=1e-3)
    assert radau.believed is not None
    assert radau.believed.variables[STIFFNESS] == pytest.approx(tuned_stiffness(), rel=1e-6)
    (line,) = (line for line in found.summary().splitlines() if line.startswith("  coarse "))
    assert f"{wrong:.4g}" in line


def test_limits_are_those_of_the_runs_of_the_design() -> None:
    # the coarse method satisfies its limit exactly where it believes that the angle is 0.1; in fact it is not
    limits = {"angle": {"value": "final(wheel.angle)", "min": 0.1, "max": 0.2}}
    found = mbdkit.design(tuned(compare={"coarse": GILL}, subject_to=limits))
    (coarse,) = found.compared
    assert coarse.believed is not None
    assert coarse.believed.measures[""]["angle"] == pytest.approx(0.1, rel=1e-5)
    assert coarse.actual is not None
    actual = np.cos(np.sqrt(coarse.actual.variables[STIFFNESS]))
    assert coarse.actual.measures[""]["angle"] == pytest.approx(actual, rel=1e-6)
    assert coarse.is_feasible == (actual >= 0.1)
    (line,) = (line for line in found.summary().splitlines() if line.startswith("  coarse "))
    assert line.split()[-1] == ("yes" if coarse.is_feasible else "no")


def test_settings_whose_runs_fail_have_no_best_point() -> None:
    found = mbdkit.design(tuned(compare={"short": {"limits.max_steps": 3}}))
    assert found.compared[0].believed is None
    assert "There is no best point with short: a run fails at the start of the variables: max-steps" in found.summary()


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "nothing": ({"compare": {"a": {}}}, "compare.a: needs dotted keys"),
    "a method that is not there": (
        {"compare": {"a": {"integrator.name": "rk5"}}}, r"compare\.a\.\"integrator\.name\".*'rk5'"),
    "no name": ({"compare": {" ": {"time.step": 0.1}}}, "compare: needs printable text as the name of settings"),
    "a name that steers terminals": ({"compare": {"\x1b[31m": {"time.step": 0.1}}}, r"needs printable.*'\\x1b\[31m'"),
    "a variable": ({"compare": {"a": {STIFFNESS: 2.0}}}, "is a variable of the design"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_comparisons_are_refused(case: str) -> None:
    sections, words = WRONG[case]
    with pytest.raises(SpecError, match=words):
        load_design_spec(tuned(**sections))


def test_fronts_are_not_compared() -> None:
    goals = {"a": distance(0, 0), "b": distance(1, 0)}
    with pytest.raises(SpecError, match="compare: is not available for Pareto fronts"):
        load_design_spec(moved(goals, compare={"a": {"time.step": 0.02}}))


@pytest.mark.slow
def test_comparisons_are_added_to_an_optimum_that_is_there_and_stages_are_named(tmp_path: Path) -> None:
    spec, told = tuned(compare={"coarse": GILL}), []  # type: dict[str, Any], list[str]
    found = mbdkit.design(spec, out=tmp_path / "both", optimum_only=True, notify=told.append)
    assert not found.compared
    assert mbdkit.load_design(tmp_path / "both").best == found.best
    assert [text for text in told if "stage" in text] == [
        "stage 1 of 2: optimisation", "stage 2 of 2: errors of the result"]  # fmt: skip
    told.clear()
    mbdkit.design(spec, out=tmp_path / "both", notify=told.append)
    assert [text for text in told if "stage" in text] == ["stage 3 of 3: comparison with coarse"]
    mbdkit.design(spec, out=tmp_path / "once")
    results = [(tmp_path / name / "design.json").read_bytes() for name in ("both", "once")]
    assert results[0] == results[1]


@pytest.mark.slow
def test_the_knee_spring_is_the_same_with_other_methods() -> None:
    packaged = load_design_spec("knee-spring")
    chosen = {name: settings for name, settings in packaged.compare.items() if not name.startswith("RK-Gill")}
    assert sorted(settings["integrator"]["name"] for settings in chosen.values()) == ["dop853", "gauss", "radau-iia"]
    faster = {"optimizer": {"name": "slsqp", "tolerance": 1e-9}, "overrides": packaged.overrides | {"time.step": 0.05}}
    found = mbdkit.design("knee-spring", compare=chosen, **faster)
    for one in found.compared:
        assert one.believed is not None
        assert one.believed.goals["goal"] == pytest.approx(found.best.goals["goal"], rel=1e-3)
        for name, value in found.best.variables.items():
            assert one.believed.variables[name] == pytest.approx(value, rel=1e-3)
    assert found.trust.is_gain["goal"]
    assert found.trust.verdict == "good"
