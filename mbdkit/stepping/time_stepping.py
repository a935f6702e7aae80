"""Time-stepping methods: velocities may jump in any step, and impacts are not located.

With positions q_m = q_0 + h/2 v_0, at which gaps, their gradients and joints are evaluated, a step of the method of
Moreau and Jean from (q_0, v_0) is

    M (v_1 - v_0) = h (theta Q(t_1, q_1, v_1) + (1 - theta) Q(t_0, q_0, v_0)) + joints + contacts
    q_1 = q_0 + h (theta v_1 + (1 - theta) v_0)

where "joints" are impulses that make the velocities consistent, and "contacts" are impulses, by the laws of Newton and
Coulomb, at the contacts that would overlap at the end. One iteration of Newton's method makes the forces implicit. Then
the positions are projected: joints are closed, and overlapping shapes are moved apart.

J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988; M. Jean, Computer Methods in Applied
Mechanics and Engineering 177:235-257, 1999; V. Acary and B. Brogliato, Numerical Methods for Nonsmooth Dynamical
Systems, 2008, chapter 10.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.projection import MOST_ITERATIONS, STAGNANT
from mbdkit.engine.nearest_state import ROUND_OFF
from mbdkit.mechanism.contacts import OPEN, SLIP, STICK
from mbdkit.methods.kinds import StepMethod, StepState
from mbdkit.stepping.complementarity import PRECISION, Pushed, stronge
from mbdkit.stepping.contact_impacts import SMALL_RESTITUTION
from mbdkit.stepping.contact_kinematics import Rows
from mbdkit.stepping.contact_state import ContactState
from mbdkit.stepping.rigid_contacts import KnownContacts, RigidContacts

MOST_HALVINGS = 4
"""Largest number of times that a step is halved."""
MANY, ROUGH = 40, 1e-4
"""Number of overlaps above which less accurate results are accepted, and the precision of their projection.

With more overlaps, positions are projected only once and to this precision, and contacts at rest that others press
together get no impulse in this step; the next steps reduce the remaining overlap.
"""
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
    solve
        Function that returns the change of the velocities (n,) by an impulse (n,).
    positions
        Function that returns the positions (n,) at the end, before projection, from the velocities (n,) at the end.
    accelerations
        Accelerations that the method passes to its next step.
    """

    v: np.ndarray
    multipliers: np.ndarray
    middle: np.ndarray
    solve: Callable[[np.ndarray], np.ndarray]
    positions: Callable[[np.ndarray], np.ndarray]
    accelerations: tuple[np.ndarray, ...] = ()


