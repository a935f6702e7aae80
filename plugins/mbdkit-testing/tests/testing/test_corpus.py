"""Each plugin of the corpus is caught, and by the check that says what is wrong with it."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from typing import Any

import pytest
from tests.testing.corpus_of_wrong_plugins import RIGHT, RK4, WRONG, outcome

import mbdkit
from mbdkit.base.errors import PluginError
from mbdkit_testing import verify
from mbdkit_testing.check import Check
from mbdkit_testing.check_result import Result

from . import corpus, further_faults, overclaims, subtle, wrong_copies, wrong_steps

SUBTLE_LAWS = {
    subtle.creates_energy_at_some_rates: "law.passivity", subtle.creates_energy_in_a_corner: "law.passivity",
    subtle.creates_energy_for_a_second: "law.passivity", subtle.creates_a_little: "law.passivity",
    subtle.wrong_slope_when_long: "derivatives.length", subtle.wrong_slope_below_zero: "derivatives.length",
    subtle.wrong_slope_near_zero: "derivatives.length", subtle.wrong_slope_of_the_product: "derivatives.length",
    subtle.wrong_rate_when_fast: "derivatives.rate", subtle.wrong_rate_late: "derivatives.rate",
    subtle.stiffer_after_two_seconds: "law.potential", subtle.flickers: "law.potential",
    subtle.potential_jumps: "law.potential",
}  # fmt: skip
SUBTLE_LAWS_WITHOUT_POTENTIAL = {
    subtle.creates_energy_when_long: "law.passivity",
    subtle.springy_but_passive: "law.passivity",
    subtle.no_number_when_short: "law.finite",
}
SUBTLE_METHODS = {
    subtle.Growing: "state.free-fall", subtle.EndShort: "state.free-fall", subtle.EndAlmostShort: "state.last-step",
    subtle.Single: "order.finest", subtle.Wrapped: "state.free-fall", subtle.Clipped: "state.free-fall",
    subtle.OwnClock: "contract.start-time",
}  # fmt: skip
WRONG |= {one.__name__: ("force-law", corpus.offer_law(one), name) for one, name in SUBTLE_LAWS.items()}
WRONG |= {
    one.__name__: ("force-law", corpus.offer_law(one, potential=False), name)
    for one, name in SUBTLE_LAWS_WITHOUT_POTENTIAL.items()
}
WRONG |= {one.__name__: ("integrator", corpus.offer_method(one, **RK4), name) for one, name in SUBTLE_METHODS.items()}
WRONG |= {
    "a wrong slope in the range of a law": (
        "force-law", subtle.ranged(subtle.wrong_where_it_says_it_holds, length=(20.0, 30.0)), "derivatives.length",
    ),
    "a step size that a symmetric start deceives": (
        "integrator", subtle.offer_derivative_solver(), "state.resting-starts",
    ),
}  # fmt: skip
WITH_CAUSES = overclaims.WRONG | wrong_steps.WRONG
WRONG |= {name: ("integrator", installed, check) for name, (installed, check, _) in WITH_CAUSES.items()}
WRONG |= {name: found[:3] for name, found in further_faults.WRONG.items()}
WRONG |= {name: ("integrator", installed, check) for name, (installed, check, _) in wrong_copies.WRONG.items()}
CAUSES = {name: cause for name, (_, _, cause) in (WITH_CAUSES | wrong_copies.WRONG).items()}
CAUSES |= {name: found[3] for name, found in further_faults.WRONG.items()}
RIGHT |= {name: ("integrator", installed) for name, installed in further_faults.RIGHT.items()}
FIRST = {(kind, check): name for name, (kind, _, check) in reversed(WRONG.items())}.values()
"""The first wrong plugin of each check; the others are slow tests, but for quick copies of methods of distributions."""


def others_slow(names: Iterable[str], chosen: Collection[str]) -> list[Any]:
    """Return parameters of which those that are not chosen are slow tests."""
    return [pytest.param(name, marks=[] if name in chosen else [pytest.mark.slow]) for name in names]


@pytest.mark.parametrize("name", others_slow(RIGHT, ("driven", "dry friction", "a root")))
def test_what_is_right_is_accused_by_no_check_that_catches_what_is_wrong(name: str) -> None:
    kind, installed = RIGHT[name]
    assert not installed.failures
    report = verify(kind, "acme:mine", installed=installed)
    assert report.verified, report.text()
    assert not report.of("warn"), report.text()
    assert {check for other, _, check in WRONG.values() if other == kind} <= {result.name for result in report.results}


@pytest.mark.parametrize("name", others_slow(WRONG, {*FIRST, *wrong_copies.WRONG} - {*wrong_copies.SLOW}))
def test_what_is_wrong_is_caught_by_the_check_that_says_so(name: str) -> None:
    kind, installed, expected = WRONG[name]
    found = outcome(kind, installed, expected)
    assert found.outcome == "fail", found
    assert found.cause
    assert CAUSES.get(name, "") in found.cause


@pytest.mark.parametrize("check", others_slow(overclaims.RIGHT, [x for x in overclaims.RIGHT if "energy" not in x]))
def test_a_claim_that_holds_is_not_refused(check: str) -> None:
    found = outcome("integrator", overclaims.RIGHT[check], check)
    assert found.outcome == ("skip" if check == "restart.state" else "pass"), found


@pytest.mark.parametrize("name", others_slow(further_faults.RIGHT, ("half-explicit Euler", "explicit Euler")))
def test_a_right_method_of_order_1_or_2_is_accused_by_no_check_that_its_coarse_steps_might_deceive(name: str) -> None:
    for check in ("state.resting-starts", "state.joint-friction", "restart.discontinuities", "drift.formulations"):
        found = outcome("integrator", further_faults.RIGHT[name], check)
        assert found.outcome in ("pass", "skip"), found


@pytest.mark.parametrize("name", others_slow(wrong_steps.RIGHT, ("a pair with fixed steps", "a library")))
def test_a_right_step_is_accused_by_no_check_of_what_it_contains(name: str) -> None:
    for check in {check for _, check, _ in wrong_steps.WRONG.values()}:
        found = outcome("integrator", wrong_steps.RIGHT[name], check)
        assert found.outcome in ("pass", "skip"), found


def test_a_method_that_tries_for_ever_is_cut_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbdkit_testing.check.WORK_LIMIT", 10_000)
    found = outcome("integrator", corpus.offer_method(corpus.Endless, **RK4), "failure.not-a-number")
    assert found.outcome == "fail"
    assert found.cause == "it did not finish within 10000 evaluations of the equations"


def test_a_method_that_loops_without_evaluations_is_cut_short_by_its_processor_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mbdkit_testing.check.PROCESSOR_LIMIT", 0.5)
    found = outcome("integrator", corpus.offer_method(corpus.Idle, **RK4), "state.free-fall")
    assert found.outcome == "fail"
    assert found.cause == "it did not finish within 0.5 s of processor time"


def test_waiting_does_not_count_against_a_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbdkit_testing.check.PROCESSOR_LIMIT", 0.2)

    def wait(method: str) -> Result:
        time.sleep(0.4)
        return Result("pass")

    found = Check("state.slow", wait).run("a method")
    assert found.outcome == "pass"
    assert found.seconds < 0.2


def test_claims_that_cannot_be_read_fail_the_checks_that_use_them() -> None:
    class Unclaimed:
        @property
        def claims(self) -> object:
            raise PluginError("it returned no claims")

    found = Check("contract.method", lambda under_test: Result("pass", str(under_test.claims))).run(Unclaimed())
    assert (found.outcome, found.cause) == ("fail", "it returned no claims")


def test_an_under_claim_is_a_warning_and_no_failure() -> None:
    found = outcome("integrator", corpus.offer_method(corpus.RungeKutta, **RK4 | {"order": 3}), "order.four-bar")
    assert found.outcome == "warn"
    assert found.figures["measured"] == pytest.approx(4.0, abs=0.2)  # the order of the classical method


def test_a_start_of_order_1_does_not_count_against_a_multistep_method() -> None:
    multistep = wrong_steps.fixed(wrong_steps.Bashforth, order=2, dense_order=2)
    dense = outcome("integrator", multistep, "order.dense-output")
    assert dense.outcome == "pass"
    assert dense.figures["measured"] == pytest.approx(2.0, abs=0.2)  # the local error of Adams-Bashforth is O(h^3)
    polynomials = outcome("integrator", multistep, "order.polynomials")
    assert polynomials.outcome == "skip"
    assert "its first step, which may be of lower order because it has no history" in polynomials.cause


def test_a_check_of_single_steps_says_why_none_could_be_taken() -> None:
    _, wrong, _ = WRONG["steps that are never accepted"]
    cause = outcome("integrator", wrong, "tolerance.error-estimate").cause
    assert cause.startswith("no single step from the start could be taken: its own control rejects them")


def test_a_tableau_with_a_wrong_coefficient_cannot_even_be_built() -> None:
    with pytest.raises(mbdkit.MbdkitError, match="order condition of order 2 has the defect"):
        mbdkit.ButcherTableau("mine", [[], ["1/2"]], ["1/2", "1/2"], [0, "1/2"], 2)
    with pytest.raises(mbdkit.MbdkitError, match="row 2 of a sums to its node plus"):
        mbdkit.ButcherTableau("mine", [[], ["1/2"]], [0, 1], [0, "1/3"], 2)
