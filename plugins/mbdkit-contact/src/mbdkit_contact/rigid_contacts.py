"""Rigid contacts on the equations of motion: accelerations with closed contacts, modes, and impulses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.repeated_call import RepeatedCall
from mbdkit.integrators.interface import StepTaken
from mbdkit.mechanism.contacts import OPEN, SLIP, STICK
from mbdkit.methods.step_methods import Dense, Step, StepEvent, StepState
from mbdkit_contact.complementarity import coulomb
from mbdkit_contact.contact_kinematics import FEW, ContactKinematics, Rows
from mbdkit_contact.contact_state import ContactState, HeldForces
from mbdkit_contact.kernels.contact_forces import (
    SINGULAR,
    closed_accelerations,
    closed_solution,
    new_closed_contacts,
)

FREE = 1e-6
"""Smallest component of a null vector, of length 1, that makes the force of a contact ambiguous."""

SAME_ACCELERATION = 1e-9
"""Accelerations below this share of those without contact forces count as zero."""


class Forced(NamedTuple):
    """Accelerations with the forces of contacts.

    Attributes
    ----------
    a, multipliers
        (n,) accelerations, and (m,) multipliers of the joints.
    normal, tangent
        (C,) forces of the contacts on the second body [N].
    rows
        Gaps, slips and derivatives of the contacts, or of those that are closed.
    """

    a: np.ndarray
    multipliers: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    rows: Rows


class RigidContacts:
    """Contacts of a mechanism in one run.

    Parameters
    ----------
    equations
        The equations of motion, whose forces do not include those of contacts.
    """

    def __init__(self, equations: EquationsOfMotion):
        self.p, self.contacts = equations, equations.contacts
        self.held = HeldForces(self.contacts)
        #: Whether a first-order state (Z,) does not belong to contacts.
        self._is_own = np.ones(len(equations.z0), dtype=bool)
        self._is_own[self.held.states] = False
        self.names = [one.pair.name for one in self.contacts]
        given = np.array([one.coefficients for one in self.contacts]).reshape(-1, 3)
        self.restitution, self.static, self.kinetic = np.ascontiguousarray(given.T)
        self.kinematics = ContactKinematics(self.contacts, equations.n, equations.length)
        self._take_room(min(len(self.names), FEW))

    @classmethod
    def on(cls, equations: EquationsOfMotion) -> RigidContacts:
        """Return the contacts of equations of motion, and exclude their forces, computed here, from the equations."""
        contacts = equations.derived(cls)
        contacts.hold(equations.z0[contacts._is_own])
        return contacts

    def own(self, z: np.ndarray) -> np.ndarray:
        """Return those of the first-order states (Z,) that do not belong to contacts."""
        return z[self._is_own]

    def all_states(self, own: np.ndarray, memory: ContactState | None = None) -> np.ndarray:
        """Return all first-order states (Z,), with the contact forces in a memory or without any."""
        z = np.zeros(len(self._is_own))
        z[self._is_own] = own
        if memory is not None:
            z[self.held.states] = self.held.of(memory)
        return z

    def hold(self, own: np.ndarray) -> None:
        """Use values of the states that do not belong to contacts in later evaluations, without contact forces."""
        self.p.hold(self.all_states(own))

    def step(
        self,
        times: tuple[float, float],
        begin: StepState,
        end: StepState,
        event: StepEvent | None = None,
        dense: Dense | None = None,
    ) -> Step:
        """Return a step from `begin` to `end`, whose memory is a `ContactState`, with the forces as first-order states.

        The forces are constant within the step if they are means over the step, or not known at its start; otherwise
        they are linear. `dense` gives the other states.
        """
        memory, begins = end.memory, self.all_states(self.own(begin.z), end.memory)
        if not begin.memory.is_new and not memory.is_over_step:
            if dense is None:
                return Step(end, event=event)
            begins = self.all_states(self.own(begin.z), begin.memory)
        taken = StepTaken(*times, begin.q, begin.v, end.q, end.v, begins, end.z)
        if dense is None:
            return Step(end, dense=taken.between, event=event)

        def inside(theta: float) -> tuple[np.ndarray, ...]:
            q, v, own, *gained = dense(theta)
            z = begins + theta * (end.z - begins)
            z[self._is_own] = own
            return q, v, z, *gained

        return Step(end, dense=inside, event=event)

    def all_open(self) -> ContactState:
        """Return the `ContactState` of open contacts, without forces."""
        count = len(self.contacts)
        return ContactState(np.zeros(count, dtype=int), np.zeros(count), np.zeros(count), np.zeros(self.p.n))

    def begun(self, state: StepState) -> ContactState:
        """Return the `ContactState` of a step that begins anew at a state: it determines the modes."""
        return (self.all_open() if state.memory is None else state.memory).after_stop()

    def accelerations(
        self, t: float, q: np.ndarray, v: np.ndarray, modes: np.ndarray, *, only_closed: bool = False
    ) -> Forced:
        """Return the accelerations with contacts in given modes (C,). The result has the rows of all contacts or, which
        takes less time, only of those that are closed.

        Raises
        ------
        StepError
            ``painleve`` if a slipping contact would be pulled together by its own friction.
        """
        p, count = self.p, self._room(modes)
        some = self._closed
        a, multipliers, normal, tangent = np.empty(p.n), np.empty(p.m), np.zeros(len(modes)), np.zeros(len(modes))
        given = (np.ascontiguousarray(x, dtype=float) for x in (q, v))
        arguments = (*given, np.ascontiguousarray(modes, dtype=np.int64), a, multipliers)
        p.counters.rhs_evaluations += 1
        p.solved_by(lambda at: self._forced_at(at, *arguments), t)
        closed = some.closed[:count].copy()
        if some.failed[0] >= 0:
            name = self.names[closed[some.failed[0]]]
            raise StepError("painleve", f"the friction of contact '{name}' presses it together more than it is pressed")
        normal[closed], tangent[closed] = some.normal[:count], some.tangent[:count]
        rows = self.kinematics.rows_of(some.rows[:count], closed) if only_closed else self.kinematics.rows(q, v)
        return Forced(a, multipliers, normal, tangent, rows)

    def solution(
        self, t: float, q: np.ndarray, force: np.ndarray, rows: np.ndarray, modes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve the equations with the constraints of joints and closed contacts in given modes (C,).

        See `mbdkit_contact.kernels.contact_forces.closed_solution`; without closed contacts, `rows` are those of the
        joints.
        """
        p = self.p
        self._room(modes)
        x, mu = np.empty(p.n), np.empty(p.m)
        given = tuple(np.ascontiguousarray(each, dtype=float) for each in (q, force, rows))
        arguments = (*given, np.ascontiguousarray(modes, dtype=np.int64), x, mu)
        p.solved_by(lambda at: self._solution_at(at, *arguments), t)
        return x, mu

    def _room(self, modes: np.ndarray) -> int:
        """Return the number of closed contacts, for which there is room afterwards."""
        count = int(np.count_nonzero(modes != OPEN))
        if count > len(self._closed.closed):
            self._take_room(2 * count)
        return count

    def _take_room(self, most: int) -> None:
        """Allocate the arrays for up to `most` closed contacts."""
        p = self.p
        self._closed = new_closed_contacts(self.kinematics.shapes, self.kinetic, most, p.n, p.pairs)
        self._forced_at = RepeatedCall(closed_accelerations, p.address, None, self._closed, *(None,) * 5)
        self._solution_at = RepeatedCall(closed_solution, p.address, None, self._closed, *(None,) * 6)

    def undetermined(self, t: float, q: np.ndarray, modes: np.ndarray, staying: np.ndarray) -> np.ndarray:
        """Return whether the normal force of each contact (C,) is not unique, because other forces of joints and
        contacts cause the same accelerations.

        Parameters
        ----------
        staying
            (C,) whether a contact touches and does not separate; it may be open, if it has no force.
        """
        closed, found = np.flatnonzero(staying), np.zeros(len(modes), dtype=bool)
        if not 0 < len(closed) <= FEW:
            return found
        rows, own = self.kinematics.rows(q, 0.0 * q, closed), modes[closed]
        friction = np.where(np.abs(own) == SLIP, -np.sign(own) * self.kinetic[closed], 0.0)  # for a unit normal force
        along, held_slips = rows.normal, rows.tangent[own == STICK]
        pushed = np.vstack([along + friction[:, None] * rows.tangent, held_slips])
        matrix = np.vstack([along, held_slips]) @ self.answers(t, q, pushed)[0]
        size = np.sqrt(np.abs(np.diag(matrix)))  # 0 if joints hold the bodies
        scale = np.divide(1.0, size, out=np.zeros(len(size)), where=size > np.sqrt(SINGULAR) * np.max(size))
        _, sizes, vectors = np.linalg.svd(matrix * np.outer(scale, scale))
        free = vectors[sizes <= SINGULAR * sizes[0], : len(closed)]
        found[closed] = np.any(np.abs(free) > FREE, axis=0)
        return found

    def answers(self, t: float, q: np.ndarray, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accelerations (n, k) and multipliers (m, k) that each of k forces (k, n) causes alone."""
        if self.p.m == 0:
            return np.asarray(forces / self.p.mass).T, np.zeros((0, len(forces)))
        none = np.zeros(self.p.m)
        found = [self.p.solve(t, q, one, none) for one in forces]
        return np.stack([x for x, _ in found], axis=1), np.stack([mu for _, mu in found], axis=1)

    def decided(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray, sliding: np.ndarray) -> np.ndarray:
        """Return the modes (C,) of touching contacts in the motion that follows.

        `SLIP` is slip in the positive direction, ``-SLIP`` slip in the negative direction.

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
        rows = self.kinematics.rows(q, v)
        response, both = self.response(t, q, rows, some)
        right = both @ a - np.concatenate([rows.normal_right[some], rows.tangent_right[some]])
        k = len(some)
        slides = sliding[some].astype(float)
        for _ in range(2):  # contacts that begin to slip have kinetic friction in the second solution
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
        """Return normal and tangential forces (C,) that cause the same accelerations as the forces in `forced`, and
        that satisfy Coulomb's law.

        Such forces are not unique if contacts are redundant. If none exist, the forces in `forced` are returned. See
        `decided` for the other arguments.
        """
        some = np.flatnonzero(touching)
        a, _ = self.p.accelerations(t, q, v)
        rows = forced.rows
        response, both = self.response(t, q, rows, some)
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

    def response(self, t: float, q: np.ndarray, rows: Rows, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrix (2 k, 2 k) that maps forces of contacts to their accelerations, and the derivatives (2 k,
        n) of gap rates and slips; normal components come first.
        """
        both = np.vstack([rows.normal[some], rows.tangent[some]])
        return both @ self.answers(t, q, both)[0], both

    def affect_each_other(self, t: float, q: np.ndarray, some: np.ndarray) -> bool:
        """Return whether a normal impulse at one of the contacts marked in `some` (C,) changes the normal velocity at
        another.
        """
        places = np.flatnonzero(some)
        if len(places) < 2:
            return False
        normal = self.kinematics.rows(q, 0.0 * q).normal[places]
        response = normal @ self.answers(t, q, normal)[0]
        size = np.sqrt(np.abs(np.diag(response)))
        others = np.abs(response - np.diag(np.diag(response)))
        return bool(np.any(others > SAME_ACCELERATION * np.outer(size, size)))
