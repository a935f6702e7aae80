"""The treatments of rigid contacts: what they require, how a run starts, and with what it is compared."""

from __future__ import annotations

from mbdkit.engine.formulation import INDEX_1
from mbdkit.mechanism.contacts import ChosenTreatment
from mbdkit.plugin import Method, RunSpec, SpecError, StepMethod
from mbdkit_contact.event_driven import EventDriven, with_contact_forces

__all__ = ["event_driven", "guards", "require_event_driven", "require_time_stepping", "with_contact_forces"]

GUARDS = {"dop853": 4, "dopri5": 16}
"""Explicit methods for comparison runs, and the factors by which their steps are smaller than those of the run."""


def require_time_stepping(spec: RunSpec, method: Method) -> None:
    """Raise SpecError unless a method is one of time-stepping."""
    if not method.traits.is_time_stepping:
        message = "the treatment time-stepping needs the integrator moreau-jean or nonsmooth-generalized-alpha"
        raise SpecError(message, key="integrator")


def require_event_driven(spec: RunSpec, method: Method) -> None:
    """Raise SpecError unless a method can take the steps between events."""
    traits = method.traits
    is_tableau = traits.is_explicit and traits.tableau and traits.tolerances is None
    needs_accelerations = set(spec.claims.needs) <= {"accelerations"} and not traits.carries_multipliers(INDEX_1)
    if not (is_tableau or (isinstance(method, StepMethod) and needs_accelerations)):
        message = (
            "the treatment event-driven needs an explicit Runge-Kutta method with fixed steps, such as dop853, or a "
            "method written in Python that evaluates accelerations only"
        )
        raise SpecError(message, key="integrator")


def event_driven(method: Method, treatment: ChosenTreatment) -> EventDriven:
    """Return the method that takes the steps of `method` between events."""
    tableau = method.traits.tableau
    return EventDriven(method if tableau is None else tableau, treatment)  # type: ignore[arg-type]


def guards(method: Method) -> dict[str, int]:
    """Return the methods of comparison runs that are others than the method of the run; see `GUARDS`."""
    tableau = method.traits.tableau
    return {name: factor for name, factor in GUARDS.items() if tableau is None or tableau.name != name}
