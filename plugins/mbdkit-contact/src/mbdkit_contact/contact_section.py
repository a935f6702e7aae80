"""The section `contact` of run specs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mbdkit.base.strict_model import StrictModel
from mbdkit.spec.item_names import TreatmentName


class ContactTreatment(StrictModel):
    """How contacts of the mechanism act in the run."""

    treatment: Annotated[str, TreatmentName("contacts", "compliant")] = "compliant"
    """`compliant`: the bodies overlap slightly, and `compliance` of a contact determines the force; for every method.
    `event-driven`: rigid bodies, whose impacts and changes between sticking, slipping and separation are located; for
    Runge-Kutta methods, SciPy's solvers and methods of plugins. `time-stepping`: rigid bodies, whose velocities may
    jump in every step; for `moreau-jean` and `nonsmooth-generalized-alpha`."""
    impact_law: Literal["newton", "poisson"] = "newton"
    """Law of impacts with `event-driven`: `restitution` of a contact is a ratio of velocities (`newton`) or of impulses
    (`poisson`)."""
    rest_energy: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] = 1e-12
    """Kinetic energy of a rebound, as a share of the mechanism's largest kinetic energy so far, below which
    `event-driven` keeps the contact closed."""
