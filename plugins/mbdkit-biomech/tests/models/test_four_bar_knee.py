"""The knee: its linkage against an independent closed form, its leg against published segments, its start.

Poses, instant centres and the range of the linkage were computed outside of this project, from link lengths and pitches
of the exoskeleton knee of emelieseguin/Group3_Matlab (commit 0664a50), for a height of 1.78 m; in mm and degrees.
"""

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.runs.varied_numbers import Variant
from mbdkit.spec import load_spec
from mbdkit_biomech.models._segments import BodySegments
from mbdkit_biomech.models.four_bar_knee import FourBarKneeOptions, KneeLinks, KneePitches, build, linkage
from tests.margins import assert_within

STRAIGHT = {
    "A": (0.0, 0.0), "B": (41.94754635360194, -14.854405235902805), "C": (10.386835641540381, 25.968156410196304),
    "D": (46.665578718529645, 7.082638128883417),
}  # fmt: skip
INSTANT_CENTRES = [
    (0, 27.264152, 4.137999), (10, 23.217323, 5.437781), (20, 19.137239, 6.411128), (30, 15.297007, 7.006109),
    (40, 11.888682, 7.24538), (50, 8.99302, 7.197874), (60, 6.601869, 6.943735), (70, 4.658761, 6.551983),
    (80, 3.091991, 6.072782), (90, 1.833633, 5.538124), (100, 0.828023, 4.965176), (110, 0.035085, 4.359148),
    (120, -0.567003, 3.714116),
]  # fmt: skip
LINKAGE = linkage(1.78, KneeLinks(), KneePitches())
RANGE = (-90, 158)  # scanned in steps of one degree
FLEXIONS = [-1.2, -0.3, 0.0, 0.35, 1.0, math.pi / 2, 2.2, 2.7]


def point(m, name, local):
    """Position and velocity of a point of a body, from the body's data alone; complex."""
    if name == "ground":
        return complex(*local), 0j
    body = m.bodies[name]
    arm = complex(*local) * np.exp(1j * body.angle)
    return complex(*body.position) + arm, complex(*body.velocity) + 1j * body.angular_velocity * arm


def shank_frame_point(m, straight, local):
    """Global position of a point of the shank's frame, found through the straight leg, where both frames coincide."""
    on_body = straight.to_local("shank", (local.real, local.imag))
    return complex(*m.to_global("shank", on_body))


def test_linkage_of_the_straight_leg_is_that_of_the_source():
    pose = LINKAGE.pose(0.0)
    for name, (x, y) in STRAIGHT.items():
        assert 1000 * getattr(pose, name) == pytest.approx(complex(x, y), abs=1e-11)


@pytest.mark.parametrize(("degrees", "x", "y"), INSTANT_CENTRES)
def test_instant_centre_in_the_tibia_is_that_of_the_source(degrees, x, y):
    centre = LINKAGE.pose(math.radians(degrees)).instant_centre
    assert 1000 * centre == pytest.approx(complex(x, y), abs=1e-6)  # margin: digits of the publication


def test_range_of_crossed_rods_is_that_of_the_source():
    low, high = (math.degrees(limit) for limit in LINKAGE.range)
    assert RANGE[0] - 1 < low <= RANGE[0]
    assert RANGE[1] <= high < RANGE[1] + 1


@pytest.mark.parametrize("flexion", FLEXIONS)
@pytest.mark.parametrize("thigh_angle", [0.0, -math.pi / 2, 2.5])
def test_start_fits_its_joints_to_round_off(flexion, thigh_angle):
    m = build(FourBarKneeOptions(flexion=flexion, thigh_angle=thigh_angle, flexion_rate=4.0, height=1.6))
    for joint in m.joints.values():
        (p, u), (q, v) = (point(m, *held) for held in zip(joint.bodies, joint.points, strict=True))
        assert_within(q - p, 3e-16)
        assert_within(v - u, 1e-14)


@pytest.mark.parametrize("flexion", FLEXIONS)
def test_velocities_are_the_derivative_of_positions_with_flexion(flexion):
    h, rate = 1e-4, -2.5
    before, m, after = (build(FourBarKneeOptions(flexion=flexion + d, flexion_rate=rate)) for d in (-h, 0.0, h))
    for name, body in m.bodies.items():
        first, last = before.bodies[name], after.bodies[name]
        slope = (np.array(last.position) - np.array(first.position)) / (2 * h)
        assert np.array(body.velocity) == pytest.approx(rate * slope, rel=1e-5, abs=1e-6)
        turn = math.remainder(last.angle - first.angle, 2 * math.pi) / (2 * h)
        assert body.angular_velocity == pytest.approx(rate * turn, rel=1e-5)


def test_flexion_turns_the_shank_backwards_against_the_thigh():
    standing = {"thigh_angle": -math.pi / 2}
    straight = build(FourBarKneeOptions(**standing))
    flexed = build(FourBarKneeOptions(**standing, flexion=math.radians(60)))
    assert straight.bodies["shank"].angle == pytest.approx(0.0, abs=1e-15)
    assert flexed.bodies["shank"].angle == pytest.approx(-math.radians(60))
    ankle = complex(0, -0.246 * 1.78)
    assert shank_frame_point(straight, straight, ankle) == pytest.approx(ankle)
    assert shank_frame_point(flexed, straight, ankle).real < -0.3
    assert build(FourBarKneeOptions(flexion_rate=1.0)).bodies["shank"].angular_velocity == -1.0


