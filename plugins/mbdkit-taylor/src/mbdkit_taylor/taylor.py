"""Taylor series of any order for trees of pins in joint coordinates.

The coefficients follow from recurrences, not from stages; see `mbdkit_taylor.kernels.tree_series`. A higher order costs
little, so that the order is chosen by the tolerance. With the radius of convergence rho, a series of order p allows
steps of ``rho rtol^(1/p)``. If the cost of a step is proportional to p^2, ``p = -ln(rtol) / 2`` is cheapest (Jorba and
Zou 2005). Here most of the cost is proportional to p, so that a higher order is cheapest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from mbdkit.base import elementary
from mbdkit.base.errors import UnsupportedMechanismError
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.applied_forces import PATHWAYS
from mbdkit.engine.kernels.motions import OPCODES
from mbdkit.engine.kernels.table_rows import SPRING
from mbdkit.engine.spanning_tree import is_tree_of_pins, spanning_tree
from mbdkit.methods.kinds import LocalError, Method, Tolerances, Traits, integrator_method
from mbdkit.methods.method_options import ControlledOptions
from mbdkit.registry.items import Claims, integrator_claims
from mbdkit.registry.target import Target
from mbdkit_taylor.kernels.power_series import EXPANDED

JORBA_ZOU = """@article{jorba2005,
  author = {Jorba, {\\`A}ngel and Zou, Maorong},
  title = {A Software Package for the Numerical Integration of {ODE}s by Means of High-Order {T}aylor Methods},
  journal = {Experimental Mathematics}, volume = {14}, number = {1}, pages = {99--117}, year = {2005},
  doi = {10.1080/10586458.2005.10128904}}"""

FIXED_ORDER = 8  #: Order of fixed steps by default.
#: Order of adaptive steps at ``rtol = 1``, and its increase per -ln(rtol).
#:
#: For the double pendulum, this order is close to the fastest one.
LEAST, PER_DIGIT = 4.0, 0.75


@dataclass(frozen=True)
class TaylorSeries(Method):
    """Taylor series of the joint coordinates of a tree of pins, with fixed or controlled step size.

    Parameters
    ----------
    order
        Order of the series of velocities, 4 or more.
    tolerances
        Tolerances for a controlled step size; None for fixed steps.
    """

    order: int
    tolerances: Tolerances | None = None

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        return Traits(
            Target("mbdkit_taylor.kernels.taylor_series:CompiledTaylor"),
            tolerances=self.tolerances,
            local_error=None if self.tolerances is None else LocalError(self.order, self.order),
            is_explicit=True,
        )

    def require_mechanism(self, mechanism: CompiledMechanism) -> None:
        """See `Method`."""
        require_series(mechanism)


_PATHWAYS = [PATHWAYS[name] for name in ("two_points", "relative_angle")]
_CODES = {OPCODES[name] for name in EXPANDED}


def require_series(mechanism: CompiledMechanism) -> None:
    """Raise UnsupportedMechanismError if a mechanism has elements without Taylor series; the message lists them all."""
    top = mechanism.topology
    others = len(top.springs) and (
        np.any(top.springs[:, SPRING.law] >= 0) or not np.all(np.isin(top.springs[:, SPRING.pathway], _PATHWAYS))
    )
    refused = {
        "closed loops, joints other than pins, or joint friction": not is_tree_of_pins(top, spanning_tree(top)),
        "forces other than linear springs and dampers between two points or two angles, torques and point forces": (
            others or len(top.sections) or len(top.states)
        ),
        "loads that depend on the state": len(top.inputs) + len(top.load_values),
        "contacts": len(top.interactions),
        "motions or loads given by tables or by functions other than sin, cos, exp, log, sqrt and whole powers": (
            not _CODES.issuperset(top.motion_ops.tolist())
        ),
    }
    if any(refused.values()):
        raise UnsupportedMechanismError(
            "taylor computes series of trees of pins with linear springs, torques and point forces; this mechanism has "
            f"{'; '.join(text for text, is_present in refused.items() if is_present)}: use dop853 instead",
            key="integrator",
        )


class TaylorOptions(ControlledOptions):
    """Taylor series with fixed or adaptive steps."""

    ABSENT_BY_DEFAULT = (*ControlledOptions.ABSENT_BY_DEFAULT, "order")

    order: Annotated[int, Field(ge=4, le=40)] | None = None
    """Order of the series of velocities; by default 8 with fixed steps, and 4 - 0.75 ln(rtol) with adaptive ones."""

    def chosen_order(self) -> int:
        """Return `order`, or its default for these tolerances."""
        tolerances = self.tolerances()
        if self.order is not None:
            return self.order
        return FIXED_ORDER if tolerances is None else math.ceil(LEAST - PER_DIGIT * elementary.log(tolerances.rtol))


@integrator_claims
def claims(options: TaylorOptions) -> Claims:
    """Return the claims of the method."""
    return Claims(
        order=None if options.adaptive else options.chosen_order(),
        adaptive=options.adaptive,
        drift="none",
        constraints_hold=("position", "velocity"),
        needs=("accelerations",),
        formulations=("joint-coordinates",),
        stabilizations=("none",),
        dense_order=options.chosen_order(),
        mechanisms="trees of pins with linear springs, torques and point forces",
    )


@integrator_method
def create(options: TaylorOptions) -> TaylorSeries:
    """Return the method."""
    return TaylorSeries(options.chosen_order(), options.tolerances())


REFERENCES = (JORBA_ZOU,)
