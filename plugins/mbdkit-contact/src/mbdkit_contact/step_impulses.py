"""Impulses of contacts in a step of a time-stepping method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.mechanism.contacts import OPEN, SLIP, STICK
from mbdkit_contact.complementarity import Pushed
from mbdkit_contact.contact_impacts import depend_on_order, stronge
from mbdkit_contact.contact_kinematics import FEW, Rows
from mbdkit_contact.contact_state import ContactState
from mbdkit_contact.kernels.impacts import SMALL_RESTITUTION
from mbdkit_contact.rigid_contacts import SAME_ACCELERATION, RigidContacts

MANY = 40
"""Number of overlaps above which less accurate results are accepted: contacts at rest that others press together get no
impulse in this step, and positions are projected only once. The next steps reduce the remaining overlap."""
AT_REST = 4.0
"""A contact is at rest if its gap, rate and impulse are smaller than this many times those that accelerations cause in
one step; otherwise it has an impact.
"""
SMALL = 1e-12
"""Overlap, relative to the length of the mechanism, that counts as zero."""


@dataclass(frozen=True)
class SmoothStep:
    """A step without impulses of contacts.

    Attributes
    ----------
    v
        (n,) velocities at its end.
    multipliers
        (m,) multipliers of the joints.
    middle
        (n,) positions at which the gradients of the gaps are evaluated.
    answer
        Function that returns the change of the velocities (n,) by an impulse (n,), and the impulses (m,) of the joints.
    positions
        Function that returns the positions (n,) at the end, before projection, from the velocities (n,) at the end.
    accelerations
        Accelerations that the method passes to its next step.
    """

    v: np.ndarray
    multipliers: np.ndarray
    middle: np.ndarray
    answer: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    positions: Callable[[np.ndarray], np.ndarray]
    accelerations: tuple[np.ndarray, ...] = ()

    def solve(self, impulse: np.ndarray) -> np.ndarray:
        """Return the change of the velocities (n,) by an impulse (n,)."""
        return self.answer(impulse)[0]


@dataclass(frozen=True)
class StepImpulses:
    """The impulses of all contacts in a step.

    Attributes
    ----------
    contacts, held
        The contacts, and their state at the end of the last step.
    smooth
        The step without impulses of contacts.
    v, h
        (n,) velocities at its start, and its size [s].
    """

    contacts: RigidContacts
    held: ContactState
    smooth: SmoothStep
    v: np.ndarray
    h: float

    def applied(self) -> tuple[np.ndarray, ContactState, float]:
        """Return the velocities (n,) after the impulses, the state of the contacts, and the energy lost [J]."""
        held, smooth, h = self.held, self.smooth, self.h
        memory = replace(
            self.contacts.all_open(),
            residual=held.residual,
            changed=held.changed,
            ordered=held.ordered,
            is_over_step=True,
            accelerations=smooth.accelerations,
        )
        kinematics = self.contacts.kinematics
        kinematics.held = kinematics.none_held()
        gaps = kinematics.gaps(smooth.positions(smooth.v))
        some = np.flatnonzero(gaps <= SMALL * self.contacts.p.length)
        if not len(some):
            return smooth.v, memory, 0.0
        left = np.zeros(len(gaps))
        if len(some) > MANY:
            more = self._still_pressed(gaps, some)
            left[more] = np.maximum(gaps[more], 0.0)
            some = np.union1d(some, more)
        some, rows, (after, found, changed) = self._of_all_pressed(some, left / h)
        forces = np.stack([found.normal, found.tangent]) / h
        slip = SLIP * self._slips(rows, after, found, self.contacts.static[some] == 0.0)
        memory = replace(memory, residual=max(held.residual, found.residual), changed=held.changed.union(changed))
        memory = replace(memory, ordered=held.ordered.union(self._ordered(some, rows, found)))
        memory.normal[some], memory.tangent[some] = forces
        memory.modes[some] = np.where(found.is_closed, np.where(slip != 0, slip, STICK), OPEN)
        memory.force[:] = rows.force(forces)
        return after, memory, -0.5 * h * float(np.sum(forces * rows.rates(self.v + after)))

    def _ordered(self, some: np.ndarray, rows: Rows, found: Pushed) -> list[str]:
        """Return the names of contacts, of at most `FEW`, that strike in this step or are closed, and whose velocities
        depend on the order of the impacts; [] if all names are known.
        """
        contacts = self.contacts
        names = np.array([contacts.names[i] for i in some])
        rates = rows.rates(self.v)
        if not 1 < len(some) <= FEW or self.held.ordered.issuperset(names.tolist()):
            return []
        if not np.any((found.normal > 0.0) & (rates[0] < -AT_REST * self._gained(rows))):
            return []
        both = np.vstack([rows.normal, rows.tangent])
        response = both @ np.stack([self.smooth.solve(row) for row in both], axis=1)
        ordered = depend_on_order(contacts, "newton", response, rates.ravel(), contacts.restitution[some], some)
        return [str(name) for name in names[ordered]]

    def _still_pressed(self, gaps: np.ndarray, some: np.ndarray) -> np.ndarray:
        """Return the indices of contacts that were pressed in the last step and are at rest.

        Both arguments refer to the end of the step without impulses: `gaps` (C,) of all contacts, and the indices
        `some` of contacts that are closed then. Bodies that lie on each other fall together in this step, so that tiny
        gaps between them stay open. Without impulses at these gaps, the upper bodies would fall onto the lower ones,
        which the floor stops, and a pile would never come to rest. With them, these gaps may close at the end of the
        step.
        """
        rows = self.contacts.kinematics.rows(self.smooth.middle, self.v, some)
        fallen = self.h * float(np.max(self._gained(rows)))
        return np.flatnonzero((self.held.normal > 0.0) & (gaps <= AT_REST * fallen))

    def _of_all_pressed(self, some: np.ndarray, closing: np.ndarray) -> tuple[np.ndarray, Rows, _Solved]:
        """Return the contacts that have impulses in the step, their rows, and the impulses.

        These are the contacts `some`, which would overlap, and others at rest that they press together. Contacts that
        stick, or whose slip would change its direction, have static friction, unless they slip with it. If there are
        impacts, contacts that are struck by them have kinetic friction. Gaps may close with the rates `closing` (C,)
        [m/s] at the end of the step.
        """
        contacts, smooth, v = self.contacts, self.smooth, self.v
        modes = self.held.modes if len(self.held.modes) else self.contacts.all_open().modes  # unknown after a stop
        stops, slides = np.zeros((2, len(contacts.names)), dtype=bool)
        while True:
            rows = self._rows(some)
            guess = self.h * np.stack([self.held.normal, self.held.tangent])[:, some]
            rests = (modes[some] == OPEN) & (np.abs(rows.rates(v)[1]) <= self._negligible(rows, self.held.residual))
            sticks = ((modes[some] == STICK) | rests | stops[some]) & ~slides[some]
            friction = np.where(sticks, contacts.static[some], contacts.kinetic[some])
            solved = _Impact(contacts, rows, some, friction, v, smooth.v, smooth.solve, guess, closing[some]).solved()
            after, found, _ = solved
            slips, has_static = self._slips(rows, after, found), contacts.static[some] > contacts.kinetic[some]
            begins = sticks & has_static & (slips != 0)
            turns = ~sticks & ~slides[some] & has_static & (slips * modes[some] < 0)
            if np.any(begins | turns):
                slides[some[begins]], stops[some[turns]] = True, True
                continue
            # With many contacts, the following search takes long, and the order of impacts has larger effects anyway.
            if len(some) > MANY:
                return some, rows, solved
            more = self._pressed(after, some)
            strikes = (found.normal > 0.0) & (rows.rates(v)[0] < -AT_REST * self._gained(rows))
            new = sticks & has_static & (found.normal > AT_REST * guess[0])
            if len(more):
                some = np.union1d(some, more)
            elif np.any(strikes) and np.any(new):  # impacts have kinetic friction
                slides[some[new]] = True
            else:
                return some, rows, solved

    def _rows(self, some: np.ndarray) -> Rows:
        """Return the rows of the contacts `some`, whose features are those at the end of the step without impulses."""
        kinematics = self.contacts.kinematics
        kinematics.hold(self.smooth.positions(self.smooth.v), np.isin(np.arange(len(self.contacts.names)), some))
        rows = kinematics.rows(self.smooth.middle, self.v, some)
        kinematics.held = kinematics.none_held()
        return rows

    def _pressed(self, after: np.ndarray, some: np.ndarray) -> np.ndarray:
        """Return the indices of other contacts at rest that the impulses of the contacts `some` press together.

        The gap of a contact at rest may be as large as the distance that a body falls in a step, so the contact may be
        predicted to stay open. Without an impulse at such a contact, the impact of others would have a wrong result,
        however small the step. Contacts with larger gaps are left to the next step, whose impulses include restitution.
        """
        kinematics = self.contacts.kinematics
        gaps = kinematics.gaps(self.smooth.positions(after))
        gaps[some] = 0.0
        others = np.flatnonzero(gaps < -SMALL * self.contacts.p.length)
        if not len(others):
            return others
        rows = kinematics.rows(self.smooth.middle, self.v, others)
        return others[rows.gap <= AT_REST * self.h * self._gained(rows)]

    def _gained(self, rows: Rows) -> np.ndarray:
        """Return the absolute changes of the gap rates (k,) in the step without impulses [m/s]."""
        changes = rows.rates(self.smooth.v - self.v)[0]
        return np.asarray(np.abs(changes) + self.h * np.abs(rows.normal_right))

    def _negligible(self, rows: Rows, residual: float) -> float:
        """Return the slip velocity [m/s] that counts as zero if velocities have a relative error `residual`."""
        size = np.max(np.abs([rows.rates(self.v), rows.rates(self.smooth.v)]))
        return max(SAME_ACCELERATION, residual) * float(size)

    def _slips(self, rows: Rows, after: np.ndarray, found: Pushed, is_smooth: np.ndarray | bool = False) -> np.ndarray:
        """Return the directions (k,) in which contacts slip at the end of the step, 1 or -1; 0 for those that stick.

        Friction at its limit does not imply slip: contacts that stick on one surface share the friction in many ways,
        and the solution may load some of them up to their limits. Those for which `is_smooth` (k,) holds slip.
        """
        slip = rows.rates(after)[1]
        moves = found.is_slipping & (np.abs(slip) > self._negligible(rows, found.residual))
        return np.where(moves | is_smooth, np.where(slip < 0.0, -1, 1), 0)


_Solved = tuple[np.ndarray, Pushed, list[str]]
"""Velocities after impulses, the impulses, and the names of contacts at which another law of impact was used."""


@dataclass(frozen=True)
class _Impact:
    """Impulses of the contacts of a step.

    Attributes
    ----------
    contacts, rows, some
        All contacts, and the rows and indices of the k contacts with impulses.
    friction
        (k,) coefficients of friction.
    v, free
        (n,) velocities at the start, and at the end without impulses.
    solve, guess
        See `RigidContacts.pushed`.
    closing
        (k,) rates with which gaps may close after the impulses [m/s].
    """

    contacts: RigidContacts
    rows: Rows
    some: np.ndarray
    friction: np.ndarray
    v: np.ndarray
    free: np.ndarray
    solve: Callable[[np.ndarray], np.ndarray]
    guess: np.ndarray
    closing: np.ndarray

    def solved(self) -> _Solved:
        """Return velocities after the impulses, the impulses, and the contacts at which another law of impact was used.

        As in `mbdkit_contact.contact_impacts.struck`, no impact gains energy.
        """
        contacts, some = self.contacts, self.some
        e = contacts.restitution[some]
        after, found = self._with(e)
        if not np.any(e * self._approach) or not self._gains(after, found):
            return after, found, []
        normal, tangent = self.rows.rates(self.free)
        if len(some) == 1 and normal[0] < 0.0:
            both = np.vstack([self.rows.normal, self.rows.tangent])
            moved = np.stack([self.solve(row) for row in both], axis=1)
            before = np.concatenate([normal, tangent])
            impulses = stronge(both @ moved, before, float(self.friction[0]), float(e[0]))
            found = found._replace(normal=impulses[:1], tangent=impulses[1:])
            after = self.free + moved @ impulses
        while self._gains(after, found) and np.any(e):
            e = np.where(e > SMALL_RESTITUTION, 0.9 * e, 0.0)
            after, found = self._with(e)
        return after, found, [contacts.names[i] for i in some[found.normal > 0.0].tolist()]

    @property
    def _approach(self) -> np.ndarray:
        return np.minimum(self.rows.rates(self.v)[0], 0.0)

    def _with(self, e: np.ndarray) -> tuple[np.ndarray, Pushed]:
        more = e * self._approach + self.closing
        return self.contacts.pushed(self.rows, self.free, more, self.friction, self.solve, self.guess)

    def _gains(self, after: np.ndarray, found: Pushed) -> bool:
        """Return whether the impulses increase the kinetic energy by more than the errors of the impulses explain."""
        impulses, before, then = np.stack([found.normal, found.tangent]), *map(self.rows.rates, (self.v, after))
        size = np.sum(np.abs(impulses) * (np.abs(before) + np.abs(then)))
        return bool(np.sum(impulses * (before + then)) > max(1e-12, found.residual) * size)
