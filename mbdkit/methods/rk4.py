"""The classical Runge-Kutta method of order 4."""

from __future__ import annotations

from functools import cache

from mbdkit.base.bibliography import entry
from mbdkit.methods.kinds import ExplicitRungeKutta, integrator_method
from mbdkit.methods.method_options import ExplicitOptions, explicit_claims
from mbdkit.methods.tableau import ButcherTableau

REFERENCE = entry(__file__, "kutta1901")


@cache
def tableau() -> ButcherTableau:
    """Return the tableau of RK4."""
    return ButcherTableau(
        "rk4",
        a=[[], ["1/2"], [0, "1/2"], [0, 0, 1]],
        b=["1/6", "1/3", "1/3", "1/6"],
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
