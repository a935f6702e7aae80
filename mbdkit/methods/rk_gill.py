"""Gill's variant of the four-stage Runge-Kutta method of order 4.

Gill (1951) chose the free parameters, which contain 1/sqrt(2), so that a step needs three storage registers and
compensates its own rounding errors. Neither property is used here: the tableau is treated like any other explicit one,
and all explicit methods use compensated summation.
"""

from __future__ import annotations

from functools import cache

from mbdkit.base.bibliography import entry
from mbdkit.methods.kinds import ExplicitRungeKutta, integrator_method
from mbdkit.methods.method_options import ExplicitOptions, explicit_claims
from mbdkit.methods.tableau import ButcherTableau

REFERENCE = entry(__file__, "gill1951")


@cache
def tableau() -> ButcherTableau:
    """Return the tableau of Runge-Kutta-Gill."""
    return ButcherTableau(
        "rk-gill",
        a=[[], ["1/2"], ["sqrt(2)/2 - 1/2", "1 - sqrt(2)/2"], [0, "-sqrt(2)/2", "1 + sqrt(2)/2"]],
        b=["1/6", "(2 - sqrt(2))/6", "(2 + sqrt(2))/6", "1/6"],
        c=[0, "1/2", "1/2", 1],
        order=4,
        reference=REFERENCE,
    )


@integrator_method
def create(options: ExplicitOptions) -> ExplicitRungeKutta:
    """Return the method."""
    return ExplicitRungeKutta(tableau())


claims = explicit_claims(order=4, stages=4)
REFERENCES = (REFERENCE,)
