"""Event-driven integration of rigid contacts: a method between events, which are impacts and changes of mode."""

from __future__ import annotations

import copy
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.base.quadrature import gauss_on_unit
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.interpolation import fade
from mbdkit.engine.kernels.table_rows import STATE_ROW
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import SAME_INSTANT, StepTaken
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.integrators.stages.stage_polynomials import collocation_polynomials
from mbdkit.methods.step_methods import Dense, ExternalMethod, Step, StepMethod, StepState, Why
from mbdkit.runs.run_seams import treatment_start
from mbdkit_contact.contact_section import ContactTreatment
from mbdkit_contact.contact_state import ContactState
from mbdkit_contact.event_step import Event, EventStep, NotAcceptedError, StepPoint, gains, power_at
from mbdkit_contact.events_of_contacts import ContactEvents
from mbdkit_contact.forced_equations import ForcedEquations, Powers

_NODES = gauss_on_unit(6)[0]  #: Places in a step at which powers are evaluated for the energies within it.
_INTEGRALS = collocation_polynomials(_NODES)[0]

#: Largest gap of joints and closed contacts in the steps of a library, relative to the length of the mechanism.
DRIFT = 1e-7


class EventDriven(StepMethod):
    """A method in Python with events of rigid contacts.

    Parameters
    ----------
    method
        The method between events.
    treatment
        Treatment of contacts in the run.
    """

    def __init__(self, method: StepMethod, treatment: ContactTreatment):
        self.treatment, self.between = treatment, method
        self.tolerances, self.error_order, self.hint = method.tolerances, method.error_order, method.hint
        self.carries_multipliers = method.carries_multipliers  # type: ignore[misc]

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: Why) -> ContactState:
        """See `StepMethod.begin`: the modes are determined anew."""
        return state.memory if why == "projection" else self._on(equations).contacts.begun(state)

    def _on(self, equations: EquationsOfMotion) -> ContactEvents:
        return ContactEvents.on(equations, self.treatment)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        """Take a step, or only its part before the first event, which `after_event` applies later.

        The time reached is stored in `StepState.memory`, a `ContactState`.
        """
        events = self._on(equations)
        step = EventStep(self.between, events, t, state)
        begin = step.now
        try:
            event = step.to(t + h)
        except NotAcceptedError as rejected:
            return Step(state, accepted=False, next_step=rejected.size)
        end = reached(step, event, self.carries_multipliers)
        result = step.now.made
        dense = None
        if result is not None and result.dense is not None and step.begin is not None:
            dense = _closing(result.dense, step.begin, step.now)
        happens = None if event is None else ContactEvent(self.after_event, end.memory.time)
        if (error := step.error) is not None:
            n = 2 * equations.n
            error = np.concatenate([error[:n], events.contacts.all_states(error[n:])])
        dense = _with_forces(events, begin, end, dense)
        return Step(end, error, dense, next_step=None if result is None else result.next_step, event=happens)

    def after_event(self, equations: EquationsOfMotion, t: float, state: StepState) -> StepState:
        """Return the state after the event at which a step has ended."""
        return _after_event(EventStep(None, self._on(equations), t, state))


def _after_event(step: EventStep) -> StepState:
    kind, contact = step.before.known["event"].tolist()
    step.happen((kind - 1, contact))
    return step.state()


def reached(step: EventStep, event: Event | None, carries_multipliers: bool) -> StepState:
    """Return the state to which a step has led."""
    end = step.reached(event)
    if carries_multipliers and end.multipliers is None:
        with step.events.acting():
            end = replace(end, multipliers=step.equations().accelerations(step.now.t, end.q, end.v)[1])
    return end


def _closing(dense: Dense, begin: StepPoint, end: StepPoint) -> Dense:
    """Return dense output that ends in a state which differs by rounding errors or a projection."""
    assert end.made is not None
    state = end.made.state
    moves = end.q - state.q, end.v - state.v, end.z - state.z

    def closed(theta: float) -> tuple[np.ndarray, ...]:
        if theta == 0.0:
            return begin.q, begin.v, begin.z
        share = fade(theta)
        return tuple(x + share * move for x, move in zip(dense(theta)[:3], moves, strict=True))

    return closed


