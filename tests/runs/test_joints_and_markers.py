"""Angles, travels and reactions of joints in the frames of their bodies, power of drivers, and markers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray
from scipy.interpolate import CubicSpline

import mbdkit
from mbdkit import Mechanism, SpecError
from mbdkit.archive.archive_check import check
from mbdkit.archive.info import describe
from mbdkit.mechanism.joints import Driver, PointOnLine, Prismatic
from tests.runs.recorded_cases import TILT, Recorded, cases, hanging, recorded

GAUSS = {"name": "gauss", "stages": 3}


def turned(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return vectors (T, 2) turned by angles (T,)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vectors[:, 0] - s * vectors[:, 1], s * vectors[:, 0] + c * vectors[:, 1]], axis=1)


def moving_rail() -> Mechanism:
    """Return a turning rail with a block on a slide and a bead driven in both coordinates of the rail."""
    m = Mechanism()
    m.body("rail", mass=1.0, inertia=0.3, position=(0.2, 0.1), angle=0.4)
    m.body("block", mass=0.5, inertia=0.02, position=(0.6, 0.3), angle=1.1)
    m.body("bead", mass=0.3, position=(0.5, 0.2))
    m.revolute("pivot", m.ground, "rail", at=(0.0, 0.0))
    m.prismatic("slide", "rail", "block", points=((0.1, 0.05), (-0.2, 0.1)), axis=(2.0, 1.0))
    m.driver("along", "rail", "bead", coordinate="x", motion="0.3 + 0.2*sin(5*t)")
    m.driver("across", "rail", "bead", coordinate="y", motion="0.1*cos(4*t)")
    m.spring_damper("s", "rail", "block", points=((0.1, 0.05), (-0.2, 0.1)), stiffness=60.0, free_length=0.3)
    return m


def parallelogram() -> Mechanism:
    """Return three parallel cranks under a bar, one of them redundant, driven by two motors that agree."""
    m = Mechanism()
    m.body("bar", mass=2.0, inertia=0.5, position=(1.0, 0.5))
    for i in range(3):
        m.body(f"crank{i}", mass=0.4, inertia=0.02, position=(float(i), 0.25), angle=np.pi / 2)
        m.revolute(f"A{i}", m.ground, f"crank{i}", points=((float(i), 0.0), (-0.25, 0.0)))
        m.revolute(f"B{i}", f"crank{i}", "bar", points=((0.25, 0.0), (float(i) - 1.0, 0.0)))
    for i in range(2):
        m.driver(f"motor{i}", m.ground, f"crank{i}", coordinate="angle", motion="pi/2 + 0.4*sin(3*t)")
    return m


@pytest.fixture(scope="module", params=[moving_rail, parallelogram])
def driven(request: pytest.FixtureRequest) -> Any:
    m = request.param()
    return mbdkit.run(m, integrator=GAUSS, time={"end": 0.5, "step": 0.005}).check(), m


def pose(run: mbdkit.Run, body: str) -> tuple[np.ndarray, np.ndarray]:
    """Return (x, y, angle) (T, 3) and its rate; ground rests at zero."""
    if body == "ground":
        return np.zeros((2, len(run.time), 3))
    at = list(run.bodies).index(body)
    return run.array("trajectory/position")[:, at], run.array("trajectory/velocity")[:, at]


def check_frames(run: mbdkit.Run) -> None:
    for joint in run.joints.values():
        size = np.max(np.linalg.norm(joint.reaction_force, axis=1))
        for body, part in zip(joint.bodies, (joint.reaction_force_first, joint.reaction_force_second), strict=True):
            there = turned(part, pose(run, body)[0][:, 2])
            np.testing.assert_allclose(there, joint.reaction_force, rtol=0, atol=1.3e-15 * size, err_msg=joint.name)
            if body == "ground":
                np.testing.assert_array_equal(part, joint.reaction_force)


def check_coordinates(run: mbdkit.Run, m: Mechanism) -> None:
    for name, joint in run.joints.items():
        element: Any = m.joints[name]
        (a, _), (b, _) = (pose(run, body) for body in joint.bodies)
        is_travel = isinstance(element, Prismatic | PointOnLine) or (
            isinstance(element, Driver) and element.coordinate != "angle"
        )
        assert joint.angle_units == ("m" if is_travel else "rad")
        if not is_travel:
            np.testing.assert_array_equal(joint.angle, b[:, 2] - a[:, 2])
            continue
        points = element.points or ((0.0, 0.0), (0.0, 0.0))
        axis = np.array(
            element.axis
            if isinstance(element, Prismatic | PointOnLine)
            else (element.coordinate == "x", element.coordinate == "y")
        )
        apart = b[:, :2] + turned(np.tile(points[1], (len(b), 1)), b[:, 2]) - a[:, :2]
        local = turned(apart, -a[:, 2]) - points[0]
        np.testing.assert_allclose(joint.angle, local @ axis / np.linalg.norm(axis), rtol=0, atol=1e-14)


@cases
def test_reactions_in_the_frames_of_the_bodies_turn_back_to_the_global_ones(case: str) -> None:
    check_frames(recorded(case).run)


@cases
def test_the_coordinate_of_a_joint_is_an_angle_or_a_travel(case: str) -> None:
    made: Recorded = recorded(case)
    check_coordinates(made.run, made.m)


def test_the_same_holds_for_moving_rails_and_redundant_joints(driven: Any) -> None:
    run, m = driven
    check_frames(run)
    check_coordinates(run, m)


def test_a_driver_of_a_coordinate_has_its_motion_as_travel() -> None:
    with mbdkit.run(moving_rail(), integrator=GAUSS, time={"end": 0.5, "step": 0.005}).check() as run:
        np.testing.assert_allclose(run.joints["along"].angle, 0.3 + 0.2 * np.sin(5 * run.time), atol=1e-7)


def test_an_angle_goes_on_over_several_turns() -> None:
    m = Mechanism(gravity=(0, 0))
    m.body("wheel", mass=1.0, inertia=1.0, angular_velocity=30.0)
    m.revolute("hub", m.ground, "wheel", at=(0, 0))
    with mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 2.0, "step": 0.01}) as run:
        np.testing.assert_allclose(run.joints["hub"].angle, 30.0 * run.time, rtol=1e-12)


@pytest.mark.parametrize(("case", "driver"), [("slider-crank", "motor"), ("slider-crank", "track"), ("press", "tilt")])
def test_the_power_of_a_driver_is_its_torque_times_its_prescribed_rate(case: str, driver: str) -> None:
    run = recorded(case).run
    joint, t = run.joints[driver], np.asarray(run.time)
    rate = {"motor": 4 + 1.5 * np.cos(5 * t), "track": 0 * t, "tilt": CubicSpline(*TILT.table)(t, 1)}[driver]
    np.testing.assert_allclose(joint.driver_power, joint.reaction_torque * rate, rtol=1e-11, atol=1e-12)
    others = [name for name, one in recorded(case).m.joints.items() if not one.is_driver]
    assert not any(np.any(run.joints[name].driver_power) for name in others)


def test_driver_powers_add_up_to_the_rate_of_the_mechanical_energy(driven: Any) -> None:
    # also where two drivers share a load: v^T (M a - M g) = powers - lambda^T (Phi_q v + Phi_t)
    run, m = driven
    rate = np.zeros(len(run.time))
    for name, body in m.bodies.items():
        v, a = pose(run, name)[1], run.array("trajectory/acceleration")[:, list(m.bodies).index(name)]
        rate += body.mass * np.sum(v[:, :2] * (a[:, :2] - m.gravity), axis=1) + (body.inertia or 0) * v[:, 2] * a[:, 2]
    drift = np.sum(run.array("constraints/multiplier") * run.array("constraints/velocity_residual"), axis=1)
    forces = run.array("forces/power").sum(axis=1) if run.forces else 0.0
    supplied = run.array("joints/driver_power").sum(axis=1) + forces
    assert np.max(np.abs(run.array("joints/driver_power"))) > 0.1
    np.testing.assert_allclose(supplied - drift, rate, rtol=0, atol=2e-12 * np.max(np.abs(rate)))


def marked() -> Mechanism:
    m = hanging()
    m.marker("tip", "bar", at=(1.2, 0.1))
    m.marker("corner", "bar", point=(-0.2, 0.3))
    m.marker("middle", "bar")
    m.marker("bob", "bob")
    m.marker("nail", m.ground, at=(0.3, 0.7))
    return m


@pytest.fixture(scope="module")
def markers() -> Any:
    return mbdkit.run(marked(), integrator=GAUSS, time={"end": 0.5, "step": 0.005}).check()


def test_a_marker_is_a_point_of_its_body(markers: Any) -> None:
    m = marked()
    assert list(markers.markers) == ["tip", "corner", "middle", "bob", "nail"]
    for name, marker in markers.markers.items():
        x, v = pose(markers, marker.body)
        arm = turned(np.tile(m.markers[name].point, (len(x), 1)), x[:, 2])
        np.testing.assert_allclose(marker.position, x[:, :2] + arm, rtol=0, atol=1e-15 * 4)
        across = np.stack([-arm[:, 1], arm[:, 0]], axis=1) * v[:, 2:]
        np.testing.assert_allclose(marker.velocity, v[:, :2] + across, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(markers.markers["middle"].position, markers["bar"].position)
    np.testing.assert_array_equal(markers.markers["nail"].position, np.tile((0.3, 0.7), (len(markers.time), 1)))
    assert not np.any(markers.markers["nail"].velocity)


def test_markers_do_not_change_the_motion_by_a_bit(markers: Any) -> None:
    with mbdkit.run(hanging(), integrator=GAUSS, time={"end": 0.5, "step": 0.005}) as run:
        for path in ("trajectory/position", "trajectory/velocity", "joints/reaction_force"):
            np.testing.assert_array_equal(run.array(path), markers.array(path))
        assert dict(run.markers) == {}
        assert "markers" not in run.file


def test_markers_survive_a_spec() -> None:
    spec = marked().to_spec()
    assert spec["markers"]["corner"] == {"body": "bar", "point": [-0.2, 0.3]}
    assert Mechanism.from_spec(spec).markers == marked().markers
    assert "markers" not in hanging().to_spec()


def test_the_builder_refuses_a_marker_in_two_places_and_names_used_twice() -> None:
    m = marked()
    with pytest.raises(SpecError, match=r"either as `point` .* or as `at`"):
        m.marker("x", "bar", at=(0, 0), point=(0, 0))
    with pytest.raises(SpecError, match="the name 'tip' is already in use"):
        m.marker("tip", "bar")
    with pytest.raises(SpecError, match="there is no body 'leg'"):
        m.marker("x", "leg")


def test_output_quantities_choose_forces_and_markers(tmp_path: Any) -> None:
    for chosen in ([], ["forces"], ["joints", "markers"], "all"):
        output = {"quantities": chosen}
        with mbdkit.run(marked(), integrator=GAUSS, time={"end": 0.01, "step": 0.005}, output=output) as run:
            for group in ("forces", "markers"):
                there = chosen == "all" or group in chosen
                assert (group in run.file) is there
                if not there:
                    with pytest.raises(mbdkit.MbdkitError, match=f"did not record {group}; `output.quantities`"):
                        getattr(run, group)


def test_archive_and_xarray_name_what_acts(tmp_path: Any) -> None:
    file = tmp_path / "run.h5"
    with mbdkit.run(marked(), integrator=GAUSS, time={"end": 0.05, "step": 0.005}, archive=file) as run:
        assert check(file) == []
        told = describe(file)
        assert told["forces"]["push"] == "ground - bar"
        assert told["markers"] == {"tip": "bar", "corner": "bar", "middle": "bar", "bob": "bob", "nail": "ground"}
        assert told["arrays"]["joints/angle"]["units"] == "mixed"
        for tree in (run.to_xarray(), xarray.open_datatree(file, engine="h5netcdf")):
            position, value = tree["markers"]["position"], tree["forces"]["value"]
            assert (position.dims, value.dims) == (("time", "marker", "axis"), ("time", "force"))
            np.testing.assert_array_equal(position.sel(marker="tip"), run.markers["tip"].position)
            np.testing.assert_array_equal(value.sel(force="twist"), run.forces["twist"].value)
            assert tree["forces"]["value_row_units"].sel(force="twist") == "N m"
            tree.close()
