"""Worst cases over tolerances, compared with closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.spec.loading import load_spec
from mbdkit_studies.report.study_headlines import headlines
from mbdkit_studies.report.study_summary import outcome
from mbdkit_studies.report.worst_cases import is_bounded_by_corners

SPEED, GRAVITY = 100.0, 9.81


def rotor(tolerances: object, **sections: object) -> dict[str, Any]:
    """Return a study of a rotor with an eccentric mass."""
    base = {
        "mbdkit": 1,
        "parameters": {"m": 2.0, "r": 0.005},
        "model": {
            "name": "mechanism",
            "bodies": {"rotor": {"mass": "m", "inertia": 0.01, "position": ["r", 0]}},
            "joints": {
                "bearing": {"type": "revolute", "bodies": ["ground", "rotor"], "at": [0, 0]},
                "motor": {"type": "driver", "bodies": ["ground", "rotor"], "coordinate": "angle", "motion": "100*t"},
            },
        },
        "integrator": {"name": "gauss", "stages": 3},
        "time": {"end": 0.1, "step": 0.001},
        "measures": {"peak": "max(abs(joints.bearing.force))"},
    }
    return {"mbdkit_study": 1, "base": base | sections, "tolerances": tolerances}


def slide(motion: str, **parameters: float) -> dict[str, Any]:
    """Return the sections of a block that moves along x for 1 s."""
    joints = {
        "guide": {"type": "prismatic", "bodies": ["ground", "block"], "at": [0, 0], "axis": [1, 0]},
        "motor": {"type": "driver", "bodies": ["ground", "block"], "coordinate": "x", "motion": motion},
    }
    block = {"mass": 1.0, "inertia": 1.0, "position": [0, 0]}
    model = {"name": "mechanism", "bodies": {"block": block}, "joints": joints}
    measures = {"x": "final(bodies.block.x)"}
    return {"model": model, "parameters": parameters, "measures": measures, "time": {"end": 1.0, "step": 0.1}}


def worst(spec: dict[str, Any], folder: Path) -> tuple[dict[str, Any], str]:
    """Return the first worst case of a study as data and as text."""
    study = mbdkit.study(spec, out=folder)
    ((_, text), *_) = headlines(study)
    return outcome(study)["worst_cases"][0], text  # type: ignore[index]


def largest(m: float, r: float) -> float:
    return m * (r * SPEED**2 + GRAVITY)


def test_the_worst_case_of_a_rotor_has_the_largest_mass_and_radius(tmp_path: Path) -> None:
    spec = rotor({"m": {"plus": "50 g", "minus": 0.05}, "r": {"plus": 1e-4}})
    with pytest.raises(SpecError, match="units of the same kind"):
        mbdkit.study(spec, out=tmp_path / "wrong")
    spec["tolerances"]["m"] = {"plus": 0.05, "minus": 0.05}
    case, text = worst(spec, tmp_path / "study")
    assert case["largest"]["value"] == pytest.approx(largest(2.05, 0.0051), rel=1e-9)
    assert case["smallest"]["value"] == pytest.approx(largest(1.95, 0.005), rel=1e-9)
    assert case["base"]["value"] == pytest.approx(largest(2.0, 0.005), rel=1e-9)
    assert not case["bound"]  # the radius changes the motion
    assert "worst of 6 runs, no bound" in text


@pytest.mark.parametrize(
    ("change", "is_bound"),
    [
        ({}, True),
        ({"measures": {"peak": "min(abs(joints.bearing.force))"}}, False),  # no convex function
        ({"events": {"half": {"when": "rotor.angle - 1"}}}, False),
        ({"parameters": {"m": 2.0, "r": "0.0025*m"}}, False),  # the mass is in a dimension, too
    ],
)
def test_the_largest_force_is_a_bound_only_where_it_is_convex_in_the_tolerances(
    change: dict[str, object], is_bound: bool
) -> None:
    spec = load_spec(rotor({}, **change)["base"])
    (measure,) = spec.defined_measures()
    assert is_bounded_by_corners(spec, ["parameters.m"], measure.expression) == is_bound


def test_gradients_find_the_corner_of_seven_tolerances(tmp_path: Path) -> None:
    """The travel is an alternating sum, so that its largest deviation is the sum of all tolerances."""
    names = [f"a{number}" for number in range(7)]
    motion = "(" + " ".join(f"{'+-'[number % 2]} {name}" for number, name in enumerate(names)).lstrip("+ ") + ")*t"
    sections = slide(motion, **dict.fromkeys(names, 1.0))
    tolerances = {name: {"plus": 0.01 * (k + 1), "minus": 0.01 * (k + 1)} for k, name in enumerate(names)}
    case, _ = worst(rotor(tolerances, **sections), tmp_path / "study")
    assert case["worst_of"] == 1 + 2 * 7 + 2
    assert case["largest"]["value"] == pytest.approx(1.0 + 0.28, rel=1e-9)
    assert case["smallest"]["value"] == pytest.approx(1.0 - 0.28, rel=1e-9)


def test_a_maximum_inside_the_limits_is_told(tmp_path: Path) -> None:
    spec = rotor({"phase": {"plus": 0.1, "minus": 0.1}}, **slide("sin(phase + pi/2)*t", phase=0.0))
    _, text = worst(spec, tmp_path / "study")
    assert "NOT MONOTONE in phase" in text


@pytest.mark.parametrize(
    ("tolerances", "words"),
    [
        ({"mass": {"plus": 1}}, "there is no parameter 'mass'"),
        ({"m": {}}, "needs `plus` or `minus` above 0"),
        ({"m": {"plus": -1}}, "should be a number from 0 on"),
        ({"m": {"plus": "5 %"}}, "should be a size in the unit of the number"),
        ({"time.step": {"plus": 1}}, "is no parameter of the mechanism"),
        ({"model.bodies.rotor.mass": {"plus": 1}}, "is the text or expression 'm'"),
    ],
)
def test_wrong_tolerances_are_refused(tolerances: object, words: str, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="tolerances") as error:
        mbdkit.study(rotor(tolerances), out=tmp_path / "study")
    assert words in error.value.message
