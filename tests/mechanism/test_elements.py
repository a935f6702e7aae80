"""Elements are strict about their values and know what they hold on to."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

import mbdkit
from mbdkit import Mechanism, SpecError
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.forces import PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.improbable_values import improbable_preloads
from mbdkit.mechanism.joints import Distance, Driver, Prismatic, Revolute, Weld
from mbdkit.mechanism.values import Table

POINTS = ((0.0, 0.0), (1.0, 0.0))


def test_a_body_takes_whole_numbers_lists_and_arrays():
    body = Body(mass=1, inertia=np.float64(2), position=[1, 2], velocity=np.array([3, 4]))
    assert body == Body(mass=1.0, inertia=2.0, position=(1.0, 2.0), velocity=(3.0, 4.0))


SCALARS = [0, -1, math.nan, math.inf, True, "1", None, [1], 10**400]
PAIRS = [[1], [1, 2, 3], "12", 1, None, [1, "2"], [1, True], [1, math.nan], {1, 2}]
MOTIONS = ["", "x", "t.real", "9**9**9", True, None, math.nan, -math.inf, [1], 10**400]


@pytest.mark.parametrize(
    ("model", "key", "value"),
    [
        *((Body, "mass", value) for value in SCALARS),
        *((Body, "position", value) for value in PAIRS),
        *((Distance, "length", value) for value in (0, -1, math.nan)),
        *((Driver, "motion", value) for value in MOTIONS),
    ],
)
def test_values_of_another_kind_or_size_are_refused(model, key, value):
    ends = {"bodies": ("a", "b")}
    right = {
        Body: {"mass": 1},
        Distance: {**ends, "points": POINTS, "length": 1},
        Driver: {**ends, "coordinate": "angle"},
    }
    with pytest.raises(ValidationError):
        model(**right[model] | {key: value})


@pytest.mark.parametrize("value", [0, -1, math.nan, True, "1"])
def test_an_inertia_is_positive_or_left_out(value):
    with pytest.raises(ValidationError):
        Body(mass=1, inertia=value)
    assert Body(mass=1).inertia is None


def test_a_mass_whose_reciprocal_is_infinite_is_refused():
    with pytest.raises(ValidationError, match=r"mass: should be at least 2\.2e-308 kg, .*, not 4\.94066e-324"):
        Body(mass=5e-324)
    with pytest.raises(ValidationError, match=r"inertia: should be at least 2\.2e-308 kg m\^2"):
        Body(mass=1.0, inertia=1e-310)
    m = Mechanism()
    rod = m.body("rod", mass=1e-300, inertia=1.0, position=(1e-10, 0.0))
    m.revolute("A", m.ground, rod, at=(0.0, 0.0))
    with pytest.raises(SpecError, match=r"the bodies, of 1e-300 kg in total and 1e-10 m in size, are too small"):
        mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.05})


@pytest.mark.parametrize("key", ["angle", "angular_velocity"])
def test_a_point_mass_does_not_turn(key):
    with pytest.raises(ValidationError, match="point mass"):
        Body(mass=1, **{key: 0.1})


def test_elements_are_frozen_and_know_their_keys():
    with pytest.raises(ValidationError):
        Body(mass=1).mass = 2
    with pytest.raises(ValidationError):
        Body(mass=1, weight=9.81)


TABLE = {"table": [[0, 1, 2.5], [3, 1, 4]]}


def test_a_table_is_kept_as_written_and_reads_back():
    driver = Driver(bodies=("a", "b"), coordinate="angle", motion=TABLE)
    assert driver.motion == Table(table=((0.0, 1.0, 2.5), (3.0, 1.0, 4.0)))
    assert driver.motion.span == (0.0, 2.5)
    assert Driver.model_validate(driver.model_dump()) == driver
    assert Driver.model_validate_json(driver.model_dump_json()) == driver
    assert hash(driver.motion) == hash(Table(**TABLE))


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        ({}, "should be {table"),
        ({"tabel": [[0, 1], [0, 1]]}, "should be {table"),
        ({**TABLE, "kind": "linear"}, "should be {table"),
        ({"table": 3}, "a column of times and a column of values"),
        ({"table": [[0, 1]]}, "a column of times and a column of values"),
        ({"table": [[0, 1], [0, 1], [0, 1]]}, "a column of times and a column of values"),
        ({"table": ["01", [0, 1]]}, "a list of numbers"),
        ({"table": [[0, 1], [0]]}, "as many values as times; it has 1 and 2"),
        ({"table": [[0], [1]]}, "two points or more, not 1"),
        ({"table": [[], []]}, "two points or more, not 0"),
        ({"table": [[0, 1, 1], [1, 2, 3]]}, "times must increase: 1.0 comes after 1.0"),
        ({"table": [[0, 2, 1], [1, 2, 3]]}, "times must increase: 1.0 comes after 2.0"),
        ({"table": [[0, 1], [1, math.nan]]}, "a finite number, not nan"),
        ({"table": [[0, math.inf], [1, 2]]}, "a finite number, not inf"),
        ({"table": [[0, 1], [1, 10**400]]}, "a finite number"),
        ({"table": [[0, 1], [1, "2"]]}, "a finite number, not '2'"),
        ({"table": [[0, True], [1, 2]]}, "a finite number, not True"),
    ],
)
def test_a_table_is_two_columns_of_finite_numbers_with_increasing_times(motion, words):
    with pytest.raises(ValidationError) as caught:
        Driver(bodies=("a", "b"), coordinate="angle", motion=motion)
    assert words in str(caught.value)
    with pytest.raises(ValidationError):
        Table(**motion)


def test_the_direction_of_a_slide_has_length_one_and_its_axis_stays_as_written():
    slide = Prismatic(bodies=("a", "b"), points=POINTS, axis=(3, -4))
    assert (slide.axis, slide.direction) == ((3.0, -4.0), (0.6, -0.8))
    for size in (1e-320, 5e-200, 1e200, 1.7e308):
        slide = Prismatic(bodies=("a", "b"), points=POINTS, axis=(size, -size))
        assert slide.direction == pytest.approx((0.5**0.5, -(0.5**0.5)), rel=1e-15)


@pytest.mark.parametrize("axis", [(0, 0), (0.0, -0.0), (1,), (1, 0, 0), None, (math.nan, 1), ("1", 0)])
def test_a_slide_needs_a_direction(axis):
    with pytest.raises(ValidationError):
        Prismatic(bodies=("a", "b"), points=POINTS, axis=axis)


def test_a_driver_takes_points_only_where_they_mean_something():
    assert Driver(bodies=("a", "b"), coordinate="x", motion=0).point == (0.0, 0.0)
    assert Driver(bodies=("a", "b"), coordinate="x", motion=0, points=POINTS).point == (1.0, 0.0)
    with pytest.raises(ValidationError, match="takes no points"):
        Driver(bodies=("a", "b"), coordinate="angle", motion=0, points=POINTS)
    with pytest.raises(ValidationError, match="from the origin of the first body"):
        Driver(bodies=("a", "b"), coordinate="y", motion=0, points=((1, 0), (0, 0)))
    with pytest.raises(ValidationError):
        Driver(bodies=("a", "b"), coordinate="z", motion=0)


@pytest.mark.parametrize("key", ["stiffness", "damping", "free_length"])
def test_a_spring_has_no_negative_parameters(key):
    with pytest.raises(ValidationError):
        SpringDamper(bodies=("a", "b"), points=POINTS, **{key: -1.0})


def test_rows_and_units_name_the_constraints():
    assert Revolute(bodies=("a", "b"), points=POINTS).rows == ("x", "y")
    assert Distance(bodies=("a", "b"), points=POINTS, length=1).units == ("m",)
    slide, weld = Prismatic(bodies=("a", "b"), points=POINTS, axis=(1, 0)), Weld(bodies=("a", "b"), points=POINTS)
    assert (slide.rows, slide.units) == (("normal", "angle"), ("m", "rad"))
    assert (weld.rows, weld.units) == (("x", "y", "angle"), ("m", "m", "rad"))
    assert slide.angles() == weld.angles() == [("bodies[0]", "a"), ("bodies[1]", "b")]
    angle, x = (Driver(bodies=("a", "b"), coordinate=coordinate, motion=0) for coordinate in ("angle", "x"))
    assert (angle.rows, angle.units, x.rows, x.units) == (("angle",), ("rad",), ("x",), ("m",))


def test_elements_say_which_points_they_hold_and_whose_angle_they_use():
    spring = SpringDamper(bodies=("a", "b"), points=POINTS)
    assert spring.attachments() == [("points[0]", "a", (0.0, 0.0)), ("points[1]", "b", (1.0, 0.0))]
    assert spring.angles() == []
    across = Driver(bodies=("a", "b"), coordinate="y", motion=0, points=POINTS)
    assert across.attachments() == [("points[1]", "b", (1.0, 0.0))]
    assert across.angles() == [("bodies[0]", "a")]
    assert TorsionSpring(bodies=("a", "b")).angles() == [("bodies[0]", "a"), ("bodies[1]", "b")]
    assert Torque(body="a", value=1, reaction_body="b").angles() == [("body", "a"), ("reaction_body", "b")]
    assert PointForce(body="a", value=(0, "t"), point=(1, 2)).attachments() == [("point", "a", (1.0, 2.0))]


def test_points_go_to_the_global_frame_and_back():
    body = Body(mass=1, inertia=1, position=(1, 2), angle=math.pi / 2)
    assert body.to_global((3, 0)) == pytest.approx((1, 5))
    assert body.to_local((1, 5)) == pytest.approx((3, 0))


def test_the_name_of_a_law_as_a_type_gets_the_way_to_write_it() -> None:
    pathway = {"type": "relative-angle", "bodies": ["ground", "a"]}
    model = {"bodies": {"a": {"mass": 1}}, "forces": {"g": {"type": "gas-spring", "pathway": pathway}}}
    with pytest.raises(SpecError, match=r"no type 'gas-spring', but a force law.*`type: law, law: gas-spring`"):
        Mechanism.from_spec(model)


def test_springs_are_relaxed_at_the_start_or_their_improbable_preload_is_said() -> None:
    def doubts(**keys: object) -> list[str]:
        m = Mechanism()
        rotor = m.body("rotor", mass=1.0, inertia=0.01)
        shank = m.body("shank", mass=3.0, inertia=0.05, position=(0.0, -0.2), angle=-math.pi / 2)
        m.torsion_spring("sea", rotor, shank, stiffness=300.0, **keys)  # 300 pi/2 = 471 N m; 4 kg at 0.2 m: 8 N m
        m.spring_damper("strap", rotor, shank, points=((0, 0), (0, 0)), stiffness=1e3, free_length="start")
        assert m.forces["strap"].free_length == pytest.approx(0.2)
        if keys.get("free_angle") == "start":
            assert m.forces["sea"].free_angle == -math.pi / 2
        return list(improbable_preloads(m))

    assert not doubts(free_angle="start")
    assert not doubts(free_angle=0.0)
    (sentence,) = doubts()
    assert sentence.startswith("spring 'sea' begins with 471 N m")
    assert "write `free_angle: start`" in sentence
