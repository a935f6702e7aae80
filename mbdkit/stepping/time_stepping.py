"""The time-stepping method of Moreau and Jean: velocities may jump in any step, and impacts are not located.

With positions q_m = q_0 + h/2 v_0, at which gaps, their gradients and joints are evaluated, a step from (q_0, v_0) is

    M (v_1 - v_0) = h (theta Q(t_1, q_1, v_1) + (1 - theta) Q(t_0, q_0, v_0)) + joints + contacts
    q_1 = q_0 + h (theta v_1 + (1 - theta) v_0)

with joints closed in velocities, and impulses, by the laws of Newton and Coulomb, of the contacts that would overlap at
the end. One iteration of Newton's method makes the forces implicit. Then positions are projected: joints are closed,
and shapes that overlap are moved apart.

J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988; M. Jean, Computer Methods in Applied
Mechanics and Engineering 177:235-257, 1999; V. Acary and B. Brogliato, Numerical Methods for Nonsmooth Dynamical
Systems, 2008, chapter 10.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.nearest_state import nearest_positions
from mbdkit.mechanism.contacts import OPEN, SLIP, STICK
from mbdkit.methods.kinds import StepMethod, StepState
from mbdkit.stepping.complementarity import Pushed, coulomb, stronge
from mbdkit.stepping.rigid_contacts import SMALL_RESTITUTION, ClosedSystem, ContactState, RigidContacts

MOST_HALVINGS = 4
"""How often a step may be halved."""
MOST_PROJECTIONS = 5
"""Projections of positions in one step, each of which may make other shapes overlap."""
SMALL = 1e-12
"""Overlap, in lengths of the mechanism, that is zero but for errors."""


class TimeStepping(StepMethod):
    """The method of Moreau and Jean.

    Parameters
    ----------
    theta
        Share of the forces at the end of a step, from 0.5 to 1.
    """

    def __init__(self, theta: float):
        self.theta = theta

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        """See `StepMethod.step`. A step whose positions cannot be projected is taken in halves."""
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
        p, theta, q, v = equations, self.theta, state.q, state.v
        contacts = RigidContacts(p)
        held = contacts.all_open().after_stop() if state.memory is None else state.memory
        middle = q + 0.5 * h * v
        a, multipliers = p.accelerations(t, q, v)
        matrix = p.iteration_matrix(
            t + 0.5 * h, middle, v, a, multipliers, damping=theta * h, stiffness=(theta * h) ** 2
        )
        force = theta * p.forces(t + h, q + h * v, v) + (1.0 - theta) * p.forces(t, q, v)
        free = v + matrix.solve(h * force, -p.constraint_rates(t + 0.5 * h, middle, v))[0]
        reached = q + h * (theta * free + (1.0 - theta) * v)
        some = np.flatnonzero(contacts.gaps(reached) <= SMALL * p.length)
        count = len(contacts.names)
        modes, normal, tangent = np.zeros(count, dtype=int), np.zeros(count), np.zeros(count)
        rows = contacts.rows(middle, v, some)
        after, force, changed = free, np.zeros(p.n), frozenset[str]()
        if len(some):
            both, k = np.vstack([rows.normal, rows.tangent]), len(some)
            none = np.zeros(p.m)
            moved = np.stack([matrix.solve(row, none)[0] for row in both], axis=1)
            before = rows.normal @ v
            rate, response = both @ free, both @ moved
            friction = np.where(
                self._sticks(held, rows.tangent @ v, v, some), contacts.static[some], contacts.kinetic[some]
            )

            def met(e: np.ndarray) -> Pushed:
                back = e * np.minimum(before, 0.0)
                found = coulomb(response, rate[:k] + back, rate[k:], friction)
                if found is None:
                    what = "no impulses of the contacts satisfy the laws of impact and friction"
                    raise StepError("contact-solver", what)
                return found

            def gains(found: Pushed) -> bool:
                impulses = np.concatenate([found.normal, found.tangent])
                work = impulses * (both @ (v + free) + response @ impulses)
                return bool(np.sum(work) > 1e-12 * np.sum(np.abs(work)))

            e = contacts.restitution[some]
            found = met(e)
            if gains(found) and np.any(e * np.minimum(before, 0.0)):  # as in `RigidContacts.struck`
                if k == 1 and rate[0] < 0.0:
                    normal_, tangent_ = stronge(response, rate, float(friction[0]), float(e[0]))
                    found = found._replace(normal=np.array([normal_]), tangent=np.array([tangent_]))
                while gains(found) and np.any(e):
                    e = np.where(e > SMALL_RESTITUTION, 0.9 * e, 0.0)
                    found = met(e)
                changed = frozenset(contacts.names[i] for i in some[found.normal > 0.0].tolist())
            impulses = np.concatenate([found.normal, found.tangent])
            after = free + moved @ impulses
            force = impulses @ both / h
            normal[some], tangent[some] = found.normal / h, found.tangent / h
            slip = np.sign(rows.tangent @ after)
            modes[some] = np.where(found.is_closed, np.where(found.is_slipping, SLIP * slip, STICK), OPEN)
        reached = self._closed(contacts, t + h, q + h * (theta * after + (1.0 - theta) * v))
        mean = 0.5 * (v + after)
        lost = -h * float(normal[some] @ (rows.normal @ mean) + tangent[some] @ (rows.tangent @ mean))
        work, dissipated = p.powers(t + 0.5 * h, middle, mean, multipliers)
        changed = held.changed.union(changed)
        memory = replace(
            held, changed=changed, modes=modes, normal=normal, tangent=tangent, force=force, is_over_step=True
        )
        return StepState(reached, after, None, memory, h * work, h * dissipated + lost)

    @staticmethod
    def _sticks(held: ContactState, slip: np.ndarray, v: np.ndarray, some: np.ndarray) -> np.ndarray:
        """Return which of some contacts have stuck in the last step; at the start, which do not slip."""
        if len(held.modes):
            return np.asarray(held.modes[some] == STICK)
        return np.abs(slip) <= SMALL * np.max(np.abs(v), initial=0.0)

    @staticmethod
    def _closed(contacts: RigidContacts, t: float, q: np.ndarray) -> np.ndarray:
        """Return the nearest positions with closed joints in which no shapes overlap."""
        overlaps = contacts.gaps(q) < 0.0
        for _ in range(MOST_PROJECTIONS):
            system = ClosedSystem(contacts, np.where(overlaps, SLIP, OPEN))
            if not system.m:
                break
            q = nearest_positions(system, t, q)
            more = contacts.gaps(q) < -SMALL * contacts.p.length
            if not np.any(more & ~overlaps):
                break
            overlaps |= more
        return q