class TimeStepping(StepMethod):
    """Base class of time-stepping methods; a subclass defines the step without contacts."""

    def __init__(self) -> None:
        self._contacts = KnownContacts()

    @abstractmethod
    def smooth(
        self, p: EquationsOfMotion, t: float, state: StepState, h: float, accelerations: tuple[np.ndarray, ...]
    ) -> SmoothStep:
        """Return the step without impulses of contacts.

        `accelerations` are those that the last step has passed on; () if there are none.
        """

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        """See `StepMethod.step`. If the positions of a step cannot be projected, it is taken as two half steps."""
        return self._taken(equations, t, state, h, MOST_HALVINGS)

    def _taken(self, p: EquationsOfMotion, t: float, state: StepState, h: float, halvings: int) -> StepState:
        try:
            return self._whole(p, t, state, h)
        except StepError as error:
            if error.code != "newton-failed" or not halvings:
                raise
        half = self._taken(p, t, state, 0.5 * h, halvings - 1)
        end = self._taken(p, t + 0.5 * h, half, 0.5 * h, halvings - 1)
        assert half.work is not None
        assert half.dissipated is not None
        assert end.work is not None
        assert end.dissipated is not None
        return replace(end, work=half.work + end.work, dissipated=half.dissipated + end.dissipated)

    def _whole(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        p, v = equations, state.v
        contacts = self._contacts.on(p)
        held = contacts.all_open().after_stop() if state.memory is None else state.memory
        smooth = self.smooth(p, t, state, h, held.accelerations)
        contacts.find_free()
        after = smooth.v
        kinematics, end = contacts.kinematics, smooth.positions(after)
        kinematics.held = kinematics.none_held()
        some = np.flatnonzero(kinematics.gaps(end) <= SMALL * p.length)
        memory = replace(
            contacts.all_open(),
            residual=held.residual,
            changed=held.changed,
            is_over_step=True,
            accelerations=smooth.accelerations,
        )
        lost = 0.0
        struck = np.zeros(len(contacts.names), dtype=bool)
        while len(some):
            kinematics.hold(end, np.isin(np.arange(len(contacts.names)), some))
            rows = kinematics.rows(smooth.middle, v, some)
            kinematics.held = kinematics.none_held()
            guess = h * np.stack([held.normal, held.tangent])[:, some]
            sticks = self._sticks(held, rows.rates(v)[1], v, some) & ~struck[some]
            friction = np.where(sticks, contacts.static[some], contacts.kinetic[some])
            impact = _Impact(contacts, rows, some, friction, v, smooth.v, smooth.solve, guess)
            after, found, changed = impact.solved()
            # with more contacts, the order of impacts has larger effects, and this search takes long
            if len(some) <= MANY:
                more = self._pressed(contacts, smooth, h, v, after, some)
                if len(more):
                    some = np.union1d(some, more)
                    continue
                strikes = (found.normal > 0.0) & (rows.rates(v)[0] < -AT_REST * _gained(rows, v, smooth.v, h))
                new = sticks & (friction > contacts.kinetic[some]) & (found.normal > AT_REST * guess[0])
                if np.any(strikes) and np.any(new):  # impacts have kinetic friction
                    struck[some[new]] = True
                    continue
            forces = np.stack([found.normal, found.tangent]) / h
            slip = SLIP * np.sign(rows.rates(after)[1]).astype(int)
            memory = replace(memory, residual=max(held.residual, found.residual), changed=held.changed.union(changed))
            memory.normal[some], memory.tangent[some] = forces
            memory.modes[some] = np.where(found.is_closed, np.where(found.is_slipping, slip, STICK), OPEN)
            memory.force[:] = rows.force(forces)
            lost = -0.5 * h * float(np.sum(forces * rows.rates(v + after)))
            break
        reached = self._closed(contacts, t + h, smooth.positions(after))
        work, dissipated = p.powers(t + 0.5 * h, smooth.middle, 0.5 * (v + after), smooth.multipliers)
        return StepState(reached, after, None, memory, h * work, h * dissipated + lost)

    @staticmethod
    def _pressed(
        contacts: RigidContacts, smooth: SmoothStep, h: float, v: np.ndarray, after: np.ndarray, some: np.ndarray
    ) -> np.ndarray:
        """Return the indices of other contacts at rest that the impulses of the contacts `some` press together.

        The gap of a contact at rest may be as large as the distance that a body falls in a step, so the contact may be
        predicted to stay open. Without an impulse at such a contact, the impact of others would have a wrong result,
        however small the step. Contacts with larger gaps are left to the next step, whose impulses include restitution.
        """
        gaps = contacts.kinematics.gaps(smooth.positions(after))
        gaps[some] = 0.0
        others = np.flatnonzero(gaps < -SMALL * contacts.p.length)
        if not len(others):
            return others
        rows = contacts.kinematics.rows(smooth.middle, v, others)
        return others[rows.gap <= AT_REST * h * _gained(rows, v, smooth.v, h)]

    @staticmethod
    def _sticks(held: ContactState, slip: np.ndarray, v: np.ndarray, some: np.ndarray) -> np.ndarray:
        """Return which of the contacts `some` stuck in the last step.

        At the start, return those whose slip velocity is zero.
        """
        if len(held.modes):
            return np.asarray(held.modes[some] == STICK)
        return np.abs(slip) <= SMALL * np.max(np.abs(v), initial=0.0)

    @staticmethod
    def _closed(contacts: RigidContacts, t: float, q: np.ndarray) -> np.ndarray:
        """Return the nearest positions in which the joints are closed and no shapes overlap."""
        p, given, before, is_last = contacts.p, q, np.inf, False
        is_closed = p.m == 0
        touched = np.zeros(len(contacts.names), dtype=bool)
        for _ in range(MOST_ITERATIONS):
            if is_closed and is_last:
                return q
            gaps = contacts.kinematics.gaps(q)
            deepest = -float(np.min(gaps, initial=0.0))
            is_apart = deepest <= SMALL * p.length
            if is_closed and is_apart:
                return q
            if 2.0 * deepest > contacts.kinematics.reach:
                gaps = contacts.kinematics.gaps(q, 2.0 * deepest)
            # near contacts are included, because shapes moved apart may be pushed into others
            touched |= gaps < (0.0 if is_apart else 2.0 * deepest)
            some = np.flatnonzero(touched)
            is_last = len(some) > MANY
            precision = ROUGH if is_last else PRECISION
            step, _ = p.solve(t, q, p.mass * (given - q), -p.constraints(t, q))
            if len(some):
                rows = contacts.kinematics.rows(q, 0.0 * q, some)
                step, _ = contacts.pushed(
                    rows, step, rows.gap, np.zeros(len(some)), partial(answer, p, t, q), precision=precision
                )
            q, now = q + step, p.relative_change(q, step)
            is_closed = p.m == 0 or now <= ROUND_OFF or (now >= 0.5 * before and now < STAGNANT)
            before = now
        raise StepError("newton-failed", f"no positions without overlap were found in {MOST_ITERATIONS} iterations")


class MoreauJeanSteps(TimeStepping):
    """The method of Moreau and Jean.

    Parameters
    ----------
    theta
        Weight of the forces at the end of a step, from 0.5 to 1.
    """

    def __init__(self, theta: float):
        super().__init__()
        self.theta = theta

    def smooth(
        self, p: EquationsOfMotion, t: float, state: StepState, h: float, accelerations: tuple[np.ndarray, ...]
    ) -> SmoothStep:
        """See `TimeStepping.smooth`."""
        theta, q, v = self.theta, state.q, state.v
        middle = q + 0.5 * h * v
        a, multipliers = p.accelerations(t, q, v)
        matrix = p.iteration_matrix(
            t + 0.5 * h, middle, v, a, multipliers, damping=theta * h, stiffness=(theta * h) ** 2
        )
        force = theta * p.forces(t + h, q + h * v, v) + (1.0 - theta) * p.forces(t, q, v)
        after = v + matrix.solve(h * force, -p.constraint_rates(t + 0.5 * h, middle, v))[0]
        none = np.zeros(p.m)
        return SmoothStep(
            after,
            multipliers,
            middle,
            lambda impulse: matrix.solve(impulse, none)[0],
            lambda end: q + h * (theta * end + (1.0 - theta) * v),
        )


def _gained(rows: Rows, v: np.ndarray, free: np.ndarray, h: float) -> np.ndarray:
    """Return the changes of the gap rates (C,) from velocities `v` to `free` in a step without impulses [m/s],
    absolute.
    """
    return np.asarray(np.abs(rows.rates(free - v)[0]) + h * np.abs(rows.normal_right))


def answer(p: EquationsOfMotion, t: float, q: np.ndarray, impulse: np.ndarray) -> np.ndarray:
    """Return the change of the velocities (n,) by an impulse (n,) at a position, with consistent joint velocities."""
    return p.solve(t, q, impulse, np.zeros(p.m))[0]


@dataclass(frozen=True)
class _Impact:
    """Impulses of the contacts of a step.

    Attributes
    ----------
    contacts, rows, some
        All contacts, and the rows and indices of those that would overlap.
    friction
        (k,) coefficients of friction.
    v, free
        (n,) velocities at the start, and at the end without impulses.
    solve, guess
        See `RigidContacts.pushed`.
    """

    contacts: RigidContacts
    rows: Rows
    some: np.ndarray
    friction: np.ndarray
    v: np.ndarray
    free: np.ndarray
    solve: Callable[[np.ndarray], np.ndarray]
    guess: np.ndarray

    def solved(self) -> tuple[np.ndarray, Pushed, list[str]]:
        """Return velocities after the impulses, the impulses, and the names of contacts with another law of impact.

        As in `RigidContacts.struck`, no impact gains energy.
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
        return self.contacts.pushed(self.rows, self.free, e * self._approach, self.friction, self.solve, self.guess)

    def _gains(self, after: np.ndarray, found: Pushed) -> bool:
        """Return whether the impulses increase the kinetic energy by more than the errors of the impulses explain."""
        work = np.stack([found.normal, found.tangent]) * self.rows.rates(self.v + after)
        return bool(np.sum(work) > max(1e-12, found.residual) * np.sum(np.abs(work)))
