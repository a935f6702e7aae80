"""The measured quantities are what is smoothed, and angles are continued over their gaps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, compute
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from tests.margins import assert_within

T = np.linspace(0.0, 1.5, 151)
CUTOFF = 6.0


def human() -> mbdkit.Mechanism:
    """Return a planar human of 12 bodies with ten named coordinates, with proportions of 1.8 m and 75 kg."""
    m = mbdkit.Mechanism()
    m.body("pelvis", mass=10.0, inertia=0.1, position=(0.0, 1.0))
    m.body("torso", mass=40.0, inertia=1.5, position=(0.0, 1.35))
    m.revolute("lumbar", "pelvis", "torso", at=(0.0, 1.1))
    m.coordinate("pelvis_tx", "pelvis.x")
    m.coordinate("pelvis_ty", "pelvis.y")
    m.coordinate("pelvis_tilt", "pelvis.angle")
    m.coordinate("lumbar_extension", "lumbar.angle")
    for side in "rl":
        m.body(f"thigh_{side}", mass=7.5, inertia=0.13, position=(0.0, 0.76))
        m.body(f"shank_{side}", mass=3.5, inertia=0.05, position=(0.0, 0.33))
        m.body(f"foot_{side}", mass=1.0, inertia=0.004, position=(0.06, 0.03))
        m.body(f"toe_{side}", mass=0.1, inertia=0.0001, position=(0.18, 0.01))
        m.revolute(f"hip_{side}", "pelvis", f"thigh_{side}", at=(0.0, 0.95))
        m.revolute(f"knee_{side}", f"thigh_{side}", f"shank_{side}", at=(0.0, 0.52))
        m.revolute(f"ankle_{side}", f"shank_{side}", f"foot_{side}", at=(0.0, 0.07))
        m.weld(f"ball_{side}", f"foot_{side}", f"toe_{side}", at=(0.16, 0.01))
        for name, sign in (("hip", 1), ("knee", -1), ("ankle", 1)):
            m.coordinate(f"{name}_flexion_{side}", f"{name}_{side}.angle", scale=sign)
    for side in "rl":
        m.body(f"arm_{side}", mass=4.0, inertia=0.1, position=(0.0, 1.3))
        m.weld(f"shoulder_{side}", "torso", f"arm_{side}", at=(0.0, 1.5))
    return m


def walk(m: mbdkit.Mechanism) -> dict[str, np.ndarray]:
    """Return values of the coordinates over time, as of a brisk walk with noise of 0.5 mrad and 0.5 mm."""
    random = np.random.default_rng(4)
    found = {}
    for number, name in enumerate(m.coordinates):
        wave = sum(random.normal(0, 0.2 / k) * np.sin(2 * np.pi * k * T + random.uniform(0, 6)) for k in (1, 2, 3))
        found[name] = (0.1 if number < 2 else 1.0) * wave + 5e-4 * random.standard_normal(len(T))
    found["pelvis_tx"] += 1.4 * T
    found["pelvis_ty"] += 1.0
    return found


def inverse(model: dict[str, Any], data: dict[str, Any], **motion: Any) -> mbdkit.Run:
    return mbdkit.inverse(
        {"mbdkit": 1, "model": model, "motion": {"data": {"time": T, **data}, "errors": "none", **motion}}
    )


def filtered(values: np.ndarray) -> np.ndarray:
    """Filter as the guide says, with SciPy: 3 dB at the cutoff for both passes, two periods of odd reflection."""
    b, a = butter(2, CUTOFF / (2**0.5 - 1) ** 0.25, fs=100.0)
    return np.asarray(filtfilt(b, a, values, padtype="odd", padlen=int(np.ceil(2 / CUTOFF * 100))))


def test_ten_measured_coordinates_of_a_human_are_those_that_are_smoothed() -> None:
    m = human()
    model, data = m.to_spec(), walk(m)
    run = inverse(model, data, smooth={"name": "butterworth", "cutoff": CUTOFF})
    # expected: the forces of columns that SciPy has filtered, through which only a spline is put
    given = inverse(model, {name: filtered(values) for name, values in data.items()}, smooth="quintic")
    for name in data:
        known = given.actuators[name].value
        assert_within(run.actuators[name].value - known, 1e-9 * max(1.0, np.max(np.abs(known))), name)
    known = given.array("joints/reaction_force")
    assert_within(run.array("joints/reaction_force") - known, 1e-9 * np.max(np.abs(known)))


def test_measured_coordinates_are_smoothed_where_a_marker_is_measured_too() -> None:
    m = human()
    m.marker("heel", "foot_r", point=(-0.1, 0.0))
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": {"smooth": {"name": "butterworth", "cutoff": CUTOFF}}}
    data = walk(m)
    pose = inverse(spec["model"], data, smooth="quintic")
    spec["motion"]["data"] = {"time": T, **data, "heel.x": pose.markers["heel"].position[:, 0]}
    result = compute(InverseProblem.of(load_inverse_spec(spec, ())))
    ((_, used),) = result.motion.coordinates
    assert set(used) == set(data)


def test_markers_that_determine_the_motion_exactly_are_smoothed() -> None:
    m = mbdkit.Mechanism()
    m.body("upper", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.body("lower", mass=1.0, inertia=0.1, position=(1.0, 0.5), angle=np.pi / 2)
    m.revolute("hip", m.ground, "upper", at=(0, 0))
    m.revolute("knee", "upper", "lower", at=(1, 0))
    m.marker("toe", "lower", at=(1.0, 1.0))
    hip, knee = 0.3 * np.sin(4 * T), np.pi / 2 + 0.5 * np.cos(5 * T)
    toe = np.exp(1j * hip) + np.exp(1j * (hip + knee))
    data = {"toe.x": toe.real, "toe.y": toe.imag}
    actuators = {"hip": {"joint": "hip"}, "knee": {"joint": "knee"}}
    spec = {"mbdkit": 1, "model": m.to_spec(), "actuators": actuators}
    smooth = {"name": "butterworth", "cutoff": CUTOFF}
    spec["motion"] = {"data": {"time": T, **data}, "smooth": smooth, "errors": "none"}
    run = mbdkit.inverse(spec)
    place = run.markers["toe"].position
    assert_within(place[:, 0] - filtered(toe.real), 1e-9)
    assert_within(place[:, 1] - filtered(toe.imag), 1e-9)


def pendulum() -> dict[str, Any]:
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("hip", m.ground, "rod", at=(0, 0))
    return m.to_spec()


def with_gap(angle: np.ndarray, gap: slice) -> list[float | None]:
    """Return an angle in degrees from -180 to 180 with a gap."""
    column = np.degrees(np.angle(np.exp(1j * angle))).astype(object)
    column[gap] = None
    return list(column)


@pytest.mark.parametrize("rate", [3.0, -9.0, 20.0])
def test_a_turning_angle_is_continued_over_gaps_before_they_are_bridged(rate: float) -> None:
    # a gap of 0.16 s at a wrap, in which the angle turns by up to 3.2 rad; expected: I phi'' + m g l cos(phi)
    angle = rate * T + 0.3 * np.sin(2 * T)
    torque = -0.35 * 1.2 * np.sin(2 * T) + 9.81 * 0.5 * np.cos(angle)
    wrap = int(np.flatnonzero(np.abs(np.diff(np.angle(np.exp(1j * angle)))) > np.pi)[0])
    columns = {"hip.angle": {"column": "hip", "unit": "deg"}}
    for gap in (slice(wrap - 7, wrap + 8), slice(wrap + 5, wrap + 20)):
        data = {"hip": with_gap(angle, gap)}
        run = inverse(pendulum(), data, columns=columns, smooth="quintic", gaps={"longest": 0.2})
        assert_within(run["rod"].angle - angle, 2e-4)
        assert_within((run.actuators["hip"].value - torque)[10:-10], 0.05)


def test_turns_that_a_gap_hides_are_refused() -> None:
    angle = np.where(T < 0.75, 20 * T, 20 * 0.75 - 20 * (T - 0.75))  # turns back during the gap
    columns = {"hip.angle": {"column": "hip", "unit": "deg"}}
    data = {"hip": with_gap(angle, slice(60, 90))}
    with pytest.raises(SpecError, match=r"row 61: column 'hip': the number of full turns during a gap of 0.31 s"):
        inverse(pendulum(), data, columns=columns, smooth="quintic", gaps={"longest": 0.5})


def test_a_gap_of_an_angle_that_does_not_turn_is_bridged() -> None:
    angle = 0.7 * np.sin(20 * T)
    columns = {"hip.angle": {"column": "hip", "unit": "deg"}}
    data = {"hip": with_gap(angle, slice(60, 80))}
    run = inverse(pendulum(), data, columns=columns, smooth="quintic", gaps={"longest": 0.5})
    assert np.max(np.abs(run["rod"].angle)) < 1.5


def test_wrapped_angles_begin_near_the_pose_of_the_model() -> None:
    # a leg that lies along -x, with a spring at its knee; segment angles from arctan2, on both sides of the wrap
    knee = 0.15 + 0.08 * np.sin(2 * T)
    angles = {"thigh": np.pi - 0.05 + 0.02 * np.sin(3 * T)}
    angles["shank"] = angles["thigh"] + knee
    data = {f"{name}.angle": np.arctan2(np.sin(angle), np.cos(angle)) for name, angle in angles.items()}

    def lying(angle: float) -> mbdkit.Run:
        m = mbdkit.Mechanism()
        m.body("thigh", mass=7.5, inertia=0.13, position=(-0.2, 0.0), angle=angle)
        m.body("shank", mass=3.5, inertia=0.05, position=(-0.6, 0.0), angle=angle)
        m.revolute("hip", m.ground, "thigh", at=(0.0, 0.0))
        m.revolute("knee", "thigh", "shank", at=(-0.4, 0.0))
        m.torsion_spring("brace", "thigh", "shank", stiffness=20.0)
        actuators = {name: {"joint": name} for name in ("hip", "knee")}
        motion = {"data": {"time": T, **data}, "smooth": "quintic", "errors": "none"}
        return mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion, "actuators": actuators})

    run = lying(np.pi)
    np.testing.assert_allclose(run.forces["brace"].value, -20.0 * knee, rtol=0, atol=1e-9)
    assert (run.verdict, run.warnings) == ("unknown", [])
    # drawn along +x, half a turn from the data, which then leave the turns open
    (reason,) = lying(0.0).verdict_reasons
    assert reason.startswith("turns: force 'brace' depends on the angle between thigh and shank")
    assert "(columns of thigh.angle and shank.angle)" in reason
