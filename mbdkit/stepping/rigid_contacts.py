"""Rigid contacts on the equations of motion: their rows, accelerations with closed contacts, and impacts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.contact_forces import HELD
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.mechanism.contacts import OPEN, SLIP, STICK
from mbdkit.stepping.complementarity import coulomb, stronge

SINGULAR = 1e-11
"""Singular values of the equations of contact forces below this share of the largest are those of redundant rows."""


SAME_ACCELERATION = 1e-9
"""Accelerations below this share of those without contact forces are zero but for rounding errors."""


class Rows(NamedTuple):
    """The rows of C contacts in a state: gap [m] and slip [m/s] (C,), gradients (C, n), right-hand sides (C,)."""

    gap: np.ndarray
    slip: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    normal_right: np.ndarray
    tangent_right: np.ndarray


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
    """

    modes: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    impacts: tuple[ContactImpact, ...] = ()
    energy: float = 0.0
    cut: frozenset[str] = frozenset()
    changed: frozenset[str] = frozenset()
    time: float = math.inf
    event: tuple[int, int] | None = None
    streak: int = 0
    is_over_step: bool = False

    def after_stop(self) -> ContactState:
        """Return the state after a discontinuity of a motion or load, where modes are determined anew."""
        return replace(self, modes=np.zeros(0, dtype=int))

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
                "contacts at once Poisson's with a smaller restitution"
            )
        return tuple(found)


SMALL_RESTITUTION = 1e-3
"""Coefficient of restitution below which an impact of several contacts that would gain energy has none."""


class Struck(NamedTuple):
    """Velocities (n,) after an impact, impulses (C,) [N s], and whether the impact law was that of the run."""

    v: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    is_as_asked: bool


class RigidContacts:
    """Contacts of a mechanism in one run.

    Parameters
    ----------
    equations
        The equations of motion, whose forces do not include those of contacts.
    """

    def __init__(self, equations: EquationsOfMotion):
        self.p, self.contacts = equations, equations.contacts
        equations.hold(np.zeros(len(HELD) * len(self.contacts)))  # their forces are computed here
        self.names = [one.pair.name for one in self.contacts]
        given = np.array([one.coefficients for one in self.contacts]).reshape(-1, 3)
        self.restitution, self.static, self.kinetic = given.T
        self._functions = []
        if self.contacts:
            from mbdkit.symbolic.contact_rows import row_function  # loads SymPy

            self._functions = [row_function(one.pair.kind) for one in self.contacts]

    def all_open(self) -> ContactState:
        """Return the state of contacts without forces."""
        none = np.zeros(len(self.contacts))
        return ContactState(none.astype(int), none, none)

    def rows(self, q: np.ndarray, v: np.ndarray) -> Rows:
        """Return the rows of all contacts in a state."""
        count, n = len(self.contacts), self.p.n
        values, normal, tangent = np.empty((4, count)), np.zeros((count, n + 3)), np.zeros((count, n + 3))
        q, v = (np.concatenate([x, np.zeros(3)]) for x in (q, v))  # the ground is last
        for i, (one, function) in enumerate(zip(self.contacts, self._functions, strict=True)):
            a, b = (slice(3 * body, 3 * body + 3) for body in one.bodies)
            state = (x for place in (a, b) for both in (q, v) for x in both[place].tolist())
            given = function(*state, *one.pair.numbers)
            values[:, i] = given[0], given[1], given[14], given[15]
            normal[i, a], normal[i, b] = given[2:5], given[5:8]
            tangent[i, a], tangent[i, b] = given[8:11], given[11:14]
        return Rows(values[0], values[1], normal[:, :n], tangent[:, :n], values[2], values[3])

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

    def _response(self, t: float, q: np.ndarray, rows: Rows, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accelerations (2 k, 2 k) by unit forces of contacts, and the rows (2 k, n), normal ones first."""
        both = np.vstack([rows.normal[some], rows.tangent[some]])
        return both @ self.answers(t, q, both)[0], both

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


class ClosedSystem:
    """Joints and closed contacts as one system of constraints; see `mbdkit.engine.nearest_state.ConstrainedSystem`."""

    def __init__(self, contacts: RigidContacts, modes: np.ndarray):
        self.contacts, self.p = contacts, contacts.p
        self.n, self.mass = self.p.n, self.p.mass
        self.closed, self.sticking = np.flatnonzero(modes != OPEN), np.flatnonzero(modes == STICK)
        self.m = self.p.m + len(self.closed)
        self._none = np.zeros(self.n)

    def _held(self, q: np.ndarray, *, is_of_velocities: bool) -> np.ndarray:
        rows = self.contacts.rows(q, self._none)
        return np.vstack([rows.normal[self.closed], rows.tangent[self.sticking][: None if is_of_velocities else 0]])

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
        return np.concatenate([self.p.constraints(t, q), self.contacts.rows(q, self._none).gap[self.closed]])

    def constraint_rates(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """See `ConstrainedSystem.constraint_rates`."""
        return np.concatenate([self.p.constraint_rates(t, q, v), self._held(q, is_of_velocities=True) @ v])

    def relative_change(self, q: np.ndarray, dq: np.ndarray) -> float:
        """See `ConstrainedSystem.relative_change`."""
        return self.p.relative_change(q, dq)


class HeldForces:
    """Forces and modes of rigid contacts as first-order states, which do not change between the ends of steps."""

    def __init__(self, mechanism: CompiledMechanism):
        self._places = [one.first_state for one in mechanism.contacts if one.first_state >= 0]
        self.count = len(HELD) * len(self._places)

    def others(self, mechanism: CompiledMechanism) -> list[str]:
        """Return the names of the other first-order states of the mechanism."""
        own = {place + i for place in self._places for i in range(len(HELD))}
        return [state.name for number, state in enumerate(mechanism.states) if number not in own]

    def of(self, memory: ContactState | None) -> np.ndarray:
        """Return the states (Z,); zeros before the first step."""
        z = np.zeros(self.count)
        if self._places and memory is not None:
            for i, place in enumerate(self._places):
                z[place : place + len(HELD)] = memory.normal[i], memory.tangent[i], abs(memory.modes[i])
        return z
