"""Gauss-Legendre collocation, s stages, order 2 s: symmetric and symplectic.

The source paper (``guide/paper.md``) calls the methods with s = 2 and 3 s2IRK and s3IRK. Its table 4 misprints three
coefficients of s = 3 (a_12 = 2/9 + sqrt15/15, a_13 = 5/36 + sqrt15/30, b_2 = 4/19); the check of row sums refuses the
printed tableau. Closed forms by the number of stages lie in ``gauss.json``.
"""

from __future__ import annotations

from decimal import localcontext
from functools import cache
from typing import Annotated

from pydantic import Field

from mbdkit.base.bibliography import entry
from mbdkit.base.quadrature import digits, legendre_roots
from mbdkit.engine.formulation import ORDINARY
from mbdkit.methods.kinds import ImplicitRungeKutta, integrator_method
from mbdkit.methods.method_options import OF_TREES, ORDER_DRIFT, TOLERANCE_DRIFT, ImplicitOptions
from mbdkit.methods.tableau import ButcherTableau, coefficients, collocation
from mbdkit.registry.items import Claims, integrator_claims

REFERENCE = entry(__file__, "butcher1964")


@cache
def tableau(stages: int) -> ButcherTableau:
    """Return the tableau with 1 to 6 `stages`.

    The coefficients are exact for up to 3 stages; for more, the nodes are roots of Legendre polynomials to 75 digits.
    """
    name = f"gauss-{stages}"
    if closed_form := coefficients(__file__).get(str(stages)):
        return ButcherTableau(name, **closed_form, order=2 * stages, reference=REFERENCE)
    with localcontext(digits(75)):
        nodes = [str((1 + x) / 2) for x in legendre_roots(stages)]
    return collocation(name, nodes, order=2 * stages, reference=REFERENCE)


class GaussOptions(ImplicitOptions):
    """Gauss-Legendre collocation."""

    stages: Annotated[int, Field(ge=1, le=6)] = 2
    """Number of stages s; the order is 2 s."""


@integrator_claims
def claims(options: GaussOptions) -> Claims:
    """Return the claims of the method."""
    # A step size that depends on earlier steps differs in the reversed motion. Adaptive steps are therefore neither
    # symmetric nor symplectic, although every single step conserves quadratic invariants.
    fixed = not options.adaptive
    return Claims(
        order=2 * options.stages if fixed else None,
        symmetric=fixed,
        symplectic=fixed,
        quadratic_invariants=True,
        stages=options.stages,
        adaptive=options.adaptive,
        drift=(ORDER_DRIFT if fixed else TOLERANCE_DRIFT) + OF_TREES,
        needs=("tangents",) if options.stage_solver == "newton" else ("accelerations",),
        formulations=ORDINARY,
        states=True,
        dense_order=options.stages,
        conserves=("linear-momentum",),
        a_stable=options.stage_solver == "newton",
    )


@integrator_method
def create(options: GaussOptions) -> ImplicitRungeKutta:
    """Return the method."""
    return options.method(tableau(options.stages))


REFERENCES = (REFERENCE,)
