"""Steps between events of rigid contacts, and the events.

Contacts are open, stick or slip. Between events, closed contacts are constraints of the accelerations, and those that
slip have the friction force -mu N against the slip. Events are zeros of functions of the state, found by steps of the
method itself: a gap that closes, a normal force that vanishes, a friction force that reaches its limit, slip that ends,
and the end of an edge of a polygon. At each event, a linear complementarity problem determines the new modes, and at an
impact also the impulses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss

from mbdkit.engine.nearest_state import nearest_positions, nearest_velocities
from mbdkit.integrators.impulse import ContactImpact
from mbdkit.integrators.interface import StepTaken
from mbdkit.mechanism.contacts import OPEN, SLIP, STICK, ChosenTreatment
from mbdkit.methods.step_methods import Step, StepMethod, StepState
from mbdkit_contact.closed_contacts import ClosedSystem
from mbdkit_contact.contact_impacts import struck
from mbdkit_contact.contact_state import ContactState
from mbdkit_contact.forced_equations import ForcedEquations
from mbdkit_contact.rigid_contacts import Forced, RigidContacts

MOST_EVENTS = 1000
"""The run stops after this many consecutive events without a complete step."""
SAMPLES = 8
"""Number of states after the start of a step, the last one at its end, at which event functions are evaluated."""
SAME_INSTANT = 4e-16
"""Times that differ by less than this, in seconds or relative to their size, are equal."""
SAME = 1e-10
"""Gaps below this, relative to the length of the mechanism, and velocities below this, relative to the largest of the
motion, count as zero.
"""

REDUNDANT = 1e-6
"""Friction forces that exceed their limit by more than this share of the normal force are assumed to result from
redundant contacts.
"""

_NODES, _WEIGHTS = (0.5 * x for x in (1.0 + leggauss(4)[0], leggauss(4)[1]))
"""Gauss-Legendre quadrature of order 8 on [0, 1]."""

STAYING = 1e-9
"""Accelerations [m/s^2] below this, absolute and relative to the largest one, do not separate shapes."""


@dataclass(frozen=True)
class Point:
    """A state within a step, and the work and dissipated energy since the start of the step [J]."""

    t: float
    q: np.ndarray
    v: np.ndarray
    z: np.ndarray
    work: float = 0.0
    dissipated: float = 0.0
    memory: Any = None
    multipliers: np.ndarray | None = None
    made: Step | None = None
    """The step of the method that has led here."""


class NotAcceptedError(Exception):
    """The method between events rejects a step; `size` is that of the next attempt [s]."""

    def __init__(self, size: float):
        super().__init__()
        self.size = size


class EventStep:
    """A step of the run, divided at events into steps of a method.

    Parameters
    ----------
    treatment
        The treatment of the run.
    between
        The method that takes the steps between events; None if none is taken.
    contacts
        The contacts.
    t, state
        Where the step begins; the memory of the state is a `ContactState`.
    """

    def __init__(
        self,
        treatment: ChosenTreatment,
        between: StepMethod | None,
        contacts: RigidContacts,
        t: float,
        state: StepState,
    ):
        self.treatment, self.between, self.p = treatment, between, contacts.p
        self.error: np.ndarray | None = None  # largest estimates of the local errors of q, v and the states
        self.contacts = contacts
        memory, own = state.memory, contacts.own(state.z)
        self.now = Point(t, state.q.copy(), state.v.copy(), own, 0.0, 0.0, memory.between, state.multipliers)
        self.begin: Point | None = self.now
        """The start of the step, if one step of the method has led from there to `now`; None after an event."""
        self.state: ContactState = memory
        self.length = contacts.p.length
        self._book_energy()
        is_known = len(self.state.modes) == len(contacts.names)
        features = self.state.features if is_known else None
        contacts.kinematics.held = contacts.kinematics.none_held() if features is None else features
        self.modes = self.state.modes if is_known else self._modes_at_rest()

    @property
    def modes(self) -> np.ndarray:
        """Modes (C,) of the contacts. Setting them fixes the polygon features of closed contacts."""
        return self._modes

    @modes.setter
    def modes(self, modes: np.ndarray) -> None:
        self._modes = modes
        self.contacts.kinematics.hold(self.now.q, modes != OPEN)

    @property
    def speed(self) -> float:
        """Largest velocity of the motion so far, from its kinetic energy [m/s]; at least 1e-3, so that rounding errors
        of bodies at rest count as zero.
        """
        return max(float(np.sqrt(2.0 * self.state.energy / np.sum(self.p.mass[::3]))), 1e-3)

    def _book_energy(self) -> None:
        now = 0.5 * float(self.now.v @ (self.p.mass * self.now.v))
        self.state = replace(self.state, energy=max(self.state.energy, now))

    def _modes_at_rest(self) -> np.ndarray:
        """Return the modes at the start or after a stop."""
        return self._met(self.contacts.kinematics.rows(self.now.q, self.now.v).gap <= SAME * self.length)

    def _met(self, touching: np.ndarray) -> np.ndarray:
        """Return the modes of contacts that touch; if their shapes approach each other, they collide first."""
        rows = self.contacts.kinematics.rows(self.now.q, self.now.v)
        if np.any(touching & (rows.normal @ self.now.v < -SAME * self.speed)):
            self._strike(touching)
            return self.modes
        return self._decided(self.now, touching)

    def contact_state(self) -> ContactState:
        """Return the present data of the contacts, which are passed to the next step."""
        now, forced = self.now, self._forced(self.now)
        force = forced.normal @ forced.rows.normal + forced.tangent @ forced.rows.tangent
        normal, tangent = self._shared(now, forced)
        features = self.contacts.kinematics.held
        found = self.state.undetermined
        if not np.array_equal(self.modes, self.state.modes):
            parting = forced.rows.normal @ forced.a - forced.rows.normal_right
            stays = (self.modes != OPEN) | (parting <= STAYING * max(np.max(np.abs(forced.a)), 1.0))
            staying = self._touching() & stays
            ambiguous = self.contacts.undetermined(now.t, now.q, self.modes, staying)
            found |= {name for name, one in zip(self.contacts.names, ambiguous, strict=True) if one}
        return replace(
            self.state,
            modes=self.modes,
            normal=normal,
            tangent=tangent,
            force=force,
            features=features,
            undetermined=found,
            is_new=False,
        )

    def _shared(self, at: Point, forced: Forced) -> tuple[np.ndarray, np.ndarray]:
        """Return the normal and tangential forces (C,) of contacts.

        If redundant contacts stick, so that their forces are not unique, forces within the limits of friction are
        chosen.
        """
        beyond = np.abs(forced.tangent) - self.contacts.static * forced.normal
        # a smaller excess means that the contact is about to slip
        if not np.any((self.modes == STICK) & (beyond > REDUNDANT * np.max(np.abs(forced.normal)))):
            return forced.normal, forced.tangent
        slides = np.where(np.abs(self.modes) == SLIP, np.sign(self.modes), 0.0)
        return self.contacts.shared(at.t, at.q, at.v, self.modes != OPEN, slides, forced)

    def reached(self, event: tuple[int, int] | None, streak: int) -> StepState:
        """Return the present state and the data of the contacts for the next step."""
        now = self.now
        memory = replace(self.contact_state(), time=now.t, event=event, streak=streak, between=now.memory)
        z = self.contacts.all_states(now.z, memory)
        return StepState(now.q, now.v, now.multipliers, memory, now.work, now.dissipated, z=z)

    def _forced(self, at: Point) -> Forced:
        self.contacts.hold(at.z)
        return self.contacts.accelerations(at.t, at.q, at.v, self.modes)

    # ---- between events ------------------------------------------------------------------------------------------

    def _moved(self, h: float) -> Point:
        """Return the state after one step of the method, projected to close joints and closed contacts."""
        method, now, equations = self.between, self.now, self.equations()
        assert method is not None
        if not h > 0.0:
            q, v = self._closed(now.t, now.q, now.v)
            return replace(now, q=q, v=v)
        begin = StepState(now.q, now.v, now.multipliers, now.memory, z=now.z)
        if now.memory is None:
            begin = replace(begin, memory=method.begin(equations, now.t, begin, "event"))
        new = method.step(equations, now.t, begin, h)
        made = new if isinstance(new, Step) else Step(new)
        if not made.accepted:
            raise NotAcceptedError(0.5 * h if made.next_step is None else made.next_step)
        if made.time is not None or made.event is not None:
            raise TypeError("the treatment event-driven needs steps that end at the time for which they are asked")
        end, t = made.state, now.t + h
        q, v = self._closed(t, end.q, end.v)
        memory = method.begin(equations, t, replace(end, q=q, v=v), "projection")
        work, lost = end.work, end.dissipated
        if work is None or lost is None:
            work, lost = gains(equations, now, Point(t, q, v, end.z), made)
        work, lost = now.work + work, now.dissipated + lost
        return Point(t, q, v, end.z, work, lost, memory, end.multipliers, made)

    def equations(self) -> ForcedEquations:
        """Return the equations of motion with the closed contacts, at the present states of other elements."""
        equations = ForcedEquations(self.contacts, self.modes)
        equations.hold(self.now.z)
        return equations

    def _closed(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the nearest state in which joints and closed contacts are closed."""
        system = ClosedSystem(self.contacts, self.modes)
        if system.m:
            q = nearest_positions(system, t, q)
            v = nearest_velocities(system, t, q, v)
        return q, v

    # ---- events --------------------------------------------------------------------------------------------------

    def to(self, end: float) -> tuple[int, int] | None:
        """Advance to the time `end` or to the first event before it; return that event, or None."""
        while (h := end - self.now.t) > SAME_INSTANT * max(abs(end), 1.0):
            there = self._moved(self.limited(h))
            found = self.first_event(there)
            if there.made is not None and there.made.error is not None:
                self.error = np.maximum(np.abs(there.made.error), 0.0 if self.error is None else self.error)
            if found is not None:
                share, event = found
                if share > 0.0:
                    self.go_to(self._moved(share * (there.t - self.now.t)))
                return event
            self.go_to(there)
        self.now = replace(self.now, t=end)
        return None

    def go_to(self, there: Point) -> None:
        """Continue from a state to which one step of the method has led."""
        self.begin = self.now if self.begin is self.now else None
        self.now = there
        self._book_energy()

    def limited(self, h: float) -> float:
        """Return a step size, at most `h`, with which no contact can open and close again unnoticed."""
        forced = self._forced(self.now)
        rows = forced.rows
        rate, curve = rows.rates(self.now.v)[0], rows.rates(forced.a)[0] - rows.normal_right
        leaves = (self.modes == OPEN) & (rows.gap <= SAME * self.length) & (rate > SAME * self.speed)
        for i in np.flatnonzero(leaves & (curve < 0)):
            h = min(h, -3.0 * rate[i] / curve[i])
        return float(h)

    def _values(self, at: Point) -> np.ndarray:
        """Return three event functions of each contact (3, C), which are negative after an event.

        They belong to the normal direction (gap or force), to friction (slip, or how far the friction force is from its
        limit), and to the place on the edge of a polygon.
        """
        forced = self._forced(at)
        is_open, slips = self.modes == OPEN, np.abs(self.modes) == SLIP
        opens = forced.rows.rates(at.v)[0] >= 0.0
        pressed, tangent = self._shared(at, forced)
        normal = np.where(is_open, np.where(opens, np.abs(forced.rows.gap), forced.rows.gap), pressed)
        limit = self.contacts.static * pressed - np.abs(tangent)
        has_slip = slips & (self.contacts.kinetic > 0)
        friction = np.where(has_slip, np.sign(self.modes) * forced.rows.slip, np.where(self.modes == STICK, limit, 1.0))
        return np.stack([normal, friction, self.contacts.kinematics.margins(at.q)])

    def _scales(self, forced: Forced) -> np.ndarray:
        inertial = np.delete(np.abs(self.p.mass * forced.a), np.s_[2::3])
        weight = max(float(np.max([*np.abs(forced.normal), *inertial])), 1e-300)
        is_open, slips = self.modes == OPEN, np.abs(self.modes) == SLIP
        normal = np.where(is_open, 1e-15 * self.length, SAME * weight)
        place = np.full(len(normal), 1e-15 * self.length)
        return np.stack([normal, SAME * np.where(slips, self.speed, weight), place])

    def first_event(self, there: Point) -> tuple[float, tuple[int, int]] | None:
        """Return the share of a step at which its first event happens, and the event as (kind, contact).

        The kind is the index of the function in `_values`: 0 normal, 1 friction, 2 place on a polygon. None if there is
        no event.
        """
        now, h = self.now, there.t - self.now.t
        shares = [i / SAMPLES for i in range(1, SAMPLES)]
        states = [self._inside(there, share) for share in shares]
        values = np.stack([self._values(one) for one in (now, *states, there)])
        small = self._scales(self._forced(there))
        shares = [0.0, *shares, 1.0]
        first: tuple[float, tuple[int, int]] | None = None
        for place in np.argwhere(np.any(values[1:] < -small, axis=0)):
            kind, contact = int(place[0]), int(place[1])
            if (
                kind < 2
                and self.modes[contact] == STICK
                and np.array_equal(self._decided(there, self.modes != OPEN), self.modes)
            ):
                continue  # no event: redundant contacts can share the forces differently, and all modes persist
            own = values[:, kind, contact]
            after = 1 + int(np.argmax(own[1:] < -small[kind, contact]))
            before = int(np.argmax(own[:after]))
            low = shares[before] if own[before] > 0 else self._rise(kind, contact, shares[after], h, small)
            share = self._zero(kind, contact, low, shares[after], h) if low is not None else 0.0
            if first is None or share < first[0]:
                first = share, (kind, contact)
        return first

    def _inside(self, there: Point, share: float) -> Point:
        """Return an interpolated state within a step that leads to `there`."""
        now = self.now
        taken = StepTaken(now.t, there.t, now.q, now.v, there.q, there.v, now.z, there.z)
        return Point(taken.time(share), *taken.between(share))

    def _rise(self, kind: int, contact: int, high: float, h: float, small: np.ndarray) -> float | None:
        """Return a share of the step below `high` at which an event function that starts at zero is positive, or None.

        Such a function is, for example, slip that begins just before the contact opens.
        """
        for share in high * 0.1 ** np.arange(1.0, 6.0):
            if self._values(self._moved(share * h))[kind, contact] > small[kind, contact]:
                return float(share)
        return None

    def _zero(self, kind: int, contact: int, low: float, high: float, h: float) -> float:
        """Return the share of the step at which an event function vanishes; each evaluation takes a step."""
        from scipy.optimize import brentq  # loaded only if a run has such events

        def value(share: float) -> float:
            return float(self._values(self._moved(share * h))[kind, contact])

        begin, end = value(low), value(high)
        if end >= 0.0:  # the interpolated state showed an event, but a step of the method does not
            return high
        if begin <= 0.0:
            return low
        return float(brentq(value, low, high, xtol=1e-15, rtol=8.9e-16))

    def happen(self, event: tuple[int, int]) -> None:
        """Apply an event, given as (kind, contact), to the present state."""
        kind, contact = event
        self.now = replace(self.now, memory=None, multipliers=None)
        if kind == 0 and self.modes[contact] == OPEN:
            self._strike(self._touching() | (np.arange(len(self.modes)) == contact))
            return
        if kind == 2:
            self._hand_over(contact)
            return
        stops, begins = np.zeros((2, len(self.modes)))
        if kind == 1 and self.modes[contact] == STICK:
            forced = self._forced(self.now)
            is_there = self._values(self.now)[1] <= self._scales(forced)[1]
            is_there[contact] = True
            begins = np.where((self.modes == STICK) & is_there, -np.sign(forced.tangent), 0.0)
        elif kind == 1:
            stops[contact] = 1.0
            self.modes = np.where(stops > 0, STICK, self.modes)
            self.now = replace(self.now, v=self._closed(self.now.t, self.now.q, self.now.v)[1])
        touching = self.modes != OPEN
        limit = self._scales(self._forced(self.now))[0, contact]
        self.modes = self._decided(self.now, touching, stops, begins)
        if kind == 0 and self.modes[contact] != OPEN and self._forced(self.now).normal[contact] <= limit:
            touching[contact] = False  # the force vanishes now, and would pull later
            self.modes = self._decided(self.now, touching, stops, begins)

    def _hand_over(self, contact: int) -> None:
        """Open a contact that reaches the end of its edge or corner, and decide the modes of contacts that touch."""
        stays = self.modes != OPEN
        stays[contact] = False
        self.modes = np.where(stays, self.modes, OPEN)
        self.modes = self._met(self._touching())

    def _touching(self) -> np.ndarray:
        rows = self.contacts.kinematics.rows(self.now.q, self.now.v)
        return (self.modes != OPEN) | (
            (rows.gap <= SAME * self.length) & (rows.normal @ self.now.v <= SAME * self.speed)
        )

    def _decided(
        self, at: Point, touching: np.ndarray, stops: np.ndarray | float = 0.0, begins: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Return the modes (C,) of touching contacts after an event that led to the state `at`.

        `stops` is positive where slip has just ended; `begins` is the direction in which it has just begun, else 0.
        """
        self.contacts.hold(at.z)
        rows = self.contacts.kinematics.rows(at.q, at.v)
        resting = touching & (rows.normal @ at.v <= SAME * self.speed)
        slips = (np.abs(rows.slip) > SAME * self.speed) & (np.asarray(stops) <= 0.0)
        sliding = np.where(np.asarray(begins) != 0.0, begins, np.where(slips, np.sign(rows.slip), 0.0))
        return self.contacts.decided(at.t, at.q, at.v, resting, sliding)

    def _strike(self, touching: np.ndarray) -> None:
        """Apply an impact of touching contacts."""
        now = self.now
        rows = self.contacts.kinematics.rows(now.q, now.v)
        approach = rows.normal @ now.v
        e = np.where(touching, self.contacts.restitution, 0.0)
        result = struck(self.contacts, now.t, now.q, now.v, touching, e, self.treatment.impact_law)
        undecided = self.state.undecided
        if self.contacts.affect_each_other(now.t, now.q, touching & (approach < -SAME * self.speed)):
            undecided = min(undecided, now.t)
        self.now = replace(now, v=result.v)
        self.modes = self._decided(self.now, touching)
        tails = self._cut(touching, approach)
        work = float(result.multipliers @ self.p.constraint_rates(now.t, now.q, 0.0 * now.v))  # of drivers that move
        lost = work + 0.5 * float((now.v - self.now.v) @ (self.p.mass * (now.v + self.now.v)))
        self.now = replace(self.now, work=now.work + work, dissipated=now.dissipated + lost)
        reactions = self.p.reactions(now.t, now.q, result.multipliers)
        new = [
            ContactImpact(now.t, i, float(result.normal[i]), float(result.tangent[i]), lost, reactions)
            for i in np.flatnonzero(touching & (result.normal > 0)).tolist()
        ]
        changed = [] if result.is_as_asked else [self.contacts.names[one.contact] for one in new]
        self.state = replace(
            self.state,
            impacts=(*self.state.impacts, *new, *(one for one in tails if one.time < np.inf)),
            cut=self.state.cut.union(self.contacts.names[one.contact] for one in tails),
            cut_time=min(self.state.cut_time, now.t) if tails else self.state.cut_time,
            changed=self.state.changed.union(changed),
            undecided=undecided,
            ordered=self.state.ordered.union(self.contacts.names[i] for i in result.ordered.tolist()),
        )

    def _cut(self, touching: np.ndarray, approach: np.ndarray) -> list[ContactImpact]:
        """Close contacts that would otherwise have an infinite sequence of impacts.

        These are the touching contacts that the impact opens with less energy than `rest_energy` and that would close
        again. The sequence may belong to one contact or to several in turn, as for a rocking block.

        Returns the ends of these sequences, as impacts without impulses; their times are infinite for contacts that did
        not approach or have no restitution.
        """
        forced, contacts, now = self._forced(self.now), self.contacts, self.now
        rows = forced.rows
        after, curve = rows.normal @ now.v, rows.normal @ forced.a - rows.normal_right
        effective_mass = 1.0 / np.maximum(np.einsum("ij,ij->i", rows.normal, rows.normal / self.p.mass), 1e-300)
        is_small = 0.5 * effective_mass * after**2 <= self.treatment.rest_energy * self.state.energy
        rests = touching & (self.modes == OPEN) & (after > 0) & (curve < 0) & is_small
        if not np.any(rests):
            return []
        self.now = replace(now, v=now.v + self._tail_change(rests, np.where(rests, np.sign(rows.slip), self.modes)))
        self.modes = self._decided(self.now, touching)
        e = np.where((approach < 0) & (contacts.restitution > 0), contacts.restitution, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = now.t - 2.0 * np.where(rests, after / curve, 0.0) / (1.0 - e)
        none = 0.0 * self.p.reactions(now.t, now.q, forced.multipliers)
        return [ContactImpact(float(ends[i]), i, 0.0, 0.0, 0.0, none) for i in np.flatnonzero(rests).tolist()]

    def _tail_change(self, rests: np.ndarray, slips: np.ndarray) -> np.ndarray:
        """Return the change of the velocities (n,) by which contacts at rest replace a sequence of impacts.

        Until the sequence ends, a contact at rest exerts the normal impulse of the sequence and, in addition, the
        impulse that stops the separation. The change removes the additional impulse, with its friction: otherwise the
        slip after the sequence would have an error of the first order in the velocity of separation.

        For contacts that come to rest, which are those in `rests`, the modes `slips` have the direction of slip, 1, -1
        or 0.
        """
        now, contacts = self.now, self.contacts
        closed = np.flatnonzero(rests | (self.modes != OPEN))
        rows = contacts.kinematics.rows(now.q, now.v, closed)
        is_stuck = self.modes[closed] == STICK
        direction = np.where(is_stuck, 0.0, np.sign(slips[closed]) * (np.abs(rows.slip) > SAME * self.speed))
        pushes = rows.normal - (direction * contacts.kinetic[closed])[:, None] * rows.tangent
        moved, _ = contacts.answers(now.t, now.q, np.vstack([pushes, rows.tangent[is_stuck]]))
        held = np.vstack([rows.normal, rows.tangent[is_stuck]])
        return np.asarray(moved @ np.linalg.lstsq(held @ moved, -held @ now.v, rcond=1e-11)[0])


def gains(equations: ForcedEquations, begin: Point, end: Point, made: Step) -> tuple[float, float]:
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
        gained += h * weight * np.array(equations.rate(begin.t + share * h, *dense(share)[:3])[2])
    return float(gained[0]), float(gained[1])
