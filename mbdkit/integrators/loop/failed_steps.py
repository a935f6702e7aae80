"""Failed steps of compiled methods: new pivots, other solutions of the stages, smaller steps, or the end of the run."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Never

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, REPIVOT, REPIVOT_STAGES
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.singularity import describe_nearness, nearest_singularity
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Failure, Timetable
from mbdkit.integrators.loop import step_loop
from mbdkit.integrators.loop.step_watch import guard_failure
from mbdkit.integrators.run.run_plan import SYMMETRIC
from mbdkit.integrators.run.run_state import MODIFIED
from mbdkit.integrators.run.step_control import SOLVER_FAILURE_FACTOR
from mbdkit.integrators.run.step_guards import ENERGY_JUMP, FELL_APART
from mbdkit.registry.seam import OwnSeam

if TYPE_CHECKING:
    from mbdkit.integrators.run.run_plan import RunPlan
    from mbdkit.integrators.run.run_state import RunState
    from mbdkit.integrators.stages.compiled_method import CompiledMethod

SINGULAR, REGULAR = 1e-6, 1e-2
"""Relative distances to the nearest singular matrix. A state counts as singular below `SINGULAR`, and as regular above
`REGULAR`.
"""

APART, SWITCHED = -1, -2
"""Codes of further attempts at a step, beside the statuses after which new pivots have been chosen."""


@OwnSeam
def obstacle_clause(handle: Never, workspace: Workspace, time: float, q: np.ndarray, v: np.ndarray, /) -> str:
    """Return a clause that names an element that cannot have the positions q (n,) at which a step failed; or nothing.

    The time is in s, v (n,) are the velocities.
    """
    raise NotImplementedError


@OwnSeam
def stiffness_clause(handle: Never, /) -> str:
    """Return a clause that names an element for which explicit methods need small steps, or an empty text."""
    raise NotImplementedError


class FailedSteps:
    """Base class of `CompiledStepper`: what it does after a failed step."""

    method: CompiledMethod
    workspace: Workspace
    timetable: Timetable
    run_state: RunState
    plan: RunPlan
    controlled: bool
    mode: int
    time: float
    failure: Failure | None
    worst_pairs: np.ndarray
    _pinned_state: PinnedBundle
    _renewed: set[tuple[int, int]]

    @property
    def _accepted(self) -> int:
        """Number of accepted steps."""
        return int(self.run_state.progress.accepted[0])

    def _handle(self, status: int) -> None:
        """React to a failed step: prepare another attempt, or set `failure`.

        The next attempt uses new pivots, a more robust solution of the stages, more iterations, or a smaller step, as
        far as the method supports it.
        """
        if status in (FELL_APART, ENERGY_JUMP):
            known = self.run_state.guards, self.worst_pairs
            limits = self.timetable.guards.energy_jump, self.plan.limits
            self.failure = guard_failure(status, self.workspace.mechanism, known, limits, self.time, self.method.hint)
            return
        done = self._accepted
        if status == step_loop.REFUSED:
            self.failure = self._failure(status, None, f"in step {done + 1} from t = {self.time:.6g} s")
            return
        where = f"in step {done + 1} from t = {self.time:.6g} s"
        if unusable := self.workspace.unusable():
            if not (self.controlled and status != step_loop.TOO_SMALL and self._shrink()):
                self.failure = Failure(self.workspace.cause, f"{unusable} {where}{self._stiffness()}.")
            return
        if status in (REPIVOT, REPIVOT_STAGES) and not self.workspace.is_finite():
            status = DIVERGED if self.method.carries_stages else NOT_FINITE
        singular: SingularSystemError | None = None
        if status != NOT_FINITE and (done, status) not in self._renewed:
            try:
                if self._renew(status):
                    self._renewed = {pair for pair in self._renewed if pair[0] == done} | {(done, status)}
                    return
            except SingularSystemError as error:
                singular = error
        apart = (done, APART)
        if status not in (step_loop.TOO_SMALL, NOT_FINITE) and self.mode != SYMMETRIC and apart not in self._renewed:
            self._renewed.add(apart)
            begin = float(self.run_state.progress.tried_begin[0])
            solved = self.method.solve_apart(self.run_state, begin, self._size_tried())
            self._take_up_pivots()
            if solved:
                return
        if not self.controlled and status == DIVERGED and self.method.extend_iterations():
            return
        switched = (done, SWITCHED)
        if not self.controlled and switched not in self._renewed and self.method.switch_iteration():
            self._renewed = {switched}
            return
        if self.controlled and status != step_loop.TOO_SMALL and self._shrink():
            return
        self.failure = self._failure(status, singular, where)
        ahead = self.run_state.q + self._size_tried() * self.run_state.v
        near = self._obstacle(ahead)
        if not near and self.failure.code != "not-finite":
            near = describe_nearness(self.workspace, self.time, self.run_state.q)
        if near:
            self.failure = replace(self.failure, sentence=f"{self.failure.sentence.rstrip('.')}; {near}.")

    def _renew(self, status: int) -> bool:
        """Choose new pivots after `status`; return whether another attempt at the step can succeed.

        The next call of the step loop repeats the attempt, after the rows written so far have been returned. The pivots
        may belong to a stage matrix of the method. Raises SingularSystemError if a matrix is singular.
        """
        if status == step_loop.TOO_SMALL:
            return False
        self.run_state.base_state[0] = MODIFIED
        if status == REPIVOT:
            self.workspace.use_pivots()
            if not self.method.remembers:
                self.method.forget()
        helped = status == REPIVOT or self.method.renew(self.run_state, self.time, self._size_tried())
        self._take_up_pivots()
        return helped

    def _take_up_pivots(self) -> None:
        """Make the compiled code use the current solver of the workspace."""
        if self.run_state.solver is self.workspace.solver:
            return
        self.run_state = self.run_state._replace(solver=self.workspace.solver)
        self._pinned_state.replace(self.run_state)

    def _shrink(self) -> bool:
        """Count the attempted step as rejected and reduce its size; return whether the new size is still allowed."""
        progress = self.run_state.progress
        progress.next_size[0] *= SOLVER_FAILURE_FACTOR
        progress.rejected[0] += 1
        self.run_state.interval.rejected[0] += 1
        self.run_state.base_state[0] = MODIFIED
        self._renewed.clear()
        return bool(progress.next_size[0] > self.plan.control.min_size[0])

    def _size_tried(self) -> float:
        """Return the size [s] of the step that failed."""
        return float(self.run_state.progress.tried_size[0])

    def _failure(self, status: int, singular: SingularSystemError | None, where: str) -> Failure:
        """Return the reason why the run stops."""
        hint, workspace = self.method.hint, self.workspace
        floor = float(self.plan.control.min_size[0])
        distance, _ = nearest_singularity(workspace, self.time, self.run_state.q)
        if status == step_loop.TOO_SMALL:
            if distance < SINGULAR:
                return Failure("singular", f"the step size decreased without limit {where}.")
            if self.run_state.guards.jumped[0]:
                sentence = f"the energy balance changes by too much {where} for any step size; the law of a force"
                return Failure("energy-jump", f"{sentence} may not be the derivative of its potential.")
            return Failure("step-too-small", f"the step fell below {floor:.2g} s {where}; looser tolerances may help.")
        if status == NOT_FINITE:
            return Failure("not-finite", f"numbers overflowed {where}; {hint}{self._stiffness()}.")
        if self.method.failure is not None:
            code, what = self.method.failure
            advice = "tighter tolerances may help" if self.controlled else hint
            return Failure(code, f"{what} {where}; {advice}.")
        if status == DIVERGED:
            return Failure("newton-failed", f"{where}{self.method.describe_divergence(self.run_state.report)}; {hint}.")
        unknown = workspace.failed_unknown if singular is None else singular.index
        what = f"the system of equations is singular at {workspace.mechanism.unknown_name(unknown)}"
        if self.method.carries_stages and distance > REGULAR:
            reached = f"the stage iteration reached a state in which {what}"
            return Failure("newton-failed", f"{where}: {reached}; {hint}.")
        return Failure("singular", f"{what} {where}; {hint}.")

    def _obstacle(self, q: np.ndarray) -> str:
        """Return a clause that names an element that cannot have the positions `q`; empty if there is none."""
        for handle, kind in self.workspace.mechanism.kinds():
            if (target := kind.failures.obstacle) is None:
                continue
            if clause := obstacle_clause.of(target)(handle, self.workspace, self.time, q, self.run_state.v):
                return clause
        return ""

    def _stiffness(self) -> str:
        """Return a clause that names an element for which explicit methods need small steps, if there is one."""
        for handle, kind in () if self.method.carries_stages else self.workspace.mechanism.kinds():
            stiffest = kind.failures.stiffest
            if stiffest is not None and (clause := stiffness_clause.of(stiffest)(handle)):
                return f"; {clause}"
        return ""