def test_linkage_is_mounted_with_the_tibial_link_nine_millimetres_below_the_knee():
    m = build(FourBarKneeOptions(thigh_angle=-math.pi / 2))
    a, b, c, d = (complex(*m.to_global(m.joints[j].bodies[1], m.joints[j].points[1])) for j in "ABCD")
    assert (a + b) / 2 == pytest.approx(-0.009j, abs=1e-15)
    middle = (complex(*STRAIGHT["C"]) + complex(*STRAIGHT["D"]) - complex(*STRAIGHT["B"])) / 2000
    assert (c + d) / 2 == pytest.approx(middle - 0.009j, abs=1e-15)


def test_rods_are_uniform_and_as_long_as_their_links():
    m = build(FourBarKneeOptions(rod_mass=0.1, links={"acl": 0.052}))
    acl, pcl = m.bodies["acl"], m.bodies["pcl"]
    assert acl.inertia == pytest.approx(0.1 * 0.052**2 / 12)
    assert pcl.inertia == pytest.approx(0.1 * 0.0472**2 / 12)
    assert m.joints["C"].points[1] == (-0.026, 0.0)
    assert m.joints["B"].points[0] == (0.026, 0.0)


def test_shank_and_foot_are_one_body_by_the_parallel_axis_theorem():
    calf, tarsus = BodySegments(75.0, 1.8).shank, BodySegments(75.0, 1.8).foot_on_shank
    both = calf + tarsus
    assert both.mass == calf.mass + tarsus.mass
    assert both.mass * both.centre == pytest.approx(calf.mass * calf.centre + tarsus.mass * tarsus.centre)
    about_knee = sum(one.inertia + one.mass * abs(one.centre) ** 2 for one in (calf, tarsus))
    assert both.inertia + both.mass * abs(both.centre) ** 2 == pytest.approx(about_knee)
    body = build(FourBarKneeOptions(thigh_angle=-math.pi / 2, height=1.8)).bodies["shank"]
    assert (body.mass, body.inertia) == (both.mass, both.inertia)
    assert complex(*body.position) == pytest.approx(both.centre, abs=1e-15)


@pytest.mark.parametrize("thigh_angle", [0.0, -math.pi / 2, 0.4])
def test_springs_are_held_in_the_frames_of_thigh_and_shank(thigh_angle):
    on_thigh, on_shank = -0.06 + 0.15j, 0.02 - 0.2j
    springs = {"s": {"points": [[-0.06, 0.15], [0.02, -0.2]], "stiffness": 100, "damping": 2, "free_length": 0.3}}
    m = build(FourBarKneeOptions(thigh_angle=thigh_angle, springs=springs))
    spring = m.forces["s"]
    assert (spring.bodies, spring.stiffness, spring.damping, spring.free_length) == (("ground", "shank"), 100, 2, 0.3)
    turn = np.exp(1j * (thigh_angle + math.pi / 2))  # the straight leg's frame in the global one
    assert complex(*spring.points[0]) == pytest.approx(turn * on_thigh)
    assert complex(*m.to_global("shank", spring.points[1])) == pytest.approx(turn * on_shank)
    bent = build(FourBarKneeOptions(thigh_angle=thigh_angle, flexion=1.0, springs=springs))
    assert bent.forces == m.forces


@pytest.mark.parametrize("degrees", [-91, 159, 180, 270, -300, 360])
def test_flexion_beyond_the_crossed_range_is_refused(degrees):
    with pytest.raises(SpecError, match=r"between -1\.571 and 2\.763 rad \(-90\.0 and 158\.3 degrees\)") as caught:
        build(FourBarKneeOptions(flexion=math.radians(degrees)))
    assert caught.value.key == "flexion"


@pytest.mark.parametrize("links", [{"acl": 0.2}, {"pcl": 0.001}, {"tibial": 1.0}])
def test_links_that_cannot_meet_are_refused(links):
    with pytest.raises(SpecError, match="cannot be assembled") as caught:
        build(FourBarKneeOptions(links=links))
    assert caught.value.key == "links"


@pytest.mark.parametrize("name", ["a/b", "ground", "", "knee-damping"])
def test_a_spring_s_name_must_be_usable(name):
    springs = {name: {"points": [[0, 0], [0, -0.1]]}}
    with pytest.raises(SpecError) as caught:
        build(FourBarKneeOptions(springs=springs, damping=1))
    assert caught.value.key == f"springs.{name}"


@pytest.mark.parametrize(
    "values",
    [
        {"height": 0},
        {"body_mass": -70},
        {"rod_mass": 0},
        {"damping": -1},
        {"flexion": math.nan},
        {"links": {"mcl": 0.05}},
        {"pitches": {"femoral": "27"}},
        {"springs": {"s": {"points": [[0, 0]]}}},
        {"springs": [1]},
    ],
)
def test_wrong_parameters_are_refused(values):
    with pytest.raises(ValidationError):
        FourBarKneeOptions(**values)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", ["stiffness", "damping", "free_length"])
def test_runs_with_other_springs_are_computed_by_formulas(number: str) -> None:
    spring: dict[str, Any] = {
        "points": [[0.05, 0.1], [0.05, -0.1]],
        "stiffness": 500.0,
        "damping": 1.0,
        "free_length": 0.15,
    }
    data: dict[str, Any] = {
        "mbdkit": 1,
        "model": {"name": "four-bar-knee", "springs": {"s": spring}},
        "integrator": {"name": "rk4"},
        "time": {"end": 0.05, "step": 0.001},
    }
    formulas = Variant.of(load_spec(data), [("model", "springs", "s", number)])
    assert formulas.places.keys() == {"linear"}
    prepared, other = mbdkit.prepare(data), 1.1 * spring[number]
    spring[number] = other
    assert prepared.run({f"model.springs.s.{number}": other}).data_sha256 == mbdkit.run(data).data_sha256
