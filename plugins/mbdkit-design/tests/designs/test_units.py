"""Units of bounds, limits and parameters of designs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import mbdkit
from mbdkit import SpecError
from mbdkit_design.design_loading import load_design_spec
from mbdkit_studies.compute.study_plan import plan_study
from mbdkit_studies.report.study_report import study_report
from mbdkit_studies.report.study_summary import plan_summary, summary
from mbdkit_studies.spec.study_loading import load_study_spec


def test_bounds_of_designs_have_units() -> None:
    base = {"mbdkit": 1, "model": {"name": "single-pendulum"}, "integrator": {"name": "rk4"},
            "time": {"end": 1, "step": 0.1}}  # fmt: skip
    design = {"mbdkit_design": 1, "base": base, "minimize": "max(abs(joints.J1.force))"}
    limit = {"torque": {"value": "max(abs(joints.J1.force))", "max": "2 kN"}}
    spec = load_design_spec(design | {"variables": {"model.length": {"bounds": ["20 cm", 1]}}, "subject_to": limit})
    assert (spec.variables["model.length"].bounds, spec.subject_to["torque"].max) == ((0.2, 1.0), 2000.0)
    with pytest.raises(SpecError, match="has the unit rad, but this is a number in m"):
        load_design_spec(design | {"variables": {"model.length": {"bounds": ["20 deg", "1 rad"]}}})


def _base() -> dict[str, Any]:
    """Return a slider on a spring; `soft` has a unit, `twice` and `mass` have one by their uses, `ratio` has none."""
    body = {"mass": "mass", "inertia": 1.0, "position": [1.0, 0.0], "velocity": [1.0, 0.0]}
    spring = {"type": "spring-damper", "bodies": ["ground", "block"], "from": [0, 0], "to": [1, 0],
              "stiffness": "ratio*soft + half", "free_length": 0.5}  # fmt: skip
    return {
        "mbdkit": 1, "parameters": {"soft": "0.1 kN/m", "half": "twice/2", "twice": 20.0, "mass": 2.0, "ratio": 1.0},
        "model": {"name": "mechanism", "gravity": [0, 0], "bodies": {"block": body}, "forces": {"spring": spring}},
        "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.05},
    }  # fmt: skip


UNITS = {"parameters.soft": "N/m", "parameters.twice": "N/m", "parameters.mass": "kg", "parameters.ratio": ""}


def test_studies_show_the_units_of_parameters(tmp_path: Path) -> None:
    values: dict[str, list[Any]] = {key: [1.0, 2.0] for key in UNITS} | {"parameters.mass": ["1 kg", "2 kg"]}
    given = {
        "mbdkit_study": 1, "base": _base(), "axes": [{key: listed} for key, listed in values.items()],
        "measures": {"peak": "max(abs(forces.spring.value))"},
    }  # fmt: skip
    study = mbdkit.study(given, out=tmp_path / "study", workers=1)
    words = "soft 1 N/m, twice 1 N/m, mass 1 kg, ratio 1"
    assert f"({words})" in summary(study)
    page = study_report(study)
    assert page.verdict.table("runs").rows[0][1] == words
    axes = {figure.x.label: figure.x.unit for figure in page.verdict.figures if figure.y.label == "peak"}
    assert axes == {key.removeprefix("parameters."): unit for key, unit in UNITS.items()}
    assert "axis       parameters.soft [N/m]: 2 values: 1.0, 2.0" in plan_summary(plan_study(load_study_spec(given)))
