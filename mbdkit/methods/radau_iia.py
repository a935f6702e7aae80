"""Radau IIA collocation, s stages, order 2 s - 1: stiffly accurate and L-stable, for stiff springs and dampers.

This is not SciPy's adaptive `Radau`. If that solver is used with a fixed step size, it stops its Newton iteration
early, and constraints drift hundreds of times faster than with this method.

Closed forms of the coefficients, by the number of stages, lie in ``radau_iia.json``.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Literal

from pydantic import Field

from mbdkit.base.bibliography import entry
from mbdkit.engine.formulation import FORMULATIONS, ORDINARY, formulation_name
from mbdkit.methods.kinds import ImplicitRungeKutta, integrator_method
from mbdkit.methods.method_options import HAIRER_WANNER, OF_TREES, ORDER_DRIFT, TOLERANCE_DRIFT, ImplicitOptions
from mbdkit.methods.tableau import ButcherTableau, coefficients, collocation
from mbdkit.registry.items import Claims, Orders, integrator_claims

GEAR = entry(__file__, "gear1985")


@cache
def tableau(stages: int) -> ButcherTableau:
    """Return the tableau with 2, 3 (closed forms) or 5 `stages` (nodes to 75 digits)."""
    name = f"radau-iia-{stages}"
    if closed_form := coefficients(__file__).get(str(stages)):
        return ButcherTableau(name, **closed_form, order=2 * stages - 1, reference=HAIRER_WANNER)
    import mpmath

    with mpmath.workdps(75):
        difference = mpmath.taylor(lambda x: mpmath.legendre(stages, x) - mpmath.legendre(stages - 1, x), 0, stages)
        roots = sorted(mpmath.re(x) for x in mpmath.polyroots(difference[::-1], maxsteps=200, extraprec=200))
        nodes = [(1 + x) / 2 for x in roots[:-1]] + [mpmath.mpf(1)]
    return collocation(name, nodes, order=2 * stages - 1, reference=HAIRER_WANNER)


class RadauOptions(ImplicitOptions):
    """Radau IIA collocation."""

    stages: Literal[2, 3, 5] = 3
    """Number of stages s; the order is 2 s - 1."""
    rtol: Annotated[float, Field(ge=1e-14, lt=1, allow_inf_nan=False)] | None = None
    """Relative error tolerance of adaptive steps; the error of a smooth motion is proportional to it. With index-3,
    also of loops, that holds for positions; the error of velocities is proportional to rtol^(s / (2 s - 1)) unless
    `stabilization: projection` is used. 1e-6 by default."""


_DRIFT_BY_FORMULATION = (
    "with index-1, drift has the order of the method and grows with time; with index-3, positions satisfy the "
    "constraints up to rounding errors; with index-2, velocities do; with ggl, both do; the misalignment of positions "
    "with index-2 grows with time, that of velocities with index-3 does not"
)

_OF_LOOPS = ", and joints that close loops satisfy the constraints as with the formulation that `loops` names"


@integrator_claims
def claims(options: RadauOptions) -> Claims:
    """Return the claims of the method."""
    # Hairer, Lubich and Roche (1989) prove the orders of index 2 for all s, and those of index 3 for s >= 3.
    s, order = options.stages, 2 * options.stages - 1
    fixed = not options.adaptive
    newton = options.stage_solver == "newton"
    orders = {"index-2": Orders(order, order, s), "index-3": Orders(order, s, s - 1), "ggl": Orders(order, order, s)}
    orders |= {formulation_name("joint-coordinates", name): value for name, value in orders.items()}
    index_1 = ORDER_DRIFT if fixed else TOLERANCE_DRIFT
    return Claims(
        order=order if fixed else None,
        stages=s,
        adaptive=options.adaptive,
        drift=_DRIFT_BY_FORMULATION + OF_TREES + _OF_LOOPS if newton else index_1 + OF_TREES,
        needs=("tangents",) if newton else ("accelerations",),
        formulations=tuple(FORMULATIONS) if newton else ORDINARY,
        orders=orders if newton and fixed else {},
        states=True,
        dense_order=s,
        conserves=("linear-momentum",),
        a_stable=newton,
        l_stable=newton,
    )


@integrator_method
def create(options: RadauOptions) -> ImplicitRungeKutta:
    """Return the method."""
    return options.method(tableau(options.stages))


REFERENCES = (HAIRER_WANNER, GEAR)