def _with_forces(events: ContactEvents, begin: StepPoint, end: StepState, dense: Dense | None) -> Dense:
    """Return dense output of a step with the forces of contacts that follow from the motion at each of its states, and
    with the work and the dissipated energy, which include those of an event at its start.

    Parameters
    ----------
    begin, end
        States at both ends; the memory of `end` has the modes in the step, and the time at its end.
    dense
        Gives the other states; if None, they are those of the cubic through both ends.
    """
    own = events.contacts.own(end.z)
    taken = StepTaken(begin.t, end.memory.time, begin.q, begin.v, end.q, end.v, begin.z, own)
    equations, powers = ForcedEquations(events), list[Powers]()

    def state(theta: float) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        q, v, z = (taken.between if dense is None else dense)(theta)[:3]
        return taken.time(theta), q, v, z

    def inside(theta: float) -> tuple[np.ndarray, ...]:
        with events.as_in(end.memory):
            if equations.has_power and not powers:  # once for all states within the step
                with events.acting():
                    powers.extend(power_at(equations, *state(share)) for share in _NODES.tolist())
            t, q, v, z = state(theta)
            held = events.held_at(t, q, v, z)
        gained = np.array([begin.work, begin.dissipated])
        if powers:  # sums over rows, since products of matrices round differently on other processors
            weights = (taken.t1 - taken.t0) * np.sum(_INTEGRALS * np.cumprod(np.full(len(_NODES), theta)), axis=1)
            gained += np.sum(weights[:, None] * np.array(powers), axis=0)
        return q, v, held, gained[0], gained[1]

    return inside


@dataclass(frozen=True)
class ContactEvent:
    """An event of contacts at which a step has ended; see `mbdkit.methods.step_methods.StepEvent`."""

    after: Callable[[EquationsOfMotion, float, StepState], StepState]
    time: float

    def apply(self, equations: EquationsOfMotion, t: float, state: StepState) -> StepState:
        """See `StepEvent.apply`."""
        return self.after(equations, t, state)


