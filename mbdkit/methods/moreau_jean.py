"""The time-stepping method of Moreau and Jean for rigid contacts; its algorithm is `mbdkit.stepping.time_stepping`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from mbdkit.methods.kinds import Method, Traits
from mbdkit.methods.method_options import Options
from mbdkit.registry.items import Claims, IntegratorPlugin

JEAN = """@article{jean1999,
  author = {Jean, Michel},
  title = {The non-smooth contact dynamics method},
  journal = {Computer Methods in Applied Mechanics and Engineering}, volume = {177}, number = {3--4},
  pages = {235--257}, year = {1999}, doi = {10.1016/S0045-7825(98)00383-1}}"""


class MoreauJeanOptions(Options):
    """How forces are weighted."""

    theta: Annotated[float, Field(ge=0.5, le=1, allow_inf_nan=False)] = 0.5
    """Share of the forces at the end of a step: 0.5 damps least, 1 most."""


@dataclass(frozen=True)
class MoreauJean(Method):
    """The method of Moreau and Jean with a share `theta` of the forces at the end of a step."""

    theta: float = 0.5

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        why = "the state of a method written in Python cannot be stored"
        return Traits("moreau-jean", suits_stiff=True, why_no_checkpoint=why)


FAMILY = "moreau-jean"
INTEGRATORS = (
    IntegratorPlugin(
        name="moreau-jean",
        summary="Moreau and Jean: time-stepping for rigid contacts, order 1, holds joints and gaps, fixed steps.",
        options=MoreauJeanOptions,
        create=lambda options: MoreauJean(options.theta),
        claims=lambda options: Claims(
            order=1,
            drift="positions meet the joints to round-off, velocities to the order of the step",
            constraints_hold=("position",),
            needs=("tangents",),
        ),
        references=(JEAN,),
    ),
)
