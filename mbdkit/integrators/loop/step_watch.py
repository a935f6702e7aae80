"""The guards of the step loop for steps in Python, and their results for all runs: evidence and failures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.engine_bundles import load_engine
from mbdkit.engine.kernels.system import OK, prepare
from mbdkit.engine.native.bundle import PinnedBundle, bundle_loader
from mbdkit.engine.native.functions import kernel
from mbdkit.engine.workspace import example_workspace
from mbdkit.integrators.interface import Failure, Guards, Impact, StepEvidence
from mbdkit.integrators.run.run_plan import GuardLimits, guard_limits
from mbdkit.integrators.run.step_guards import (
    ENERGY_JUMP,
    GuardState,
    begin_energy,
    distance_to_singularity,
    energy_jump,
    limit_status,
    new_guard_state,
    note_jump,
    watch_branch,
)
from mbdkit.trust.criteria import BranchSuspicion

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.workspace import Workspace


class WatchedStep(NamedTuple):
    """A step and the state of the guards. States are (3 (B + 1),), ground last."""

    guards: GuardState
    limits: GuardLimits
    worst: np.ndarray  #: (P,) largest squared misalignments so far, those of the step included [m^2, rad^2].
    #: (1,) whether the energy balance can be checked, because stabilization does no work within the step.
    booked: np.ndarray
    from_q: np.ndarray  #: State at the start of the step.
    from_v: np.ndarray
    made_q: np.ndarray  #: State at its end, before a projection.
    made_v: np.ndarray
    q: np.ndarray  #: State at its end.
    v: np.ndarray
    gain: np.ndarray  #: (2,) work done in the step, and energy dissipated [J].
    dq: np.ndarray  #: Work arrays: displacement, accelerations, (P, 2) multipliers.
    acc: np.ndarray
    lam: np.ndarray


def _new_step(workspace: Workspace, guards: Guards, worst: np.ndarray) -> WatchedStep:
    size, kind = workspace.mechanism.size, workspace.stabilization
    booked = kind.kind == "none" or (kind.kind == "projection" and not kind.symmetric)
    from_q, from_v, made_q, made_v, q, v, dq, acc = np.zeros((8, size))
    return WatchedStep(
        guards=new_guard_state(workspace.mechanism), limits=guard_limits(workspace.mechanism, guards), worst=worst,
        booked=np.array([int(booked)]), from_q=from_q, from_v=from_v, made_q=made_q, made_v=made_v, q=q, v=v,
        gain=np.zeros(2), dq=dq, acc=acc, lam=np.zeros((len(worst), 2)),
    )  # fmt: skip


load_step = bundle_loader(lambda: _new_step(example_workspace(), Guards(), np.zeros(0)))


@kernel
def watch_step(engine: int, watched: int, begin: float, end: float, projected: bool) -> int:
    """Apply the guards to a step from `begin` to `end` [s]; return a status."""
    h, s = load_engine(engine), load_step(watched)
    guards, limits = s.guards, s.limits
    if np.isnan(guards.energy[0]):
        begin_energy(h, guards, begin, s.from_q, s.from_v)
    prepare(h.top, h.w, end, s.made_q)
    jump, total, kinetic, rounding = energy_jump(h, guards, s.gain, s.made_q, s.made_v)
    if s.booked[0] == 0:
        jump = 0.0
    note_jump(guards, end, jump, total, kinetic, rounding, limits.energy_jump[0])
    if projected:
        begin_energy(h, guards, end, s.q, s.v)
    if guards.has_loops[0] != 0.0:
        # Methods in Python solve other systems too, so that the last factors may not be those of the accelerations. If
        # this solution fails, the distance of the previous step is used.
        if solve_accelerations(h.top, h.w, h.solver, s.q, s.v, s.acc, s.lam, False) == OK:
            guards.distance[0] = distance_to_singularity(h, guards.vectors)
        for d in range(len(s.q)):
            s.dq[d] = s.q[d] - s.from_q[d]
        watch_branch(guards, h.top.mass, end, s.dq, s.v)
    return limit_status(guards, s.worst, limits)


class StepWatch:
    """Applies the guards of the compiled step loop to steps in Python.

    Parameters
    ----------
    workspace
        The mechanism and its start, with stabilization.
    guards
        Limits of the run.
    worst
        (P,) largest squared misalignments; the caller updates them before each call of `step`.
    hint
        Advice to the user if the run fails, as a clause.
    """

    def __init__(self, workspace: Workspace, guards: Guards, worst: np.ndarray, hint: str):
        self.workspace, self.limits, self.hint = workspace, guards, hint
        self._step = _new_step(workspace, guards, worst)
        self._pinned = PinnedBundle(self._step)
        self._n = workspace.mechanism.size - 3

    def forget_energy(self) -> None:
        """Forget the known energy, because an impulse has changed the velocities since the end of the last step."""
        self._step.guards.energy[0] = np.nan

    def step(
        self,
        times: tuple[float, float],
        from_q: np.ndarray,
        from_v: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        gain: np.ndarray,
        made: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> Failure | None:
        """Check a step; return the reason why the run has to stop, or None.

        Parameters
        ----------
        times
            Start and end of the step [s].
        from_q, from_v, q, v
            (n,) states at its start and at its end.
        gain
            (2,) work done in the step, and energy dissipated [J].
        made
            State before the projection that led to `q`, `v`; None without a projection.
        """
        step, n = self._step, self._n
        step.from_q[:n], step.from_v[:n], step.q[:n], step.v[:n] = from_q, from_v, q, v
        step.made_q[:n], step.made_v[:n] = (q, v) if made is None else made
        step.gain[:] = gain
        begin, end = times
        status = watch_step(self.workspace.engine, self._pinned.address, begin, end, made is not None)
        if status == OK:
            return None
        limits = self.limits.energy_jump, step.limits
        return guard_failure(int(status), self.workspace.mechanism, (step.guards, step.worst), limits, end, self.hint)

    @property
    def guards(self) -> GuardState:
        """State of the guards after the last step."""
        return self._step.guards

    def evidence(self, impacts: Sequence[Impact]) -> StepEvidence:
        """Return the quantities observed so far, including the impulses `impacts` of the run."""
        return guard_evidence(self.guards, impacts)


def guard_evidence(guards: GuardState, impacts: Sequence[Impact]) -> StepEvidence:
    """Return the quantities that the guards have observed so far, including the impulses of the run."""
    turns = guards.turns[: int(guards.turn_count[0])].tolist()
    return StepEvidence(
        energy_jump=float(guards.jump[0]),
        energy_jump_time=float(guards.jump_time[0]),
        kinetic=float(guards.kinetic[0]),
        branch=tuple(BranchSuspicion(*x) for x in turns),
        impacts=tuple(impacts),
    )


def guard_failure(
    status: int,
    mechanism: CompiledMechanism,
    known: tuple[GuardState, np.ndarray],
    limits: tuple[float, GuardLimits],
    end: float,
    hint: str,
) -> Failure:
    """Return a failure that names the limit exceeded by a step that ends at `end` [s].

    Parameters
    ----------
    status
        FELL_APART or ENERGY_JUMP.
    known
        State of the guards, and (P,) the largest squared misalignments.
    limits
        ``limits.energy_jump`` of the run, and the limits as the kernels read them.
    """
    (guards, worst), (share_allowed, allowed) = known, limits
    if status == ENERGY_JUMP:
        share = float(guards.jump[0] / guards.kinetic[0]) if guards.kinetic[0] > 0.0 else np.inf
        return Failure(
            "energy-jump",
            f"the energy balance changes by {float(guards.jump[0]):.3g} J in the step to t = {end:.6g} s, {share:.3g} "
            f"of the largest kinetic energy so far, more than limits.energy_jump = {share_allowed:g}; {hint}.",
        )
    pair = int(np.argmax(worst / allowed.squared_misalignment))
    joint = next(name for name, pairs in zip(mechanism.joints, mechanism.joint_pairs, strict=True) if pair in pairs)
    unit = next(row.unit for row in mechanism.rows if row.pair == pair)
    return Failure(
        "fell-apart",
        f"joint '{joint}' is misaligned by {float(np.sqrt(worst[pair])):.3g} {unit} at t = {end:.6g} s, more than the "
        f"{float(np.sqrt(allowed.squared_misalignment[pair])):.3g} {unit} of limits.misalignment; {hint}, "
        "or `stabilization: projection`.",
    )
