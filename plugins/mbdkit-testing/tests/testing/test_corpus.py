"""Each plugin of the corpus is caught, and by the check that says what is wrong with it."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest

import mbdkit
from mbdkit.registry.catalogue import Registry
from mbdkit_testing import Result, checks_of, verify
from mbdkit_testing.check import Check
from mbdkit_testing.kit import plugin_under_test

from . import corpus, further_faults, overclaims, subtle, wrong_steps

RK4 = {"order": 4, "needs": ("accelerations",)}
MIDPOINT = {"order": 2, "needs": ("tangents",), "symmetric": True, "symplectic": True, "quadratic_invariants": True}

EULER = {"order": 1, "needs": ("accelerations",), "symplectic": True}

RIGHT = {
    "symplectic Euler": ("integrator", corpus.offer_method(corpus.SymplecticEuler, **EULER)),
    "runge-kutta": ("integrator", corpus.offer_method(corpus.RungeKutta, **RK4)),
    "midpoint": ("integrator", corpus.offer_method(corpus.Midpoint, **MIDPOINT)),
    "pendulum": ("model", corpus.offer_model()),
    "driven": ("model", corpus.offer_model(motion="0.5*sin(2*t)")),
    "hardening": ("force-law", corpus.offer_law(corpus.hardening)),
    "contact": ("force-law", corpus.offer_law(subtle.hertz)),
    "dry friction": ("force-law", corpus.offer_law(subtle.dry_friction, potential=False)),
    "a steep stop": ("force-law", corpus.offer_law(subtle.steep)),
    "a root": (
        "force-law",
        subtle.ranged(subtle.right_where_it_says_it_holds, length=(0.0, math.inf), time=(0.0, 4.0)),
    ),
}

WRONG: dict[str, tuple[Any, Registry, str]] = {
    "a wrong coefficient": ("integrator", corpus.offer_method(corpus.WrongCoefficient, **RK4), "order.four-bar"),
    "a wrong stage time": ("integrator", corpus.offer_method(corpus.WrongStageTime, **RK4), "order.forced-pendulum"),
    "a loose Newton": ("integrator", corpus.loose_gauss(1e-4), "newton.tolerance"),
    "a default that is too loose": ("integrator", corpus.loose_by_default(), "newton.tolerance"),
    "a Newton that is left out at fine steps": (
        "integrator",
        corpus.offer_method(corpus.LazyNewton, **MIDPOINT),
        "order.finest",
    ),
    "a Newton that ends while bodies move": (
        "integrator",
        corpus.offer_method(corpus.LooseNewton, **MIDPOINT),
        "geometry.reversibility-pendulum",
    ),
    "a wrong Jacobian, used once": (
        "integrator",
        corpus.offer_method(corpus.WrongJacobian, **MIDPOINT),
        "geometry.symplectic-form",
    ),
    "a claim of symmetry": (
        "integrator",
        corpus.offer_method(corpus.RungeKutta, **RK4, symmetric=True),
        "geometry.reversibility-pendulum",
    ),
    "a tableau's claim of symmetry": ("integrator", corpus.trapezoid(symmetric=True), "tableau.symmetry"),
    "a claim of symplecticity": (
        "integrator",
        corpus.offer_method(corpus.RungeKutta, **RK4, symplectic=True),
        "geometry.symplectic-form",
    ),
    "a claim of invariants": (
        "integrator",
        corpus.offer_method(corpus.RungeKutta, **RK4, quadratic_invariants=True),
        "geometry.quadratic-invariants",
    ),
    "a claim of invariants by a method that keeps one of them": (
        "integrator",
        corpus.offer_method(corpus.SymplecticEuler, **EULER, quadratic_invariants=True),
        "geometry.quadratic-invariants",
    ),
    "an over-claim of order": (
        "integrator",
        corpus.offer_method(corpus.RungeKutta, **RK4 | {"order": 5}),
        "order.forced-pendulum",
    ),
    "a claim to hold the joints": (
        "integrator",
        corpus.offer_method(corpus.RungeKutta, **RK4, formulations=("index-3",)),
        "drift.position",
    ),
    "a lying counter": ("integrator", corpus.offer_method(corpus.LyingCounter, **RK4), "honesty.counters"),
    "tangents that it does not own up to": (
        "integrator",
        corpus.offer_method(corpus.Midpoint, **MIDPOINT | {"needs": ()}),
        "honesty.needs",
    ),
    "hidden stabilization": ("integrator", corpus.offer_method(corpus.Stabilized, **RK4), "honesty.projections"),
    "a changed input": ("integrator", corpus.offer_method(corpus.ChangesItsInput, **RK4), "contract.inputs"),
    "a buffer": ("integrator", corpus.offer_method(corpus.ReturnsItsBuffer, **RK4), "contract.inputs"),
    "a swallowed NaN": ("integrator", corpus.offer_method(corpus.SwallowsNaN, **RK4), "failure.not-a-number"),
    "a memory outside the state": (
        "integrator",
        corpus.offer_method(corpus.Forgetful, order=2, needs=("accelerations",)),
        "restart.state",
    ),
    "a memory that a look inside a step changes": (
        "integrator",
        corpus.offer_method(corpus.Alternating, order=1, needs=("accelerations",)),
        "restart.stretches",
    ),
    "a solver that obeys no tolerance": ("integrator", corpus.offer_solver(), "tolerance.forced-pendulum"),
    "a driver with a corner": ("model", corpus.offer_model(motion="0.5*abs(t - 0.4)"), "model.drivers"),
    "a model that is another each time": ("model", corpus.offer_model(random=True), "model.repeatable"),
    "a wrong derivative in the length": ("force-law", corpus.offer_law(corpus.wrong_slope), "derivatives.length"),
    "a wrong derivative in the rate": ("force-law", corpus.offer_law(corpus.wrong_rate), "derivatives.rate"),
    "a potential of the wrong sign": ("force-law", corpus.offer_law(corpus.wrong_potential), "law.potential"),
    "a damper that pushes": ("force-law", corpus.offer_law(corpus.pushes), "law.passivity"),
    "a law that is no number": (
        "force-law",
        corpus.offer_law(corpus.no_number, potential=False, passive=False),
        "law.finite",
    ),
}
SUBTLE_LAWS = {
    subtle.creates_energy_at_some_rates: "law.passivity",
    subtle.creates_energy_in_a_corner: "law.passivity",
    subtle.creates_energy_for_a_second: "law.passivity",
    subtle.creates_a_little: "law.passivity",
    subtle.wrong_slope_when_long: "derivatives.length",
    subtle.wrong_slope_below_zero: "derivatives.length",
    subtle.wrong_slope_near_zero: "derivatives.length",
    subtle.wrong_slope_of_the_product: "derivatives.length",
    subtle.wrong_rate_when_fast: "derivatives.rate",
    subtle.wrong_rate_late: "derivatives.rate",
    subtle.stiffer_after_two_seconds: "law.potential",
    subtle.flickers: "law.potential",
    subtle.potential_jumps: "law.potential",
}
SUBTLE_LAWS_WITHOUT_POTENTIAL = {
    subtle.creates_energy_when_long: "law.passivity",
    subtle.springy_but_passive: "law.passivity",
    subtle.no_number_when_short: "law.finite",
}
SUBTLE_METHODS = {
    subtle.Growing: "state.free-fall",
    subtle.EndShort: "state.free-fall",
    subtle.EndAlmostShort: "state.last-step",
    subtle.NoEnd: "state.free-fall",
    subtle.Single: "order.finest",
    subtle.Wrapped: "state.free-fall",
    subtle.Clipped: "state.free-fall",
    subtle.OwnClock: "contract.start-time",
    subtle.EarlyTimeOnly: "contract.start-time",
}
WRONG |= {one.__name__: ("force-law", corpus.offer_law(one), name) for one, name in SUBTLE_LAWS.items()}
WRONG |= {
    one.__name__: ("force-law", corpus.offer_law(one, potential=False), name)
    for one, name in SUBTLE_LAWS_WITHOUT_POTENTIAL.items()
}
WRONG |= {one.__name__: ("integrator", corpus.offer_method(one, **RK4), name) for one, name in SUBTLE_METHODS.items()}
WRONG |= {
    "a wrong slope in the range of a law": (
        "force-law",
        subtle.ranged(subtle.wrong_where_it_says_it_holds, length=(20.0, 30.0)),
        "derivatives.length",
    ),
    "a step size that a symmetric start deceives": (
        "integrator",
        subtle.offer_derivative_solver(),
        "state.resting-starts",
    ),
}
WITH_CAUSES = overclaims.WRONG | wrong_steps.WRONG
WRONG |= {name: ("integrator", installed, check) for name, (installed, check, _) in WITH_CAUSES.items()}
WRONG |= {name: found[:3] for name, found in further_faults.WRONG.items()}
CAUSES = {name: cause for name, (_, _, cause) in WITH_CAUSES.items()}
CAUSES |= {name: found[3] for name, found in further_faults.WRONG.items()}
RIGHT |= {name: ("integrator", installed) for name, installed in further_faults.RIGHT.items()}


def outcome(kind: Any, installed: Registry, name: str) -> Result:
    """Return what one check says of a plugin."""
    assert not installed.failures
    check = next(check for check in checks_of(kind) if check.name == name)
    return check.run(plugin_under_test(kind, "acme:mine", {}, installed))


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (kind == "integrator")) for name, (kind, _) in RIGHT.items()],
)
def test_what_is_right_is_accused_by_no_check_that_catches_what_is_wrong(name: str) -> None:
    kind, installed = RIGHT[name]
    assert not installed.failures
    report = verify(kind, "acme:mine", installed=installed)
    assert report.verified, report.text()
    assert not report.of("warn"), report.text()
    assert {check for other, _, check in WRONG.values() if other == kind} <= {result.name for result in report.results}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_caught_by_the_check_that_says_so(name: str) -> None:
    kind, installed, expected = WRONG[name]
    found = outcome(kind, installed, expected)
    assert found.outcome == "fail", found
    assert found.cause
    assert CAUSES.get(name, "") in found.cause


@pytest.mark.parametrize(
    "check", [pytest.param(x, marks=[pytest.mark.slow] * (x == "geometry.conserved-energy")) for x in overclaims.RIGHT]
)
def test_a_claim_that_holds_is_not_refused(check: str) -> None:
    found = outcome("integrator", overclaims.RIGHT[check], check)
    assert found.outcome == ("skip" if check == "restart.state" else "pass"), found


@pytest.mark.parametrize("name", further_faults.RIGHT)
def test_a_right_method_of_order_1_or_2_is_accused_by_no_check_that_its_coarse_steps_might_deceive(name: str) -> None:
    for check in (
        "state.resting-starts",
        "state.joint-friction",
        "restart.discontinuities",
        "drift.formulations",
    ):
        found = outcome("integrator", further_faults.RIGHT[name], check)
        assert found.outcome in ("pass", "skip"), found


@pytest.mark.parametrize("name", wrong_steps.RIGHT)
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


def test_an_under_claim_is_a_warning_and_no_failure() -> None:
    found = outcome("integrator", corpus.offer_method(corpus.RungeKutta, **RK4 | {"order": 3}), "order.four-bar")
    assert found.outcome == "warn"
    assert found.figures["measured"] == pytest.approx(4.0, abs=0.2)  # the order of the classical method


def test_a_wrong_stage_time_does_not_show_where_nothing_depends_on_time() -> None:
    # what makes this one treacherous: there it is the classical method
    wrong = outcome("integrator", corpus.offer_method(corpus.WrongStageTime, **RK4), "geometry.energy")
    assert wrong.figures == outcome(*RIGHT["runge-kutta"], "geometry.energy").figures


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


def test_an_estimate_that_is_zero_for_linear_equations_does_not_show_in_nonlinear_problems() -> None:
    _, wrong, _ = WRONG["an error estimate that is zero for linear equations"]
    for check in ("tolerance.forced-pendulum", "tolerance.four-bar", "tolerance.error-estimate"):
        assert outcome("integrator", wrong, check).outcome == "pass"


def test_a_tableau_with_a_wrong_coefficient_cannot_even_be_built() -> None:
    with pytest.raises(mbdkit.MbdkitError, match="order condition of order 2 has the defect"):
        mbdkit.ButcherTableau("mine", [[], ["1/2"]], ["1/2", "1/2"], [0, "1/2"], 2)
    with pytest.raises(mbdkit.MbdkitError, match="row 2 of a sums to its node plus"):
        mbdkit.ButcherTableau("mine", [[], ["1/2"]], [0, 1], [0, "1/3"], 2)
