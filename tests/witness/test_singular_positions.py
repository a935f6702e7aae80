"""Motions through singular positions agree with the reference, or the run stops and names the joint."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.integrators.stages.coupled_newton import CoupledNewton
from mbdkit.methods import gauss
from mbdkit.models import n_four_bar
from tests.margins import assert_within
from tests.slow_cases import slow
from tests.witness.hard_runs import EXPLICIT, every_method, run
from tests.witness.n_four_bar import PUBLISHED

from .n_four_bar import Windows


def windows(n: int, integrator: str, stages: int, end: float, step: float, **sections: Any) -> mbdkit.Run:
    """Run n windows."""
    method = {"name": integrator, "stages": stages}
    spec = {"mbdkit": 1, "model": {"name": "n-four-bar", "n": n}, "integrator": method}
    return mbdkit.run(spec | {"time": {"end": end, "step": step}} | sections)


def error(result: mbdkit.Run, n: int) -> float:
    """Return the largest error of a crank's angle at the end [rad]."""
    exact = Windows(n, math.pi / 2, -1.0).angle(float(result.time[-1]))
    return max(abs(float(result[f"crank{i}"].angle[-1]) - exact) for i in range(n + 1))


def test_two_windows_pass_their_singular_positions_for_ten_seconds():
    # expected: conservation of energy, and the angle by quadrature
    result = windows(2, "gauss", 3, 10.0, 0.001).check()
    assert np.min(result.singularity_distance) < 1e-3
    assert_within(result.energy.balance, 1e-6)
    assert_within(error(result, 2), 1e-9)
    assert_within(result.misalignment_max, 1e-12)


@pytest.mark.parametrize(
    ("integrator", "stages", "accuracy"),
    [("gauss", 1, 1e-3), ("gauss", 2, 1e-7), ("radau-iia", 2, 1e-5), ("radau-iia", 3, 1e-9)],
)
def test_methods_of_every_order_pass_as_accurately_as_elsewhere(integrator, stages, accuracy):
    # expected: the angle by quadrature; after three flat positions
    result = windows(2, integrator, stages, 3.0, 0.001).check()
    assert error(result, 2) < accuracy


@pytest.mark.parametrize("step", [0.001, 0.002, 0.004])
def test_projected_windows_pass_ten_seconds_with_their_energy(step):
    # expected: the angle by quadrature, and the energy of the start
    result = windows(2, "gauss", 3, 10.0, step, stabilization="projection").check()
    assert_within(result.energy.balance, 1e-6)
    assert_within(error(result, 2), 1e-8)
    assert_within(max(joint.misalignment_max for joint in result.joints.values()), 1e-12)


def test_forty_windows_move_as_published():
    # expected: reference solution of the benchmark, see tests/witness/test_n_four_bar.py
    result = windows(40, "gauss", 3, 2.5, 0.0025, output={"every": 10}).check()
    for t, (x, y) in PUBLISHED.items():
        rows = np.flatnonzero(np.abs(result.time - t) < 1e-9)
        for row in rows:
            angle = result["crank0"].angle[row]
            assert (math.cos(angle), math.sin(angle)) == pytest.approx((x, y), abs=2e-6)
    assert_within(result["coupler40"].angle, 1e-6)


def test_end_position_converges_at_the_order_of_the_method():
    # expected: order 6 of three Gauss stages; steps chosen to stay above round-off
    errors = [error(windows(2, "gauss", 3, 3.0, step).check(), 2) for step in (0.03, 0.015)]
    assert math.log2(errors[0] / errors[1]) > 5.0


