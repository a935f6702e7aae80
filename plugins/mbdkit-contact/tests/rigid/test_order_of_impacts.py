"""The remark on simultaneous impacts whose order would change the velocities."""

from __future__ import annotations

from typing import Any

import pytest
from tests.rigid import scenes
from tests.rigid.scenes import FLOOR, outline

import mbdkit

TREATMENTS = [("event-driven", "rk4"), ("time-stepping", "moreau-jean")]


def remarks(found: mbdkit.Run) -> list[str]:
    return [sentence for sentence in found.warnings if "coincide" in sentence]


def run(treatment: tuple[str, str], model: dict[str, Any], end: float) -> mbdkit.Run:
    return scenes.run(model, end, 0.01, *treatment)


def cradle(gap: float, restitution: float = 1.0) -> dict[str, Any]:
    places, circle = [-0.3, 0.2, 0.4 + gap], {"circle": {"radius": 0.1}}
    bodies = {f"ball{i}": {"mass": 1.0, "inertia": 0.01, "position": [x, 0.0]} for i, x in enumerate(places)}
    bodies["ball0"]["velocity"] = [1.0, 0.0]
    contacts = {
        f"c{i}": {"bodies": [f"ball{i}", f"ball{i + 1}"], "shapes": [circle, circle], "restitution": restitution}
        for i in range(2)
    }
    return {"gravity": [0.0, 0.0], "bodies": bodies, "contacts": contacts}


def box(half_width: float, half_height: float, restitution: float, friction: float = 0.0) -> dict[str, Any]:
    a, b = half_width, half_height
    contact = {"bodies": ["ground", "box"], "shapes": [FLOOR, outline(a, b)]}
    body = {"mass": 1.0, "inertia": (a * a + b * b) / 3.0, "position": [0.0, b + 0.05]}
    return {
        "bodies": {"box": body},
        "contacts": {"floor": contact | {"restitution": restitution, "friction": friction}},
    }


@pytest.mark.parametrize("treatment", TREATMENTS)
def test_a_touching_cradle_is_said_to_depend_on_the_order_of_impacts(treatment: tuple[str, str]) -> None:
    # expected: one after another, [0, 0, 1]; together by Newton's law, relative velocities 1 and 0 and the momentum
    found = run(treatment, cradle(0.0), 0.33)
    velocities = [found[f"ball{i}"].velocity[-1, 0] for i in range(3)]
    assert velocities == pytest.approx([-1 / 3, 2 / 3, 2 / 3], abs=1e-12)
    (remark,) = remarks(found)
    assert "'c0' and 'c1'" in remark
    assert found.verdict == "unknown"
    assert list(found.warnings) == [remark]


def test_a_cradle_with_a_gap_has_no_such_remark() -> None:
    found = run(TREATMENTS[0], cradle(1e-6), 0.33)
    assert [found[f"ball{i}"].velocity[-1, 0] for i in range(3)] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
    assert remarks(found) == []


@pytest.mark.parametrize("treatment", TREATMENTS)
@pytest.mark.parametrize(
    ("model", "depends"),
    [
        # Without restitution, an impact at one corner changes the velocity of the other by (k^2 - a^2) / (k^2 + a^2) of
        # its own change, with the radius of gyration k and the half width a. For a > k, it presses the other one, and
        # impacts in turn end with both at rest, as one impact of both does. For a < k, it lifts the other one.
        pytest.param(box(0.3, 0.1, 0.0), False, id="wide box, a > k"),
        pytest.param(box(0.3, 0.1, 0.0, 0.3), False, id="wide box with friction"),
        pytest.param(box(0.1, 0.3, 0.0), True, id="narrow box, a < k"),
        pytest.param(box(0.3, 0.1, 0.5), True, id="box that rebounds"),
        # balls that stay together: each impact presses the next one, until all have a third of the velocity
        pytest.param(cradle(0.0, 0.0) | {"gravity": [0.0, -1e-9]}, False, id="plastic balls"),
    ],
)
def test_the_remark_is_given_only_where_the_order_changes_velocities(
    treatment: tuple[str, str], model: dict[str, Any], depends: bool
) -> None:
    assert len(remarks(run(treatment, model, 0.33 if "ball0" in model["bodies"] else 0.12))) == depends
