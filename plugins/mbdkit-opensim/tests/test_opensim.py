"""Models compared with OpenSim, where its package is installed, and with closed forms."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import osim_texts as osim
import pytest

import mbdkit
from mbdkit import SpecError
from mbdkit_opensim.building import build_mechanism
from mbdkit_opensim.functions import simm_spline

needs_opensim = pytest.mark.skipif(
    not importlib.util.find_spec("opensim"), reason="the package opensim is not installed"
)

RANGES = {
    "pelvis_tilt": (-0.5, 0.5), "pelvis_tx": (-1, 1), "pelvis_ty": (0.5, 1.2), "hip_flexion": (-0.6, 1.5),
    "knee_angle": (-2.0, 0.05), "ankle_angle": (-0.6, 0.5), "rail_x": (-0.3, 0.3), "swing": (-3, 3),
}  # fmt: skip


@pytest.fixture
def leg(tmp_path: Path) -> Path:
    path = tmp_path / "leg.osim"
    path.write_text(osim.leg())
    return path


def written(tmp_path: Path, text: str) -> str:
    path = tmp_path / "subject.osim"
    path.write_text(text)
    return str(path)


def drawn(seed: int) -> tuple[dict[str, float], dict[str, float]]:
    """Return values and speeds of all coordinates of the leg."""
    rng = np.random.default_rng(seed)
    values = {name: float(rng.uniform(*limits)) for name, limits in RANGES.items()}
    return values, {name: float(rng.normal()) for name in RANGES}


class Witness:
    """The leg in OpenSim at given values and speeds of its coordinates."""

    def __init__(self, path: Path):
        import opensim

        opensim.Logger.setLevelString("error")
        self.model = opensim.Model(str(path))
        self.state = self.model.initSystem()

    def at(self, values: dict[str, float], speeds: dict[str, float]) -> None:
        coordinates = self.model.updCoordinateSet()
        for name, value in values.items():
            coordinates.get(name).setValue(self.state, value, False)
            coordinates.get(name).setSpeedValue(self.state, speeds[name])
        self.model.realizeAcceleration(self.state)

    def marker(self, name: str) -> tuple[list[float], list[float]]:
        marker = self.model.getMarkerSet().get(name)
        place, velocity = marker.getLocationInGround(self.state), marker.getVelocityInGround(self.state)
        return [place.get(0), place.get(1)], [velocity.get(0), velocity.get(1)]

    def acceleration(self, name: str) -> list[float]:
        body = self.model.getBodySet().get(name)
        linear = body.findStationAccelerationInGround(self.state, body.getMassCenter())
        return [linear.get(0), linear.get(1), body.getAngularAccelerationInGround(self.state).get(2)]

    def reaction(self, name: str) -> list[float]:
        found = self.model.getJointSet().get(name).calcReactionOnChildExpressedInGround(self.state)
        return [found.get(1).get(0), found.get(1).get(1), found.get(0).get(2)]


@needs_opensim
def test_markers_are_where_opensim_has_them(leg: Path) -> None:
    witness = Witness(leg)
    for seed in range(20):
        values, speeds = drawn(seed)
        witness.at(values, speeds)
        m = build_mechanism(str(leg), values, speeds)
        for name, marker in m.markers.items():
            if name == "ground_pelvis":
                continue
            place, velocity = witness.marker(name)
            body = m.bodies[marker.body]
            now = body.to_global(marker.held)
            assert now == pytest.approx(place, abs=1e-12)
            arm = np.subtract(now, body.position)
            moved = np.array(body.velocity) + body.angular_velocity * np.array([-arm[1], arm[0]])
            np.testing.assert_allclose(moved, velocity, rtol=0, atol=1e-11)


@needs_opensim
def test_accelerations_and_reactions_are_those_of_opensim(leg: Path) -> None:
    witness = Witness(leg)
    for seed in range(6):
        values, speeds = drawn(seed)
        witness.at(values, speeds)
        run = started(str(leg), values, speeds)
        for name in run.bodies:
            found = [*run[name].acceleration[0], run[name].angular_acceleration[0]]
            np.testing.assert_allclose(found, witness.acceleration(name), rtol=1e-9, atol=1e-8)
        for name in run.joints:
            joint = run.joints[name]
            found = [*joint.reaction_force[0], joint.reaction_torque[0]]
            expected = witness.reaction(name)
            peak = max(np.abs(expected))
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * max(peak, 1.0), err_msg=name)


def started(file: str, values: dict[str, float], speeds: dict[str, float]) -> mbdkit.Run:
    model = {"name": "opensim", "file": file, "initial": values, "speeds": speeds}
    time = {"end": 1e-6, "step": 1e-6}
    return mbdkit.run({"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": time}).check()


def test_coordinates_have_the_values_of_the_file_and_of_the_spec(leg: Path) -> None:
    values, speeds = drawn(3)
    m = build_mechanism(str(leg), values, speeds)
    assert set(m.coordinates) == set(RANGES)
    for name, one in m.coordinates.items():
        owner, _, quantity = one.of.partition(".")
        if owner in m.markers:
            marker = m.markers[owner]
            found = m.to_global(marker.body, marker.held)["xy".index(quantity)]
        elif owner in m.bodies:
            found = m.bodies[owner].angle
        elif owner == "rail":
            joint = m.joints["rail"]
            (a, b), (x, y) = joint.bodies, joint.direction
            here = np.subtract(m.to_local(a, m.to_global(b, joint.points[1])), joint.points[0])
            found = here @ [x, y]
        else:
            found = m.relative_angle(*m.joints[owner].bodies)
        assert one.scale * found + one.offset == pytest.approx(values[name], abs=1e-13)
    assert build_mechanism(str(leg), {}, {}).bodies["pelvis"].position != m.bodies["pelvis"].position


def test_the_joints_of_the_start_hold(leg: Path) -> None:
    values, speeds = drawn(5)
    run = started(str(leg), values, speeds)
    for name in run.joints:
        np.testing.assert_allclose(run.joints[name].misalignment[0], 0.0, rtol=0, atol=1e-14)
        np.testing.assert_allclose(run.joints[name].velocity_misalignment[0], 0.0, rtol=0, atol=1e-13)
    assert run.energy.balance[-1] == pytest.approx(0.0, abs=1e-9)


def test_a_pin_and_a_slide_move_by_their_formulas(tmp_path: Path) -> None:
    # expected: rotation matrices by hand
    bodies = [osim.body("rod", 2.0, (0.3, 0.0, 0.0), 0.06), osim.body("bead", 0.5, (0.0, 0.0, 0.0), 0.001)]
    joints = [
        osim.joint("PinJoint", "pin", "ground", "rod", "turn", at=(1.0, 2.0, 0.5), turned=(0, 0, 0.4)),
        osim.joint("SliderJoint", "slide", "rod", "bead", "way=0.25"),
    ]
    file = written(tmp_path, osim.document(bodies, joints))
    m = build_mechanism(file, {"turn": 0.3}, {"turn": 2.0, "way": -1.0})
    c, s = math.cos(0.7), math.sin(0.7)
    assert m.bodies["rod"].position == pytest.approx((1.0 + 0.3 * c, 2.0 + 0.3 * s), abs=1e-15)
    assert m.bodies["rod"].velocity == pytest.approx((-0.6 * s, 0.6 * c), abs=1e-15)
    assert m.bodies["bead"].position == pytest.approx((1.0 + 0.25 * c, 2.0 + 0.25 * s), abs=1e-15)
    assert m.bodies["bead"].velocity == pytest.approx((-0.5 * s - c, 0.5 * c - s), abs=1e-15)
    assert m.gravity == (0.0, -9.80665)
    assert m.bodies["rod"].inertia == 0.06
    assert m.coordinates["turn"].of == "pin.angle"
    assert m.coordinates["way"].of == "slide.angle"


FORMAT_3 = """<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="30000"><Model name="subject"><gravity>0 -9.80665 0</gravity><BodySet><objects>
<Body name="ground"><mass>0</mass><mass_center>0 0 0</mass_center><Joint/></Body>
<Body name="rod"><mass>2.0</mass><mass_center>0.3 0 0</mass_center><inertia_xx>0.1</inertia_xx>
<inertia_yy>0.1</inertia_yy><inertia_zz>0.06</inertia_zz><inertia_xy>0</inertia_xy><inertia_xz>0</inertia_xz>
<inertia_yz>0</inertia_yz><Joint><PinJoint name="pin"><parent_body>ground</parent_body>
<location_in_parent>1.0 2.0 0.5</location_in_parent><orientation_in_parent>0 0 0.4</orientation_in_parent>
<location>0 0 0</location><orientation>0 0 0</orientation><CoordinateSet><objects><Coordinate name="turn">
<default_value>0</default_value><locked>false</locked></Coordinate></objects></CoordinateSet><reverse>false</reverse>
</PinJoint></Joint></Body>
<Body name="bead"><mass>0.5</mass><mass_center>0 0 0</mass_center><inertia_zz>0.001</inertia_zz><Joint>
<CustomJoint name="slide"><parent_body>rod</parent_body><location_in_parent>0 0 0</location_in_parent>
<orientation_in_parent>0 0 0</orientation_in_parent><location>0 0 0</location><orientation>0 0 0</orientation>
<CoordinateSet><objects><Coordinate name="way"><default_value>0.25</default_value></Coordinate></objects>
</CoordinateSet><SpatialTransform><TransformAxis name="rotation1"><coordinates></coordinates><axis>0 0 1</axis>
<function><Constant><value>0</value></Constant></function></TransformAxis><TransformAxis name="translation1">
<coordinates>way</coordinates><axis>1 0 0</axis><function><LinearFunction><coefficients>1 0</coefficients>
</LinearFunction></function></TransformAxis></SpatialTransform></CustomJoint></Joint></Body></objects></BodySet>
<MarkerSet><objects><Marker name="R.Tip"><body>rod</body><location>0.6 0 0</location></Marker></objects></MarkerSet>
</Model></OpenSimDocument>"""


def test_a_file_of_opensim_3_is_read_like_one_of_opensim_4(tmp_path: Path) -> None:
    # expected: rotation matrices by hand, as above
    m = build_mechanism(written(tmp_path, FORMAT_3), {"turn": 0.3}, {"turn": 2.0, "way": -1.0})
    c, s = math.cos(0.7), math.sin(0.7)
    assert m.bodies["rod"].position == pytest.approx((1.0 + 0.3 * c, 2.0 + 0.3 * s), abs=1e-15)
    assert m.bodies["rod"].inertia == 0.06
    assert m.bodies["bead"].position == pytest.approx((1.0 + 0.25 * c, 2.0 + 0.25 * s), abs=1e-15)
    assert m.bodies["bead"].velocity == pytest.approx((-0.5 * s - c, 0.5 * c - s), abs=1e-15)
    assert m.markers["R.Tip"].point == pytest.approx((0.3, 0.0), abs=1e-15)  # from the centre of mass
    with pytest.raises(SpecError, match="joint 'pin' is reversed, which is not read"):
        build_mechanism(written(tmp_path, FORMAT_3.replace("<reverse>false", "<reverse>true")), {}, {})


def test_a_spline_of_opensim_through_points_of_a_cubic_is_the_cubic() -> None:
    # expected: the end conditions, third differences of four points, are exact for a cubic
    x = np.array([-1.0, -0.4, 0.1, 0.9, 1.5])
    y = 1.0 - 2.0 * x + 0.3 * x**2 - 0.7 * x**3
    at = np.linspace(-1.0, 1.5, 31)
    np.testing.assert_allclose(simm_spline(x, y)(at), 1.0 - 2.0 * at + 0.3 * at**2 - 0.7 * at**3, rtol=0, atol=1e-14)


def test_a_wheel_given_as_custom_joint_rolls(tmp_path: Path) -> None:
    # expected: a disc that rolls down an incline of angle b accelerates by g sin(b) / (1 + J / (m r^2))
    rolling = osim.transform(
        osim.axis("rotation1", "0 0 -1", osim.linear(), "turn"),
        osim.axis("rotation2", "0 1 0", osim.constant(0.0)),
        osim.axis("rotation3", "1 0 0", osim.constant(0.0)),
        osim.axis("translation1", "1 0 0", osim.linear(0.2), "turn"),
    )
    bodies = [osim.body("disc", 3.0, (0.0, 0.0, 0.0), 0.05)]
    joints = [osim.joint("CustomJoint", "roll", "ground", "disc", "turn", turned=(0, 0, -0.3), transform=rolling)]
    run = started(written(tmp_path, osim.document(bodies, joints)), {}, {})
    expected = 9.80665 * math.sin(0.3) / (1 + 0.05 / (3.0 * 0.2**2))
    assert np.linalg.norm(run["disc"].acceleration[0]) == pytest.approx(expected, rel=1e-12)
    assert run["disc"].angular_acceleration[0] == pytest.approx(-expected / 0.2, rel=1e-12)


def test_a_locked_coordinate_makes_a_weld(tmp_path: Path) -> None:
    bodies = [osim.body("rod", 2.0, (0.3, 0.0, 0.0), 0.06)]
    joints = [osim.joint("PinJoint", "pin", "ground", "rod", "turn=0.5=true")]
    m = build_mechanism(written(tmp_path, osim.document(bodies, joints)), {}, {})
    assert m.joints["pin"].type == "weld"
    assert m.joints["pin"].angle == 0.5
    assert not m.coordinates


def test_markers_keep_names_with_dots_and_fit_a_file_of_trajectories(tmp_path: Path) -> None:
    markers = (osim.marker("R.ASIS", "rod", (0.1, 0.0, 0.1)), osim.marker("Top.Head", "rod", (0.3, 0.1, 0.0)))
    model = {"name": "opensim", "file": written(tmp_path, osim.document(ROD, [PIN], markers))}
    angle = np.linspace(0.0, 0.5, 21)
    trc = ["PathFileType\t4\t(X/Y/Z)\tm.trc", "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
           f"100\t100\t{len(angle)}\t2\tmm", "Frame#\tTime\tR.ASIS\t\t\tTop.Head",
           "\t\tX1\tY1\tZ1\tX2\tY2\tZ2", ""]  # fmt: skip
    for i, turned in enumerate(angle):
        c, s = 1000 * math.cos(turned), 1000 * math.sin(turned)
        values = [i + 1, i / 100, 0.1 * c, 0.1 * s, 0, 0.3 * c - 0.1 * s, 0.3 * s + 0.1 * c, 0]
        trc.append("\t".join(map(str, values)))
    (tmp_path / "m.trc").write_text("\n".join(trc))
    run = mbdkit.inverse({"mbdkit": 1, "model": model, "motion": {"file": str(tmp_path / "m.trc"), "columns": {
        f"{name}.{axis}": {"column": f"{name}.{axis}"} for name in ("R.ASIS", "Top.Head") for axis in "xy"},
        "smooth": {"name": "none"}}, "actuators": {"pin": {"joint": "pin"}}})  # fmt: skip
    assert list(run.markers) == ["R.ASIS", "Top.Head"]
    np.testing.assert_allclose(run.joints["pin"].angle, angle, atol=1e-6)


def test_a_run_is_doubtful_without_the_muscles_and_a_contact_of_the_file(tmp_path: Path) -> None:
    forces = (
        "".join(f'<Thelen2003Muscle name="muscle{i}"/>' for i in range(9))
        + '<SmoothSphereHalfSpaceForce name="heel"/><CoordinateActuator name="motor"/>'
    )
    bodies = [osim.body("rod", 2.0, (0.3, 0.0, 0.0), 0.06)]
    joints = [osim.joint("PinJoint", "pin", "ground", "rod", "turn")]
    file = written(tmp_path, osim.document(bodies, joints, more=f"<ForceSet><objects>{forces}</objects></ForceSet>"))
    run = started(file, {}, {})
    assert run.verdict == "doubtful"
    idle, contact, muscles = run.warnings
    assert list(run.verdict_reasons) == [contact, muscles]
    assert contact.startswith("left-out: ")
    assert "SmoothSphereHalfSpaceForce" in contact
    assert "heel" in contact
    assert "has 9 Thelen2003Muscle" in muscles
    assert "muscle0, muscle1, muscle2, muscle3, muscle4, muscle5 and 3 more" in muscles
    assert "motor" in idle


ROD = [osim.body("rod", 2.0, (0.3, 0.0, 0.0), 0.06)]
PIN = osim.joint("PinJoint", "pin", "ground", "rod", "turn")
LINES = osim.points("PiecewiseLinearFunction", [0, 1, 2], [0, 1, 0])


CHAIN = [osim.body(name, 1.0, (0.2, 0.0, 0.0), 0.02) for name in ("upper", "lower", "tip")]
CHAIN_PINS = [
    osim.joint("PinJoint", "first", "ground", "upper", "a=0.3", turned=(0, 0, 0.2)),
    osim.joint("PinJoint", "second", "upper", "lower", "b=0.5", at=(0.4, 0, 0), child_turned=(0, 0, 0.1)),
]
SLIDE = osim.joint("SliderJoint", "third", "upper", "lower", "c=0.1", at=(0.4, 0, 0), turned=(0, 0, 0.3))


def coupler(dependent: str, independent: str, coefficients: str, scale: str = "1") -> str:
    return (
        '<ConstraintSet><objects><CoordinateCouplerConstraint name="coupler"><coupled_coordinates_function>'
        f"<PolynomialFunction><coefficients>{coefficients}</coefficients></PolynomialFunction>"
        f"</coupled_coordinates_function><independent_coordinate_names>{independent}</independent_coordinate_names>"
        f"<dependent_coordinate_name>{dependent}</dependent_coordinate_name><scale_factor>{scale}</scale_factor>"
        "</CoordinateCouplerConstraint></objects></ConstraintSet>"
    )


def on_line(direction: str) -> str:
    return (
        '<ConstraintSet><objects><PointOnLineConstraint name="line"><socket_line_body>/ground</socket_line_body>'
        "<socket_follower_body>/bodyset/rod</socket_follower_body>"
        f"<line_direction_vec>{direction}</line_direction_vec><point_on_line>0 0.1 0</point_on_line>"
        "<point_on_follower>0.5 0 0</point_on_follower></PointOnLineConstraint></objects></ConstraintSet>"
    )


def moved(path: str) -> tuple[mbdkit.Run, dict[str, np.ndarray]]:
    """Return a run of a model over 0.3 s, and its coordinates over time."""
    spec = {"mbdkit": 1, "model": {"name": "opensim", "file": path}, "integrator": {"name": "gauss", "stages": 3}}
    run = mbdkit.run(spec, time={"end": 0.3, "step": 0.005})
    named = build_mechanism(path, {}, {}).coordinates
    return run, {
        name: one.scale * run.joints[one.of.partition(".")[0]].angle + one.offset for name, one in named.items()
    }


@pytest.mark.parametrize(("dependent", "independent"), [("b", "a"), ("a", "b"), ("c", "a")])
def test_a_coordinate_that_follows_another_one_is_coupled_to_it(
    tmp_path: Path, dependent: str, independent: str
) -> None:
    # expected: OpenSim's dependent = scale*f(independent), whose coefficients are in descending powers
    pins = [CHAIN_PINS[0], SLIDE if dependent == "c" else CHAIN_PINS[1]]
    text = osim.document(CHAIN[:2], pins, more=coupler(dependent, independent, "0.2 0.4 0.1", "1.5"))
    run, values = moved(written(tmp_path, text))
    assert np.ptp(values[independent]) > 0.1
    wanted = 1.5 * (0.2 * values[independent] ** 2 + 0.4 * values[independent] + 0.1)
    np.testing.assert_allclose(values[dependent], wanted, atol=1e-8)
    assert run.joints["coupler"].bodies == ("upper", "lower")


def test_a_point_on_a_line_stays_there(tmp_path: Path) -> None:
    free = osim.joint("PlanarJoint", "free", "ground", "rod", "turn=0.4 x=0.2 y=-0.1")
    path = written(tmp_path, osim.document(ROD, [free], more=on_line("1 0.5 0")))
    run = mbdkit.run(
        {"mbdkit": 1, "model": {"name": "opensim", "file": path}, "integrator": {"name": "gauss", "stages": 3}},
        time={"end": 0.3, "step": 0.005},
    )
    angle = run["rod"].angle
    point = run["rod"].position.T + 0.2 * np.stack([np.cos(angle), np.sin(angle)])  # 0.5 m from the frame
    np.testing.assert_allclose(point[1] - 0.1, 0.5 * point[0], atol=1e-8)
    assert np.ptp(point[0]) > 0.01


def custom(*axes: str, coordinates: str = "turn") -> str:
    return osim.joint("CustomJoint", "knee", "ground", "rod", coordinates, transform=osim.transform(*axes))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<OpenSimDocument", "is not XML"),
        ("<html/>", "is not a file of OpenSim: its root is <html>"),
        ('<OpenSimDocument Version="20302"><Model/></OpenSimDocument>', "open it in OpenSim 4 and save it again"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><OpenSimDocument Version="40500"/>', "contains a document type definition"),
        (osim.document(ROD, [osim.joint("PinJoint", "pin", "ground", "rod", "turn", turned=(0.1, 0, 0))]),
         "PinJoint 'pin' is not planar: the z axis of its parent frame"),
        (osim.document(ROD, [osim.joint("BallJoint", "ball", "ground", "rod", "a b c")]),
         "BallJoint 'ball' is not planar"),
        (osim.document(ROD, [osim.joint("PinJoint", "pin", "ground", "rod", "turn", turned=(0, math.pi, 0))]),
         "PinJoint 'pin' is not planar: it turns the z axis of 'rod' around"),
        (osim.document(ROD, [custom(osim.axis("rotation1", "1 0 0", osim.linear(), "turn"))]),
         "CustomJoint 'knee' is not planar: rotation1 turns about [1.0, 0.0, 0.0]"),
        (osim.document(ROD, [custom(osim.axis("translation3", osim.Z, osim.linear(), "turn"))]),
         "translation3 moves along [0.0, 0.0, 1.0]"),
        (osim.document(ROD, [custom(osim.axis("rotation1", osim.Z, osim.linear(), "turn"),
                                    osim.axis("translation1", "1 0 0", LINES, "turn"))]),
         "translation1 of CustomJoint 'knee' has a PiecewiseLinearFunction, whose slope jumps"),
        (osim.document(ROD, [custom(osim.axis("translation1", "1 0 0", osim.linear(), "other"))]),
         "depends on 'other', which is no coordinate of the joint"),
        (osim.document(ROD, []), "body 'rod' has no joint"),
        (osim.document([osim.body("rod", 0.0, (0, 0, 0), 0.1)], [PIN]), "body 'rod' has no mass"),
        (osim.document(ROD, [PIN, PIN.replace('"pin"', '"again"')]), "PinJoint 'again' closes a loop at 'rod'"),
        (osim.document(ROD, [PIN], more='<ConstraintSet><objects><WeldConstraint name="w"/></objects></ConstraintSet>'),
         "WeldConstraint 'w' is a constraint"),
        (osim.document(ROD, [PIN], more=coupler("turn", "other", "1 0")), "couples 'other', which is no free"),
        (osim.document(ROD, [PIN], more=coupler("turn", "turn other", "1 0")), "it depends on 2 coordinates"),
        (osim.document(ROD, [PIN], more=on_line("0 0 1")), "PointOnLineConstraint 'line' is not planar"),
        (osim.document(CHAIN, [*CHAIN_PINS, osim.joint("PinJoint", "third", "lower", "tip", "c")],
                       more=coupler("c", "a", "1 0")), "from which its coordinates do not both follow"),
        (osim.document([osim.body("rod", math.nan, (0, 0, 0), 0.1)], [PIN]),
         "Body 'rod': <mass> should be a finite number"),
        (osim.document(ROD, [PIN.replace("ground_offset</socket", "nowhere</socket")]),
         "refers to the frame 'nowhere'"),
    ],
)  # fmt: skip
def test_what_is_not_planar_or_not_read_is_refused_by_name(tmp_path: Path, text: str, message: str) -> None:
    model = {"name": "opensim", "file": written(tmp_path, text)}
    with pytest.raises(SpecError) as error:
        mbdkit.run({"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}})
    assert error.value.key == "model.file"
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("options", "key", "message"),
    [
        ({"file": "nowhere.osim"}, "model.file", "cannot be read: No such file"),
        ({"file": "/dev/zero"}, "model.file", "this is not a regular file but a pipe, a socket or a device"),
        ({"initial": {"tern": 1.0}}, "model.initial.tern", "there is no coordinate 'tern' (did you mean 'turn'?)"),
        ({"speeds": {"other": 1.0}}, "model.speeds.other", "there is no coordinate 'other'; there are turn"),
    ],
)
def test_wrong_options_are_refused_by_key(tmp_path: Path, options: dict[str, Any], key: str, message: str) -> None:
    model = {"name": "opensim", "file": written(tmp_path, osim.document(ROD, [PIN]))} | options
    with pytest.raises(SpecError) as error:
        mbdkit.run({"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}})
    assert error.value.key == key
    assert message in str(error.value)
