"""Verification beyond the defaults: options, laws with states, claims of drift, and where a plugin failed."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path

import pytest
import sympy
from pydantic import BaseModel, ConfigDict, Field
from tests.testing.corpus import _with
from tests.testing.results import one

import mbdkit
from mbdkit import ExpressionLaw, ForceLawPlugin
from mbdkit.base.errors import with_place
from mbdkit.plugin import PlotKind, ReportSection, Target
from mbdkit.registry.manager import registry
from mbdkit.runs.simulation import simulate
from mbdkit_testing import verify
from mbdkit_testing.check_result import Report, Result
from mbdkit_testing.drift_checks import CHECKS as DRIFT
from mbdkit_testing.kit import plugin_under_test
from mbdkit_testing.options_under_test import variants
from tests.laws.motor import MOTOR

from . import corpus


def test_a_negative_damping_of_a_passive_law_is_caught_though_its_default_is_0() -> None:
    found = one("law.other-options", "force-law", corpus.offer_damper(corpus.LooseDamping))
    assert found.outcome == "fail"
    assert found.cause.startswith("with damping = -1: it claims to be passive, but adds energy")
    assert found.cause.endswith("if that is not meant, give the option bounds")
    assert one("law.passivity", "force-law", corpus.offer_damper(corpus.LooseDamping)).outcome == "pass"
    assert one("law.other-options", "force-law", corpus.offer_damper(corpus.BoundedDamping)).outcome == "pass"


STIFFNESS, FREE_LENGTH, LENGTH = sympy.symbols("stiffness free_length length", real=True)
SPRINGS = {
    "used": (corpus.offer_spring(STIFFNESS * (LENGTH - FREE_LENGTH)), "pass", ""),
    "used beyond 4 m only": (corpus.offer_spring(STIFFNESS * sympy.Max(LENGTH - 4 - FREE_LENGTH / 100, 0)), "pass", ""),
    "not in the expression": (corpus.offer_spring(STIFFNESS * LENGTH), "fail", "its option free_length has no effect"),
    "not passed on": (
        corpus.offer_spring(STIFFNESS * LENGTH, parameters=lambda options: {"stiffness": options.stiffness}), "warn",
        "its option free_length has no effect for 16 random sets of values",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", [pytest.param(x, marks=[pytest.mark.slow] * (x == "not passed on")) for x in SPRINGS])
def test_options_that_do_not_change_the_force_are_found(name: str) -> None:
    installed, outcome, message = SPRINGS[name]
    found = one("law.option-effects", "force-law", installed)
    assert found.outcome == outcome, found
    assert found.cause.startswith(message)


def test_values_of_options_are_within_their_bounds_and_the_same_each_time() -> None:
    item = registry().get("integrator", "gauss")
    tried = list(variants(item, {"stages": 2}))
    assert tried == list(variants(item, {"stages": 2}))
    stages = {options["stages"] for _, options in tried}
    assert stages <= {1, 2, 3, 4, 5, 6}
    assert len(stages) > 2
    assert any(options.get("stage_solver") == "fixed-point" for _, options in tried)


def test_an_integrator_that_fails_with_another_option_is_caught() -> None:
    installed = corpus.offer(corpus.fragile, corpus.Fragile, order=4, needs=("accelerations",))
    found = one("contract.other-options", "integrator", installed)
    assert found.outcome == "fail"
    assert "TypeError" in found.cause


@pytest.mark.parametrize(
    ("claims", "outcome", "message"),
    [
        ({"drift": "none"}, "fail", "it claims drift = 'none', but the constraints do not hold at position level"),
        ({"constraints_hold": ("position",)}, "fail", "it claims constraints_hold = ['position']"),
        pytest.param({"drift": "of order 4"}, "pass", "", marks=pytest.mark.slow),
    ],
)
def test_a_claim_of_no_drift_is_held(claims: dict[str, object], outcome: str, message: str) -> None:
    installed = corpus.offer_method(corpus.RungeKutta, order=4, needs=("accelerations",), **claims)
    found = DRIFT[0].run(plugin_under_test("integrator", "mine", {}, installed))
    assert found.outcome == outcome
    assert message in found.cause


@pytest.mark.slow
def test_a_pass_says_what_was_compared_with_what() -> None:
    text = verify("force-law", "one-sided", {"stiffness": 50.0, "acts": "tension"}, quick=True).text()
    lines = {line.split()[0]: line for line in text.splitlines() if line.startswith("  ")}
    assert "(at most 1e-05)" in lines["derivatives.length"]
    assert "The law's values are finite and repeatable" in lines["law.finite"]


def test_one_error_is_told_once_with_the_checks_that_failed() -> None:
    error = "AttributeError: '{}' object has no attribute 'mass' (/plugin.py, line 29)"
    raised = Result("fail", f"it raised {error.format('Equations')}", name="contract.inputs")
    run = Result(
        "fail", f"the run failed: plugin-error: rocket raised {error.format('Counted')}", name="order.four-bar"
    )
    left, other = replace(run, outcome="skip", name="drift.growth"), Result("fail", "order 1", name="state.free-fall")
    text = Report("a:b", "integrator", "1", {}, {}, (raised, run, left, other)).text()
    assert text.count("line 29") == text.count("order.four-bar") == text.count("state.free-fall") == 1
    assert (
        f"2 checks failed, 1 skipped: the plugin raised {error.format('Equations')}\n  failed: contract.inputs" in text
    )
    assert "not verified: 3 failed; " in text


def test_a_wrong_tableau_is_told_once_with_the_number_of_checks_that_it_failed() -> None:
    def create(options: object) -> object:
        tableau = mbdkit.ButcherTableau("heun", [[], [1]], ["1/2", "1/3"], [0, 1], 2)
        return mbdkit.ExplicitRungeKutta(tableau)

    report = verify("integrator", "mine", installed=corpus.offer(create, order=2, stages=2), quick=True)
    count = len(report.of("fail"))
    assert count > 40
    cause = "heun claims order 2, but an order condition of order 1 has the defect -0.167"
    assert report.text().count("order condition") == 1
    assert f"{count} checks failed: {cause}\n" in report.text()
    assert f"{count - 12} more\n" in report.text()


def test_the_cost_of_a_step_is_known_while_the_time_of_a_check_is_limited() -> None:
    """A clock of 10 ms would give multiples of 33 us for 300 steps, and 0 for compiled methods."""
    found = one("cost.step", "integrator", corpus.trapezoid(symmetric=False))
    assert 0.1 < float(found.figures["us_per_step"]) < 33.0
    assert found.figures["rhs_per_step"] == 2.0


@pytest.mark.parametrize(
    ("name", "shows", "outcome", "words"),
    [
        ("right", "[Figure('a', 'A', '', Axis('x', ''), Axis('y', ''), (Line('l', run.time, run.time),))]", "pass", ""),
        ("nothing", "[]", "skip", "it shows nothing of the packaged examples double-pendulum, knee, slider-crank"),
        ("other", "[3]", "fail", "for a run of double-pendulum it returned an object of type int, not a Figure or Sec"),
        (
            "raises",
            "run.jump",
            "fail",
            "it raised AttributeError: 'Run' object has no attribute 'jump' (acme_raises.py",
        ),
        (
            "short",
            "[Figure('a', 'A', '', Axis('x', ''), Axis('y', ''), (Line('l', run.time, run.time[1:]),))]",
            "fail",
            "it raised ",
        ),
    ],
)
def test_plots_and_sections_of_plugins_are_called(
    name: str, shows: str, outcome: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / f"acme_{name}.py").write_text(
        "from mbdkit.plugin.reports import Axis, Figure, Line, Section, report_charts, report_sections\n"
        f"def charts(run):\n    return {shows}\ndef chart(run):\n    return charts(run)[0]\n"
        "figures = report_charts(charts)\n"
        "@report_sections\ndef sections(run, mechanism):\n    return []\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    module = f"acme_{name}"
    section = ReportSection(
        name="mine", summary="A section.", make=Target(f"{module}:sections"), charts=Target(f"{module}:figures")
    )
    for kind, item in (
        ("plot-kind", PlotKind(name="mine", summary="A plot.", module=module)),
        ("report-section", section),
    ):
        found = one("contract.pages", kind, corpus._with(mbdkit_items=item))
        assert found.outcome == outcome, found
        assert found.cause.startswith(words.replace("acme", str(tmp_path / "acme"))), found


def test_an_exception_of_a_method_is_told_with_its_line_and_chained() -> None:
    installed = corpus.offer_method(corpus.Raises, order=4, needs=("accelerations",))
    under_test = plugin_under_test("integrator", "mine", {}, installed)
    lines, first = inspect.getsourcelines(corpus.Raises)
    line = first + next(i for i, text in enumerate(lines) if "raise LookupError" in text)
    with simulate(under_test.spec({"name": "double-pendulum"}, {"end": 0.1, "step": 0.01})) as run:
        assert run.status_reason.startswith("plugin-error: integrator acme:mine raised LookupError: no table for this")
        assert run.status_reason.endswith(f"({corpus.__file__}, line {line}).")
        with pytest.raises(mbdkit.RunError) as caught:
            run.check()
    assert isinstance(caught.value.__cause__, LookupError)


def test_an_exception_in_a_step_is_told_first_and_is_the_cause_of_all_failures() -> None:
    installed = corpus.offer_method(corpus.Raises, order=4, needs=("accelerations",))
    report = verify("integrator", "acme:mine", installed=installed, quick=True)
    text = report.text()
    assert text.index("the plugin raised LookupError: no table for this step") < text.index("CHECK  ")
    assert {one.name: one.cause for one in report.of("fail") if "LookupError" not in one.cause} == {}


def test_an_exception_without_a_plugin_has_no_place() -> None:
    assert with_place(ValueError("too small")) == "ValueError: too small"


class Filter(BaseModel):
    """A spring with a delay."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    stiffness: float = Field(default=50.0, gt=0.0)
    """Stiffness [N/m]."""
    pull: float = 0.0
    """Initial pull [N]."""


