"""Redundant joints: the motion is that of the mechanism without them, and the reactions have the least norm."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within

from .parallelogram import Parallelogram
from .running import gauss, run

LINKAGE = Parallelogram()
PHI, RATE, END = -2.3, 0.4, 2.0
TIMES = np.linspace(0.0, END, 21)
METHODS: dict[str, tuple[dict[str, Any], float | None]] = {
    "rk4": ({"name": "rk4"}, 0.0002),
    "gauss": (gauss(4), 0.005),
    "radau-iia": ({"name": "radau-iia", "stages": 5}, 0.005),
    "scipy-dop853": ({"name": "scipy-dop853", "rtol": 1e-13, "atol": 1e-14}, None),
}


def largest_error(result: mbdkit.Run, linkage: Parallelogram, times: np.ndarray, solution: np.ndarray) -> float:
    """Return the largest distance of a body's centre from where it should be [m], or of its angle [rad]."""
    worst = 0.0
    at = np.searchsorted(result.time, times - 1e-9)
    np.testing.assert_allclose(result.time[at], times, rtol=0, atol=1e-12)
    for name, centre in linkage.centres(solution[:, 0]).items():
        seen = np.asarray(result[name].position) @ [1, 1j]
        worst = max(worst, float(np.max(np.abs(seen[at] - centre))))
        angle = 0.0 if name == "coupler" else solution[:, 0]
        worst = max(worst, float(np.max(np.abs(result[name].angle[at] - angle))))
    return worst


def test_the_motion_keeps_clear_of_the_flat_position_and_its_rods_pass_the_vertical() -> None:
    # The tests below need this: neither row of a pin is redundant throughout the motion.
    phi = LINKAGE.solve(PHI, RATE, TIMES)[:, 0]
    assert np.max(np.abs(np.cos(phi))) < 0.95
    assert np.min(phi) < -np.pi / 2 - 0.5
    assert np.max(phi) > -np.pi / 2 + 0.5


@pytest.mark.parametrize("name", METHODS)
def test_a_parallelogram_with_a_spare_rod_moves_as_in_its_one_angle_to_1e_9(name: str) -> None:
    # expected: Lagrange's equation in the cranks' angle by DOP853 at rtol 1e-13
    integrator, step = METHODS[name]
    spec: dict[str, Any] = {"mbdkit": 1, "model": LINKAGE.model(PHI, RATE), "integrator": integrator}
    if step is None:
        spec |= {"time": {"end": END}, "output": {"interval": 0.1}}
    else:
        spec |= {"time": {"end": END, "step": step}, "output": {"every": round(0.1 / step)}}
    result = mbdkit.run(spec).check()
    assert result.redundancy == "1 redundant row: joints base0, top0, base1, top1, base2 and top2"
    assert_within(largest_error(result, LINKAGE, TIMES, LINKAGE.solve(PHI, RATE, TIMES)), 1e-9)
    assert_within(result.energy.balance, 1e-8)


@pytest.mark.parametrize("bases", [(0.0, 2.0, 0.7), (0.0, 2.0, 0.7, 1.3, 2.5)])
def test_pin_forces_are_the_least_that_balance_every_body(bases: tuple[float, ...]) -> None:
    # expected: Newton's and Euler's equations of the single bodies, solved by least squares of least norm
    linkage = Parallelogram(bases=bases, masses=(1.0, 1.5, 0.8, 0.6, 1.1)[: len(bases)])
    result = run(linkage.model(PHI, RATE), gauss(4), end=END, step=0.005, every=20)
    assert result.redundancy.startswith(f"{len(bases) - 2} redundant row")
    for row, (time, (phi, rate)) in enumerate(zip(TIMES, linkage.solve(PHI, RATE, TIMES), strict=True)):
        for name, force in linkage.pin_forces(time, phi, rate).items():
            np.testing.assert_allclose(result.joints[name].reaction_force[row], force, rtol=0, atol=1e-8)
    np.testing.assert_allclose(result.array("joints/reaction_torque"), 0.0, rtol=0, atol=1e-8)


