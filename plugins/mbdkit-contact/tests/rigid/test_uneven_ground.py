"""Uneven ground: polylines against lines, closed forms, other frames, and the treatments against each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.rigid import scenes
from tests.rigid.scenes import G, outline

import mbdkit

DISC, BOX = {"circle": {"radius": 0.1}}, outline(0.2, 0.1)
COMPLIANCE = {"law": "linear", "stiffness": 1e5, "dissipation": 300.0}
METHODS = {"compliant": "rk4", "event-driven": "dop853", "time-stepping": "moreau-jean"}


def run(
    treatment: str,
    ground: dict[str, Any],
    shape: dict[str, Any],
    body: dict[str, Any],
    end: float = 0.4,
    step: float = 1e-3,
    **more: Any,
) -> mbdkit.Run:
    contact = {"bodies": ["ground", "body"], "shapes": [ground, shape], "compliance": COMPLIANCE, "friction": 0.3}
    bodies = {"body": {"mass": 1.0, "inertia": 0.004} | body}
    return scenes.run(
        {"bodies": bodies, "contacts": {"floor": contact | more}}, end, step, treatment, METHODS[treatment]
    )


def polyline(points: Any) -> dict[str, Any]:
    return {"polyline": np.asarray(points, dtype=float).tolist()}


def states(found: mbdkit.Run, name: str = "body") -> np.ndarray:
    return np.column_stack([found[name].position, found[name].angle])


@pytest.mark.parametrize("treatment", METHODS)
@pytest.mark.parametrize("shape", [DISC, BOX])
def test_collinear_points_are_one_line(shape: dict[str, Any], treatment: str) -> None:
    slope = 0.3
    x = np.linspace(-2.0, 2.0, 17)
    normal = [np.sin(slope), np.cos(slope)]
    body = {"position": [0.1 * n for n in normal], "angle": -slope, "velocity": [0.2 * normal[1], -0.2 * normal[0]]}
    several = run(treatment, polyline(np.column_stack([x, -np.tan(slope) * x])), shape, body)
    one = run(treatment, {"line": {"normal": normal}}, shape, body)
    assert [*several.contacts] == [*one.contacts]
    np.testing.assert_allclose(states(several), states(one), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("treatment", METHODS)
def test_a_ball_in_a_groove_presses_on_both_sides(treatment: str) -> None:
    slope = 0.6
    ground = polyline([[-1.0, np.tan(slope)], [0.0, 0.0], [1.0, np.tan(slope)]])
    found = run(treatment, ground, DISC, {"position": [0.0, 0.1 / np.cos(slope)]}, friction=0.0)
    for row in found.contacts.values():
        assert row.normal_force[-1] == pytest.approx(G / (2.0 * np.cos(slope)), rel=1e-6)


@pytest.mark.parametrize("treatment", METHODS)
@pytest.mark.parametrize("shape", [DISC, BOX])
def test_a_polyline_may_belong_to_a_turned_body(shape: dict[str, Any], treatment: str) -> None:
    # expected: the same motion with the points of the polyline turned
    turn = 0.1
    c, s = np.cos(turn), np.sin(turn)
    points = np.array([[-1.0, 0.0], [0.1, 0.0], [0.2, 0.1], [0.5, -0.1], [0.8, -0.1], [1.5, 0.3]])
    body = {"position": [-0.3, 0.15], "velocity": [1.5, 0.0]}
    plain = run(treatment, polyline(points @ [[c, s], [-s, c]]), shape, body)
    model = {
        "bodies": {
            "hill": {"mass": 5.0, "inertia": 1.0, "position": [0.2, -0.3], "angle": turn},
            "body": {"mass": 1.0, "inertia": 0.004} | body,
        },
        "joints": {"held": {"type": "weld", "bodies": ["ground", "hill"], "at": [0.0, 0.0]}},
        "contacts": {
            "floor": {
                "bodies": ["body", "hill"],
                "shapes": [shape, polyline(points - np.array([0.2, -0.3]) @ [[c, -s], [s, c]])],
                "compliance": COMPLIANCE,
                "friction": 0.3,
            }
        },
    }
    turned = scenes.run(model, 0.4, 1e-3, treatment, METHODS[treatment])
    np.testing.assert_allclose(states(turned)[-1], states(plain)[-1], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("treatment", METHODS)
@pytest.mark.parametrize("shape", [DISC, BOX])
def test_ground_far_away_changes_nothing(shape: dict[str, Any], treatment: str) -> None:
    # expected: the motion on the part of the ground that the body reaches; 400 segments are searched by bisection
    x = np.linspace(-10.0, 10.0, 401)
    points = np.column_stack([x, 0.02 * np.cos(37.0 * x) + 0.03 * np.sin(5.0 * x)])
    body = {"position": [0.0, 0.16], "velocity": [0.5, 0.0]}
    near = points[np.abs(x) < 1.0]
    assert len(near) < 50
    ends = [run(treatment, polyline(part), shape, body, end=0.2) for part in (points, near)]
    np.testing.assert_allclose(states(ends[0])[-1], states(ends[1])[-1], rtol=0.0, atol=1e-9)
    assert min(np.min(row.gap) for row in ends[0].contacts.values()) > (-1e-2 if treatment == "compliant" else -1e-9)


@pytest.mark.parametrize("treatment", ["event-driven", "time-stepping"])
def test_a_box_slides_into_a_concave_corner(treatment: str) -> None:
    # expected: it stops at the wall, at the distance of its half width; time-stepping, up to a step before
    ground = polyline([[-1.0, 0.0], [0.5, 0.0], [0.5, 1.0], [1.0, 1.0]])
    found = run(treatment, ground, BOX, {"position": [0.0, 0.1], "velocity": [2.0, 0.0]}, friction=0.0)
    assert found["body"].position[-1] == pytest.approx([0.3, 0.1], abs=1e-9 if treatment == "event-driven" else 2e-3)
    assert min(np.min(row.gap) for row in found.contacts.values()) > -1e-9


def test_rigid_contacts_have_no_rolling_resistance() -> None:
    with pytest.raises(mbdkit.SpecError, match="rigid contacts have no rolling resistance") as caught:
        run("event-driven", {"line": {"normal": [0, 1]}}, DISC, {"position": [0.0, 0.1]}, rolling_resistance=1e-3)
    assert caught.value.key == "model.contacts.floor.rolling_resistance"