class EventDrivenLibrary(ExternalMethod):
    """A library with a loop of its own, with events of rigid contacts, which are found by its dense output.

    The library is opened again after every event, and where gaps of joints or closed contacts exceed `DRIFT`. They are
    closed there, and not after each step, which would end the history of a multistep method.

    Parameters
    ----------
    library
        The method between events.
    treatment
        Treatment of contacts in the run.
    """

    def __init__(self, library: ExternalMethod, treatment: ContactTreatment):
        self.treatment, self._given = treatment, library
        self.tolerances, self.hint = library.tolerances, library.hint
        self.carries_multipliers = library.carries_multipliers  # type: ignore[misc]

    def open(self, equations: EquationsOfMotion, t: float, state: StepState, stop: float) -> None:
        """See `ExternalMethod.open`."""
        self._library = copy.copy(self._given)
        self._stop, self._opened = stop, state
        events = ContactEvents.on(equations, self.treatment)
        self._before = replace(state, memory=events.contacts.begun(state))
        self._begin(_LibraryStep(None, events, t, self._before))

    def _begin(self, step: _LibraryStep, until: float | None = None) -> None:
        """Open the library at the present state of a step; it stops where a contact could open and close unnoticed."""
        now = step.now
        self._step, self._ended = step, False
        self._until = now.t + step.limited(self._stop - now.t) if until is None else until
        equations = step.equations()
        equations.first_step = step.events.p.first_step
        begin = StepState(now.q, now.v, now.multipliers, z=now.z)
        with step.events.acting():
            self._library.open(equations, now.t, begin, self._until)

    def advance(self) -> Step:
        """See `ExternalMethod.advance`."""
        if self._ended:
            self._begin(self._step)
        step, begin = self._step, self._step.now
        while True:
            with step.events.acting():
                result = step.acting(self._library.advance())
            if result.dense is None or result.time is None:
                raise StepError("not-finite", "the library gives no states within its steps")
            end = result.state
            step.dense = dense = result.dense
            there = StepPoint(float(result.time), end.q, end.v, end.z, multipliers=end.multipliers, made=result)
            if (search := step.first_event(there)) is None or not step.is_unclear:
                break
            self._begin(step, begin.t + search[0] * (there.t - begin.t))
        share, event = (1.0, None) if search is None else search
        if share < 1.0:
            there = step.inside(there, share)
        is_over = there.t >= self._until - SAME_INSTANT * max(abs(self._until), 1.0)
        if share < 1.0 or event is not None or is_over or step.drift(there) > DRIFT * step.events.p.length:
            there = step.closed(there)  # where the library is opened again
            self._ended = True
        h = there.t - begin.t
        inside = _closing(lambda theta: dense(theta * share), begin, replace(there, made=Step(_end(result, share))))
        if event is None and end.work is not None and end.dissipated is not None:
            work, lost = end.work, end.dissipated
        elif h > 0.0:
            with step.events.acting():
                work, lost = gains(step.equations(), begin, there, Step(end, dense=inside))
        else:
            work = lost = 0.0
        # an impact at the start of the step, where the library was opened, has dissipated energy too
        step.go_to(replace(there, work=begin.work + work, dissipated=begin.dissipated + lost))
        state = reached(step, event, self.carries_multipliers)
        self._before, step.before = state, state.memory
        happens = None if event is None else ContactEvent(self._after_event, there.t)
        step.now = replace(step.now, work=0.0, dissipated=0.0)
        return Step(state, dense=_with_forces(step.events, begin, state, inside), event=happens, time=there.t)

    def _after_event(self, equations: EquationsOfMotion, t: float, state: StepState) -> StepState:
        step = _LibraryStep(None, ContactEvents.on(equations, self.treatment), t, state)
        after = _after_event(step)
        step.before, step.now = after.memory, replace(step.now, work=0.0, dissipated=0.0)
        self._step, self._ended, self._before = step, True, after
        return after

    def save(self) -> bytes | None:
        """See `ExternalMethod.save`: where the library stops next, and its state."""
        if self._ended:
            return struct.pack("d", np.nan)
        own = self._library.save()
        return None if own is None else struct.pack("d", self._until) + own

    def restore(self, stored: bytes) -> None:
        """See `ExternalMethod.restore`."""
        (until,) = struct.unpack("d", stored[:8])
        step = _LibraryStep(None, self._step.events, self._step.now.t, self._opened)
        self._before = self._opened
        if np.isnan(until):
            self._step, self._ended = step, True
        else:
            self._begin(step, until)
            self._library.restore(stored[8:])


def _end(step: Step, share: float) -> StepState:
    assert step.dense is not None
    if share == 1.0:
        return step.state
    q, v, z = step.dense(share)[:3]
    return StepState(q, v, z=z)


class _LibraryStep(EventStep):
    dense: Dense

    def inside(self, there: StepPoint, share: float) -> StepPoint:
        """Return the state at a share of the step that leads to `there`."""
        q, v, z = self.dense(share)[:3]
        return StepPoint(self.now.t + share * (there.t - self.now.t), np.array(q), np.array(v), np.array(z))

    def first_event(self, there: StepPoint) -> tuple[float, Event | None] | None:
        """See `EventStep.first_event`."""
        self._there = there
        return super().first_event(there)

    def _moved(self, h: float) -> StepPoint:
        return self.inside(self._there, h / (self._there.t - self.now.t)) if h > 0.0 else self.now


@treatment_start
def with_contact_forces(workspace: Workspace) -> Workspace:
    """Return a workspace that starts with the contact forces and modes of the initial state.

    Raises
    ------
    StepError
        If no modes or forces of the contacts are possible.
    """
    mechanism = workspace.mechanism
    top, chosen = mechanism.topology, mechanism.reacting
    assert chosen is not None
    p = EquationsOfMotion(workspace, states_at_start(workspace))
    events = ContactEvents.on(p, chosen.section)
    begin = StepState(p.q0, p.v0, z=p.z0)
    begin = replace(begin, memory=events.contacts.begun(begin))
    state = EventStep(None, events, workspace.t0, begin).state()
    held = events.contacts.held
    parameters = top.law_parameters.copy()
    parameters[top.states[held.states, STATE_ROW.parameter]] = held.of(state.memory)
    return replace(workspace, mechanism=replace(mechanism, topology=top._replace(law_parameters=parameters)))
