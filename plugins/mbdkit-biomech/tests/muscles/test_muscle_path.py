"""Lengths, rates and moment arms of paths against closed forms, derivatives, and OpenSim 4.6; paths in pictures."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.muscles import leg
from tests.muscles.models import directions, leg_mechanism, poses

from mbdkit import Mechanism, RunError, SpecError
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.inverse_dynamics.muscles.fibers import fibers_on_rigid_tendon
from mbdkit_biomech.muscles.muscle_path import MusclePath, muscle_lines
from mbdkit_report import draw_mechanism

OPENSIM = json.loads((Path(__file__).parent / "opensim_muscles.json").read_text())["geometry"]
ANGLES = np.array(leg.ANGLES)
TIME = np.arange(len(ANGLES)) * 0.01
LEG = leg_mechanism()
SHORTER = "wrapped-spatial"
"""OpenSim's path on a cylinder with points of different offsets is not the shortest one."""


def path_of(m: Mechanism, name: str) -> MusclePath:
    return MusclePath(name, m.muscles[name], QuantityNames(m))


def motion() -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Return positions, their derivatives with respect to both angles, and velocities."""
    by_angle = directions(ANGLES[:, :2])
    return poses(ANGLES[:, :2]), by_angle, sum(d * ANGLES[:, 2 + i, None] for i, d in enumerate(by_angle))


@pytest.mark.parametrize("name", [name for name in leg.MUSCLES if name != SHORTER])
def test_lengths_and_rates_are_those_of_opensim(name):
    q, _, v = motion()
    path = path_of(LEG, name).at(TIME, q)
    np.testing.assert_allclose(path.length, OPENSIM[name]["length"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(path.rate(v), OPENSIM[name]["rate"], rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", [name for name in leg.MUSCLES if name not in (SHORTER, "moving")])
def test_moment_arms_are_those_of_opensim(name):
    # OpenSim's solver for moment arms leaves out the work of moving points, so that they are not -dL/dq there.
    q, by_angle, _ = motion()
    path = path_of(LEG, name).at(TIME, q)
    arms = np.stack([-path.rate(one) for one in by_angle], axis=1)
    np.testing.assert_allclose(arms, OPENSIM[name]["arms"], rtol=0, atol=1e-8)


def test_a_path_on_a_cylinder_is_a_geodesic_and_shorter_than_that_of_opensim():
    q, _, _ = motion()
    ours, theirs = path_of(LEG, SHORTER).at(TIME, q).length, np.array(OPENSIM[SHORTER]["length"])
    assert np.all(ours <= theirs + 1e-12)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=5e-5)


@pytest.mark.parametrize("name", leg.MUSCLES)
def test_the_gradient_is_the_derivative_of_the_length(name):
    q, _, _ = motion()
    path, step = path_of(LEG, name), 1e-6
    slopes = np.zeros_like(q)
    for axis in range(q.shape[1]):
        moved = np.zeros(q.shape[1])
        moved[axis] = step
        slopes[:, axis] = (path.at(TIME, q + moved).length - path.at(TIME, q - moved).length) / (2 * step)
    np.testing.assert_allclose(path.at(TIME, q).gradient, slopes, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", [name for name, data in leg.MUSCLES.items() if name != SHORTER])
def test_active_and_passive_force_on_a_rigid_tendon_are_those_of_opensim(name):
    q, _, v = motion()
    path, muscle = path_of(LEG, name).at(TIME, q), LEG.muscles[name]
    fibers = fibers_on_rigid_tendon(name, muscle, TIME, path.length, path.rate(v))
    assert np.max(OPENSIM[name]["capacity"]) > 0.1 * muscle.max_force
    for found, theirs in ((fibers.active, "capacity"), (fibers.passive, "passive")):
        np.testing.assert_allclose(
            found, np.maximum(OPENSIM[name][theirs], 0.0), rtol=1e-8, atol=1e-8 * muscle.max_force
        )


def pulley(circles: list[tuple[float, float]], offset: float = 0.0, side: str = "left") -> Mechanism:
    """Return a rod whose muscle passes circles of radius 0.1 m that are fixed to the ground."""
    m = Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1)
    wraps = [{"wrap": {"body": "ground", "center": c, "radius": 0.1, "side": side}} for c in circles]
    path = [{"body": "ground", "point": (-1.0, 0.0)}, *wraps, {"body": rod, "point": (1.0, 0.0, offset)}]
    m.muscle("m", path, max_force=1.0, optimal_length=1.0, tendon_length=0.0)
    return m


def length_at(m: Mechanism, *q: float) -> float:
    return float(path_of(m, "m").at(np.zeros(1), np.array([q], dtype=float)).length[0])


def test_a_path_over_a_circle_consists_of_two_tangents_and_an_arc():
    planar = 2 * np.sqrt(1 - 0.1**2) + 0.1 * (np.pi - 2 * np.arccos(0.1))
    assert length_at(pulley([(0.0, 0.0)]), 0, 0, 0) == pytest.approx(planar, abs=1e-15)
    assert length_at(pulley([(0.0, 0.0)], offset=0.5), 0, 0, 0) == pytest.approx(np.hypot(planar, 0.5), abs=1e-15)
    assert length_at(pulley([(0.0, 0.0)], side="right"), 0, 0, 0) == pytest.approx(planar, abs=1e-15)


def test_a_path_leaves_a_circle_smoothly_and_is_straight_then():
    m = pulley([(0.0, -0.1)])
    assert length_at(m, 0, 1e-9, 0) == pytest.approx(2.0, abs=1e-15)
    state = [path_of(m, "m").at(np.zeros(1), np.array([[0.0, y, 0.0]])).gradient[0] for y in (-1e-7, 1e-7)]
    np.testing.assert_allclose(state[0], state[1], atol=1e-6)


def test_a_path_over_two_circles_is_the_convex_hull():
    # up to the first circle, along the common tangent, and down again
    m = pulley([(-0.5, 0.0), (0.5, 0.0)])
    side = np.sqrt(0.5**2 - 0.1**2) + 0.1 * (np.pi / 2 - np.arccos(0.1 / 0.5))
    assert length_at(m, 0, 0, 0) == pytest.approx(2 * side + 1.0, abs=3e-15)
    low = pulley([(-0.5, 0.0), (0.5, -0.4)])  # the second circle is not touched
    first = pulley([(-0.5, 0.0)])
    assert length_at(low, 0, 0, 0) == pytest.approx(length_at(first, 0, 0, 0), abs=1e-15)


def test_points_inside_a_circle_and_the_wrong_side_are_refused():
    with pytest.raises(RunError, match=r"has a point of its path inside its circle of radius 0.1 m at t = 0 s"):
        length_at(pulley([(0.95, 0.0)]), 0, 0, 0)
    with pytest.raises(RunError, match="it is on the other side; correct `side`"):
        length_at(pulley([(-1.0, -0.1001)], side="right"), -1.9658, -0.00604, 0)


def test_a_path_that_switches_sides_between_frames_is_refused():
    m = pulley([(0.0, 0.0)], side="left")
    angles = np.linspace(-1.0, -3.2, 12)  # the rod goes around the circle, clockwise
    q = np.column_stack([2 * np.cos(angles) - 1.0, 2 * np.sin(angles), 0 * angles])
    with pytest.raises(RunError, match="switches the side of its circle between"):
        path_of(m, "m").at(np.arange(12.0), q[::-1])


def test_a_tendon_longer_than_the_path_is_named_with_its_time():
    m = pulley([])
    with pytest.raises(RunError, match=r"the tendon of muscle 'm' is longer \(3 m\) than its path \(2 m\) at t = 0.5"):
        fibers_on_rigid_tendon(
            "m", m.muscles["m"].model_copy(update={"tendon_length": 3.0}), np.array([0.5]), np.array([2.0]), np.zeros(1)
        )


ROD = {"bodies": {"rod": {"mass": 1.0, "inertia": 0.1}}}
MUSCLE = {
    "path": [{"body": "ground", "point": [0.0, 1.0]}, {"body": "rod", "point": [0.1, 0.0]}], "max_force": 100.0,
    "optimal_length": 0.1, "tendon_length": 0.2,
}  # fmt: skip


WITH_BEND = {"table": [[0, 1], [0, 1]], "of": "bend"}
CIRCLE = {"body": "rod", "center": [0, 0], "radius": 0.1, "side": "left"}


def with_item(index: int, **item: object) -> dict:
    path = list(MUSCLE["path"])
    path.insert(index, item)
    return MUSCLE | {"path": path}


@pytest.mark.parametrize(
    ("muscle", "key", "message"),
    [
        (MUSCLE | {"optimal_length": -0.1}, "optimal_length", "greater than 0"),
        (MUSCLE | {"tendon_length": -0.1}, "tendon_length", "at least 0"),
        (MUSCLE | {"pennation": 20.0}, "pennation", "angles are in radians"),
        (MUSCLE | {"path": MUSCLE["path"][:1]}, "path", "at least 2 items"),
        (MUSCLE | {"path": [MUSCLE["path"][0]] * 2}, "path", "has all its points on 'ground'"),
        (MUSCLE | {"tendon": "stiff"}, "tendon", "'rigid' or 'elastic'"),
        (MUSCLE | {"optimal": 1.0}, "optimal", "unknown key"),
        (with_item(1, body="rid", point=[0, 0]), "path[1].body", "there is no body 'rid' (did you mean 'rod'?)"),
        (with_item(1, body="rod"), "path[1].point", "is missing"),
        (with_item(1, body="rod", point=[0, 0], when={"rod.x": [1, 0]}), "path[1].when.rod.x", "is empty"),
        (with_item(0, body="rod", point=[0, 0], when={"rod.x": [0, 1]}), "path[0].when", "cannot have `when`"),
        (with_item(1, body="rod", point=["2*bend", 0]), "path[1].point[0]", "neither a coordinate"),
        (with_item(1, body="rod", point=[WITH_BEND, 0]), "path[1].point[0]", "neither a coordinate"),
        (with_item(1, body="rod", point=[{"table": [[0, 1], [0, 1]]}, 0]), "path[1].point[0].of", "is missing"),
        (with_item(1, wrap=CIRCLE | {"radius": 0.0}), "path[1].wrap.radius", "greater than 0"),
        (with_item(0, wrap=CIRCLE), "path[0].wrap", "is a point, not a circle"),
    ],
)
def test_wrong_muscles_get_one_sentence_with_their_key(muscle, key, message):
    with pytest.raises(SpecError) as error:
        Mechanism.from_spec(ROD | {"muscles": {"m": muscle}})
    assert error.value.key.endswith(f"muscles.m.{key}")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_muscle_survives_the_way_to_a_spec_and_back():
    spec = LEG.to_spec()
    assert Mechanism.from_spec(spec).to_spec() == spec
    assert Mechanism.from_spec(spec).muscles == LEG.muscles


def test_numbers_and_moving_points_may_contain_parameters():
    item = {"body": "rod", "point": ["half*tilt + half", "half/5"]}
    spec = ROD | {
        "coordinates": {"tilt": "rod.angle"},
        "muscles": {"m": with_item(1, **item) | {"max_force": "2*half"}},
    }
    m = Mechanism.from_spec(spec, {"half": 0.5})
    assert m.muscles["m"].max_force == 1.0
    q = np.array([[0.0, 0.0, 0.3]])
    own, plain = path_of(m, "m"), with_item(1, body="rod", point=[0.5 * 0.3 + 0.5, 0.1])
    other = path_of(Mechanism.from_spec(ROD | {"muscles": {"m": plain}}), "m")
    assert own.at(np.zeros(1), q).length == pytest.approx(other.at(np.zeros(1), q).length, abs=1e-15)


def test_a_point_may_move_along_a_table_of_a_coordinate():
    angles = np.linspace(-1, 1, 9)
    table = {"table": [angles.tolist(), (0.5 + 0.2 * angles - 0.1 * angles**3).tolist()], "of": "tilt"}
    q = np.random.default_rng(2).normal(0, 0.3, (5, 3))
    coordinates = {"coordinates": {"tilt": "rod.angle"}}
    for x in (table, "0.5 + 0.2*tilt - 0.1*tilt**3"):  # a cubic spline through points of a cubic is the cubic
        item = with_item(1, body="rod", point=[x, 0.1])
        m = Mechanism.from_spec(ROD | coordinates | {"muscles": {"m": item}})
        assert Mechanism.from_spec(m.to_spec()).muscles == m.muscles
        state = path_of(m, "m").at(np.zeros(5), q)
        if x is table:
            first = state
    np.testing.assert_allclose(first.length, state.length, rtol=0, atol=1e-14)
    np.testing.assert_allclose(first.gradient, state.gradient, rtol=0, atol=1e-13)


def test_a_condition_on_an_unknown_quantity_is_refused():
    item = {"body": "rod", "point": [0.05, 0.0], "when": {"knie.angle": [0.0, 1.0]}}
    m = Mechanism.from_spec(ROD | {"muscles": {"m": with_item(1, **item)}})
    with pytest.raises(SpecError, match=r"the mechanism has no quantity 'knie\.angle'"):
        path_of(m, "m")


def test_symbolic_equations_refuse_muscles():
    with pytest.raises(SpecError, match="muscles have no symbolic form"):
        LEG.to_sympy()


def test_a_muscle_is_drawn_through_its_points_and_beside_its_circles():
    m = Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(1.0, 0.0), angle=0.5)
    m.revolute("pin", m.ground, rod, at=(0.0, 0.0))
    m.coordinate("turn", "pin.angle")
    path = [
        {"body": "ground", "point": (-1.0, 0.0)},
        {"wrap": {"body": "ground", "center": (0.0, -0.2), "radius": 0.1, "side": "left"}},
        {"body": rod, "point": (5.0, 5.0), "when": {"turn": [2.0, 3.0]}},
        {"body": rod, "point": ("0.2*turn", 0.0, 0.3)},
        {"body": rod, "point": (0.0, 0.0)},
    ]
    m.muscle("m", path, max_force=1.0, optimal_length=0.1, tendon_length=0.1)
    (places,) = muscle_lines(m.muscles["m"], m)
    assert [body for body, _ in places] == ["ground", "ground", "rod", "rod"]
    x, y = places[1][1]
    assert np.isclose(np.hypot(x, y + 0.2), 0.1)  # on the circle, above its center: a path to the right has left up
    assert y > -0.2
    np.testing.assert_allclose(places[2][1], (0.1, 0.0), atol=1e-15)
    drawing = draw_mechanism(m)
    (line,) = drawing.muscles
    np.testing.assert_allclose(drawing.local[list(line)], [place for _, place in places], atol=1e-12)
    assert not set(line[:1]) & {index for outline in drawing.outlines for index in outline}
