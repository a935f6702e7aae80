"""Growth laws, found in series made from each law with oscillation and noise, and in real runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_report import growth_law, worst_history
from mbdkit_report.analysis.growth import Law

TIME = np.linspace(0.0, 100.0, 2001)
ENVELOPES: dict[Law, np.ndarray] = {
    "bounded": np.full_like(TIME, 3e-7), "linear": 1e-9 * TIME, "quadratic": 1e-11 * TIME**2,
    "exponential": 1e-12 * np.exp(0.1 * TIME),
}  # fmt: skip


def oscillating(envelope: np.ndarray, period: float, seed: int = 1) -> np.ndarray:
    """Return the envelope times an oscillation through zero, with 10 percent of noise."""
    noise = np.exp(0.1 * np.random.default_rng(seed).standard_normal(len(TIME)))
    return np.asarray(envelope * np.abs(np.sin(2 * math.pi * TIME / period + 0.3)) * noise)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("law", ENVELOPES)
def test_law_is_found_under_a_fast_oscillation_and_noise(law: Law, seed: int) -> None:
    # expected: the law that the history was made by
    growth = growth_law(TIME, oscillating(ENVELOPES[law], 3.1, seed))
    assert growth.candidates == (law,)


@pytest.mark.parametrize(("law", "exponent"), [("linear", 1.0), ("quadratic", 2.0)])
def test_exponent_is_that_of_the_power_law(law: Law, exponent: float) -> None:
    growth = growth_law(TIME, oscillating(ENVELOPES[law], 3.1))
    assert growth.exponent == pytest.approx(exponent, abs=0.05)


@pytest.mark.parametrize("law", ENVELOPES)
def test_law_among_the_candidates_under_an_oscillation_slower_than_a_block(law: Law) -> None:
    # A block covers a third of a swing. The data may not suffice to decide, but the candidates include the true law.
    growth = growth_law(TIME, oscillating(ENVELOPES[law], 25.0))
    assert law in growth.candidates or growth.law == "unclear"


def test_growth_on_top_of_a_bounded_oscillation_is_seen_once_it_dominates() -> None:
    # expected: the series is made so; the growing part is nine tenths of the last value
    value = np.abs(1e-8 * np.sin(5 * TIME)) + 1e-11 * TIME**2
    assert growth_law(TIME, value).candidates == ("quadratic",)


def test_growth_by_less_than_half_counts_as_bounded() -> None:
    value = 1e-8 * (1 + 0.2 * TIME / 100) * np.abs(np.sin(5 * TIME))
    assert growth_law(TIME, value).candidates == ("bounded",)


def test_two_laws_that_noise_hides_are_both_named() -> None:
    # Over less than one e-fold, an exponential cannot be distinguished from a straight line with an offset.
    noise = np.exp(0.3 * np.random.default_rng(2).standard_normal(len(TIME)))
    growth = growth_law(TIME, np.exp(TIME / 120) * noise)
    assert len(growth.candidates) > 1
    assert {"linear", "exponential"} <= set(growth.candidates)


def test_noise_without_any_law_is_called_unclear() -> None:
    value = 10.0 ** np.repeat(np.random.default_rng(3).uniform(-12, -3, 23), 87)[: len(TIME)]
    assert growth_law(TIME, value).law == "unclear"


def test_zeros_are_no_misalignment() -> None:
    assert growth_law(TIME, np.zeros_like(TIME)).candidates == ("none",)


@pytest.mark.parametrize("value", [np.full(30, math.nan), -np.ones(30), np.ones(10)])
def test_histories_that_are_none_are_refused(value: np.ndarray) -> None:
    with pytest.raises(ValueError, match="growth law"):
        growth_law(np.arange(float(len(value))), value)


def swinging(integrator: dict[str, Any]) -> mbdkit.Run:
    """Return a run of a rod over twenty swings."""
    model = {"name": "single-pendulum", "length": 20.0, "angle": math.radians(-40.0)}
    run = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": 150.0, "step": 0.1}})
    return run.check()


@pytest.mark.parametrize("name", ["rk4", "rk-gill"])
def test_drift_of_an_explicit_method_is_quadratic_in_time(name: str) -> None:
    # expected: d2 Phi/dt2 = 0 does not damp what the method adds to Phi' in every swing (Baumgarte 1972; Ascher and
    # Petzold, Computer Methods for Ordinary Differential Equations, 1998, section 9.2.1: growth like t^2)
    run = swinging({"name": name})
    growth = growth_law(run.time, worst_history(run))
    assert growth.candidates == ("quadratic",)
    assert growth.exponent == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("stages", [2, 3])
def test_drift_of_a_symmetric_method_is_bounded_over_twenty_swings(stages: int) -> None:
    # expected: on a reversible motion a symmetric method's error returns with every swing (Hairer, Lubich, Wanner,
    # Geometric Numerical Integration, section XI.3)
    run = swinging({"name": "gauss", "stages": stages})
    assert growth_law(run.time, worst_history(run)).candidates == ("bounded",)
