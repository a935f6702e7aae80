"""Trends, and standard errors that allow for the correlation of neighbouring rows."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mbdkit
from mbdkit_report import Trend, trend

TIME = np.linspace(0.0, 100.0, 2001)


@pytest.mark.parametrize("seed", range(5))
def test_slope_is_found_within_its_error_under_noise(seed: int) -> None:
    # expected: made with slope 2e-6
    value = 2e-6 * TIME + 1e-5 * np.random.default_rng(seed).standard_normal(len(TIME))
    found = trend(TIME, value)
    assert found.drifts
    assert abs(found.slope - 2e-6) < 4 * found.error


@pytest.mark.parametrize("period", [3.0, 17.0, 60.0])
def test_oscillation_is_no_trend(period: float) -> None:
    assert not trend(TIME, np.sin(2 * math.pi * TIME / period)).drifts


def test_short_histories_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 12 values"):
        trend(np.arange(5.0), np.arange(5.0))


def test_radau_loses_energy_and_gauss_does_not() -> None:
    # expected: Radau IIA damps what Gauss conserves (Hairer, Wanner, Solving ODEs II, section IV.5); over so
    # many swings that the loss is steady
    model = {"name": "single-pendulum", "length": 20.0, "angle": math.radians(-40.0)}
    spec = {"mbdkit": 1, "model": model, "time": {"end": 150.0, "step": 0.1}}

    def balance(name: str) -> Trend:
        run = mbdkit.run(spec, integrator={"name": name, "stages": 3})
        return trend(run.time, run.energy.balance)

    radau = balance("radau-iia")
    assert radau.drifts
    assert radau.slope < 0
    gauss = balance("gauss")
    assert abs(gauss.slope) < 1e-2 * abs(radau.slope)
