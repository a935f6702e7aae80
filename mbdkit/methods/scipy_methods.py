"""Adaptive solvers of ``scipy.integrate`` on the index-1 equations."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, ClassVar

from pydantic import Field

from mbdkit.base.bibliography import entry
from mbdkit.methods.kinds import integrator_method
from mbdkit.methods.method_options import HAIRER_NORSETT_WANNER, HAIRER_WANNER, TOLERANCE_DRIFT, MaxStep, Options
from mbdkit.methods.scipy_solver import SciPySolver
from mbdkit.registry.items import Claims, integrator_claims

SCIPY = entry(__file__, "scipy2020")
PETZOLD = entry(__file__, "petzold1983")


class AdaptiveOptions(Options):
    """An adaptive method of SciPy."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("atol", "max_step")

    rtol: Annotated[float, Field(ge=2.3e-14, lt=1, allow_inf_nan=False)] = 1e-8
    """Relative error tolerance of a step; SciPy does not accept values below 100 eps, 2.3e-14."""
    atol: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """Absolute error tolerance of a step [m, rad, m/s, rad/s]; by default 1e-10. For lengths and velocities, the
    default is multiplied by the characteristic length of the mechanism if this is below 1 m."""
    max_step: MaxStep = None
    """Largest step [s]; unlimited by default."""


ATOL = 1e-10  #: Default of `AdaptiveOptions.atol`.


def _solver(solver: str, jacobian: bool, options: AdaptiveOptions) -> SciPySolver:
    """Return a solver class with its options."""
    atol = ATOL if options.atol is None else options.atol
    return SciPySolver(solver, options.rtol, atol, jacobian, options.max_step, by_size=options.atol is None)


def _claims(
    *needs: str,
    stabilizations: tuple[str, ...] = ("none", "baumgarte", "projection"),
    variable_order: bool = False,
    a_stable: bool = False,
) -> Callable[[AdaptiveOptions], Claims]:
    @integrator_claims
    def claims(options: AdaptiveOptions) -> Claims:
        """Return the claims of the solver."""
        return Claims(
            adaptive=True,
            drift=TOLERANCE_DRIFT,
            needs=needs,
            stabilizations=stabilizations,
            states=True,
            restartable=False,
            variable_order=variable_order,
            a_stable=a_stable,
        )

    return claims


create_radau, create_dop853, create_lsoda = (
    integrator_method(partial(_solver, solver, jacobian))
    for solver, jacobian in (("Radau", True), ("DOP853", False), ("LSODA", True))
)
claims_of_radau = _claims("accelerations", "tangents", a_stable=True)
claims_of_dop853 = _claims("accelerations")
claims_of_lsoda = _claims(  # after each projection, it would start again with order 1
    "accelerations", "tangents", stabilizations=("none", "baumgarte"), variable_order=True
)
REFERENCES_OF_RADAU = (SCIPY, HAIRER_WANNER)
REFERENCES_OF_DOP853 = (SCIPY, HAIRER_NORSETT_WANNER)
REFERENCES_OF_LSODA = (SCIPY, PETZOLD)
