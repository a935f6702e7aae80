"""The kit from outside: what mbdkit ships is verified, reports count, tests are made, and the table is fresh."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tests.testing import corpus

import mbdkit
import mbdkit.testing
from mbdkit import ImplicitRungeKutta
from mbdkit.registry.manager import registry
from mbdkit.runs.method_evidence import evidence_file, read_records
from mbdkit_testing import conformance
from mbdkit_testing.check_result import Report, Result
from mbdkit_testing.kit import checks_of, plugin_under_test
from mbdkit_testing.order_checks import reference
from mbdkit_testing.trial_models import DRIVEN_PENDULUM
from tests.integrators.diagonal_tableaus import TABLEAUS

README = Path(__file__).parents[2] / "README.md"
OPTIONS: dict[str, dict[str, Any]] = {
    "linear": {"stiffness": 30.0, "damping": 1.0, "free_length": 0.5},
    "exponential": {"scale": 5.0, "growth": 2.0, "damping": 1.0, "free_length": 0.5, "acts": "tension"},
    "gas-spring": {"preload": 50.0, "progression": 1.4, "extended_length": 2.0, "stroke": 0.5, "exponent": 1.2},
    "one-sided": {"stiffness": 200.0, "damping": 1.0, "free_length": 0.5, "acts": "compression"},
    "table": {"table": [[0.0, 0.5, 1.0, 1.5], [-20.0, 0.0, 30.0, 90.0]], "damping": 1.0},
    "n-pendulum": {"n": 4, "angle": -1.0},
    "mechanism": DRIVEN_PENDULUM,
}
EVIDENCE = read_records(evidence_file(registry().get("integrator", "mbdkit:gauss").origin))
VARIANTS = [(record["name"], record["options"]) for record in EVIDENCE]
FULL = [("gauss", {"stages": 3}), ("rk4", {}), ("scipy-dop853", {})]
FIRST = [("gauss", {"stages": 2}), ("dop853", {})]
"""An implicit method and an explicit one with adaptive steps; the others of mbdkit are slow tests."""
EVERY = [pytest.param(*x, marks=[] if x in FIRST else [pytest.mark.slow]) for x in VARIANTS]


@pytest.mark.parametrize(("name", "options"), EVERY, ids=lambda x: str(x))
def test_every_integrator_of_mbdkit_is_verified(name: str, options: dict[str, Any]) -> None:
    report = mbdkit.testing.check_integrator(f"mbdkit:{name}", options, quick=True)
    assert report.verified, report.text()
    assert not report.of("warn"), report.text()


def test_warnings_about_the_test_problems_are_not_printed(capsys: pytest.CaptureFixture[str]) -> None:
    reference.__wrapped__("beam")  # its elements are coarse
    assert capsys.readouterr().err == ""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options"), FULL, ids=lambda x: str(x))
def test_the_slow_checks_find_no_fault_either(name: str, options: dict[str, Any]) -> None:
    integrator = plugin_under_test("integrator", f"mbdkit:{name}", options)
    found = [check.run(integrator) for check in checks_of("integrator") if check.slow]
    assert found
    assert all(result.outcome != "fail" for result in found), found
    assert sum(result.seconds for result in found) < 60  # processor time


@pytest.mark.parametrize("name", [item.name for item in registry().only("mbdkit").of_kind("model")])
def test_every_model_of_mbdkit_is_verified(name: str) -> None:
    options = {key: value for key, value in OPTIONS.get(name, {}).items() if key != "name"}
    report = mbdkit.testing.check_model(f"mbdkit:{name}", options)
    assert report.verified, report.text()


LAWS = [item.name for item in registry().only("mbdkit").of_kind("force-law")]


@pytest.mark.parametrize(
    ("name", "by_example"),
    [
        pytest.param(name, by_example, marks=[pytest.mark.slow] * (not by_example or name != "gas-spring"))
        for name in LAWS
        for by_example in (True, False)
    ],
)
def test_every_force_law_of_mbdkit_is_verified(name: str, by_example: bool) -> None:
    report = mbdkit.testing.check_force_law(f"mbdkit:{name}", {} if by_example else OPTIONS[name])
    assert report.verified, report.text()
    assert not report.of("warn"), report.text()


# in place of its verification above
@conformance(force_law="mbdkit:one-sided", options={"stiffness": 50.0, "acts": "tension"})
def test_one_line_makes_every_check_a_test(case: Any) -> None:
    assert case().outcome == "pass"


def test_a_decorated_test_fails_where_the_check_does_and_skips_where_it_does() -> None:
    from mbdkit_testing.pytest_suite import ConformanceWarning, cases

    by_name = {str(case): case for case in cases("integrator", "mbdkit:rk4")}
    with pytest.raises(pytest.skip.Exception, match="it does not iterate"):
        by_name["newton.tolerance"]()
    dishonest = next(case for case in by_name.values() if str(case) == "contract.method")
    assert dishonest().outcome == "pass"
    assert issubclass(ConformanceWarning, UserWarning)
    with pytest.raises(pytest.skip.Exception, match="not claimed; measured: defect"):
        by_name["geometry.symplectic-form"]()
    with pytest.raises(TypeError, match=r"exactly one of integrator=, .*element= and joint="):
        conformance(integrator="rk4", model="single-pendulum")


def result(name: str, outcome: Any) -> Result:
    cause = "because" if outcome != "pass" else ""
    return Result(outcome, cause, {"x": float("nan")}, name, "It does.", 0.1)


def report(*results: Result) -> Report:
    return Report("acme:mine", "integrator", "1.0", {"k": 1}, {"order": 2}, results)


def test_nothing_is_verified_without_a_check_of_its_geometry() -> None:
    assert report(result("order.x", "pass"), result("geometry.x", "pass")).verified
    bare = report(result("order.x", "pass"), result("geometry.x", "skip"))
    assert not bare.verified
    assert bare.verdict() == "not verified: no check of the group geometry could be run; 1 check run, 1 skipped"


def test_a_warning_is_no_failure_and_a_failure_is_named() -> None:
    assert report(result("order.x", "warn"), result("geometry.x", "pass")).verified
    found = report(result("order.x", "fail"), result("geometry.x", "pass"), result("drift.x", "skip"))
    assert found.verdict() == "not verified: 1 failed (order.x); 2 checks run, 1 skipped"


def test_a_property_that_is_not_claimed_is_measured_but_does_not_pass() -> None:
    rk4 = plugin_under_test("integrator", "mbdkit:rk4", {})  # neither symmetric nor symplectic
    names = ["tableau.symmetry", "tableau.symplecticity", "geometry.quadratic-invariants", "geometry.symplectic-form"]
    found = [check.run(rk4) for check in checks_of("integrator") if check.name in names]
    assert [one.name for one in found] == names
    assert all(one.outcome == "not claimed" and one.figures for one in found)
    assert all(value > 1e-7 for one in found[2:] for value in one.figures.values() if isinstance(value, float))
    told = report(*found, result("order.x", "pass"))
    assert told.verdict() == "verified: 5 checks run, 4 of properties that are not claimed"
    assert "not claimed  symmetric no; The method is symmetric" in told.text()
    assert told.to_dict()["not_claimed"] == 4


def test_a_report_as_json_holds_no_number_that_json_has_not() -> None:
    told = json.loads(json.dumps(report(result("geometry.x", "pass")).to_dict(), allow_nan=False))
    assert told["checks"][0]["figures"] == {"x": None}
    assert (told["verified"], told["run"], told["failed"], told["skipped"]) == (True, 1, 0, 0)


@pytest.mark.parametrize("kind", ["integrator", "model", "force-law", "element-kind"])
def test_every_check_has_a_name_of_its_own_in_a_group_and_says_what_it_does(kind: Any) -> None:
    checks = list(checks_of(kind))
    assert len({check.name for check in checks}) == len(checks)
    assert all(check.what.endswith(".") and len(check.what) > 30 for check in checks)
    assert all(f"`{check.name.partition('.')[0]}`" in README.read_text(encoding="utf-8") for check in checks)


def test_the_evidence_has_every_integrator_of_mbdkit_with_what_it_claims_now() -> None:
    """`mbdkit plugins verify mbdkit --record` renews it."""
    assert {item.name for item in registry().only("mbdkit").of_kind("integrator")} == {name for name, _ in VARIANTS}
    for record in EVIDENCE:
        claims = plugin_under_test("integrator", f"mbdkit:{record['name']}", record["options"]).claims
        assert record["claims"].get("order") == claims.order
        assert record["verified"]
        assert not record["failed"]


def test_a_plugin_with_such_a_tableau_is_verified() -> None:
    tableau = TABLEAUS["alexander-2"]
    offered = corpus.offer(lambda options: ImplicitRungeKutta(tableau), order=2, stages=2, needs=("tangents",))
    integrator = plugin_under_test("integrator", "mine", {}, offered)
    wanted = ("contract.", "tableau.", "counters.", "newton.tolerance")
    found = [check.run(integrator) for check in checks_of("integrator", quick=True) if check.name.startswith(wanted)]
    assert len(found) > 12
    assert [result for result in found if result.outcome == "fail"] == []
