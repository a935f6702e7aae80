"""The observed order: its window is found in synthetic errors with a coarse part and a floor, and in real runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_report import observed_order
from mbdkit_studies.spec.reference_errors import LAST_ROW, offsets

STEPS = 0.5 / 2.0 ** np.arange(12)


def curve(order: float, constant: float, floor: float, seed: int = 1) -> np.ndarray:
    """Return errors of an order, with a pre-asymptotic part at the coarse steps and rounding at the fine ones."""
    coarse = 1 + 40 * (STEPS / STEPS[0]) ** 2
    rounding = floor * np.random.default_rng(seed).uniform(0.3, 1.0, len(STEPS))
    return np.asarray(constant * STEPS**order * coarse + rounding)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("order", [2, 4, 6])
def test_order_is_found_between_coarse_steps_and_rounding(order: int, seed: int) -> None:
    # expected: the order that the curve was made with
    found = observed_order(STEPS, curve(order, 1.0, 1e-14, seed))
    assert found.order == pytest.approx(order, abs=0.2)
    assert min(found.steps) ** order > 1e-14


def test_floor_is_measured_at_the_steps_that_no_longer_help() -> None:
    assert observed_order(STEPS, curve(4, 1.0, 1e-9)).floor == pytest.approx(1e-9, rel=0.5)
    assert observed_order(STEPS, STEPS**4).floor == 0.0


def test_errors_below_a_given_floor_are_left_out() -> None:
    found = observed_order(STEPS, STEPS**4, floor=1e-6)
    assert min(found.steps) ** 4 > 2e-5
    assert found.order == pytest.approx(4.0)


def test_floor_alone_shows_no_order() -> None:
    found = observed_order(STEPS, 1e-15 * np.random.default_rng(1).uniform(0.3, 1.0, len(STEPS)))
    assert not found.found
    assert math.isnan(found.order)


def test_order_of_steps_and_failed_runs_do_not_matter() -> None:
    errors = STEPS**4
    errors[0] = math.nan
    errors[1] = math.inf
    shuffled = np.random.default_rng(1).permutation(len(STEPS))
    assert observed_order(STEPS[shuffled], errors[shuffled]) == observed_order(STEPS[2:], errors[2:])


@pytest.mark.parametrize(
    ("integrator", "order"),
    [
        ({"name": "rk-gill"}, 4),
        ({"name": "gauss", "stages": 2}, 4),
        ({"name": "gauss", "stages": 3}, 6),
        ({"name": "radau-iia", "stages": 3}, 5),
    ],
    ids=["rk-gill", "gauss-2", "gauss-3", "radau-iia-3"],
)
def test_methods_show_their_order_on_the_double_pendulum(integrator: dict[str, Any], order: int) -> None:
    # expected: Gill 1951; 2 s for Gauss and 2 s - 1 for Radau IIA with s stages, on an index-1 system
    model = {"name": "double-pendulum", "lengths": [20.0, 20.0], "angles": [-0.7, -0.7]}

    def run(method: dict[str, Any], step: float) -> mbdkit.Run:
        time, output = {"end": 15.0, "step": step}, {"every": round(0.5 / step)}
        return mbdkit.run({"mbdkit": 1, "model": model, "integrator": method, "time": time, "output": output})

    reference = run({"name": "gauss", "stages": 6}, STEPS[4])
    steps = STEPS[:8]
    ends = [offsets(run(integrator, float(h)), reference, LAST_ROW)[0, :, :2] for h in steps]
    errors = np.array([np.linalg.norm(end, axis=-1).max() for end in ends])
    assert observed_order(steps, errors).order == pytest.approx(order, abs=0.2)