def test_stages_around_a_flat_position_solve_their_equations_where_one_tangent_for_all_does_not():
    # expected: the state after the step by quadrature
    rod = Windows(2, math.pi / 2, -1.0)
    angle, h = 0.0017, 0.001
    speed = rod.speed(angle)
    p = EquationsOfMotion.of(n_four_bar.build(n_four_bar.NFourBarOptions(angle=angle, speed=-speed)))
    workspace = p._workspace
    a, b, c = gauss.tableau(3).floats()
    acc, lam = np.zeros((3, len(workspace.q0))), np.zeros((3, len(workspace.mechanism.topology.pairs), 2))
    assert 0 < CoupledNewton(workspace, a, a @ a, c).solve(0.0, h, workspace.q0, workspace.v0, acc, lam) < 10
    v = workspace.v0 + h * (b @ acc)
    q = workspace.q0 + h * workspace.v0 + h * h * (b @ a @ acc)
    after = rod.angle(rod.time(angle) + h)
    np.testing.assert_allclose(q[[2, 5, 8]], after, rtol=0, atol=1e-12)
    np.testing.assert_allclose(v[[2, 5, 8]], rod.speed(after), rtol=0, atol=1e-10)


def test_stages_that_have_no_solution_are_left_as_they_were():
    p = EquationsOfMotion.of(n_four_bar.build(n_four_bar.NFourBarOptions()))
    workspace = p._workspace
    a, _, c = gauss.tableau(2).floats()
    acc, lam = np.ones((2, len(workspace.q0))), np.ones((2, len(workspace.mechanism.topology.pairs), 2))
    assert CoupledNewton(workspace, a, a @ a, c).solve(0.0, 50.0, workspace.q0, workspace.v0, acc, lam) == 0
    assert np.all(acc == 1)
    assert np.all(lam == 1)


def four_bar(motion: str) -> dict[str, Any]:
    """Return a crank-rocker whose rocker is driven: crank 0.5, coupler 1, rocker 0.8 and ground 1.2 m."""
    a = math.radians(60)
    crank = 0.5 * np.exp(1j * a)
    reach = 1.2 - crank
    d = abs(reach)
    turn = math.acos((1.0 + d**2 - 0.64) / (2 * d))
    coupler = reach / d * np.exp(1j * turn)
    top = crank + coupler
    b = float(np.angle(top - 1.2))
    rods = {"crank": (0j, crank), "coupler": (crank, top), "rocker": (1.2 + 0j, top)}
    bodies = {
        name: {
            "mass": 1.0,
            "inertia": 0.1,
            "position": [float(((p + q) / 2).real), float(((p + q) / 2).imag)],
            "angle": float(np.angle(q - p)),
        }
        for name, (p, q) in rods.items()
    }
    joints = {
        "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0, 0], [-0.25, 0]]},
        "B": {"type": "revolute", "bodies": ["crank", "coupler"], "points": [[0.25, 0], [-0.5, 0]]},
        "C": {"type": "revolute", "bodies": ["coupler", "rocker"], "points": [[0.5, 0], [0.4, 0]]},
        "D": {"type": "revolute", "bodies": ["ground", "rocker"], "points": [[1.2, 0], [-0.4, 0]]},
        "M": {"type": "driver", "bodies": ["ground", "rocker"], "coordinate": "angle", "motion": f"{b!r} {motion}"},
    }
    return {"name": "mechanism", "bodies": bodies, "joints": joints}


@every_method
@pytest.mark.parametrize("way", ["- t", *slow("+ t")])
def test_driver_that_pushes_a_rocker_beyond_its_dead_centre_stops_the_run_there(method, way):
    # expected: with crank and coupler in a line the rocker is at its limit, by the law of cosines
    model = four_bar(way)
    start = model["bodies"]["rocker"]["angle"]
    outstretched, folded = (math.acos((1.2**2 + 0.8**2 - r**2) / (2 * 1.2 * 0.8)) for r in (1.5, 0.5))
    limit = start - (math.pi - outstretched) if way == "- t" else math.pi - folded - start
    result = run(model, method, end=4.0)
    assert result.status == "failed"
    code, _, sentence = result.status_reason.partition(": ")
    if method in EXPLICIT:  # they step across it, and the values after that are soon too large
        assert code in ("fell-apart", "not-finite")
    else:
        assert code in ("newton-failed", "singular", "step-too-small")
        assert "singular position" in sentence
        assert any(f"at joint '{joint}'" in sentence for joint in result.joint_names)
    assert result.time[-1] == pytest.approx(limit, abs=0.015)
