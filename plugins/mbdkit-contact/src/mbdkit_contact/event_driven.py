"""Event-driven integration of rigid contacts: a method between events, which are impacts and changes of mode."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbdkit.base.errors import SpecError, StepError
from mbdkit.base.text import listed
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.contacts import ChosenTreatment
from mbdkit.methods.step_methods import Step, StepMethod, StepState, Why
from mbdkit.methods.tableau import ButcherTableau
from mbdkit_contact.contact_state import ContactState, HeldForces, held_step
from mbdkit_contact.event_step import MOST_EVENTS, Between, EventStep, NotAcceptedError
from mbdkit_contact.rigid_contacts import RigidContacts


class EventDriven(StepMethod):
    """A method that evaluates accelerations, with events of rigid contacts.

    Parameters
    ----------
    method
        The method between events: an explicit tableau with fixed steps, or a method in Python.
    treatment
        ChosenTreatment of contacts in the run.
    """

    def __init__(self, method: ButcherTableau | StepMethod, treatment: ChosenTreatment):
        self.treatment = treatment
        self.between: Between
        if isinstance(method, StepMethod):
            self.between = method
            self.tolerances, self.error_order, self.hint = method.tolerances, method.error_order, method.hint
        else:
            self.between = tuple(x.tolist() for x in method.floats())

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: Why) -> ContactState:
        """See `StepMethod.begin`: the modes are determined anew."""
        return RigidContacts.on(equations).begun(state)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        """Take a step, or only its part before the first event, which `after_event` applies later.

        The time reached is stored in `StepState.memory`, a `ContactState`.
        """
        step = EventStep(self.treatment, self.between, RigidContacts.on(equations), t, state)
        try:
            event = step.to(t + h)
        except NotAcceptedError as rejected:
            return Step(state, accepted=False, next_step=rejected.size)
        streak = 0 if event is None else step.state.streak + 1
        if streak > MOST_EVENTS:
            raise StepError("zeno", f"contacts changed {MOST_EVENTS} times without a step between")
        end = step.reached(event, streak)
        happens = None if event is None else ContactEvent(self, end.memory.time)
        made = held_step(equations.contacts, (t, end.memory.time), state, end, happens)
        error = None if step.error is None else np.concatenate([step.error, 0.0 * made.state.z])
        return replace(made, error=error, next_step=step.now.next_step)

    def after_event(self, equations: EquationsOfMotion, t: float, state: StepState) -> StepState:
        """Return the state after the event at which a step has ended."""
        step = EventStep(self.treatment, self.between, RigidContacts.on(equations), t, state)
        assert step.state.event is not None
        step.happen(step.state.event)
        end = step.reached(None, step.state.streak)
        return replace(end, z=HeldForces(equations.contacts).of(end.memory))


@dataclass(frozen=True)
class ContactEvent:
    """An event of contacts at which a step has ended; see `mbdkit.methods.step_methods.StepEvent`."""

    method: EventDriven
    time: float

    def apply(self, equations: EquationsOfMotion, t: float, state: StepState) -> StepState:
        """See `StepEvent.apply`."""
        return self.method.after_event(equations, t, state)


def with_contact_forces(workspace: Workspace) -> Workspace:
    """Return a workspace that starts with the contact forces and modes of the initial state.

    Raises
    ------
    SpecError
        If the mechanism has first-order states that do not belong to contacts.
    StepError
        If no modes or forces of the contacts are possible.
    """
    mechanism = workspace.mechanism
    top, held = mechanism.topology, HeldForces(mechanism.contacts)
    if others := [state.name for number, state in enumerate(mechanism.states) if number not in held.states]:
        names = listed(others, "and")
        raise SpecError(f"runs with rigid contacts do not include other first-order states ({names})", key="model")
    p = EquationsOfMotion(workspace)
    contacts = RigidContacts.on(p)
    begin = StepState(p.q0, p.v0)
    begin = replace(begin, memory=contacts.begun(begin))
    step = EventStep(mechanism.contact_treatment, None, contacts, workspace.t0, begin)
    parameters = top.law_parameters.copy()
    parameters[top.states[held.states, 1]] = held.of(step.contact_state())
    started = replace(mechanism, topology=top._replace(law_parameters=parameters))
    return Workspace(
        started,
        workspace.t0,
        workspace.q0,
        workspace.v0,
        formulation=workspace.formulation,
        stabilization=workspace.stabilization,
    )
