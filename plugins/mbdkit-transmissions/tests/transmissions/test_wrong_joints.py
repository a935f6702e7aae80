"""Wrong joints are refused by a sentence with the key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

import mbdkit
from mbdkit import SpecError

CASES = yaml.safe_load((Path(__file__).parent / "wrong_inputs.yaml").read_text(encoding="utf-8"))


def spec_with(joint: dict[str, Any]) -> dict[str, Any]:
    """Return the spec of a run of two discs and a point mass with a joint."""
    disc = {"mass": 1.0, "inertia": 0.1}
    bodies = {
        "a": disc | {"position": [0.0, 0.0]},
        "b": disc | {"position": [0.3, 0.0]},
        "c": disc | {"position": [0.6, 0.0]},
        "point": {"mass": 1.0, "position": [0.3, 0.0]},
    }
    model = {"name": "mechanism", "bodies": bodies, "joints": {"J": joint}}
    return {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}}


@pytest.mark.parametrize(
    "case", CASES, ids=[f"{i}-{case['joint']['type']}{case['key']}" for i, case in enumerate(CASES)]
)
def test_wrong_joints_are_refused_by_key(case: dict[str, Any]) -> None:
    with pytest.raises(SpecError) as error:
        mbdkit.run(spec_with(case["joint"]))
    assert error.value.key == f"model.joints.J{case['key']}"
    assert case["says"] in error.value.message
    assert "\n" not in error.value.message


def train(radii: dict[str, tuple[float, float]]) -> mbdkit.Mechanism:
    """Return three discs that turn on the ground, with gears between each two of them."""
    m = mbdkit.Mechanism()
    for name, place in (("a", (0.0, 0.0)), ("b", (0.3, 0.0)), ("c", (0.15, 0.3 * 0.75**0.5))):
        m.body(name, mass=1.0, inertia=0.1, position=place)
        m.revolute(name.upper(), m.ground, name, at=place)
    for name, pair in (("G1", "ab"), ("G2", "bc"), ("G3", "ca")):
        (m.belt if name == "G3" and radii.get("G3") else m.gear)(name, *pair, radii=radii.get(name, (0.15, 0.15)))
    m.driver("motor", m.ground, "a", coordinate="angle", motion="t")
    return m


@pytest.mark.parametrize(
    ("radii", "says"),
    [
        ({}, "turns 'a' by -1 times the angle of 'c', but 'G2' and 'G1' turn it by 1 times this angle"),
        ({"G3": (0.1, 0.05)}, "turns 'a' by 2 times the angle of 'c', but 'G2' and 'G1' turn it by 1 times this angle"),
    ],
)
def test_the_ratio_that_contradicts_those_of_a_closed_train_is_named(
    radii: dict[str, tuple[float, float]], says: str
) -> None:
    with pytest.raises(SpecError) as error:
        train(radii)
    assert error.value.key == "model.joints.G3"
    assert says in error.value.message


def test_a_closed_train_whose_ratios_agree_turns() -> None:
    run = mbdkit.run(train({"G3": (0.1, 0.1)}), integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.01})
    assert run.bodies["c"].angle[-1] == pytest.approx(0.1, abs=1e-12)