def checked(rate: sympy.Expr) -> Result:
    """Return the check of a law whose force is its state, with this rate."""
    law = ExpressionLaw(sympy.Symbol("pull"), rates={"pull": (rate, "N")})
    return one(
        "law.states", "force-law", _with(mbdkit_force_laws=ForceLawPlugin("mine", "A law", Filter, law, ("@misc{a}",)))
    )


length, time, stiffness, pull = sympy.symbols("length time stiffness pull")


def test_states_that_are_finite_and_converge_pass():
    assert checked((stiffness * length - pull) / 0.05).outcome == "pass"
    assert (
        one(
            "law.states",
            "force-law",
            _with(mbdkit_force_laws=ForceLawPlugin("mine", "A motor", MOTOR.options, MOTOR.law, MOTOR.references)),
        ).outcome
        == "pass"
    )


@pytest.mark.parametrize(
    ("rate", "cause"),
    [
        (sympy.sqrt(length) - pull, "the rate of its state 'pull' is nan at length -"),
        (1e3 * sympy.sin(1e7 * time), "its state 'pull' in a run does not converge with the step"),
    ],
)
def test_states_that_are_not_finite_or_depend_on_the_step_fail(rate, cause):
    found = checked(rate)
    assert found.outcome == "fail"
    assert cause in found.cause


def test_laws_without_states_are_not_concerned():
    law = ExpressionLaw(-stiffness * length)
    plugin = ForceLawPlugin("mine", "A spring", Filter, law, ("@misc{a}",))
    assert one("law.states", "force-law", _with(mbdkit_force_laws=plugin)).outcome == "skip"
