"""The walker's legs follow the measured angles, have the masses of Winter's table, and satisfy the energy balance."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_walker.walker import HIP, KNEE


@cache
def walked(knees: str = "driven", **options: Any) -> mbdkit.Run:
    """Return a run of two cycles of 1 s each."""
    model = {"name": "walker", "knees": knees, "period": 1.0} | options
    integrator, time = {"name": "gauss", "stages": 2}, {"end": 2.0, "step": 0.0025}
    return mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time}).check()


def test_hips_and_knees_follow_the_measured_angles() -> None:
    # expected: the means of Olshen et al. (1989); the harmonics above the sixth change them by less than one degree
    run = walked()
    thigh, shank = run["left_thigh"].angle, run["left_shank"].angle
    at = [round((0.025 + 0.05 * i) / 0.0025) for i in range(20)]
    hip, knee = np.degrees(thigh + 0.5 * np.pi + 0.3)[at], np.degrees(thigh - shank)[at]
    np.testing.assert_allclose(hip, HIP, rtol=0, atol=1.0)  # margin: how far the source is from this model
    np.testing.assert_allclose(knee, KNEE, rtol=0, atol=1.0)


def test_the_right_leg_does_the_same_half_a_cycle_later() -> None:
    run = walked()
    for part in ("thigh", "shank"):
        left, right = run[f"left_{part}"].angle, run[f"right_{part}"].angle
        np.testing.assert_allclose(left[200:], right[:-200], rtol=0, atol=1e-6)


def test_the_hips_carry_the_legs_over_a_whole_cycle() -> None:
    # expected: momentum is periodic, so the mean load on both hips is the weight of both legs, 2 (0.100 + 0.061) m g
    # (Winter 2009, table 4.1)
    run = walked()
    load = (run.joints["left_hip"].reaction_force + run.joints["right_hip"].reaction_force)[400:800]
    assert load.mean(axis=0) == pytest.approx([0.0, 0.322 * 70.0 * 9.81], abs=1e-3)


@pytest.mark.parametrize("knees", ["driven", "damped"])
def test_work_of_the_motors_and_damping_close_the_energy_balance(knees: str) -> None:
    run = walked(knees)
    assert np.abs(run.energy.work).max() > 1.0
    np.testing.assert_allclose(run.energy.balance, 0.0, rtol=0, atol=1e-5)
    np.testing.assert_allclose(run.misalignment_max, 0.0, rtol=0, atol=1e-8)


def test_a_damped_knee_is_no_driver() -> None:
    assert {"left_knee_motor", "right_knee_motor"} & set(walked("damped").joints) == set()
    assert walked("damped").energy.dissipated[-1] > 1.0


@pytest.mark.parametrize("wrong", [{"knees": "stiff"}, {"height": 0.0}, {"pelvic_tilt": 2.0}])
def test_wrong_options_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(mbdkit.SpecError, match=next(iter(wrong))):
        walked(**wrong)
