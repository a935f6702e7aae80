"""The knee linkage against the same linkage in one coordinate, and its link lengths against their source."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.witness.four_bar import FourBar, Link, Spring
from tests.witness.running import gauss, run

SEATED: dict[str, Any] = {"name": "four-bar-knee", "thigh_angle": 0.0, "flexion": 0.4, "flexion_rate": 0.5}
SUPPORTED: dict[str, Any] = SEATED | {
    "height": 1.65, "body_mass": 60.0, "rod_mass": 0.08, "damping": 0.4,
    "springs": {
        "front": {"points": [[0.05, 0.2], [0.04, -0.15]], "stiffness": 300.0, "damping": 8.0, "free_length": 0.3},
        "back": {"points": [[-0.06, 0.15], [-0.05, -0.1]], "stiffness": 150.0, "free_length": 0.2},
    },
}  # fmt: skip
END = 1.5
models = pytest.mark.parametrize("model", [SEATED, SUPPORTED], ids=["bare", "supported"])


def mechanism(model: dict[str, Any]) -> dict[str, Any]:
    """Return the knee as mbdkit builds it: bodies, joints and forces as data."""
    time = {"end": 1.0, "step": 0.01}
    spec = mbdkit.RunSpec(mbdkit=1, model=model, integrator={"name": "rk4"}, time=time)
    return spec.mechanism().to_spec()


def linkage(data: dict[str, Any], damping: float) -> tuple[FourBar, float, float]:
    """Return the linkage C -> acl -> B -> shank -> A <- pcl <- D in one coordinate, with angle and rate of C-B."""
    joints, bodies = data["joints"], data["bodies"]
    points = {
        (joint, body): tuple(point)
        for joint in "ABCD"
        for body, point in zip(joints[joint]["bodies"], joints[joint]["points"], strict=True)
    }

    def link(body: str, first: str, second: str) -> Link:
        return Link(bodies[body]["mass"], bodies[body]["inertia"], (points[first, body], points[second, body]))

    springs = tuple(
        Spring(
            ground=tuple(force["points"][0]),
            coupler=tuple(force["points"][1]),
            stiffness=force["stiffness"],
            damping=force.get("damping", 0.0),
            free_length=force["free_length"],
        )
        for force in data.get("forces", {}).values()
        if force["type"] == "spring-damper"
    )
    crank = link("acl", "C", "B")
    phi = bodies["acl"]["angle"] + crank.tilt
    for branch in (1, -1):
        four_bar = FourBar(
            ground=(points["C", "ground"], points["D", "ground"]), crank=crank, coupler=link("shank", "B", "A"),
            follower=link("pcl", "D", "A"), branch=branch, springs=springs, damping=damping,
        )  # fmt: skip
        turn = four_bar.state(phi, 0.0).angle[1] - bodies["shank"]["angle"]
        if abs(math.remainder(turn, 2 * math.pi)) < 1e-6:
            return four_bar, phi, bodies["acl"]["angular_velocity"]
    raise AssertionError("the knee is on neither branch of its linkage")


@models
def test_the_knee_has_the_link_lengths_of_its_source_scaled_with_height(model: dict[str, Any]) -> None:
    # expected: 44.5, 51.6, 40.9 and 47.2 mm for a height of 1.78 m (exoskeleton design, FourBarLinkageMathDefined)
    four_bar, _, _ = linkage(mechanism(model), 0.0)
    scale = model.get("height", 1.78) / 1.78
    seen = [four_bar.coupler.length, four_bar.crank.length, four_bar.follower.length, math.dist(*four_bar.ground)]
    assert seen == pytest.approx([scale * length for length in (0.0445, 0.0516, 0.0472, 0.0409)], rel=1e-12)


METHODS: dict[str, tuple[dict[str, Any], float]] = {
    "rk4": ({"name": "rk4"}, 0.0005), "gauss3": (gauss(3), 0.005), "gauss4": (gauss(4), 0.01),
}  # fmt: skip


@models
@pytest.mark.parametrize("name", METHODS)
def test_the_knee_moves_as_in_its_minimal_coordinate_to_1e_9(model: dict[str, Any], name: str) -> None:
    # expected: Eksergian's equation in the angle of the rod C-B by DOP853 at rtol 1e-13
    integrator, step = METHODS[name]
    four_bar, phi, rate = linkage(mechanism(model), model.get("damping", 0.0))
    times = np.linspace(0.0, END, 16)
    solution = four_bar.solve(phi, rate, times)
    states = [four_bar.state(angle, speed) for angle, speed, _ in solution]
    assert min(four_bar.transmission(angle) for angle, _, _ in solution) > 0.1
    result = run(model, integrator, end=END, step=step, every=round(0.1 / step))
    for k, body in enumerate(("acl", "shank", "pcl")):
        position = np.array([state.position[k] for state in states])
        np.testing.assert_allclose(result[body].position, position, rtol=0, atol=1e-9)
        turn = np.exp(1j * np.array([state.angle[k] for state in states]))
        np.testing.assert_allclose(np.exp(1j * np.asarray(result[body].angle)), turn, rtol=0, atol=1e-8)
    np.testing.assert_allclose(result.energy.dissipated, solution[:, 2], rtol=0, atol=1e-7)


@models
def test_the_loads_of_the_knees_joints_follow_newton_and_euler(model: dict[str, Any]) -> None:
    # expected: the nine equations of acl, shank and pcl, from the accelerations of the minimal coordinate
    data = mechanism(model)
    four_bar, phi, rate = linkage(data, model.get("damping", 0.0))
    times = np.linspace(0.0, END, 16)
    result = run(model, gauss(4), end=END, step=0.005, every=20)
    forces = np.array([four_bar.pin_forces(angle, speed) for angle, speed, _ in four_bar.solve(phi, rate, times)])
    on = {"C": "acl", "B": "shank", "A": "pcl", "D": "pcl"}  # whom `pin_forces` takes as the body acted on
    for k, joint in enumerate("CBAD"):
        sign = 1.0 if data["joints"][joint]["bodies"][1] == on[joint] else -1.0
        np.testing.assert_allclose(result.joints[joint].reaction_force, sign * forces[:, k], rtol=0, atol=1e-5)
