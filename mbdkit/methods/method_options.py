"""Definitions that several methods share: base classes of options, claims, and references.

Options are the fields that a spec can have under ``integrator:``. A definition that only one method uses is in the file
of this method.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mbdkit.base.bibliography import entry
from mbdkit.base.strict_model import StrictModel
from mbdkit.engine.formulation import ORDINARY
from mbdkit.methods.kinds import ImplicitRungeKutta, Tolerances
from mbdkit.methods.tableau import ButcherTableau
from mbdkit.registry.items import Claims, integrator_claims

#: Drift of methods in fixed steps on the index-1 equations.
ORDER_DRIFT = "only accelerations satisfy the constraints; drift has the order of the method and grows with time"

#: Drift of methods in adaptive steps on the index-1 equations.
TOLERANCE_DRIFT = "only accelerations satisfy the constraints; drift depends on the tolerance and grows with time"

#: Clause on joint coordinates that methods append to `ORDER_DRIFT` or `TOLERANCE_DRIFT`.
OF_TREES = "; with joint-coordinates, the joints of the spanning tree stay closed up to rounding errors"

HAIRER_NORSETT_WANNER = entry(__file__, "hairer1993")

HAIRER_WANNER = entry(__file__, "hairer1996")

MaxStep = Annotated[float, Field(gt=0, allow_inf_nan=False)] | None  #: Largest step [s]; None for no limit.


class Options(StrictModel):
    """Base class of the options of the built-in methods."""


class ExplicitOptions(Options):
    """Options of an explicit method in fixed steps: none."""


class ControlledOptions(Options):
    """A method with fixed or adaptive steps."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("adaptive", "rtol", "atol", "max_step")

    adaptive: bool = False
    """Choose step sizes by an error estimate; `time.step` is then the first step and may be omitted."""
    rtol: Annotated[float, Field(ge=1e-14, lt=1, allow_inf_nan=False)] | None = None
    """Relative error tolerance of adaptive steps; the error of a smooth motion is proportional to it. 1e-6 by
    default."""
    atol: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """Absolute error tolerance of adaptive steps [m, rad, m/s, rad/s]; by default equal to `rtol`, multiplied for
    lengths and velocities by the mechanism's characteristic length if that is below 1 m."""
    max_step: MaxStep = None
    """Largest adaptive step [s], so that short, smooth pulses are not missed; unlimited by default.

    Steps end at the points of tables and at discontinuities of motions and loads in any case.
    """

    @model_validator(mode="after")
    def _tolerances_need_adaptive_steps(self) -> ControlledOptions:
        for name in ("rtol", "atol", "max_step"):
            if getattr(self, name) is not None and not self.adaptive:
                raise PydanticCustomError("mbdkit", f"takes `{name}` only with `adaptive: true`")
        return self

    def tolerances(self) -> Tolerances | None:
        """Return the tolerances of adaptive steps; None for fixed steps."""
        if not self.adaptive:
            return None
        rtol = self.rtol if self.rtol is not None else 1e-6
        atol = self.atol if self.atol is not None else rtol
        return Tolerances(rtol, atol, self.max_step, by_size=self.atol is None)


class ImplicitOptions(ControlledOptions):
    """How the stage equations of an implicit method are solved."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*ControlledOptions.ABSENT_BY_DEFAULT, "max_iterations")

    stage_solver: Literal["newton", "fixed-point"] = "newton"
    """Simplified Newton with exact tangents, or fixed-point iteration on the stage accelerations."""
    tolerance: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] | None = None
    """Stop when the relative change of the stage accelerations is below this value; by default, stop when it no longer
    decreases."""
    max_iterations: Annotated[int, Field(ge=2, le=10_000)] | None = None
    """Largest number of iterations in one step, after which the step fails. By default 50; with fixed steps, the
    iteration may go on up to 500 while it converges steadily."""

    def method(self, tableau: ButcherTableau) -> ImplicitRungeKutta:
        """Return the method with this tableau and these options."""
        return ImplicitRungeKutta(tableau, self.stage_solver, self.tolerance, self.max_iterations, self.tolerances())


def explicit_claims(order: int, stages: int) -> Callable[[ExplicitOptions], Claims]:
    """Return the claims of an explicit method in fixed steps."""
    return integrator_claims(
        lambda options: Claims(
            order=order,
            stages=stages,
            drift=ORDER_DRIFT + OF_TREES,
            needs=("accelerations",),
            formulations=ORDINARY,
            states=True,
            conserves=("linear-momentum",),
        )
    )


def embedded_claims(order: int, stages: int, dense_order: int) -> Callable[[ControlledOptions], Claims]:
    """Return the claims of an explicit method with an error estimate, in fixed or adaptive steps."""

    @integrator_claims
    def claims(options: ControlledOptions) -> Claims:
        return Claims(
            order=None if options.adaptive else order,
            stages=stages,
            adaptive=options.adaptive,
            drift=(TOLERANCE_DRIFT if options.adaptive else ORDER_DRIFT) + OF_TREES,
            needs=("accelerations",),
            formulations=ORDINARY,
            states=True,
            dense_order=dense_order,
            conserves=("linear-momentum",),
        )

    return claims
