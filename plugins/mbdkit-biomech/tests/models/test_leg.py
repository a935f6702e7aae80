"""The leg: segments against published numbers, consistent poses and motions, and the swing of a pendulum.

Segments of gait2d: csu-hmc/gait2d, data/example_constants.yml (commit 44bb269), Winter's fractions for 75 kg and 1.8 m,
rounded there to four decimals. De Leva's numbers: Journal of Biomechanics 29 (1996) 1223-1230, table 4.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import SpecError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import load_spec
from mbdkit_biomech.models._segments import BodySegments
from mbdkit_biomech.models.leg import LegFourBarOptions, LegOptions, build, build_four_bar

POSE = {"hip_flexion": 0.4, "knee_flexion": 0.9, "ankle_dorsiflexion": -0.2, "trunk_angle": -0.1}
RATES = {"hip_flexion_rate": 1.1, "knee_flexion_rate": -2.3, "ankle_dorsiflexion_rate": 0.7, "trunk_rate": 0.5}
MUSCLE = {
    "path": [{"body": "thigh", "point": [0, 0]}, {"body": "shank", "point": [0, 0]}],
    "max_force": 1, "optimal_length": 0.1, "tendon_length": 0.1, "excitation": 0.1,
}  # fmt: skip
HEEL = {"body": "foot", "point": [0, 0]}
TWICE = {"legs": 2, "symmetric_muscles": True}
RK4 = {"mbdkit": 1, "integrator": {"name": "rk4"}}
GAUSS = {"mbdkit": 1, "integrator": {"name": "gauss", "stages": 3}}
LEGS = [(LegOptions, build), (LegFourBarOptions, build_four_bar)]


def _moving(options: type[LegOptions], build: Any, time: float) -> Mechanism:
    """Return a leg whose joints and trunk moved at constant rates for some time."""
    angles = {key: value + time * RATES[f"{key.removesuffix('_angle')}_rate"] for key, value in POSE.items()}
    velocity = (0.3, -0.8)
    place = (1.0 + 0.3 * time, 2.0 - 0.8 * time)
    mechanism: Mechanism = build(options(root="trunk", hip_position=place, hip_velocity=velocity, **angles, **RATES))
    return mechanism


def test_segments_of_75_kg_and_180_cm_are_those_of_gait2d() -> None:
    person = BodySegments(75.0, 1.8)
    for segment, mass, centre, inertia in (
        (person.trunk, 50.85, 0.3155j, 3.1777),
        (person.thigh, 7.5, -0.1910j, 0.1522),
        (person.shank, 3.4875, -0.1917j, 0.0624),
        (person.foot, 1.0875, 0.0768 - 0.0351j, 0.0184),
    ):
        assert segment.mass == pytest.approx(mass)
        assert segment.centre == pytest.approx(centre, abs=6e-5)  # margin: digits of the publication
        assert segment.inertia == pytest.approx(inertia, abs=6e-5)  # margin: digits of the publication
    assert person.thigh_length == pytest.approx(0.4410)
    assert person.shank_length == pytest.approx(0.4428)
    assert person.heel.real == pytest.approx(-0.06)


@pytest.mark.parametrize(("options", "build"), LEGS)
def test_added_masses_are_on_both_legs_and_turn_nothing(options: Any, build: Any) -> None:
    carried = {"trunk": 8.0, "foot": 2.0}
    both = [build(options(legs=2, root="trunk", added_mass=mass)) for mass in ({}, carried)]
    plain, loaded = (mechanism.bodies for mechanism in both)
    assert both[0].name == both[1].name
    for name, body in loaded.items():
        assert body.mass - plain[name].mass == pytest.approx(carried.get(name.removesuffix("_left"), 0.0))
        assert (body.inertia, body.position) == (plain[name].inertia, plain[name].position)
    with pytest.raises(SpecError, match=r"added_mass\.trunk: should be left out, or use `root: trunk`"):
        build(options(added_mass=carried))


@pytest.mark.parametrize(
    ("table", "mass", "height", "thigh", "centre", "gyration"),
    [("de-leva-female", 61.9, 1.735, 0.3685, 0.3612, 0.364), ("de-leva-male", 73.0, 1.741, 0.4222, 0.4095, 0.329)],
)
def test_de_levas_mean_person_has_the_published_thigh(
    table: str, mass: float, height: float, thigh: float, centre: float, gyration: float
) -> None:
    person = BodySegments(mass, height, table)
    assert person.thigh_length == pytest.approx(thigh)
    assert person.thigh.centre == pytest.approx(-1j * centre * thigh)
    assert person.thigh.inertia == pytest.approx(person.thigh.mass * (gyration * thigh) ** 2)
    legs = 2 * (person.thigh.mass + person.shank.mass + person.foot.mass)
    assert person.trunk.mass + legs == pytest.approx(mass)


@pytest.mark.parametrize(("options", "build"), LEGS)
def test_velocities_are_the_derivative_of_positions(options: type[LegOptions], build: Any) -> None:
    h = 1e-4
    before, leg, after = (_moving(options, build, time) for time in (-h, 0.0, h))
    for name, body in leg.bodies.items():
        first, last = before.bodies[name], after.bodies[name]
        slope = (np.array(last.position) - np.array(first.position)) / (2 * h)
        assert np.array(body.velocity) == pytest.approx(slope, rel=1e-6, abs=1e-6)
        turn = math.remainder(last.angle - first.angle, 2 * math.pi) / (2 * h)
        assert body.angular_velocity == pytest.approx(turn, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(("options", "build"), LEGS)
def test_joints_are_closed_and_markers_stand_at_the_joints(options: type[LegOptions], build: Any) -> None:
    leg = _moving(options, build, 0.0)
    for joint in leg.joints.values():
        places = [leg.to_global(body, point) for body, point in zip(joint.bodies, joint.points, strict=True)]
        assert places[0] == pytest.approx(places[1], abs=1e-15)
    for name in ("hip", "ankle"):
        marker = leg.markers[name]
        body, point = leg.joints[name].bodies[0], leg.joints[name].points[0]
        assert leg.to_global(marker.body, marker.point) == pytest.approx(leg.to_global(body, point), abs=1e-15)


@pytest.mark.parametrize(("options", "build"), LEGS)
def test_the_second_leg_is_a_leg_in_its_own_pose(options: type[LegOptions], build: Any) -> None:
    pose = {key: value for key, value in (POSE | RATES).items() if not key.startswith("trunk")}
    trunk = {"root": "trunk", "trunk_angle": -0.1, "trunk_rate": 0.5, "hip_position": (1.0, 2.0)}
    both, alone = build(options(legs=2, left=pose, **trunk)), build(options(**pose, **trunk))
    for name, body in alone.bodies.items():
        assert both.bodies[name if name == "trunk" else f"{name}_left"] == body
    for joint in both.joints.values():
        places = [both.to_global(body, point) for body, point in zip(joint.bodies, joint.points, strict=True)]
        assert places[0] == pytest.approx(places[1], abs=1e-15)
    assert sum(both.bodies[name].mass for name in ("trunk", *PARTS)) == pytest.approx(75.0)
    assert both.coordinates["knee_flexion_left"].of.partition(".")[0] in ("knee_left", "shank_left")


PARTS = [f"{name}{side}" for name in ("thigh", "shank", "foot") for side in ("", "_left")]


def test_muscles_of_the_second_leg_refer_to_its_own_bodies_coordinates_and_muscles() -> None:
    path = [
        {"body": "trunk", "point": [0, 0]},
        {"body": "thigh", "point": [0, 0.1], "when": {"knee.angle": [-1, 0]}},
        {"wrap": {"body": "thigh", "center": [0, -0.2], "radius": 0.02, "side": "left"}},
        {"body": "shank", "point": [{"table": [[0, 1], [0, 0.1]], "of": "knee_flexion"}, "0.1*knee_flexion"]},
    ]
    muscle = {"max_force": 1, "optimal_length": 0.1, "tendon_length": 0.1, "path": path}
    muscles = {"left": {**muscle, "excitation": "0.1 + muscles.left.rate + joints.knee.angle"}}
    leg = build(LegOptions(legs=2, root="trunk", symmetric_muscles=True, muscles=muscles))
    first, second = leg.muscles["left"], leg.muscles["left_left"]
    assert first.path[1].on == "thigh"
    assert [item.on for item in second.path] == ["trunk", "thigh_left", "thigh_left", "shank_left"]
    assert list(second.path[1].when) == ["knee_left.angle"]
    assert second.path[2].wrap.side == "left"
    assert second.path[3].point[0].of == "knee_flexion_left"
    assert second.path[3].point[1] == "0.1*knee_flexion_left"
    assert second.excitation == "0.1 + muscles.left_left.rate + joints.knee_left.angle"


def test_flexion_of_hip_and_knee_lifts_the_leg_as_when_climbing_a_stair() -> None:
    person = BodySegments(75.0, 1.8)
    leg = build(LegOptions(hip_flexion=math.pi / 2, knee_flexion=math.pi / 2))
    assert leg.to_global("shank", leg.markers["knee"].point) == pytest.approx((person.thigh_length, 0.0))
    ankle = leg.to_global("foot", leg.markers["ankle"].point)
    assert ankle == pytest.approx((person.thigh_length, -person.shank_length))
    heel, toe = (leg.to_global("foot", leg.markers[name].point) for name in ("heel", "toe"))
    assert heel[1] == pytest.approx(toe[1])
    assert heel[0] < ankle[0] < toe[0]


def test_relative_angles_are_flexion_minus_flexion_and_dorsiflexion() -> None:
    run = mbdkit.run({"model": {"name": "leg", **POSE}, **RK4, "time": {"steps": 1, "step": 1e-3}})
    assert run.joints["hip"].angle[0] == pytest.approx(POSE["hip_flexion"] + POSE["trunk_angle"])  # to the ground
    assert run.joints["knee"].angle[0] == pytest.approx(-POSE["knee_flexion"])
    assert run.joints["ankle"].angle[0] == pytest.approx(POSE["ankle_dorsiflexion"])


def test_a_stiff_leg_swings_with_the_period_of_a_compound_pendulum() -> None:
    person = BodySegments(75.0, 1.8)
    whole = person.thigh
    below_knee = person.thigh_length + person.shank_length
    for segment, below in ((person.shank, person.thigh_length), (person.foot, below_knee)):
        whole = whole + type(segment)(segment.mass, segment.centre - 1j * below, segment.inertia)
    about_hip = whole.inertia + whole.mass * abs(whole.centre) ** 2
    exact = 2 * math.pi * math.sqrt(about_hip / (whole.mass * 9.81 * abs(whole.centre)))
    locks = {name: {"type": "driver", "bodies": bodies, "coordinate": "angle", "motion": 0} for name, bodies in
             (("lock-knee", ["thigh", "shank"]), ("lock-ankle", ["shank", "foot"]))}  # fmt: skip
    tilt = math.atan2(whole.centre.real, -whole.centre.imag)  # equilibrium: the foot lies in front of the leg
    model = {"name": "leg", "hip_flexion": -tilt + 1e-4, "joints": locks}
    run = mbdkit.run({"model": model, **GAUSS, "time": {"end": exact, "step": exact / 64}})
    assert run["thigh"].angle[-1] + tilt == pytest.approx(1e-4, rel=1e-6)
    assert run["thigh"].angle[32] + tilt == pytest.approx(-1e-4, rel=1e-6)


def test_the_four_bar_leg_moves_like_the_seated_knee_when_its_thigh_is_held() -> None:
    motion = {**GAUSS, "time": {"end": 0.5, "step": 0.005}}
    locks = {
        "hold": {"type": "driver", "bodies": ["ground", "thigh"], "coordinate": "angle", "motion": math.pi / 2},
        "lock-ankle": {"type": "weld", "bodies": ["shank", "foot"], "at": [0.0, 0.0]},
    }
    person = {"height": 1.78, "body_mass": 75.0}
    seated = mbdkit.run({"model": {"name": "four-bar-knee", "flexion": 0.5, **person}, **motion})
    leg = {"name": "leg-four-bar", "hip_flexion": math.pi / 2, "knee_flexion": 0.5, "joints": locks, **person}
    run = mbdkit.run({"model": leg, **motion})
    # the seated knee counts the angle of a horizontal thigh as 0, and its shank carries the foot
    assert run["shank"].angle == pytest.approx(seated["shank"].angle, abs=1e-9)
    for name in "AB":
        force = np.linalg.norm(run.joints[name].reaction_force, axis=1)
        assert force == pytest.approx(np.linalg.norm(seated.joints[name].reaction_force, axis=1), rel=1e-8)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"hip_velocity": [1, 0]}, r"model\.hip_velocity: with `root: hip` the trunk is at rest"),
        ({"table": "dempster"}, r"model\.table: .*winter"),
        ({"markers": {"toe": HEEL}}, r"model\.markers\.toe: the leg itself has an element of this name"),
        ({"forces": {"s": {"type": "torque", "body": "trunk", "value": 1}}}, r"model\.forces\.s.*trunk"),
        ({"height": -1}, r"model\.height"),
        ({"left": {"hip_flexion": 0.1}}, r"model\.left: is for a second leg only: add `legs: 2`"),
        ({"legs": 3}, r"model\.legs: .*2"),
        ({"name": "leg-four-bar", "knee_flexion": 3.0}, r"model\.knee_flexion: should be between"),
        ({"legs": 2, "markers": {"toe_left": HEEL}}, r"model\.markers\.toe_left"),
        ({**TWICE, "muscles": {"m": MUSCLE, "m_left": MUSCLE}}, r"model\.muscles\.m_left: .* on the second leg under"),
    ],
)
def test_wrong_legs_are_refused_by_key(model: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError, match=message):
        mbdkit.run(load_spec({"model": {"name": "leg", **model}, **RK4, "time": {"end": 1, "step": 0.1}}))
