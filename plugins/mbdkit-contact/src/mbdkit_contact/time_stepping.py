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
from dataclasses import replace
from functools import partial

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.projection import MOST_ITERATIONS, STAGNANT
from mbdkit.engine.nearest_state import ROUND_OFF
from mbdkit.methods.step_methods import Step, StepMethod, StepState, Why
from mbdkit_contact.complementarity import PRECISION
from mbdkit_contact.contact_state import ContactState
from mbdkit_contact.rigid_contacts import RigidContacts
from mbdkit_contact.step_impulses import MANY, SMALL, SmoothStep, StepImpulses
from mbdkit_contact.time_stepping_methods import MoreauJean

MOST_HALVINGS = 4
"""Largest number of times that a step is halved."""
ROUGH = 1e-4
"""Precision of the projection in a step if more than `MANY` contacts overlap; the next steps reduce the remaining
overlap."""


class TimeStepping(StepMethod):
    """Base class of time-stepping methods; a subclass defines the step without contacts."""

    @abstractmethod
    def smooth(
        self, p: EquationsOfMotion, t: float, state: StepState, h: float, accelerations: tuple[np.ndarray, ...]
    ) -> SmoothStep:
        """Return the step without impulses of contacts.

        `accelerations` are those that the previous step has returned for this one; () if there are none.
        """

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: Why) -> ContactState:
        """See `StepMethod.begin`."""
        return RigidContacts.on(equations).begun(state)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        """See `StepMethod.step`. If an iteration in a step does not converge, the step is taken as two half steps."""
        end = self._taken(equations, t, state, h, MOST_HALVINGS)
        contacts = RigidContacts.on(equations)
        return contacts.step((t, t + h), state, replace(end, z=contacts.all_states(contacts.own(state.z), end.memory)))

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

    def _whole(self, p: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        contacts, v = RigidContacts.on(p), state.v
        held = state.memory
        smooth = self.smooth(p, t, state, h, held.accelerations)
        contacts.find_free()
        after, memory, lost = StepImpulses(contacts, held, smooth, v, h).applied()
        reached = self._closed(contacts, t + h, smooth.positions(after))
        work, dissipated = p.powers(t + 0.5 * h, smooth.middle, 0.5 * (v + after), smooth.multipliers)
        more, lifted = self._moved(p, (t, h), smooth, (after, reached), memory.force)
        lost -= held.owed + lifted
        memory = replace(memory, owed=max(-lost, 0.0), is_new=False)
        return StepState(reached, after, None, memory, h * work + more, h * dissipated + max(lost, 0.0))

    @staticmethod
    def _moved(
        p: EquationsOfMotion,
        time: tuple[float, float],
        smooth: SmoothStep,
        end: tuple[np.ndarray, np.ndarray],
        force: np.ndarray,
    ) -> tuple[float, float]:
        """Return the work of drivers and loads due to the contacts of a step, and the energy that the contacts add [J].

        The energy that contacts take is computed from the mean velocities of the step. Contacts displace the bodies
        farther than these velocities do, mainly where overlapping shapes are moved apart, and thereby add energy, for
        example by lifting a body.

        Parameters
        ----------
        time
            Start of the step and its size [s].
        end
            (n,) velocities and positions at the end of the step.
        force
            (n,) generalized forces of all contacts, as a mean over the step.
        """
        if not np.any(force):
            return 0.0, 0.0
        (t, h), (after, reached) = time, end
        moved = reached - smooth.positions(smooth.v) - 0.5 * h * (after - smooth.v)
        way, none = reached - 0.5 * moved, np.zeros(p.n)
        work = p.powers(t + h, way, moved, np.zeros(p.m))[0]
        lifted = -float(p.forces(t + h, way, none) @ moved)
        if p.m:
            work += float(smooth.answer(h * force)[1] @ p.constraint_rates(t + 0.5 * h, smooth.middle, none))
        return work, lifted

    @staticmethod
    def _closed(contacts: RigidContacts, t: float, q: np.ndarray) -> np.ndarray:
        """Return the nearest positions in which the joints are closed and no shapes overlap.

        If more than `MANY` contacts overlap, some overlap may remain.
        """
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
        self.theta = theta

    @classmethod
    def of(cls, method: MoreauJean) -> MoreauJeanSteps:
        """Return the steps of a method as described."""
        return cls(method.theta)

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
            lambda impulse: matrix.solve(impulse, none),
            lambda end: q + h * (theta * end + (1.0 - theta) * v),
        )


def answer(p: EquationsOfMotion, t: float, q: np.ndarray, impulse: np.ndarray) -> np.ndarray:
    """Return the change of the velocities (n,) by an impulse (n,) at a position; it is consistent with the joints."""
    return p.solve(t, q, impulse, np.zeros(p.m))[0]
