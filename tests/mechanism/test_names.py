"""Names of elements: whatever a spec accepts, its archive can be read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import mbdkit
from mbdkit.base.errors import SpecError


def spec(kind: str, name: str) -> dict[str, Any]:
    """Return the spec of a pendulum in which the element of a kind has this name."""
    body = name if kind == "bodies" else "rod"
    model: dict[str, Any] = {
        "bodies": {body: {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0]}},
        "joints": {"A": {"type": "revolute", "bodies": ["ground", body], "points": [[0, 0], [-0.5, 0]]}},
        "forces": {"f": {"type": "torque", "body": body, "value": "sin(t)"}},
        "markers": {"k": {"body": body, "point": [0, 0]}},
        "beams": {"c": {"a": [0, 0], "b": [1, 0], "elements": 2, "mass_per_length": 1.0, "rotary_inertia": 0.01,
                        "stiffness": {"axial": 1e7, "shear": "none", "bending": 1e3}}},
        "coordinates": {"q": f"{name if kind == 'joints' else 'A'}.angle"},
    }  # fmt: skip
    if kind not in ("bodies", "events"):
        model[kind] = {name: next(iter(model[kind].values()))}
    made = {"mbdkit": 1, "model": {"name": "mechanism", **model}, "integrator": {"name": "rk4"}}
    return {**made, "time": {"steps": 1, "step": 1e-5}, "events": {name if kind == "events" else "e": {"when": "t"}}}


@pytest.mark.parametrize("kind", ["bodies", "joints", "forces", "markers", "beams", "coordinates", "events"])
def test_the_longest_names_are_read_and_longer_ones_refused(kind: str, tmp_path: Path) -> None:
    mbdkit.run(spec(kind, 255 * "n"), archive=tmp_path / "run.h5").close()
    with mbdkit.load(tmp_path / "run.h5") as run:
        assert run.summary()
    with pytest.raises(SpecError, match="has 256 characters; a name has at most 255"):
        mbdkit.run(spec(kind, 256 * "n"))


def test_the_message_about_a_name_is_shorter_than_the_name() -> None:
    with pytest.raises(SpecError) as refused:
        mbdkit.run(spec("bodies", 100_000 * "n"))
    assert len(str(refused.value)) < 500
