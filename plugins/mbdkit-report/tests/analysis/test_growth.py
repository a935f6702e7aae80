"""Growth laws, trends of energies, observed orders and answers, in series made from each law and in real runs."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_report import (
    Answer,
    Axis,
    Claim,
    Column,
    Figure,
    Line,
    Range,
    Table,
    Trend,
    Verdict,
    exceeds,
    growth_law,
    observed_order,
    together,
    trend,
    worst_history,
)
from mbdkit_report.analysis.growth import Law
from mbdkit_studies.spec.reference_errors import LAST_ROW, offsets
from tests.margins import assert_within

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
    assert growth.exponent == pytest.approx(exponent, abs=0.06)  # margin: exponent of a fitted law


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
    assert growth.exponent == pytest.approx(2.0, abs=0.12)  # margin: exponent of a fitted law


@pytest.mark.parametrize("stages", [2, 3])
def test_drift_of_a_symmetric_method_is_bounded_over_twenty_swings(stages: int) -> None:
    # expected: on a reversible motion a symmetric method's error returns with every swing (Hairer, Lubich, Wanner,
    # Geometric Numerical Integration, section XI.3)
    run = swinging({"name": "gauss", "stages": stages})
    assert growth_law(run.time, worst_history(run)).candidates == ("bounded",)


@pytest.mark.parametrize("seed", range(5))
def test_slope_is_found_within_its_error_under_noise(seed: int) -> None:
    # expected: made with slope 2e-6
    value = 2e-6 * TIME + 1e-5 * np.random.default_rng(seed).standard_normal(len(TIME))
    found = trend(TIME, value)
    assert found.drifts
    assert_within(found.slope - 2e-6, 4 * found.error)  # margin: seeded noise


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
    assert_within(gauss.slope, 1e-2 * abs(radau.slope))


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
    assert found.order == pytest.approx(order, abs=0.2)  # margin: seeded noise
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


YES, NO, PARTLY, OPEN = Answer.YES, Answer.NO, Answer.PARTLY, Answer.OPEN


@pytest.mark.parametrize(
    ("value", "answer"),
    [(0.5, YES), (2e-3, YES), (5e-4, NO), (3.0, NO), (1.0, OPEN), (1.02, OPEN), (9.9e-4, OPEN), (math.nan, OPEN)],
)
def test_a_range_leaves_open_what_lies_on_its_border(value: float, answer: Answer) -> None:
    assert Range(1e-3, 1.0, "mm").holds(value) is answer


def test_one_value_exceeds_another_only_beyond_the_margin() -> None:
    assert [exceeds(a, 1.0) for a in (2.0, 1.01, 0.5, math.nan)] == [YES, OPEN, NO, OPEN]


@pytest.mark.parametrize(
    ("answers", "answer"),
    [
        ([YES, YES], YES),
        ([NO, NO], NO),
        ([YES, NO], PARTLY),
        ([YES, NO, OPEN], PARTLY),
        ([YES, OPEN], OPEN),
        ([], OPEN),
        ([YES, PARTLY], PARTLY),
    ],
)
def test_answers_together(answers: list[Answer], answer: Answer) -> None:
    assert together(answers) is answer


def test_a_verdict_is_json() -> None:
    table = Table("t", "Table", (Column("a"), Column("b", "m")), (("x", math.nan), (1, None)))
    figure = Figure("f", "Figure", "", Axis("t", "s"), Axis("x", "m", True), (Line("l", np.arange(2), np.zeros(2)),))
    claim = Claim("c", "It holds.", "1", "2", Answer.NO, "It does not.")
    verdict = Verdict("v", "Verdict", "So it is.", (claim,), (table,), (figure,))
    plain = json.loads(json.dumps(verdict.to_dict(), allow_nan=False))
    assert plain["tables"][0]["rows"] == [["x", None], [1, None]]
    assert plain["figures"][0]["lines"][0]["x"] == [0, 1]
    assert plain["claims"][0]["answer"] == "no"
    assert verdict.claim("c") is claim
    with pytest.raises(KeyError, match=r"there is no 'd'; there are c"):
        verdict.claim("d")


def test_a_table_whose_rows_do_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="2 columns, but a row of 1 cells"):
        Table("t", "Table", (Column("a"), Column("b")), ((1,),))
