"""Coordinates with names: which quantities they may stand for, and their form in a spec."""

from __future__ import annotations

from typing import Any

import pytest

from mbdkit import Mechanism, SpecError
from mbdkit.mechanism.mechanism_data import NamedCoordinate
from mbdkit.spec import load_spec

MODEL: dict[str, Any] = {
    "name": "mechanism",
    "bodies": {"shank": {"mass": 3.0, "inertia": 0.05, "position": [0.0, -0.2]}},
    "joints": {"knee": {"type": "revolute", "bodies": ["ground", "shank"], "at": [0, 0]}},
    "markers": {"ankle": {"body": "shank", "point": [0.0, -0.2]}},
}


def test_a_coordinate_is_a_quantity_or_one_with_scale_and_offset() -> None:
    names = {"flexion": {"of": "knee.angle", "scale": "-2*half", "offset": "degrees(90)"}, "height": "ankle.y"}
    m = Mechanism.from_spec(MODEL | {"coordinates": names}, {"half": 0.5})
    assert m.coordinates == {
        "flexion": NamedCoordinate(of="knee.angle", scale=-1.0, offset=1.5707963267948966),
        "height": NamedCoordinate(of="ankle.y"),
    }
    assert m.to_spec()["coordinates"]["height"] == "ankle.y"
    assert Mechanism.from_spec(m.to_spec()).coordinates == m.coordinates


def test_the_builder_adds_the_same() -> None:
    m = Mechanism.from_spec(MODEL)
    m.coordinate("flexion", "knee.angle", scale=-1.0)
    m.coordinate("height", "shank.y")
    assert m.coordinates["flexion"] == NamedCoordinate(of="knee.angle", scale=-1.0)
    with pytest.raises(SpecError, match="the name 'height' is already in use"):
        m.coordinate("height", "ankle.y")


def test_the_model_of_a_loaded_spec_is_refused_with_what_to_use_instead() -> None:
    spec = load_spec("four-bar")
    with pytest.raises(SpecError, match=r"the mechanism of a loaded spec is `spec\.mechanism\(\)`"):
        Mechanism.from_spec(spec.model)  # type: ignore[arg-type]


def test_the_name_of_a_coordinate_is_not_that_of_a_quantity() -> None:
    Mechanism.from_spec(MODEL | {"coordinates": {"a.b": "knee.angle"}})
    with pytest.raises(SpecError, match=r'coordinates."shank.angle": is the name of a quantity'):
        Mechanism.from_spec(MODEL | {"coordinates": {"shank.angle": "knee.angle"}})
