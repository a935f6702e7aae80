"""Steps of methods in Python between events of rigid contacts, and the events.

The events, their search and what they change are those of `mbdkit_contact.kernels.steps_to_events`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.base.quadrature import gauss_on_unit
from mbdkit.integrators.interface import SAME_INSTANT, StepTaken
from mbdkit.methods.step_methods import Step, StepMethod, StepState
from mbdkit_contact.contact_state import ContactState
from mbdkit_contact.events_of_contacts import ContactEvents
from mbdkit_contact.forced_equations import ForcedEquations, Powers
from mbdkit_contact.kernels.event_bundle import UNKNOWN
from mbdkit_contact.kernels.steps_to_events import (
    MOST_EVENTS,
    MOST_SAMPLES,
    SAMPLES,
    TURN,
    begin_search_at,
    drift_at,
    limited_at,
    search_at,
    values_at,
)

_NODES, _WEIGHTS = gauss_on_unit(4)

Event = tuple[int, int]  #: Kind of an event function, and contact.


@dataclass(frozen=True)
class StepPoint:
    """A state within a step, and the work and dissipated energy since the start of the step [J]."""

    t: float
    q: np.ndarray
    v: np.ndarray
    z: np.ndarray
    work: float = 0.0
    dissipated: float = 0.0
    memory: Any = None
    multipliers: np.ndarray | None = None
    made: Step | None = None  #: The step of the method that has led here.


class NotAcceptedError(Exception):
    """The method between events rejects a step; `size` is that of the next attempt [s]."""

    def __init__(self, size: float):
        super().__init__()
        self.size = size


class EventStep:
    """A step of the run, divided at events into steps of a method.

    Parameters
    ----------
    between
        The method that takes the steps between events; None if none is taken.
    events
        The contacts.
    t, state
        Where the step begins; the memory of the state is a `ContactState`.
    """

    def __init__(self, between: StepMethod | None, events: ContactEvents, t: float, state: StepState):
        self.between, self.events = between, events
        self.error: np.ndarray | None = None  # largest estimates of the local errors of q, v and the states
        memory: ContactState = state.memory
        own = events.contacts.own(state.z)
        self.now = StepPoint(t, state.q.copy(), state.v.copy(), own, 0.0, 0.0, memory.between, state.multipliers)
        #: The start of the step, if one step of the method has led from there to `now`; None after an event.
        self.begin: StepPoint | None = self.now
        self.before = memory
        self.is_unclear = False  # whether the last search has shown only that the step has to be shorter
        self.impacts = memory.impacts
        events.load(memory.known)
        if not events.bundle.known.determined[0]:
            self._change((-1, 0))

    @property
    def modes(self) -> np.ndarray:
        """(C,) modes of the contacts."""
        return self.events.modes

    def happen(self, event: Event) -> None:
        """Apply an event to the present state."""
        self.now = replace(self.now, memory=None, multipliers=None)
        self._change(event)

    def _change(self, event: Event) -> None:
        """Apply an event, or determine the modes anew if its kind is negative."""
        events, now = self.events, self.now
        self._look_at(now)
        limited_at(*self._addresses, 0.0)  # which notes the kinetic energy
        events.happen(*event)
        work, lost = events.bundle.gained.tolist()
        v = events.bundle.v[: events.p.n].copy()
        self.now = replace(now, v=v, work=now.work + work, dissipated=now.dissipated + lost)
        self.impacts = (*self.impacts, *events.take_impacts())
        events.bundle.known.event[0] = 0

    @property
    def _addresses(self) -> tuple[int, int]:
        return self.events.workspace.stepping_engine, self.events.pinned.address

    def _look_at(self, at: StepPoint) -> None:
        self.events.at(at.t, at.q, at.v, at.z)

    def reached(self, event: Event | None) -> StepState:
        """Return the present state and the data of the contacts for the next step."""
        known = self.events.bundle.known
        known.streak[0] = 0 if event is None else known.streak[0] + 1
        if known.streak[0] > MOST_EVENTS:
            raise StepError("zeno", f"contacts changed {MOST_EVENTS} times without a step between")
        return self.state(event)

    def state(self, event: Event | None = None) -> StepState:
        """Return the present state, with an event that follows."""
        events, now, known = self.events, self.now, self.events.bundle.known
        self._look_at(now)
        events.show_forces()
        known.event[:] = (0, 0) if event is None else (event[0] + 1, event[1])
        memory = events.state(self.impacts, time=now.t, between=now.memory)
        z = events.contacts.all_states(now.z, memory)
        return StepState(now.q, now.v, now.multipliers, memory, now.work, now.dissipated, z=z)

    # ---- between events ------------------------------------------------------------------------------------------

    def _moved(self, h: float) -> StepPoint:
        """Return the state after one step of the method, projected to close joints and closed contacts."""
        method, now, equations = self.between, self.now, self.equations()
        assert method is not None
        if not h > 0.0:
            return self.closed(now)
        begin = StepState(now.q, now.v, now.multipliers, now.memory, z=now.z)
        with self.events.acting():
            if now.memory is None:
                begin = replace(begin, multipliers=None)
                begin = replace(begin, memory=method.begin(equations, now.t, begin, "event"))
            new = method.step(equations, now.t, begin, h)
        result = new if isinstance(new, Step) else Step(new)
        if not result.accepted:
            raise NotAcceptedError(0.5 * h if result.next_step is None else result.next_step)
        if result.time is not None or result.event is not None:
            raise TypeError("the treatment event-driven needs steps that end at the time for which they are asked")
        result = self.acting(result)
        end = self.closed(StepPoint(now.t + h, result.state.q, result.state.v, result.state.z))
        with self.events.acting():
            memory = method.begin(equations, end.t, replace(result.state, q=end.q, v=end.v), "projection")
            work, lost = result.state.work, result.state.dissipated
            if work is None or lost is None:
                work, lost = gains(equations, now, end, result)
        work, lost = now.work + work, now.dissipated + lost
        return StepPoint(end.t, end.q, end.v, end.z, work, lost, memory, result.state.multipliers, result)

    def acting(self, made: Step) -> Step:
        """Return a step whose dense output, which may evaluate the equations of motion, includes closed contacts."""
        if (dense := made.dense) is None:
            return made

        def inside(theta: float) -> tuple[np.ndarray, ...]:
            with self.events.acting():
                return dense(theta)

        return replace(made, dense=inside)

    def equations(self) -> ForcedEquations:
        """Return the equations of motion with the closed contacts, at the present states of other elements."""
        equations = ForcedEquations(self.events)
        equations.hold(self.now.z)
        return equations

    def closed(self, at: StepPoint) -> StepPoint:
        """Return the nearest state in which joints and closed contacts are closed."""
        self._look_at(at)
        self.events.close()
        n, bundle = self.events.p.n, self.events.bundle
        return replace(at, q=bundle.q[:n].copy(), v=bundle.v[:n].copy())

    # ---- events --------------------------------------------------------------------------------------------------

    def to(self, end: float) -> Event | None:
        """Advance to the time `end` or to the first event before it; return that event, or None."""
        longest = math.inf
        while (h := end - self.now.t) > SAME_INSTANT * max(abs(end), 1.0):
            there = self._moved(min(self.limited(h), longest))
            search = self.first_event(there)
            longest = 2.0 * (there.t - self.now.t)
            if search is not None and self.is_unclear:
                longest *= 0.5 * search[0]
                continue
            if there.made is not None and there.made.error is not None:
                self.error = np.maximum(np.abs(there.made.error), 0.0 if self.error is None else self.error)
            if search is not None:
                share, event = search
                if share > 0.0:
                    there = self._moved(share * (there.t - self.now.t))
                    self.go_to(there)
                if event is not None:
                    return event
            else:
                self.go_to(there)
        self.now = replace(self.now, t=end)
        return None

    def go_to(self, there: StepPoint) -> None:
        """Continue from a state to which one step of the method has led."""
        self.begin = self.now if self.begin is self.now else None
        self.now = there

    def limited(self, h: float) -> float:
        """Return a step size, at most `h`, with which no contact can open and close again unnoticed."""
        self._look_at(self.now)
        size = h

        def limited(engine: int, method: int) -> int:
            nonlocal size
            size, status = limited_at(engine, method, h)
            return status

        self.events.called(limited)
        return size

    def _values(self, at: StepPoint) -> np.ndarray:
        """Return three event functions of each contact (3, C), which are negative after an event."""
        self.events.p.counters.rhs_evaluations += 1
        self._look_at(at)
        self.events.called(values_at)
        return self.events.bundle.values.copy()

    def first_event(self, there: StepPoint) -> tuple[float, Event | None] | None:
        """Return the share of a step at which its first event happens, and the event; None if there is none.

        Without an event, the share is where the step has to end because a gap has a minimum there.
        """
        h = there.t - self.now.t
        places = self._places(there)
        shares = np.arange(places + 1) / places
        points = (self.now, *(self.inside(there, share) for share in shares[1:-1].tolist()), there)
        looks = [(self._values(point), self.events.bundle.pace.copy()) for point in points]
        samples, rates = (np.stack(arrays) for arrays in zip(*looks, strict=True))
        q, v = (np.array([[*getattr(point, name), 0.0, 0.0, 0.0] for point in points]) for name in ("q", "v"))
        self._look_at(there)
        self.events.called(lambda engine, method: begin_search_at(engine, method, h, shares, samples, rates, q, v))
        method, search = self.events.pinned.address, self.events.bundle.search
        share = search_at(method, False)
        while share >= 0.0:
            self._values(self._moved(share * h))
            share = search_at(self.events.pinned.address, True)
        share = float(search.first[0])
        kind, contact = search.event.tolist()
        self.is_unclear = kind == UNKNOWN
        return None if share == np.inf else (share, None if kind < 0 else (kind, contact))

    def _places(self, there: StepPoint) -> int:
        """Return the number of places of the samples in a step, more than `SAMPLES` if a body turns far."""
        fastest = max(float(np.max(np.abs(at.v[2::3]), initial=0.0)) for at in (self.now, there))
        return max(SAMPLES, int(min(fastest * (there.t - self.now.t) / TURN, MOST_SAMPLES)))

    def inside(self, there: StepPoint, share: float) -> StepPoint:
        """Return the state at a share of the step to `there`."""
        now, result = self.now, there.made
        taken = StepTaken(now.t, there.t, now.q, now.v, there.q, there.v, now.z, there.z)
        between = taken.between if result is None or result.dense is None else result.dense
        q, v, z = between(share)[:3]
        return StepPoint(taken.time(share), q, v, z)

    def drift(self, at: StepPoint) -> float:
        """Return the largest gap of joints and closed contacts at a state [m, rad]."""
        self._look_at(at)
        return float(drift_at(*self._addresses))


def gains(equations: ForcedEquations, begin: StepPoint, end: StepPoint, made: Step) -> tuple[float, float]:
    """Return the work and the dissipated energy of a step of a method [J], from its dense output or from both ends.

    The powers are integrated by Gauss-Legendre quadrature of order 8 over dense output, or by Simpson's rule over the
    cubic through both ends.
    """
    h, dense = end.t - begin.t, made.dense
    if not equations.has_power:
        return 0.0, 0.0
    if dense is None:
        taken = StepTaken(0.0, h, begin.q, begin.v, end.q, end.v, begin.z, end.z)
        dense, nodes, weights = taken.between, (0.0, 0.5, 1.0), (1 / 6, 2 / 3, 1 / 6)
    else:
        nodes, weights = tuple(_NODES), tuple(_WEIGHTS)
    gained = np.zeros(2)
    for share, weight in zip(nodes, weights, strict=True):
        gained += h * weight * np.array(power_at(equations, begin.t + share * h, *dense(share)[:3]))
    return float(gained[0]), float(gained[1])


def power_at(equations: ForcedEquations, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Powers:
    """Return the power of loads and drivers and the dissipated power at a state [W]."""
    return equations.powers(t, q, v, equations.derivatives(t, q, v, z)[1])
