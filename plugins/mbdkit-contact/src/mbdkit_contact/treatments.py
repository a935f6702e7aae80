"""The treatments of rigid contacts: what they require, how a run starts, and with what it is compared."""

from __future__ import annotations

from collections.abc import Callable

from mbdkit.base.errors import SpecError
from mbdkit.engine.formulation import INDEX_1
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.integrators.start import treatment_method
from mbdkit.mechanism.joints import force_of_reaction
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import run_check
from mbdkit.methods.kinds import Method
from mbdkit.methods.step_methods import ExternalMethod, StepMethod
from mbdkit.runs.run_seams import treatment_condition, treatment_guards
from mbdkit.spec.run_spec import RunSpec
from mbdkit_contact.compiled_events import CompiledEventDriven
from mbdkit_contact.contact_section import ContactTreatment
from mbdkit_contact.event_driven import EventDriven, EventDrivenLibrary

#: Explicit methods for comparison runs, and the factors by which their steps are smaller than those of the run.
GUARDS = {"dop853": 4, "dopri5": 16}


@run_check
def check_run(mechanism: Mechanism) -> None:
    """Raise SpecError if contacts are rigid and a joint has friction, or a side force."""
    if mechanism.reacting is not None and (force := force_of_reaction(mechanism.joints)):
        key, what, remedy = force
        raise SpecError(
            f"runs with rigid contacts do not support {what}; {remedy}, or use `contact: {{treatment: compliant}}`",
            key=f"model.joints.{key}",
        )


@treatment_condition
def require_time_stepping(spec: RunSpec, method: Method) -> None:
    """Raise SpecError unless a method is one of time-stepping."""
    if not method.traits.is_time_stepping:
        message = "the treatment time-stepping needs the integrator moreau-jean or nonsmooth-generalized-alpha"
        raise SpecError(message, key="integrator")
    _require_rigid(spec)


@treatment_condition
def require_event_driven(spec: RunSpec, method: Method) -> None:
    """Raise SpecError unless a method can take the steps between events."""
    traits, name = method.traits, spec.integrator_item.name
    if traits.is_time_stepping:
        message = f"the integrator {name} does not locate impacts; use the treatment time-stepping"
        raise SpecError(message, key="contact.treatment")
    if traits.tableau is None and traits.compiled is not None:
        message = (
            f"the treatment event-driven cannot use {name}, whose steps exist in machine code only; use a Runge-Kutta "
            "method, such as dop853 or gauss"
        )
        raise SpecError(message, key="integrator")
    if traits.tableau is not None and spec.formulated != INDEX_1:
        message = "the treatment event-driven solves the index-1 equations with Runge-Kutta methods; omit `formulation`"
        raise SpecError(message, key="formulation")
    if spec.stabilized.symmetric:
        message = "the treatment event-driven closes joints and contacts itself; omit `stabilization`"
        raise SpecError(message, key="stabilization")
    _require_rigid(spec)


def _require_rigid(spec: RunSpec) -> None:
    if spec.formulated.coordinates == "joint":
        message = "rigid contacts are not available in joint coordinates; use index-1, or compliant contacts"
        raise SpecError(message, key="formulation")
    if spec.stabilized.kind != "none":
        message = "with rigid contacts, every step projects joints and contacts; omit `stabilization`"
        raise SpecError(message, key="stabilization")
    if spec.accuracy is not None:
        message = "`accuracy` is not available for runs with rigid contacts; give `time.step` and `check: true`"
        raise SpecError(message, key="accuracy")


@treatment_method
def event_driven(
    method: Method, treatment: ContactTreatment
) -> EventDriven | EventDrivenLibrary | Callable[[CompiledMethod], CompiledMethod]:
    """Return the method that takes the steps of `method` between events, or the function that makes it of a compiled
    method.
    """
    traits = method.traits
    if traits.compiled is not None:
        return lambda between: CompiledEventDriven(between, treatment, traits.tolerances)
    steps = method if traits.steps is None else traits.steps()(method)
    if isinstance(steps, ExternalMethod):
        return EventDrivenLibrary(steps, treatment)
    assert isinstance(steps, StepMethod)
    return EventDriven(steps, treatment)


@treatment_guards
def guards(method: Method) -> dict[str, int]:
    """Return the methods of comparison runs that are others than the method of the run; see `GUARDS`."""
    tableau = method.traits.tableau
    return {name: factor for name, factor in GUARDS.items() if tableau is None or tableau.name != name}