def pinned_arm() -> mbdkit.Mechanism:
    """Return an arm on a pin, with a plate to be fixed to it."""
    m = mbdkit.Mechanism()
    m.body("arm", mass=2.0, inertia=0.5, position=(0.6, 0.0))
    m.body("plate", mass=1.0, inertia=0.2, position=(1.1, 0.3), angle=0.4)
    m.revolute("pin", m.ground, "arm", at=(0.0, 0.0))
    return m


def test_a_pin_and_a_weld_share_the_load_by_the_least_sum_of_squares() -> None:
    # expected: a rigid body on a pin, phi'' = M / J; the force and moment that the plate then needs, split by lstsq
    m = pinned_arm()
    pin, weld = np.array([1.0, 0.1]), np.array([1.2, 0.2])
    m.revolute("bolt", "arm", "plate", at=pin)
    m.weld("seam", "arm", "plate", at=weld)
    result = mbdkit.run(m, integrator=gauss(2), time={"end": 0.01, "step": 0.01}).check()
    assert result.redundancy == "2 redundant rows: joints bolt and seam"
    arm, plate = np.array([0.6, 0.0]), np.array([1.1, 0.3])
    inertia = 0.5 + 2.0 * arm @ arm + 0.2 + 1.0 * plate @ plate
    angular = -9.81 * (2.0 * arm[0] + 1.0 * plate[0]) / inertia
    force = 1.0 * (angular * np.array([-plate[1], plate[0]]) + [0.0, 9.81])
    moment = 0.2 * angular
    # largest distance of joint points, centres included, on one body: the arm's pin at -0.6 and the seam
    length = math.hypot(1.2, 0.2)
    assert result.file["joints"].attrs["characteristic_length"] == pytest.approx(length, rel=1e-14)
    (bx, by), (wx, wy) = pin - plate, weld - plate
    balance = np.array(
        [[1, 0, 1, 0, 0], [0, 1, 0, 1, 0], [-by, bx, -wy, wx, length]]
    )  # moment at the seam: over length
    shares = np.linalg.lstsq(balance, np.array([*force, moment]), rcond=None)[0]
    np.testing.assert_allclose(result.joints["bolt"].reaction_force[0], shares[:2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.joints["seam"].reaction_force[0], shares[2:4], rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.joints["seam"].reaction_torque[0], length * shares[4], rtol=0, atol=1e-12)


def test_two_equal_drivers_share_the_torque_and_the_work_is_that_of_one() -> None:
    # expected: the run with one driver; each of two gives half its torque
    runs = []
    for count in (1, 2):
        m = pinned_arm()
        del m.bodies["plate"]
        for i in range(count):
            m.driver(f"D{i}", m.ground, "arm", coordinate="angle", motion="0.5*sin(2*t)")
        runs.append(mbdkit.run(m, integrator=gauss(3), time={"end": 1.0, "step": 0.01}).check())
    one, two = runs
    assert two.redundancy == "1 redundant row: drivers D0 and D1"
    np.testing.assert_allclose(two["arm"].angle, one["arm"].angle, rtol=0, atol=1e-12)
    for name in ("D0", "D1"):
        half = one.joints["D0"].reaction_torque / 2
        np.testing.assert_allclose(two.joints[name].reaction_torque, half, rtol=0, atol=1e-11)
    np.testing.assert_allclose(two.energy.work, one.energy.work, rtol=0, atol=1e-12)
    assert np.abs(two.energy.work).max() > 1.0
    assert_within(two.joints["D1"].angle_misalignment, 1e-12)


def truss(bays: int) -> tuple[mbdkit.Mechanism, dict[str, tuple[str, str]], dict[str, np.ndarray]]:
    """Return a cantilever of point masses and bars with two diagonals a bay; its bars and where its nodes are."""
    m = mbdkit.Mechanism()
    nodes = {f"{level}{i}": np.array([float(i), float(j)]) for i in range(bays + 1) for j, level in enumerate("ab")}
    bars: dict[str, tuple[str, str]] = {}
    for i in range(1, bays + 1):
        for level in "ab":
            m.body(f"{level}{i}", mass=1.0 + 0.3 * i, position=nodes[f"{level}{i}"])
        ends = (("a", -1, "a", 0), ("b", -1, "b", 0), ("a", 0, "b", 0), ("a", -1, "b", 0), ("b", -1, "a", 0))
        for first, back, second, here in ends:
            one, two = f"{first}{i + back}", f"{second}{i + here}"
            bars[f"{one}-{two}"] = (one, two)
    for name, (one, two) in bars.items():
        held = [end if end in m.bodies else m.ground for end in (one, two)]
        m.distance(name, *held, from_=nodes[one], to=nodes[two])
    return m, bars, nodes


@pytest.mark.parametrize("bays", [1, 4])
def test_a_truss_stays_at_rest_and_its_bars_carry_the_least_forces(bays: int) -> None:
    # expected: equilibrium of the nodes under their weight, solved by least squares of least norm
    m, bars, nodes = truss(bays)
    result = mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.1}).check()
    assert result.redundancy.startswith(f"{bays} redundant row{'s' * (bays > 1)}: joint")
    matrix, right = np.zeros((2 * len(m.bodies), len(bars))), np.zeros(2 * len(m.bodies))
    for i, (name, body) in enumerate(m.bodies.items()):
        right[2 * i + 1] = body.mass * 9.81
        for k, (one, two) in enumerate(bars.values()):
            if name in (one, two):
                along = nodes[two] - nodes[one]
                matrix[2 * i : 2 * i + 2, k] = along / np.linalg.norm(along) * (1 if name == two else -1)
    forces = np.linalg.lstsq(matrix, right, rcond=None)[0]
    for k, name in enumerate(bars):
        one, two = bars[name]
        along = (nodes[two] - nodes[one]) / np.linalg.norm(nodes[two] - nodes[one])
        np.testing.assert_allclose(result.joints[name].reaction_force[-1], forces[k] * along, rtol=0, atol=1e-10)
    for name in m.bodies:
        np.testing.assert_allclose(result[name].position[-1], nodes[name], rtol=0, atol=1e-13)


