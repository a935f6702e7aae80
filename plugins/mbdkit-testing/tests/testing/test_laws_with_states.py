"""Verification of force laws with first-order states."""

from __future__ import annotations

import pytest
import sympy
from pydantic import BaseModel, ConfigDict, Field
from tests.testing.corpus import _with
from tests.testing.results import one

from mbdkit import ExpressionLaw, ForceLawPlugin
from mbdkit_testing import Result
from tests.laws.motor import MOTOR


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
