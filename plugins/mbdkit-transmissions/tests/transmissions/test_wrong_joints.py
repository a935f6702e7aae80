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


def test_a_locked_train_and_its_driver_are_named() -> None:
    """Expected: the radii of an odd ring of gears contradict each other, so that a driver cannot turn it."""
    m = mbdkit.Mechanism()
    for name, place in (("a", (0.0, 0.0)), ("b", (0.3, 0.0)), ("c", (0.15, 0.3 * 0.75**0.5))):
        m.body(name, mass=1.0, inertia=0.1, position=place)
        m.revolute(name.upper(), m.ground, name, at=place)
    for name, pair in (("G1", "ab"), ("G2", "bc"), ("G3", "ca")):
        m.gear(name, *pair, radii=(0.15, 0.15))
    m.driver("motor", m.ground, "a", coordinate="angle", motion="t")
    with pytest.raises(SpecError) as error:
        mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.01})
    assert all(name in error.value.message for name in ("G1", "G2", "G3", "motor"))