@pytest.mark.parametrize("count", [3, 5])
def test_forces_that_rigid_bodies_do_not_determine_have_no_bar(count: int) -> None:
    """Bars side by side carry a platform. How they share its weight depends on their elasticity alone."""
    m = mbdkit.Mechanism(gravity=(0, -9.81))
    top = m.body("top", mass=5, inertia=1, position=(1, 1))
    for k in range(count):
        bar = m.body(f"bar{k}", mass=1, inertia=0.1, position=(0.5 * k, 0.5), angle=math.pi / 2)
        m.revolute(f"g{k}", m.ground, bar, at=(0.5 * k, 0))
        m.revolute(f"t{k}", bar, top, at=(0.5 * k, 1))
    m.revolute("hinge", top, m.body("tail", mass=1, inertia=0.1, position=(2, 0.5)), at=(2, 1))
    time = {"end": 0.05, "step": 0.01}
    measures = {"shared": "max(abs(joints.g0.force))", "hung": "max(abs(joints.hinge.force))"}
    spec = {"model": m.to_spec(), "integrator": {"name": "gauss", "stages": 2}, "time": time}
    plain, measured = (
        mbdkit.run({"mbdkit": 1, **spec, **more}, check=True).summary() for more in ({}, {"measures": measures})
    )
    for name in (f"{side}{k}" for side in "gt" for k in range(count)):
        assert name in plain
    answers = next(line for line in plain.splitlines() if line.startswith("answer")).split(";")
    assert all("(not unique" in answer and "+-" not in answer for answer in answers)
    shared, hung = measured.partition("measures")[2].splitlines()[:2]
    assert "error is unknown: the reaction of g0 is not unique" in shared
    assert "9.81" in hung
    assert "+-" in hung
