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
from mbdkit.integrators.run.run_plan import SYMMETRIC, RunPlan
from mbdkit.integrators.run.run_state import MODIFIED, RunState
from mbdkit.integrators.run.step_control import SOLVER_FAILURE_FACTOR
from mbdkit.integrators.run.step_guards import ENERGY_JUMP, FELL_APART
from mbdkit.registry.seam import OwnSeam

if TYPE_CHECKING:
    from mbdkit.integrators.stages.compiled_method import CompiledMethod

#: Relative distances to the nearest singular matrix. A state counts as singular below `SINGULAR`, and as regular above
#: `REGULAR`.
SINGULAR, REGULAR = 1e-6, 1e-2

#: Codes of further attempts at a step, beside the statuses after which new pivots have been chosen.
APART, SWITCHED = -1, -2


@OwnSeam
def obstacle_clause(handle: Never, workspace: Workspace, t: float, q: np.ndarray, v: np.ndarray, /) -> str:
    """Return a clause that names an element that cannot have the positions q (n,) at which a step failed; or nothing.

    The time t is in s, v (n,) are the velocities.
    """
    raise NotImplementedError


@OwnSeam
def stiffness_clause(handle: Never, /) -> str:
    """Return a clause that names an element for which explicit methods need small steps, or an empty text."""
    raise NotImplementedError


