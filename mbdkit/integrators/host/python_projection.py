"""Projection of the steps of Python methods onto the constraints, after the step or symmetrically before and after it.

`mbdkit.integrators.loop.projected_step` is the equivalent for compiled methods. Here each iteration takes a step in
Python, which evaluates `EquationsOfMotion`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.kernels.projection import EPS, FEW_ROUNDINGS, STAGNANT
from mbdkit.integrators.loop.projected_step import MAX_TRIALS, improve
from mbdkit.integrators.run.reached import NO_CORRECTION
from mbdkit.integrators.run.run_plan import CHANGES
from mbdkit.methods.step_methods import StepState

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion

Vector = np.ndarray | float


class Taken(NamedTuple):
    """A step with its projection.

    The state from which the step of the method starts (displaced if the projection is symmetric), the state in which
    this step ends, the state after projection, and the time at the end [s]. `correction` (4,) is a row of
    ``Stretch.corrections`` (`mbdkit.integrators.interface.Stretch`).
    """

    begin: StepState
    made: StepState
    reached: StepState
    correction: np.ndarray
    end: float


class StabilizedSteps:
    """Takes steps of a Python method with the stabilization of the run.

    *Projection* replaces positions and velocities by the nearest consistent ones in the mass metric. *Symmetric
    projection* (Hairer 2000, BIT 40, 726-734): with multipliers mu of positions and nu of velocities,

        q_0~ = q_0 + M^-1 Phi_q(q_0)^T mu,    (q_1~, v_1~) = step(q_0~, v_0~),    q_1 = q_1~ + M^-1 Phi_q(q_1)^T mu
        v_0~ = v_0 + M^-1 Phi_q(q_0)^T nu,                                        v_1 = v_1~ + M^-1 Phi_q(q_1)^T nu

    so that Phi(q_1) = 0 and Phi_q(q_1) v_1 + Phi_t = 0. The projected method is symmetric if the method is. The
    multipliers are computed by Broyden's method (`mbdkit.integrators.loop.projected_step.improve`). Each iteration
    takes a step of the method; the first matrix of the iteration approximates this step by q + h v.

    Projection changes neither the multipliers nor the memory of a state. For methods whose memory should be consistent
    with the velocities, such as generalized-alpha, this can reduce the order of the multipliers by one.

    `step`: function that takes a step of the method: (t, state, h, end) to the new state and the time at which it ends.
    `begun`: function that returns a state with the memory that the method needs after a projection, from the time and
    the state. `equations`: the equations, with their counters and the stabilization of the run.
    """

    def __init__(
        self,
        step: Callable[[float, StepState, float, float], tuple[StepState, float]],
        begun: Callable[[float, StepState], StepState],
        equations: EquationsOfMotion,
    ):
        self.step, self.begun, self.equations, self.wanted = step, begun, equations, equations.stabilization
        self.weight = equations.mass / float(np.sum(equations.mass[::3]))

    def take(self, t: float, end: float, state: StepState, h: float, number: int) -> Taken:
        """Take step `number`, counted from 1, from `state` at `t` to `end`; raises StepError."""
        wanted, p = self.wanted, self.equations
        if wanted.symmetric:
            return self._symmetric(t, end, state, h)
        made, end = self.step(t, state, h, end)
        if wanted.kind == "projection":
            return self.project(end, state, made, number)
        correction = NO_CORRECTION
        if wanted.kind == "baumgarte":
            correction = np.array([0.0, 0.0, 0.0, p.baumgarte_terms(end, made.q, made.v)])
        return Taken(state, made, made, correction, end)

    def project(self, end: float, state: StepState, made: StepState, number: int) -> Taken:
        """Return step `number` from `state` to `made` at the time `end`, projected if the stabilization wants this."""
        p = self.equations
        if self.wanted.kind == "projection" and number % self.wanted.every == 0 and self._is_off(end, made):
            q, v = p.project(end, made.q, made.v)
            return self._corrected(end, state, made, q - made.q, v - made.v)
        return Taken(state, made, made, NO_CORRECTION, end)

    def _is_off(self, end: float, made: StepState) -> bool:
        bound, p = self.wanted.bound, self.equations
        if bound is None:
            return True
        rows = p.constraints(end, made.q), p.constraint_rates(end, made.q, made.v)
        return bool(np.max(np.abs(rows), initial=0.0) > bound)

    def _symmetric(self, t: float, end: float, state: StepState, h: float) -> Taken:
        p, none = self.equations, np.zeros(self.equations.n)
        mu, nu = np.zeros((2, p.m))
        at: np.ndarray | None = None
        changes, count = np.zeros((CHANGES, 2, p.m, 1)), 0
        before, idle = np.inf, 0
        for _ in range(MAX_TRIALS):
            begin, pushed_q, pushed_v = state, none, none
            if at is not None:
                pushed_q, pushed_v = self._push(t, state.q, mu), self._push(t, state.q, nu)
                begin = state.moved(pushed_q, pushed_v, multipliers=state.multipliers, memory=state.memory)
            made, end = self.step(t, begin, h, end)
            dq = none if at is None else self._push(end, at, mu)
            at = made.q + dq
            step_q, for_q = p.solve(end, at, none, -p.constraints(end, at))
            at = at + step_q
            dv = self._push(end, at, nu)
            v = made.v + dv
            step_v, for_v = p.solve(end, at, none, -p.constraint_rates(end, at, v))
            now = max(p.relative_change(at, step_q), p.relative_change(v, step_v))
            idle = idle + 1 if now >= 0.5 * before else 0
            if now <= FEW_ROUNDINGS * EPS or (idle >= 2 and now < STAGNANT):
                p.counters.projections += 1
                return self._corrected(end, begin, made, dq + step_q, dv + step_v, pushed_q, pushed_v)
            change = changes[count, :, :, 0]
            change[:] = 0.25 * h * for_v - 0.5 * for_q, -0.5 * for_v
            count = improve(changes, count, h)
            mu, nu = mu + change[0], nu + change[1]
            before = now
        raise StepError(
            "newton-failed",
            f"the symmetric projection did not converge in {MAX_TRIALS} iterations, because the bodies turn or the "
            "joints drift too far in a step; projection without `symmetric` takes larger steps",
        )

    def _push(self, t: float, q: np.ndarray, mu: np.ndarray) -> np.ndarray:
        return self.equations.constraint_forces(t, q, mu) / self.equations.mass

    def _corrected(
        self,
        end: float,
        begin: StepState,
        made: StepState,
        dq: np.ndarray,
        dv: np.ndarray,
        before_q: Vector = 0.0,
        before_v: Vector = 0.0,
    ) -> Taken:
        reached = made.moved(
            dq, dv, multipliers=made.multipliers, memory=made.memory, work=made.work, dissipated=made.dissipated
        )
        moved_q, moved_v = (np.sqrt(np.sum(self.weight * x**2)) for x in (before_q + dq, before_v + dv))
        return Taken(begin, made, self.begun(end, reached), np.array([1.0, moved_q, moved_v, 0.0]), end)
