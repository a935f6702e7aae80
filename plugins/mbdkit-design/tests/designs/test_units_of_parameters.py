"""Units of parameters in the results of designs and studies: as given, as the study gives them, or from their uses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import mbdkit
from mbdkit_design.commands import validate_design
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.design_report import design_report
from mbdkit_studies.compute.study_plan import plan_study
from mbdkit_studies.report.study_report import study_report
from mbdkit_studies.report.study_summary import plan_summary, summary
from mbdkit_studies.spec.study_loading import load_study_spec


def _base() -> dict[str, Any]:
    """Return a slider on a spring; `soft` has a unit, `twice` and `mass` have one by their uses, `ratio` has none."""
    body = {"mass": "mass", "inertia": 1.0, "position": [1.0, 0.0], "velocity": [1.0, 0.0]}
    spring = {"type": "spring-damper", "bodies": ["ground", "block"], "from": [0, 0], "to": [1, 0],
              "stiffness": "ratio*soft + half", "free_length": 0.5}  # fmt: skip
    return {
        "mbdkit": 1,
        "parameters": {"soft": "0.1 kN/m", "half": "twice/2", "twice": 20.0, "mass": 2.0, "ratio": 1.0},
        "model": {"name": "mechanism", "gravity": [0, 0], "bodies": {"block": body}, "forces": {"spring": spring}},
        "integrator": {"name": "rk4"},
        "time": {"end": 0.1, "step": 0.05},
    }


UNITS = {"parameters.soft": "N/m", "parameters.twice": "N/m", "parameters.mass": "kg", "parameters.ratio": ""}


def test_studies_show_the_units_of_parameters(tmp_path: Path) -> None:
    values: dict[str, list[Any]] = {key: [1.0, 2.0] for key in UNITS} | {"parameters.mass": ["1 kg", "2 kg"]}
    given = {
        "mbdkit_study": 1,
        "base": _base(),
        "axes": [{key: listed} for key, listed in values.items()],
        "measures": {"peak": "max(abs(forces.spring.value))"},
    }
    study = mbdkit.study(given, out=tmp_path / "study", workers=1)
    words = "soft 1 N/m, twice 1 N/m, mass 1 kg, ratio 1"
    assert f"({words})" in summary(study)
    page = study_report(study)
    assert page.verdict.table("runs").rows[0][1] == words
    axes = {figure.x.label: figure.x.unit for figure in page.verdict.figures if figure.y.label == "peak"}
    assert axes == {key.removeprefix("parameters."): unit for key, unit in UNITS.items()}
    assert "axis       parameters.soft [N/m]: 2 values: 1.0, 2.0" in plan_summary(plan_study(load_study_spec(given)))


def test_designs_show_the_units_of_parameters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = {
        "mbdkit_design": 1,
        "base": _base(),
        "variables": {"soft": {"bounds": [100.0, 200.0]}, "parameters.mass": {"bounds": ["1 kg", "3000 g"]}},
        "minimize": "max(abs(forces.spring.value))",
        "subject_to": {"speed": {"value": "max(abs(bodies.block.vx))", "max": 0.5}},
        "optimizer": {"name": "slsqp", "max_iterations": 2},  # units are shown wherever the search ends
    }
    design = mbdkit.design(given, out=tmp_path / "design")
    rows = [line.split() for line in design.summary().splitlines()]
    assert {row[0]: row[-1] for row in rows if len(row) in (4, 5) and not row[0].endswith(":")} == {
        "START": "UNIT",
        "soft": "N/m", "parameters.mass": "kg", "goal": "N", "speed": "m/s"}  # fmt: skip
    assert "above its limit of 0.5 m/s" in design.summary()
    with design_report(tmp_path / "design") as page:
        tiles = dict(page.headline)
        assert (tiles["soft"][-4:], tiles["mass"][-3:]) == (" N/m", " kg")
        assert [page.verdict.figure(f"cut-{index}").x.unit for index in (1, 2)] == ["N/m", "kg"]
    validate_design(load_design_spec(given)._document, "design", [])  # type: ignore[arg-type]
    assert "variables    soft [N/m], parameters.mass [kg]" in capsys.readouterr().out