class FailedSteps:
    """Prepares other attempts at failed steps of a compiled method, or says why a run stops.

    `method`, `workspace`, `timetable`: the run. `run`: the bundle of its state (`RunState`). `plan`: the plan of the
    run; stops that are added later make no difference. `renewed`: pairs of the number of accepted steps and a status
    after which another attempt has been made.
    """

    def __init__(
        self, method: CompiledMethod, workspace: Workspace, timetable: Timetable, run: PinnedBundle, plan: RunPlan
    ):
        self.method, self.workspace, self.timetable, self.plan = method, workspace, timetable, plan
        self.renewed: set[tuple[int, int]] = set()
        self._run = run
        self._is_controlled, self._mode = bool(plan.control.controlled[0]), int(plan.projection.mode[0])

    @property
    def _state(self) -> RunState:
        return self._run.bundle

    def handle(self, status: int) -> Failure | None:
        """React to a failed step: prepare another attempt, or return why the run stops.

        The next attempt uses new pivots, a more robust solution of the stages, more iterations, or a smaller step, as
        far as the method supports it.
        """
        method, progress, is_controlled = self.method, self._state.progress, self._is_controlled
        done, t = int(progress.accepted[0]), float(progress.time[0])
        if status in (FELL_APART, ENERGY_JUMP):
            known = self._state.guards, self._state.worst
            limits = self.timetable.guards.energy_jump, self.plan.limits
            return guard_failure(status, self.workspace.mechanism, known, limits, t, method.hint)
        where = f"in step {done + 1} from t = {t:.6g} s"
        if status == step_loop.REFUSED:
            return self._failure(status, None, where)
        can_shrink = is_controlled and status != step_loop.TOO_SMALL
        if unusable := self.workspace.unusable():
            if can_shrink and self._shrink():
                return None
            return Failure(self.workspace.cause, f"{unusable} {where}{self._stiffness()}.")
        if status in (REPIVOT, REPIVOT_STAGES) and not self.workspace.is_finite():
            status = DIVERGED if method.carries_stages else NOT_FINITE
        singular: SingularSystemError | None = None
        if status != NOT_FINITE and (done, status) not in self.renewed:
            try:
                if self._renew(status):
                    self.renewed = {pair for pair in self.renewed if pair[0] == done} | {(done, status)}
                    return None
            except SingularSystemError as error:
                singular = error
        apart = (done, APART)
        if status not in (step_loop.TOO_SMALL, NOT_FINITE) and self._mode != SYMMETRIC and apart not in self.renewed:
            self.renewed.add(apart)
            solved = method.solve_apart(self._state, float(progress.tried_begin[0]), self._size_tried())
            self.take_up_pivots()
            if solved:
                return None
        if not is_controlled and status == DIVERGED and method.extend_iterations():
            return None
        switched = (done, SWITCHED)
        if not is_controlled and switched not in self.renewed and method.switch_iteration():
            self.renewed = {switched}
            return None
        if can_shrink and self._shrink():
            return None
        failure = self._failure(status, singular, where)
        near = self._obstacle(t, self._state.q + self._size_tried() * self._state.v)
        if not near and failure.code != "not-finite":
            near = describe_nearness(self.workspace, t, self._state.q)
        sentence = failure.sentence.rstrip(".")
        if near and self.workspace.mechanism.drivers:
            sentence = sentence.removesuffix(f"; {method.hint}")
        return replace(failure, sentence=f"{sentence}; {near}.") if near else failure

    def _renew(self, status: int) -> bool:
        """Choose new pivots after `status`; return whether another attempt at the step can succeed.

        The next call of the step loop repeats the attempt, after the rows written so far have been returned. The pivots
        may belong to a stage matrix of the method. Raises SingularSystemError if a matrix is singular.
        """
        if status == step_loop.TOO_SMALL:
            return False
        self._state.base_state[0] = MODIFIED
        if status == REPIVOT:
            self.workspace.use_pivots()
            if not self.method.remembers:
                self.method.forget()
        t = float(self._state.progress.time[0])
        helped = status == REPIVOT or self.method.renew(self._state, t, self._size_tried())
        self.take_up_pivots()
        return helped

    def take_up_pivots(self) -> None:
        """Make the compiled code use the current solver of the workspace."""
        if self._state.solver is not self.workspace.solver:
            self._run.replace(self._state._replace(solver=self.workspace.solver))

    def _shrink(self) -> bool:
        progress = self._state.progress
        progress.next_size[0] *= SOLVER_FAILURE_FACTOR
        progress.rejected[0] += 1
        self._state.interval.rejected[0] += 1
        self._state.base_state[0] = MODIFIED
        self.renewed.clear()
        return bool(progress.next_size[0] > self.plan.control.min_size[0])

    def _size_tried(self) -> float:
        return float(self._state.progress.tried_size[0])

    def _failure(self, status: int, singular: SingularSystemError | None, where: str) -> Failure:
        hint, workspace, state = self.method.hint, self.workspace, self._state
        floor = float(self.plan.control.min_size[0])
        distance, _ = nearest_singularity(workspace, float(state.progress.time[0]), state.q)
        if status == step_loop.TOO_SMALL:
            if distance < SINGULAR:
                return Failure("singular", f"the step size decreased without limit {where}.")
            if state.guards.jumped[0]:
                sentence = f"the energy balance changes by too much {where} for any step size; the law of a force"
                return Failure("energy-jump", f"{sentence} may not be the derivative of its potential.")
            remedy = "looser tolerances may help"
            # velocities of index 3 violate the joints by an error that does not vanish with the next step h; reactions
            # of about this error over h remove it, and friction changes other velocities by the same amount
            if workspace.formulation == "index-3" and workspace.mechanism.friction:
                remedy = (
                    "the friction in joints follows reactions that index-3 computes from the errors of positions; use "
                    "`stabilization: projection`, or the formulation index-2 or index-1"
                )
            return Failure("step-too-small", f"the step fell below {floor:.2g} s {where}; {remedy}.")
        if status == NOT_FINITE:
            return Failure("not-finite", f"numbers overflowed {where}; {hint}{self._stiffness()}.")
        if self.method.failure is not None:
            code, what = self.method.failure
            advice = "tighter tolerances may help" if self._is_controlled else hint
            return Failure(code, f"{what} {where}; {advice}.")
        if status == DIVERGED:
            return Failure("newton-failed", f"{where}{self.method.describe_divergence(state.report)}; {hint}.")
        unknown = workspace.failed_unknown if singular is None else singular.index
        what = f"the system of equations is singular at {workspace.mechanism.unknown_name(unknown)}"
        if self.method.carries_stages and distance > REGULAR:
            reached = f"the stage iteration reached a state in which {what}"
            return Failure("newton-failed", f"{where}: {reached}; {hint}.")
        return Failure("singular", f"{what} {where}; {hint}.")

    def _obstacle(self, t: float, q: np.ndarray) -> str:
        """Return a clause that names an element that cannot have the positions `q`; empty if there is none."""
        for handle, kind in self.workspace.mechanism.kinds():
            if (target := kind.failures.obstacle) is None:
                continue
            if clause := obstacle_clause.of(target)(handle, self.workspace, t, q, self._state.v):
                return clause
        return ""

    def _stiffness(self) -> str:
        """Return a clause that names an element for which explicit methods need small steps, if there is one."""
        for handle, kind in () if self.method.carries_stages else self.workspace.mechanism.kinds():
            stiffest = kind.failures.stiffest
            if stiffest is not None and (clause := stiffness_clause.of(stiffest)(handle)):
                return f"; {clause}"
        return ""
