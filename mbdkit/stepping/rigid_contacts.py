"""Rigid contacts on the equations of motion: their rows, accelerations with closed contacts, and impacts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.contact_forces import HELD, ActingContact, held_coordinates
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.mechanism.contacts import OPEN, SLIP, STICK
from mbdkit.stepping.complementarity import (
    PRECISION,
    Pushed,
    coulomb,
    coupled_by_all,
    coupled_by_bodies,
    stronge,
    swept,
)

SINGULAR = 1e-11
"""Singular values of the equations of contact forces below this share of the largest are those of redundant rows."""


SAME_ACCELERATION = 1e-9
"""Accelerations below this share of those without contact forces are zero but for rounding errors."""


FEW = 8
"""Number of contacts of a kind that are evaluated one by one, which takes less time than arrays."""


@dataclass(frozen=True)
class Rows:
    """The rows of C contacts in a state.

    Attributes
    ----------
    gap, slip
        (C,) in m and m/s.
    normal_right, tangent_right
        (C,) right-hand sides; see `mbdkit.symbolic.contact_rows.row_function`.
    bodies
        (C, 2) numbers of the bodies.
    gradients
        (2, C, 6) derivatives of the rates of gap and slip by the velocities of both bodies.
    n
        Number of coordinates.
    """

    gap: np.ndarray
    slip: np.ndarray
    normal_right: np.ndarray
    tangent_right: np.ndarray
    bodies: np.ndarray
    gradients: np.ndarray
    n: int

    @cached_property
    def columns(self) -> np.ndarray:
        """(C, 6) coordinates of both bodies; those of the ground follow the others."""
        return (3 * self.bodies[:, :, None] + np.arange(3)).reshape(len(self.bodies), 6)

    @cached_property
    def normal(self) -> np.ndarray:
        """(C, n) derivatives of the rates of the gaps by the velocities."""
        return self._whole(self.gradients[0])

    @cached_property
    def tangent(self) -> np.ndarray:
        """(C, n) derivatives of the slips by the velocities."""
        return self._whole(self.gradients[1])

    def _whole(self, parts: np.ndarray) -> np.ndarray:
        rows = np.zeros((len(parts), self.n + 3))
        np.put_along_axis(rows, self.columns, parts, axis=1)
        return rows[:, : self.n]

    def rates(self, v: np.ndarray) -> np.ndarray:
        """Return the rates of gaps and slips (2, C) at velocities (n,)."""
        return np.asarray(np.sum(self.gradients * np.concatenate([v, np.zeros(3)])[self.columns], axis=2))

    def force(self, forces: np.ndarray) -> np.ndarray:
        """Return the generalized forces (n,) of normal and tangential forces (2, C)."""
        parts = np.sum(forces[:, :, None] * self.gradients, axis=0)
        return np.bincount(self.columns.ravel(), parts.ravel(), self.n + 3)[: self.n]


class Forced(NamedTuple):
    """Accelerations with the forces of contacts.

    Attributes
    ----------
    a, multipliers
        (n,) and (m,) accelerations and multipliers of joints.
    normal, tangent
        (C,) forces of the contacts, on the second body.
    rows
        The rows of the contacts.
    """

    a: np.ndarray
    multipliers: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    rows: Rows


class ContactImpact(NamedTuple):
    """An impact of a contact: time [s], number of the contact, impulses [N s], energy lost by all contacts [J]."""

    time: float
    contact: int
    normal_impulse: float
    tangential_impulse: float
    energy_lost: float


@dataclass(frozen=True)
class ContactState:
    """What contacts pass from step to step.

    Attributes
    ----------
    modes, normal, tangent
        (C,) modes and forces [N] at the end of the step.
    force
        (n,) generalized forces of all contacts [N, N m].
    impacts
        All impacts so far.
    energy
        Largest kinetic energy so far [J].
    cut, changed
        Names of contacts whose sequence of impacts was cut, and of those with another law of impact.
    time
        Time at which the step has ended [s]: before its planned end if there is an event.
    event
        What happens then, before the next step; None if nothing does. See `mbdkit.stepping.event_driven`.
    streak
        Number of events since a step that had none.
    is_over_step
        Whether the forces are those over the whole step, and not at its end.
    undecided
        First time at which several contacts that affect each other have closed at once, in an unknown order [s].
    residual
        Largest error of the velocities of contacts, relative to the largest one in its step.
    accelerations
        What a time-stepping method passes to its next step.
    """

    modes: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    force: np.ndarray
    impacts: tuple[ContactImpact, ...] = ()
    energy: float = 0.0
    cut: frozenset[str] = frozenset()
    changed: frozenset[str] = frozenset()
    time: float = math.inf
    event: tuple[int, int] | None = None
    streak: int = 0
    is_over_step: bool = False
    undecided: float = math.inf
    residual: float = 0.0
    accelerations: tuple[np.ndarray, ...] = ()

    def after_stop(self) -> ContactState:
        """Return the state after a discontinuity of a motion or load, where modes are determined anew."""
        return replace(self, modes=np.zeros(0, dtype=int), accelerations=())

    def remarks(self) -> tuple[str, ...]:
        """Return sentences about sequences of impacts that were cut, and about impacts with another law."""
        found = []
        if self.cut:
            names = listed(sorted(self.cut), "and")
            found.append(
                f"impacts that follow each other without end were cut, at {names}: the contact stays closed from the "
                "last one on; `/impacts` has the time at which they would have accumulated"
            )
        if self.changed:
            names = listed(sorted(self.changed), "and")
            found.append(
                f"the law of impact would have created energy at {names}; Stronge's law was used there, for several "
                "contacts at once that of the run or Poisson's with a smaller restitution"
            )
        if self.residual > SOLVED:
            found.append(
                f"the laws of contact and friction are satisfied to {self.residual:.1g} of the largest velocity only, "
                "in the worst step; a smaller `time.step` may help"
            )
        return tuple(found)


SOLVED = 1e-6
"""Error of the velocities of contacts that is not worth a remark."""

SMALL_RESTITUTION = 1e-3
"""Coefficient of restitution below which an impact of several contacts that would gain energy has none."""


class Struck(NamedTuple):
    """Velocities (n,) after an impact, impulses (C,) [N s], and whether the impact law was that of the run."""

    v: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    is_as_asked: bool


class _Alike(NamedTuple):
    """Contacts of one kind of geometry: their places among all, bodies (2, K), and numbers of the geometry (N, K)."""

    kind: tuple[str, int]
    places: np.ndarray
    bodies: np.ndarray
    numbers: np.ndarray

    @classmethod
    def of(cls, contacts: Sequence[ActingContact], kind: tuple[str, int]) -> _Alike:
        places = [i for i, one in enumerate(contacts) if one.pair.kind == kind]
        some = [contacts[i] for i in places]
        bodies, numbers = np.array([one.bodies for one in some]).T, np.array([one.pair.numbers for one in some]).T
        return cls(kind, np.array(places), bodies, numbers)


class RigidContacts:
    """Contacts of a mechanism in one run.

    Parameters
    ----------
    equations
        The equations of motion, whose forces do not include those of contacts.
    """

    def __init__(self, equations: EquationsOfMotion):
        self.p, self.contacts = equations, equations.contacts
        self._held = np.zeros(len(HELD) * len(self.contacts) + len(held_coordinates(self.contacts)))
        self.names = [one.pair.name for one in self.contacts]
        given = np.array([one.coefficients for one in self.contacts]).reshape(-1, 3)
        self.restitution, self.static, self.kinetic = given.T
        self._bodies = np.array([one.bodies for one in self.contacts], dtype=int).reshape(-1, 2)
        kinds = [one.pair.kind for one in self.contacts]
        self._alike = [_Alike.of(self.contacts, kind) for kind in dict.fromkeys(kinds)]
        #: Place of each contact among those of its kind, and number of the kind (C,).
        self._place, self._kind = np.zeros((2, len(self.contacts)), dtype=int)
        for number, alike in enumerate(self._alike):
            self._place[alike.places], self._kind[alike.places] = np.arange(len(alike.places)), number
        #: Inverse masses (B + 1, 3), and whether a body is not coupled to others but by contacts; the ground is last.
        self._lightness = np.vstack([1.0 / equations.mass.reshape(-1, 3), np.zeros(3)])
        self._is_free = np.zeros(len(self._lightness), dtype=bool)

    def begin(self) -> None:
        """Leave the forces of contacts, which are computed here, out of those of the equations of motion."""
        self.p.hold(self._held)

    def find_free(self) -> None:
        """Find the bodies that only contacts couple to others, by the last tangents that were evaluated."""
        self._is_free = np.append(self.p.free_now(), True)

    def all_open(self) -> ContactState:
        """Return the state of contacts without forces."""
        count = len(self.contacts)
        return ContactState(np.zeros(count, dtype=int), np.zeros(count), np.zeros(count), np.zeros(self.p.n))

    def gaps(self, q: np.ndarray) -> np.ndarray:
        """Return the gaps (C,) of all contacts at a position [m]."""
        from mbdkit.symbolic.contact_rows import gap_function  # loads SymPy

        if len(self.contacts) <= FEW:
            return self.rows(q, 0.0 * q).gap
        gaps, states, none = np.empty(len(self.contacts)), self._states(q, 0.0 * q)[:4], (0.0,) * 3
        for alike in self._alike:
            first, second = (states[:, side] for side in alike.bodies)
            gaps[alike.places] = gap_function(alike.kind)(*first, *none, *second, *none, *alike.numbers)
        return gaps

    def rows(self, q: np.ndarray, v: np.ndarray, some: np.ndarray | None = None) -> Rows:
        """Return the rows of all contacts in a state, or of some (C,), given by their numbers."""
        from mbdkit.symbolic.contact_rows import row_function  # loads SymPy

        states = self._states(q, v)
        chosen = np.arange(len(self.contacts)) if some is None else some
        values = np.empty((16, len(chosen)))
        for number, alike in enumerate(self._alike):
            which = np.flatnonzero(self._kind[chosen] == number)
            places = self._place[chosen[which]]
            given = np.concatenate([states[:, alike.bodies[0, places]], states[:, alike.bodies[1, places]]])
            numbers = alike.numbers[:, places]
            if len(which) <= FEW:
                function = row_function(alike.kind, is_of_arrays=False)
                for place, one, own in zip(which, given.T.tolist(), numbers.T.tolist(), strict=True):
                    values[:, place] = function(*one, *own)
                continue
            for row, computed in enumerate(row_function(alike.kind, is_of_arrays=True)(*given, *numbers)):
                values[row, which] = computed
        gradients = np.ascontiguousarray(values[2:14].reshape(2, 6, len(chosen)).transpose(0, 2, 1))
        return Rows(values[0], values[1], values[14], values[15], self._bodies[chosen], gradients, self.p.n)

    def _states(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return x, y, cosine and sine of the angle and the velocities of all bodies (7, B + 1), the ground last."""
        states = np.zeros((7, self.p.n // 3 + 1))
        states[2, -1] = 1.0
        x, y, angle = q.reshape(-1, 3).T
        states[0, :-1], states[1, :-1], states[4:, :-1] = x, y, v.reshape(-1, 3).T
        angles = angle.tolist()  # NumPy's functions depend on the number of items
        states[2, :-1], states[3, :-1] = [math.cos(x) for x in angles], [math.sin(x) for x in angles]
        return states

    def accelerations(self, t: float, q: np.ndarray, v: np.ndarray, modes: np.ndarray) -> Forced:
        """Return the accelerations with contacts in given modes (C,).

        Raises
        ------
        StepError
            ``painleve`` if a slipping contact would be pulled together by its own friction.
        """
        a, multipliers = self.p.accelerations(t, q, v)
        rows, count = self.rows(q, v), len(modes)
        normal, tangent = np.zeros(count), np.zeros(count)
        closed, sticking = np.flatnonzero(modes != OPEN), np.flatnonzero(modes == STICK)
        if not len(closed):
            return Forced(a, multipliers, normal, tangent, rows)
        share = np.where(np.abs(modes) == SLIP, -np.sign(modes) * self.kinetic, 0.0)  # friction over normal force
        held = np.vstack([rows.normal[closed], rows.tangent[sticking]])
        pushed = np.vstack([rows.normal[closed] + share[closed, None] * rows.tangent[closed], rows.tangent[sticking]])
        moved, loaded = self.answers(t, q, pushed)
        right = np.concatenate([rows.normal_right[closed], rows.tangent_right[sticking]]) - held @ a
        matrix = held @ moved
        own = np.diag(matrix)[: len(closed)]
        if np.any((own <= 0.0) & (share[closed] != 0.0)):
            name = self.names[closed[int(np.argmin(own))]]
            raise StepError("painleve", f"the friction of contact '{name}' presses it together more than it is pressed")
        forces, _, rank, _ = np.linalg.lstsq(matrix, right, rcond=SINGULAR)
        normal[closed] = forces[: len(closed)]
        if rank < len(forces) and len(sticking):  # friction is shared in proportion to the normal forces
            weights = np.ones(len(forces))
            weights[len(closed) :] = np.sqrt(np.maximum(normal[sticking], 1e-9 * np.max(np.abs(normal))))
            forces = weights * np.linalg.lstsq(matrix * weights, right, rcond=SINGULAR)[0]
            normal[closed] = forces[: len(closed)]
        tangent[closed] = share[closed] * normal[closed]
        tangent[sticking] = forces[len(closed) :]
        return Forced(a + moved @ forces, multipliers + loaded @ forces, normal, tangent, rows)

    def pushed(
        self,
        rows: Rows,
        free: np.ndarray,
        more: np.ndarray,
        friction: np.ndarray,
        solve: Callable[[np.ndarray], np.ndarray],
        guess: np.ndarray | float = 0.0,
        precision: float = PRECISION,
    ) -> tuple[np.ndarray, Pushed]:
        """Return the velocities (n,) after impulses of contacts, and the impulses.

        Small problems are solved by Lemke's method, others by sweeps over the contacts.

        Parameters
        ----------
        rows
            Rows of the contacts.
        free
            (n,) velocities without these impulses.
        more
            (k,) numbers that are added to the normal velocities: those that an impact has to reverse.
        friction
            (k,) coefficients of friction.
        solve
            Returns the change of velocities (n,) by an impulse (n,).
        guess
            (2, k) impulses that may be close to the result, normal ones first.
        precision
            See `mbdkit.stepping.complementarity.swept`.
        """
        normal, tangent = rows.rates(free)
        normal = normal + more
        is_large, found = len(rows.gap) > FEW, None
        begin = np.broadcast_to(guess, (2, len(normal)))
        if is_large and np.all(self._is_free[rows.bodies]):
            coupled = coupled_by_bodies(rows.bodies, rows.gradients, self._lightness)
            found = swept(coupled, normal, tangent, friction, begin, precision)
            if found is not None:
                change = rows.force(np.stack([found.normal, found.tangent]))
                return free + self._lightness[:-1].ravel() * change, found
        both = np.vstack([rows.normal, rows.tangent])
        moved = np.stack([solve(row) for row in both], axis=1)
        response = both @ moved
        if is_large:
            found = swept(coupled_by_all(response), normal, tangent, friction, begin, precision)
        if found is None:
            found = coulomb(response, normal, tangent, friction)
        if found is None:
            raise StepError("contact-solver", "no impulses of the contacts satisfy the laws of impact and friction")
        return free + moved @ np.concatenate([found.normal, found.tangent]), found

    def answers(self, t: float, q: np.ndarray, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return accelerations (n, k) and multipliers (m, k) by k forces (k, n) alone."""
        none = np.zeros(self.p.m)
        found = [self.p.solve(t, q, one, none) for one in forces]
        return np.stack([x for x, _ in found], axis=1), np.stack([mu for _, mu in found], axis=1)

    def decided(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray, sliding: np.ndarray) -> np.ndarray:
        """Return the modes (C,) with which touching contacts go on; minus `SLIP` is slip in the negative direction.

        Parameters
        ----------
        touching
            (C,) whether a contact is closed and does not separate.
        sliding
            (C,) directions of slip, 1 or -1; 0 if there is none.

        Raises
        ------
        StepError
            ``painleve`` if no forces satisfy Coulomb's law.
        """
        modes = np.zeros(len(touching), dtype=int)
        some = np.flatnonzero(touching)
        if not len(some):
            return modes
        a, _ = self.p.accelerations(t, q, v)
        rows = self.rows(q, v)
        response, both = self._response(t, q, rows, some)
        right = both @ a - np.concatenate([rows.normal_right[some], rows.tangent_right[some]])
        k = len(some)
        slides = sliding[some].astype(float)
        for _ in range(2):  # those that begin to slip have kinetic friction
            friction = np.where(slides != 0, self.kinetic[some], self.static[some])
            solved = coulomb(response, right[:k], right[k:], friction, slides)
            if solved is None:
                names = ", ".join(f"'{self.names[i]}'" for i in some)
                raise StepError("painleve", f"no forces at contact {names} satisfy Coulomb's law")
            found = solved
            after = right[k:] + response[k:] @ np.concatenate([found.normal, found.tangent])
            moves = np.abs(after) > SAME_ACCELERATION * np.max(np.abs(right))
            begins = found.is_slipping & found.is_closed & (slides == 0) & (moves | (friction == 0))
            direction = np.where(slides != 0, slides, np.where(found.tangent != 0, -np.sign(found.tangent), 1.0))
            if not np.any(begins & (self.kinetic[some] != self.static[some])):
                break
            slides = np.where(begins, direction, slides)
        modes[some] = np.where(begins | (slides != 0), SLIP * direction, STICK) * found.is_closed
        return modes

    def shared(
        self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray, sliding: np.ndarray, forced: Forced
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return forces (C,), normal and tangential, that satisfy Coulomb's law, where those of redundant contacts that
        stick are not unique; those of `forced` if they are.

        See `decided` for the other arguments.
        """
        some = np.flatnonzero(touching)
        a, _ = self.p.accelerations(t, q, v)
        rows = forced.rows
        response, both = self._response(t, q, rows, some)
        right = both @ a - np.concatenate([rows.normal_right[some], rows.tangent_right[some]])
        k = len(some)
        friction = np.where(sliding[some] != 0, self.kinetic[some], self.static[some])
        found = coulomb(response, right[:k], right[k:], friction, sliding[some])
        normal, tangent = np.zeros(len(touching)), np.zeros(len(touching))
        if found is not None:
            normal[some], tangent[some] = found.normal, found.tangent
            moved = both.T @ np.concatenate([normal[some] - forced.normal[some], tangent[some] - forced.tangent[some]])
            if np.max(np.abs(self.answers(t, q, moved[None])[0])) <= SAME_ACCELERATION * max(np.max(np.abs(a)), 1.0):
                return normal, tangent
        return forced.normal, forced.tangent

    def _response(self, t: float, q: np.ndarray, rows: Rows, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accelerations (2 k, 2 k) by unit forces of contacts, and the rows (2 k, n), normal ones first."""
        both = np.vstack([rows.normal[some], rows.tangent[some]])
        return both @ self.answers(t, q, both)[0], both

    def affect_each_other(self, t: float, q: np.ndarray, some: np.ndarray) -> bool:
        """Return whether a normal impulse at one of some contacts (C,) changes the normal velocity at another."""
        places = np.flatnonzero(some)
        if len(places) < 2:
            return False
        normal = self.rows(q, 0.0 * q).normal[places]
        response = normal @ self.answers(t, q, normal)[0]
        size = np.sqrt(np.abs(np.diag(response)))
        others = np.abs(response - np.diag(np.diag(response)))
        return bool(np.any(others > SAME_ACCELERATION * np.outer(size, size)))

    def struck(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray, e: np.ndarray, law: str) -> Struck:
        """Return the result of an impact of touching contacts.

        Parameters
        ----------
        touching
            (C,) whether a contact is closed.
        e
            (C,) coefficients of restitution.
        law
            ``newton`` or ``poisson``.
        """
        some, rows = np.flatnonzero(touching), self.rows(q, v)
        response, both = self._response(t, q, rows, some)
        before = both @ v
        own = e[some]
        impulses = self._impulses(law, response, before, own, some)
        is_asked = not self._gains(response, before, impulses)
        if not is_asked and len(some) == 1:
            impulses = stronge(response, before, float(self.kinetic[some[0]]), float(own[0]))
        while self._gains(response, before, impulses) and np.any(own):
            own = np.where(own > SMALL_RESTITUTION, 0.9 * own, 0.0)
            impulses = self._impulses("poisson", response, before, own, some)
        normal, tangent = np.zeros(len(touching)), np.zeros(len(touching))
        normal[some], tangent[some] = np.split(impulses, 2)
        return Struck(v + self.answers(t, q, both)[0] @ impulses, normal, tangent, is_asked)

    @staticmethod
    def _gains(response: np.ndarray, before: np.ndarray, impulses: np.ndarray) -> bool:
        """Return whether impulses would increase the kinetic energy by more than rounding errors."""
        gain = impulses @ (before + 0.5 * response @ impulses)
        return bool(gain > 1e-12 * (np.abs(impulses) @ np.abs(before)))

    def _impulses(
        self, law: str, response: np.ndarray, before: np.ndarray, e: np.ndarray, some: np.ndarray
    ) -> np.ndarray:
        """Return the impulses (2 k,) of k contacts, normal ones first, by the law of Newton or of Poisson."""
        k = len(some)

        def solved(velocities: np.ndarray, pressed: np.ndarray | float = 0.0) -> np.ndarray:
            found = coulomb(response, velocities[:k], velocities[k:], self.kinetic[some], pressed=pressed)
            if found is None:
                raise StepError("contact-solver", "no impulses of the contacts satisfy the law of impact")
            return np.concatenate([found.normal, found.tangent])

        if law == "newton":
            back = np.where(before[:k] < 0.0, e * before[:k], 0.0)
            return solved(before + np.concatenate([back, np.zeros(k)]))
        pressed = solved(before)
        least = np.concatenate([e * pressed[:k], np.zeros(k)])
        return pressed + least + solved(before + response @ (pressed + least), least[:k])


class KnownContacts:
    """The contacts of the equations of motion that a method was last used with."""

    def __init__(self) -> None:
        self._known: RigidContacts | None = None

    def on(self, equations: EquationsOfMotion) -> RigidContacts:
        """Return the contacts on equations of motion, whose forces then do not include those of contacts."""
        if self._known is None or self._known.p is not equations:
            self._known = RigidContacts(equations)
        self._known.begin()
        return self._known


class ClosedSystem:
    """Joints and closed contacts as one system of constraints; see `mbdkit.engine.nearest_state.ConstrainedSystem`."""

    def __init__(self, contacts: RigidContacts, modes: np.ndarray):
        self.contacts, self.p = contacts, contacts.p
        self.n, self.mass = self.p.n, self.p.mass
        self.closed, self.sticking = np.flatnonzero(modes != OPEN), np.flatnonzero(modes == STICK)
        self.m = self.p.m + len(self.closed)
        self._none = np.zeros(self.n)

    def _held(self, q: np.ndarray, *, is_of_velocities: bool) -> np.ndarray:
        rows = self.contacts.rows(q, self._none, self.closed)
        sticking = np.isin(self.closed, self.sticking) & is_of_velocities
        return np.vstack([rows.normal, rows.tangent[sticking]])

    def solve(self, t: float, q: np.ndarray, force: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `ConstrainedSystem.solve`."""
        x, mu = self.p.solve(t, q, force, rows[: self.p.m])
        held = self._held(q, is_of_velocities=len(rows) > self.m)
        if not len(held):
            return x, mu
        moved, loaded = self.contacts.answers(t, q, held)
        forces = np.linalg.lstsq(held @ moved, rows[self.p.m :] - held @ x, rcond=1e-11)[0]
        return x + moved @ forces, mu + loaded @ forces

    def constraints(self, t: float, q: np.ndarray) -> np.ndarray:
        """See `ConstrainedSystem.constraints`."""
        return np.concatenate([self.p.constraints(t, q), self.contacts.rows(q, self._none, self.closed).gap])

    def constraint_rates(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """See `ConstrainedSystem.constraint_rates`."""
        return np.concatenate([self.p.constraint_rates(t, q, v), self._held(q, is_of_velocities=True) @ v])

    def relative_change(self, q: np.ndarray, dq: np.ndarray) -> float:
        """See `ConstrainedSystem.relative_change`."""
        return self.p.relative_change(q, dq)


class HeldForces:
    """Forces and modes of rigid contacts as first-order states, which do not change between the ends of steps."""

    def __init__(self, mechanism: CompiledMechanism):
        rigid = [one for one in mechanism.contacts if one.first_state >= 0]
        self._first = rigid[0].first_state if rigid else 0
        self._contacts, self._coordinates = len(HELD) * len(rigid), held_coordinates(rigid)
        self.count = self._contacts + len(self._coordinates)

    def others(self, mechanism: CompiledMechanism) -> list[str]:
        """Return the names of the other first-order states of the mechanism."""
        own = range(self._first, self._first + self.count)
        return [state.name for number, state in enumerate(mechanism.states) if number not in own]

    def of(self, memory: ContactState | None) -> np.ndarray:
        """Return the states (Z,); zeros before the first step."""
        z = np.zeros(self.count)
        if self.count and memory is not None:
            modes = memory.modes if len(memory.modes) else np.zeros(len(memory.normal))  # not known after a stop
            z[: self._contacts] = np.stack([memory.normal, memory.tangent, np.abs(modes)], axis=1).ravel()
            z[self._contacts :] = memory.force[self._coordinates]
        return z
