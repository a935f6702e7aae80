"""Rigid polygons against polygons, circles and uneven ground, event-driven and by time-stepping."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.rigid import scenes
from tests.rigid.scenes import G, block, outline, run

import mbdkit

TABLE = {"polygon": [[-1.0, -0.5], [0.0, -0.5], [0.0, 0.0], [-1.0, 0.0]]}
"""A table whose corner is the origin."""
EDGE_OF_GROUND = {"polyline": [[-1.0, 0.0], [0.0, 0.0], [0.0, -0.5]]}
"""Ground that ends at the origin like the table."""
TREATMENTS = [("event-driven", 0.02, 1e-8), ("time-stepping", 0.001, 0.01)]
"""Treatment, step [s] and largest error of the position at the end [m]; that of time-stepping is of order 1."""


def on_table(
    body: dict[str, Any], shape: dict[str, Any], friction: float, table: dict[str, Any] = TABLE
) -> dict[str, Any]:
    contact = {"bodies": ["ground", "body"], "shapes": [table, shape], "friction": friction}
    return {"bodies": {"body": {"mass": 1.0} | body}, "contacts": {"table": contact}}


def end_of(found: mbdkit.Run) -> np.ndarray:
    return np.array([*found["body"].position[-1], found["body"].angle[-1]])


def solved(rate: Any, start: list[float], span: tuple[float, float], event: Any = None) -> tuple[float, np.ndarray]:
    """Return end and state [s] of a motion by DOP853, at an event if there is one."""
    if event is not None:
        event.terminal = True
    found = solve_ivp(rate, span, start, method="DOP853", rtol=1e-12, atol=1e-13, events=event)
    return float(found.t[-1]), found.y[:, -1]


def flown(time: float, place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    return place + time * velocity + 0.5 * time**2 * np.array([0.0, -G, 0.0])


@pytest.mark.parametrize(
    ("floor", "wall", "slope", "told"),
    [
        # a box that rests against a wall down the slope: the friction of the floor may carry any part of its weight
        pytest.param(0.5, 0.0, 0.3, ["floor.0", "floor.1", "wall.1"], id="rough floor"),
        # without friction, the two corners at the wall may carry any moment
        pytest.param(0.0, 0.0, 0.3, ["floor.0", "floor.1", "wall.1", "wall.2"], id="smooth floor"),
        pytest.param(0.5, None, 0.3, [], id="no wall"),
        pytest.param(0.0, None, 0.0, [], id="smooth floor alone"),
    ],
)
def test_normal_forces_that_are_not_unique_are_told(
    floor: float, wall: float | None, slope: float, told: list[str]
) -> None:
    box = outline(0.2, 0.1)
    ground = {"line": {"point": [0.0, 0.0], "normal": [0.0, 1.0]}}
    contacts = {"floor": {"bodies": ["ground", "body"], "shapes": [ground, box], "friction": floor}}
    if wall is not None:
        side = {"line": {"point": [0.2, 0.0], "normal": [-1.0, 0.0]}}
        contacts["wall"] = {"bodies": ["ground", "body"], "shapes": [side, box], "friction": wall}
    model = {
        "gravity": [G * np.sin(slope), -G * np.cos(slope)],
        "bodies": {"body": {"mass": 1.0, "inertia": 0.02, "position": [0.0, 0.1]}},
        "contacts": contacts,
    }
    warnings = [one for one in run(model, 0.05, 0.01).warnings if "not unique" in one]
    assert len(warnings) == bool(told)
    assert all(f"'{name}'" in warning for warning in warnings for name in told)


def test_forces_of_a_body_that_joints_hold_are_not_unique() -> None:
    # the joint carries any part of the weight of the first box; the second one rests on the floor
    box, ground = outline(0.2, 0.1), {"line": {"point": [0.0, 0.0], "normal": [0.0, 1.0]}}
    contacts = {
        name: {"bodies": ["ground", body], "shapes": [ground, box], "friction": 0.5}
        for name, body in (("under", "held"), ("floor", "free"))
    }
    bodies = {name: {"mass": 1.0, "inertia": 0.02, "position": [x, 0.1]} for name, x in (("held", 0.0), ("free", 2.0))}
    guide = {"type": "prismatic", "bodies": ["ground", "held"], "at": [0.0, 0.1], "axis": [1.0, 0.0]}
    found = run({"bodies": bodies, "contacts": contacts, "joints": {"guide": guide}}, 0.05, 0.01)
    assert found.status == "complete"
    (warning,) = found.warnings
    assert "'under.0' and 'under.1' are not unique" in warning
    assert found.contacts["floor.0"].normal_force[-1] == pytest.approx(G / 2)


@pytest.mark.parametrize(("table", "corner"), [(TABLE, "table.6"), (EDGE_OF_GROUND, "table.4")])
@pytest.mark.parametrize(("treatment", "step", "error"), TREATMENTS)
def test_a_box_slides_off_a_table_and_tips_around_its_corner(
    treatment: str, step: float, error: float, table: dict[str, Any], corner: str
) -> None:
    # expected: Lagrange's equations with the distance s of the centre along the box from the corner, by DOP853, from
    # the time on at which the centre is above the corner, until the corner no longer pushes; then free flight
    b, h, speed, end = 0.2, 0.1, 0.5, 0.5
    inertia = (b * b + h * h) / 3.0

    def rate(t: float, y: np.ndarray) -> list[float]:
        s, angle, ds, turn = y
        matrix = [[1.0, -h], [-h, h * h + s * s + inertia]]
        right = [s * turn**2 - G * np.sin(angle), -2 * s * ds * turn - G * (s * np.cos(angle) - h * np.sin(angle))]
        return [ds, turn, *np.linalg.solve(matrix, right)]

    def place(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s, angle, ds, turn = y
        along, up = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        return np.append(s * along + h * up, angle), np.append((ds - h * turn) * along + s * turn * up, turn)

    def push(t: float, y: np.ndarray) -> float:  # normal acceleration of the centre, and weight
        s, angle, ds, turn = y
        return float(2 * ds * turn + s * rate(t, y)[3] - h * turn**2 + G * np.cos(angle))

    begin = 0.05 / speed
    leaves, state = solved(rate, [0.0, 0.0, speed, 0.0], (begin, end), push)
    assert begin < leaves < end
    expected = flown(end - leaves, *place(state))
    body = {"inertia": inertia, "position": [-0.05, h], "velocity": [speed, 0.0]}
    with run(on_table(body, outline(b, h), 0.0, table), end, step, treatment) as found:
        assert end_of(found) == pytest.approx(expected, abs=error)
        assert min(np.min(row.gap) for row in found.contacts.values()) > -1e-9
        assert len(found.impacts.time) == 0
        hands_over = [name for name, row in found.contacts.items() if np.any(row.normal_force > 0.1)]
        assert hands_over == ["table.0", corner]  # the box's rear corner, then the corner of the table


def test_polygons_as_ground_give_the_closed_forms_of_lines() -> None:
    # expected: see the tests of the same bodies on lines
    sliding = block(0.3)
    sliding["contacts"]["incline"]["shapes"][0] = {"polygon": [[-4.0, -4.0], [4.0, -4.0], [4.0, 4 / np.sqrt(3)],
                                                              [-4.0, -4 / np.sqrt(3)]]}  # fmt: skip
    found = run(sliding, 1.0, 0.05)
    up = [np.cos(np.radians(30.0)), np.sin(np.radians(30.0))]
    assert found["block"].position[-1] @ up == pytest.approx(-0.362398577094839, abs=1e-11)

    b, h, tilt = 0.1, 0.4, 0.05
    place = [b * np.cos(tilt) - h * np.sin(tilt) - 0.3, b * np.sin(tilt) + h * np.cos(tilt)]
    body = {"inertia": (b * b + h * h) / 3.0, "angle": tilt, "position": [float(x) for x in place]}
    with run(on_table(body, outline(b, h), 5.0), 0.3, 0.02) as found:
        ratio = 1.0 - 1.5 * np.sin(np.arctan(b / h)) ** 2  # Housner
        assert found.impacts.energy_lost[0] == pytest.approx((1 - ratio**2) * G * (place[1] - h), rel=1e-9)


@pytest.mark.parametrize("treatment", ["event-driven", "time-stepping"])
def test_a_pile_of_boxes_stands(treatment: str) -> None:
    # expected: forces of the weights above, whose resultant is below the centre of mass of these
    half, bodies, contacts = 0.1, {}, {}
    for i, x in enumerate((0.0, 0.0, 0.05)):
        bodies[f"b{i}"] = {"mass": 1.0, "inertia": 0.01, "position": [x, half * (2 * i + 1)]}
        below = [f"b{i - 1}", outline(half, half)] if i else ["ground", {"line": {"normal": [0.0, 1.0]}}]
        own = {"bodies": [below[0], f"b{i}"], "shapes": [below[1], outline(half, half)], "friction": 0.5}
        contacts[f"c{i}"] = own
    end = 0.1 if treatment == "event-driven" else 0.03  # a step of time-stepping takes a second
    with run({"bodies": bodies, "contacts": contacts}, end, 0.01, treatment) as found:
        for i, body in enumerate(bodies):
            assert found[body].position[-1] == pytest.approx(bodies[body]["position"], abs=1e-12)
            rows = [row for name, row in found.contacts.items() if name.startswith(f"c{i}.")]
            assert sum(row.normal_force[-1] for row in rows) == pytest.approx((3 - i) * G, rel=1e-9)


def test_edges_that_a_circle_does_not_touch_have_no_overlap() -> None:
    # expected: the distance of the disc from each edge of the table
    body = {"inertia": 0.01, "position": [-0.5, 0.1]}
    with run(on_table(body, {"circle": {"radius": 0.1}}, 0.0), 0.01, 0.01) as found:
        gaps = [row.gap[0] for row in found.contacts.values()]
    assert gaps == pytest.approx([0.5, np.hypot(0.5, 0.1) - 0.1, 0.0, np.hypot(0.5, 0.1) - 0.1], abs=1e-15)


DISC, BOX = {"circle": {"radius": 0.1}}, outline(0.2, 0.1)
COMPLIANCE = {"law": "linear", "stiffness": 1e5, "dissipation": 300.0}
METHODS = {"compliant": "rk4", "event-driven": "dop853", "time-stepping": "moreau-jean"}


def over(
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
    several = over(treatment, polyline(np.column_stack([x, -np.tan(slope) * x])), shape, body)
    one = over(treatment, {"line": {"normal": normal}}, shape, body)
    assert [*several.contacts] == [*one.contacts]
    np.testing.assert_allclose(states(several), states(one), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("treatment", METHODS)
def test_a_ball_in_a_groove_presses_on_both_sides(treatment: str) -> None:
    slope = 0.6
    ground = polyline([[-1.0, np.tan(slope)], [0.0, 0.0], [1.0, np.tan(slope)]])
    found = over(treatment, ground, DISC, {"position": [0.0, 0.1 / np.cos(slope)]}, friction=0.0)
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
    plain = over(treatment, polyline(points @ [[c, s], [-s, c]]), shape, body)
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
    ends = [over(treatment, polyline(part), shape, body, end=0.2) for part in (points, near)]
    np.testing.assert_allclose(states(ends[0])[-1], states(ends[1])[-1], rtol=0.0, atol=1e-9)
    assert min(np.min(row.gap) for row in ends[0].contacts.values()) > (-1e-2 if treatment == "compliant" else -1e-9)


@pytest.mark.parametrize("treatment", ["event-driven", "time-stepping"])
def test_a_box_slides_into_a_concave_corner(treatment: str) -> None:
    # expected: it stops at the wall, at the distance of its half width; time-stepping, up to a step before
    ground = polyline([[-1.0, 0.0], [0.5, 0.0], [0.5, 1.0], [1.0, 1.0]])
    found = over(treatment, ground, BOX, {"position": [0.0, 0.1], "velocity": [2.0, 0.0]}, friction=0.0)
    # margin: error of mbdkit's method at these steps
    assert found["body"].position[-1] == pytest.approx([0.3, 0.1], abs=1e-9 if treatment == "event-driven" else 2e-3)
    assert min(np.min(row.gap) for row in found.contacts.values()) > -1e-9


def test_rigid_contacts_have_no_rolling_resistance() -> None:
    with pytest.raises(mbdkit.SpecError, match="rigid contacts have no rolling resistance") as caught:
        over("event-driven", {"line": {"normal": [0, 1]}}, DISC, {"position": [0.0, 0.1]}, rolling_resistance=1e-3)
    assert caught.value.key == "model.contacts.floor.rolling_resistance"
