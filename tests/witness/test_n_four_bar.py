"""N four-bar windows (IFToMM A02) against their one-coordinate solution, which knows of no singular position."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within
from tests.witness.n_four_bar import PUBLISHED

from .n_four_bar import Windows

FIRST_FLAT = 0.7143556
"""Time at which two windows lie flat for the first time [s]."""


def run(n: int = 2, end: float = 0.7, **sections: Any) -> mbdkit.Run:
    """Run n windows with the benchmark's rods and start."""
    sections.setdefault("integrator", {"name": "gauss", "stages": 3})
    time = {"end": end} | ({} if sections["integrator"]["name"].startswith("scipy") else {"step": 0.001})
    spec = {"mbdkit": 1, "model": {"name": "n-four-bar", "n": n}, "time": time} | sections
    return mbdkit.run(spec)


def test_witness_agrees_with_the_published_solution():
    # expected: see PUBLISHED
    windows = Windows(40, math.pi / 2, -1.0)
    for t, (x, y) in PUBLISHED.items():
        phi = windows.angle(t)
        assert (math.cos(phi), math.sin(phi)) == pytest.approx((x, y), abs=2e-6)  # margin: digits of the publication


def test_witness_lies_flat_when_the_tests_say():
    assert Windows(2, math.pi / 2, -1.0).time(0.0) == pytest.approx(FIRST_FLAT, abs=1e-6)


@pytest.mark.parametrize("n", [1, 2, 40])
@pytest.mark.parametrize("method", [{"name": "gauss", "stages": 3}, {"name": "rk4"}], ids=["gauss", "rk4"])
def test_windows_move_as_their_one_angle_says_up_to_the_first_flat_position(n, method):
    # expected: conservation of energy in one coordinate, by quadrature
    windows = Windows(n, math.pi / 2, -1.0)
    with run(n, integrator=method) as result:
        result.check()
        phi = windows.angle(0.7)
        for i in range(n + 1):
            crank = result[f"crank{i}"]
            assert crank.angle[-1] == pytest.approx(phi, abs=1e-9)
            assert crank.angular_velocity[-1] == pytest.approx(windows.speed(phi), abs=1e-8)
            np.testing.assert_allclose(crank.position[-1], [i + math.cos(phi) / 2, math.sin(phi) / 2], atol=1e-9)
        for i in range(n):
            coupler = result[f"coupler{i + 1}"]
            assert_within(coupler.angle[-1], 1e-9)
            np.testing.assert_allclose(coupler.position[-1], [i + math.cos(phi) + 0.5, math.sin(phi)], atol=1e-9)


def test_lengths_masses_and_speed_are_taken():
    # expected: conservation of energy in one coordinate, by quadrature
    windows = Windows(3, 1.4, -0.8 / 0.5, mass=2.0, length=0.5)
    model = {"name": "n-four-bar", "n": 3, "length": 0.5, "mass": 2.0, "angle": 1.4, "speed": 0.8}
    with run(model=model, end=0.3) as result:
        assert result["crank2"].angle[-1] == pytest.approx(windows.angle(0.3), abs=1e-11)


def test_distance_to_singularity_is_least_where_the_windows_lie_flat_and_then_proportional_to_their_angle():
    # expected: a simple zero of the Jacobian's smallest singular value
    with run() as result:
        angle, distance = np.asarray(result["crank0"].angle), np.asarray(result.singularity_distance)
    late = angle < 0.15
    assert late.sum() > 10
    ratio = distance[late] / np.sin(angle[late])
    assert_within(np.ptp(ratio), 0.03 * ratio.mean())
    assert np.argmin(distance) == len(distance) - 1


@pytest.mark.parametrize(
    "method",
    [{"name": "gauss", "stages": 3}, {"name": "gauss", "stages": 2}, {"name": "radau-iia", "stages": 3}],
    ids=lambda method: f"{method['name']}-{method['stages']}",
)
def test_fixed_point_stages_fail_in_the_singular_position_and_say_so(method):
    # expected: tangents grow like 1 / x there, so that no step is small enough for them
    with run(end=10.0, integrator=method | {"stage_solver": "fixed-point"}) as result:
        assert result.status == "failed"
        assert result.status_reason.startswith("newton-failed: ")
        assert result.time[-1] == pytest.approx(FIRST_FLAT, abs=0.003)
        assert_within(result.energy.balance, 1e-9)
        assert np.isfinite(result["crank2"].acceleration).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scipy-dop853", "scipy-radau"])
def test_adaptive_solvers_that_stop_at_a_singular_position_name_a_joint_of_it(name):
    with run(end=10.0, integrator={"name": name, "rtol": 1e-9, "atol": 1e-9}) as result:
        if result.status == "complete":
            return
        code, _, sentence = result.status_reason.partition(": ")
        assert code in ("singular", "step-too-small")
        assert "singular position" in sentence
        assert any(f"'{joint}'" in sentence for joint in result.joint_names)
        assert_within(result.energy.balance[result.time < FIRST_FLAT - 0.01], 1e-6)


def test_start_in_a_flat_position_is_refused_by_the_joints_that_block_each_other():
    with pytest.raises(mbdkit.SpecError, match="singular position at the start"):
        run(model={"name": "n-four-bar", "angle": 0.0})
