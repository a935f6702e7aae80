"""Named parameters and expressions of them in the numbers of a model."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from mbdkit.base.errors import SpecError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.parameters import parameter_values
from mbdkit.spec import load_spec

BODIES = ["ground", "crank"]
CRANK = {"mass": "2*crank", "inertia": "crank**2/12", "angle": "degrees(45)"}
SPRING = {"type": "spring-damper", "bodies": BODIES, "stiffness": "100*speed"}
LAW = {"type": "law", "law": "table", "table": [[0, "crank", 1], [0, "-speed", "2*speed"]]}
SPEC: dict[str, Any] = {
    "mbdkit": 1,
    "parameters": {"half": "0.5*crank", "crank": 0.4, "speed": "3 + 0*half"},
    "model": {
        "name": "mechanism",
        "bodies": {"crank": CRANK | {"position": ["half*cos(degrees(45))", "half*sin(degrees(45))"]}},
        "joints": {
            "A": {"type": "revolute", "bodies": BODIES, "at": [0, 0]},
            "D": {"type": "driver", "bodies": BODIES, "coordinate": "angle", "motion": "degrees(45) + speed*t"},
        },
        "forces": {
            "f": {"type": "force", "body": "crank", "at": ["crank*cos(pi/4)", 0.1], "value": ["speed*t", "half"]},
            "s": SPRING | {"from": ["2*crank", 0], "to": [0.1, 0.1]},
            "p": LAW | {"pathway": {"type": "two-points", "bodies": BODIES, "from": [2, 0], "to": [0, 0]}},
        },
    },
    "integrator": {"name": "rk4"},
    "time": {"end": 1, "step": 0.01},
    "events": {"e": {"when": "crank.angle - degrees(90) - crank"}},
}


@pytest.mark.parametrize("crank", [0.4, 0.3])
def test_numbers_motions_points_and_tables_may_be_expressions(crank: float) -> None:
    spec = load_spec(SPEC, [f"parameters.crank={crank}"])
    m = spec.mechanism()
    body, (c, s) = m.bodies["crank"], (math.cos(math.pi / 4), math.sin(math.pi / 4))
    assert (body.mass, body.inertia) == pytest.approx((2 * crank, crank**2 / 12))
    assert body.angle == math.radians(45)
    assert body.position == pytest.approx((0.5 * crank * c, 0.5 * crank * s))
    assert m.joints["A"].points == (pytest.approx((0, 0)), pytest.approx((-0.5 * crank, 0)))
    assert m.forces["f"].value == ("(3.0)*t", f"({0.5 * crank!r})")
    assert m.to_global("crank", m.forces["f"].point) == pytest.approx((crank * c, 0.1))
    assert (m.forces["s"].stiffness, m.forces["s"].points[0]) == (300, (2 * crank, 0))
    assert m.forces["p"].table == ((0, crank, 1), (0, -3, 6))


def test_whole_numbers_and_lists_of_a_model_may_be_expressions() -> None:
    model = {"name": "n-pendulum", "n": "2*k", "angles": ["degrees(10)", "degrees(-90)", 0, "k"]}
    spec = load_spec({**SPEC, "parameters": {"k": 2}, "model": model, "events": {}})
    assert spec.model.n == 4
    assert spec.model.angles == (math.radians(10), -math.pi / 2, 0, 2)
    with pytest.raises(SpecError, match=r"model\.n: should be a whole number, not 3\.5 \(the value of '2\*k'\)"):
        load_spec({**SPEC, "parameters": {"k": 1.75}, "model": model, "events": {}})


def test_the_canonical_form_keeps_expressions_and_is_read_to_the_same_hash() -> None:
    spec = load_spec(SPEC)
    data = json.loads(spec.canonical_json())
    assert data["parameters"] == SPEC["parameters"]
    assert data["model"]["bodies"]["crank"]["mass"] == "2*crank"
    assert data["model"]["forces"]["p"]["table"] == [[0, "crank", 1], [0, "-speed", "2*speed"]]
    assert data["model"]["forces"]["s"]["from"] == ["2*crank", 0]
    assert data["model"]["joints"]["A"] == {"type": "revolute", "bodies": ["ground", "crank"], "at": [0, 0]}
    again = load_spec(data)
    assert again.sha256() == spec.sha256() == load_spec(spec).sha256()
    assert again.mechanism().to_spec() == spec.mechanism().to_spec()
    assert load_spec(spec, ["parameters.crank=0.3"]).model.bodies["crank"].mass == 0.6
    plain = load_spec({**SPEC, "model": {"name": "single-pendulum"}, "parameters": {}, "events": {}})
    assert "parameters" not in json.loads(plain.canonical_json())


def test_a_mechanism_is_read_with_parameters_and_written_with_numbers() -> None:
    m = Mechanism.from_spec(SPEC["model"], SPEC["parameters"])
    assert m.to_spec() == load_spec(SPEC).mechanism().to_spec()
    assert Mechanism.from_spec(m.to_spec()).to_spec() == m.to_spec()
    with pytest.raises(SpecError, match=r"model\.bodies\.crank\.mass: there is no parameter 'crank'; the spec has no"):
        Mechanism.from_spec(SPEC["model"])


def test_parameters_depend_on_each_other_in_any_order() -> None:
    links = {f"p{i}": f"p{i + 1} + 1" for i in range(1500)}
    assert parameter_values({**links, "p1500": 1})["p0"] == 1501
    assert parameter_values({"a": "max(b, 2)*c", "c": "-b", "b": "sqrt(16)"}) == {"a": -16, "c": -4, "b": 4}


def test_angles_are_pure_numbers_in_expressions() -> None:
    spec = {**SPEC, "parameters": SPEC["parameters"] | {"start": "30 deg"}}
    body = load_spec(spec, ["model.bodies.crank.position=[0.4*sin(start), start/2]"]).mechanism().bodies["crank"]
    assert body.position == pytest.approx((0.2, math.pi / 12))
    with pytest.raises(SpecError, match=r"mass: .*deg"):
        load_spec(spec, ["model.bodies.crank.mass=start"])


@pytest.mark.parametrize("text", ["wrong", "2*wrong"])
def test_misspelled_parameters_get_the_same_hint_alone_and_in_expressions(text: str) -> None:
    with pytest.raises(SpecError, match=r"mass: .*there is no parameter 'wrong'; parameters: half, crank, speed"):
        load_spec(SPEC, [f"model.bodies.crank.mass={text}"])


@pytest.mark.parametrize("text", ["crank/2 - 100 mm", "2*(100 mm)", "crank + 100 mm"])
def test_a_unit_within_an_expression_is_named(text: str) -> None:
    with pytest.raises(SpecError, match="numbers in expressions have no units; make '100 mm' a parameter"):
        load_spec(SPEC, [f"model.bodies.crank.position=[{text}, 0]"])
