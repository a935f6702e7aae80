"""Time-stepping methods for rigid contacts.

Their algorithms are in `mbdkit_contact.kernels.time_stepping`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from mbdkit.methods.kinds import Method, Traits, integrator_method
from mbdkit.methods.method_options import Options
from mbdkit.registry.items import Claims, integrator_claims
from mbdkit.registry.target import Target

JEAN, CHEN = Path(__file__).with_name("references.bib").read_text("utf-8").strip().split("\n\n")


_TRAITS = Traits(
    Target("mbdkit_contact.stepping:CompiledTimeStepping"),
    suits_stiff=True,
    is_time_stepping=True,
    integrates_states=False,
    holds_states=True,
)


class TimeStepping(Method):
    """What time-stepping methods have in common."""

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        return _TRAITS


class MoreauJeanOptions(Options):
    """Weights of the forces at the start and at the end of a step."""

    theta: Annotated[float, Field(ge=0.5, le=1, allow_inf_nan=False)] = 0.5
    """Weight of the forces at the end of a step, from 0.5 (least numerical damping) to 1 (most). The forces at the
    start have the weight 1 - theta."""


@dataclass(frozen=True)
class MoreauJean(TimeStepping):
    """The method of Moreau and Jean with the weight `theta` of the forces at the end of a step."""

    theta: float = 0.5


class NonsmoothGeneralizedAlphaOptions(Options):
    """Damping of fast vibrations."""

    rho_inf: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.8
    """Factor by which a step multiplies the amplitude of infinitely fast vibrations: 0 removes them, 1 does not damp
    them."""


@dataclass(frozen=True)
class NonsmoothGeneralizedAlpha(TimeStepping):
    """The nonsmooth generalized-alpha method."""

    rho_inf: float = 0.8


@integrator_method
def create_moreau_jean(options: MoreauJeanOptions) -> MoreauJean:
    """Return the method of Moreau and Jean."""
    return MoreauJean(options.theta)


@integrator_method
def create_generalized_alpha(options: NonsmoothGeneralizedAlphaOptions) -> NonsmoothGeneralizedAlpha:
    """Return the nonsmooth generalized-alpha method."""
    return NonsmoothGeneralizedAlpha(options.rho_inf)


def _claims(order: int, *, l_stable: bool = False) -> Claims:
    return Claims(
        order=order,
        drift="positions satisfy the constraints up to rounding errors, velocities up to errors of the order of "
        "the step",
        constraints_hold=("position",),
        needs=("tangents",),
        conserves=("linear-momentum",),
        a_stable=True,
        l_stable=l_stable,
    )


@integrator_claims
def claims_of_moreau_jean(options: MoreauJeanOptions) -> Claims:
    """Return the claims of the method of Moreau and Jean."""
    return _claims(1, l_stable=options.theta == 1.0)


@integrator_claims
def claims_of_generalized_alpha(options: NonsmoothGeneralizedAlphaOptions) -> Claims:
    """Return the claims of the nonsmooth generalized-alpha method."""
    return _claims(2)


REFERENCES_OF_MOREAU_JEAN, REFERENCES_OF_GENERALIZED_ALPHA = (JEAN,), (CHEN,)
