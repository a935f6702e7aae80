"""Published joint loads of walking and running come out of the published motions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.inverse_dynamics.running import JOINTS, differences, reference, running_spec, table

import mbdkit
from tests.margins import assert_within

LIGHT = 1e-13
"""Mass [kg] and inertia of bodies that only carry joints."""


@pytest.mark.slow
def test_an_unsmoothed_running_step_has_the_published_loads() -> None:
    path = reference("isb_running.csv")
    run = mbdkit.inverse(running_spec(path))
    for force, moment in differences(run, table(path), slice(51, 2800)).values():
        assert np.median(force) < 0.05
        assert np.median(moment) < 0.02
    assert list(run.actuators) == ["hip", "knee", "ankle", "root.x", "root.y"]


SLOW = [
    pytest.param({"name": name, "cutoff": 20.0}, error, marks=pytest.mark.slow)
    for name, error in (("opensim", 230.2), ("butterworth", 205.3))
]


@pytest.mark.parametrize(("smooth", "error"), [("quintic", 1.0), *SLOW])
def test_the_impact_is_missed_by_as_much_as_the_table_says(smooth: Any, error: float) -> None:
    path = reference("isb_running.csv")
    run = mbdkit.inverse(running_spec(path, smooth), time={"end": 0.37})
    force, _ = differences(run, table(path)[: len(run.time)], slice(51, 800))["knee"]  # heel strike is at row 300
    assert np.max(force) < 1.0 if error == 1.0 else 0.8 * error < np.max(force) < 1.2 * error


def segment(data: Any, first: str, second: str) -> dict[str, Any]:
    """Return the angle of the line between two markers, with its derivatives."""
    (x, dx, ddx), (y, dy, ddy) = (
        [data[f"{second}_{axis}{order}"] - data[f"{first}_{axis}{order}"] for order in ("", "_d", "_dd")]
        for axis in "xy"
    )
    square = x**2 + y**2
    rate = (x * dy - y * dx) / square
    acceleration = (x * ddy - y * ddx - 2 * rate * (x * dx + y * dy)) / square
    return {"": np.unwrap(np.arctan2(y, x)), "_d": rate, "_dd": acceleration}


def walking_spec(data: Any) -> dict[str, Any]:
    """Return the spec of a leg whose segments change their length, as those between measured markers do.

    Massless sliders carry the joints; they slide along the segment, and at the foot, whose segment does not pass the
    ankle, along both axes.
    """
    shares = {"thigh": 0.433, "shank": 0.433, "foot": 0.5}
    ends = {"thigh": ("hip", "knee"), "shank": ("knee", "ankle"), "foot": ("heel", "mt5")}
    columns: dict[str, Any] = {}
    measured: dict[str, Any] = {name: data[name] for name in ("F_x", "F_y", "M_z")}
    measured["time"] = data["t"]

    def observe(name: str, values: dict[str, Any]) -> None:
        for order, series in values.items():
            measured[f"{name}{order}"] = series
        columns[name] = {"column": name, "rate": f"{name}_d", "acceleration": f"{name}_dd"}

    def point(body: str, first: str, second: str, share: float) -> None:
        for axis in "xy":
            at = {
                order: (1 - share) * data[f"{first}_{axis}{order}"] + share * data[f"{second}_{axis}{order}"]
                for order in ("", "_d", "_dd")
            }
            observe(f"{body}.{axis}", at)

    m = mbdkit.Mechanism(gravity=(0.0, -9.81))
    m.body("pelvis", mass=LIGHT, position=(data["hip_x"][0], data["hip_y"][0]))
    for name, (first, second) in ends.items():
        point(name, first, second, shares[name])
        observe(f"{name}.angle", segment(data, first, second))
        start = [float(measured[f"{name}.{axis}"][0]) for axis in ("x", "y", "angle")]
        length = np.mean(np.hypot(*(data[f"{second}_{axis}"] - data[f"{first}_{axis}"] for axis in "xy")))
        inertia = 0.0145 * (0.475 * length) ** 2
        m.body(name, mass=0.0145, inertia=inertia, position=(start[0], start[1]), angle=start[2])
    sliders = {
        "thigh top": ("thigh", "hip"), "thigh end": ("thigh", "knee"), "shank top": ("shank", "knee"),
        "shank end": ("shank", "ankle"), "foot slide": ("foot", ""), "foot top": ("foot slide", "ankle"),
    }  # fmt: skip
    actuators: dict[str, Any] = {"hip": {"body": "thigh", "coordinate": "angle"}}
    for name, (body, marker) in sliders.items():
        at = (data[f"{marker}_x"][0], data[f"{marker}_y"][0]) if marker else m.bodies["foot"].position
        m.body(name, mass=LIGHT, inertia=LIGHT, position=at, angle=m.bodies[body].angle)
        axis = (0.0, 1.0) if name == "foot top" else (1.0, 0.0)
        m.prismatic(f"{name} guide", body, name, points=((0, 0), (0, 0)), axis=axis)
        actuators[name] = {"joint": f"{name} guide"}
    for joint, (first, second) in {
        "hip": ("pelvis", "thigh top"), "knee": ("thigh end", "shank top"), "ankle": ("shank end", "foot top"),
    }.items():  # fmt: skip
        m.revolute(joint, first, second, points=((0, 0), (0, 0)))
        point(second, joint, joint, 0.0)
        if joint != "hip":
            actuators[joint] = {"joint": joint}
    return {
        "mbdkit": 1, "model": m.to_spec(), "motion": {"data": measured, "columns": columns},
        "loads": {"ground": {"body": "foot", "force": ["F_x", "F_y"], "point": [0.0, 0.0], "torque": "M_z"}},
        "actuators": actuators,
    }  # fmt: skip


def test_walking_has_the_published_moments_and_forces() -> None:
    data = table(reference("gait_leg2d.csv"))
    run = mbdkit.inverse(walking_spec(data))
    sign = {"hip": 1.0, "knee": -1.0, "ankle": -1.0}  # flexion of the hip and the knee, plantarflexion of the ankle
    for joint in JOINTS:
        moment, force = data[f"{joint}_moment"], np.column_stack([data[f"{joint}_Fx"], data[f"{joint}_Fy"]])
        found = sign[joint] * run.actuators[joint].value
        # the ground force has nine digits: half a unit is 5e-8 N/kg, at a lever of up to 0.7 m
        assert_within(found - moment, 1e-7 * np.max(np.abs(moment)) + 0.7 * 5e-8)  # margin: digits of the publication
        assert_within(run.joints[joint].reaction_force - force, 1e-7 * np.max(np.abs(force)))
