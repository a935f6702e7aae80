"""Vectorized runs of collocation methods on the index-1 equations, and of other fully implicit Runge-Kutta methods.

Several runs advance together, one in each *lane* of a SIMD vector, with fixed steps
(`mbdkit.integrators.lanes.lane_loop`) or controlled ones (`mbdkit.integrators.lanes.lane_control`). The step is that
of single runs (`mbdkit.integrators.stages.collocation_step`), compiled for lanes. All lanes share the pivots of the
stage matrix, so that only runs with equal pivots can share a loop; `StagePivoting` chooses them as single runs do. The
scaling of the matrix may differ between lanes. A run that later needs other pivots or, with fixed steps, a more
careful iteration or more iterations, is *lost*, that is, repeated alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError, empty_pattern
from mbdkit.engine.kernels.bundle_types import example_of
from mbdkit.engine.kernels.engine_bundles import Scatter
from mbdkit.engine.kernels.lu import Pattern
from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import inlined, kernel, subkernel
from mbdkit.engine.native.number_arrays import new_lanes
from mbdkit.engine.workspace import Workspace, example_workspace
from mbdkit.integrators.lanes.lane_control import LaneStep, drive_controlled, new_lane_control
from mbdkit.integrators.lanes.lane_loop import drive
from mbdkit.integrators.lanes.lane_run import InLanes, LaneRun, new_lane_run, widened
from mbdkit.integrators.run.step_control import Control, first_step
from mbdkit.integrators.run.step_guards import distance_by_pivots
from mbdkit.integrators.stages.collocation import CompiledCollocation
from mbdkit.integrators.stages.collocation_index1 import KERNELS
from mbdkit.integrators.stages.collocation_stages import LaneKept, Stages, example_stages, new_systems
from mbdkit.integrators.stages.collocation_step import (
    complete_step,
    estimate_errors,
    first_acceleration,
    solve_stages,
    state_inside,
)
from mbdkit.integrators.stages.stage_iteration import hold_counts
from mbdkit.methods.kinds import ImplicitRungeKutta


class StagePivots(NamedTuple):
    """Pivots of the stage matrix of a run, as chosen at its start."""

    pattern: Pattern
    scatter: Scatter
    size: float  #: Size of the first step [s].

    @property
    def key(self) -> tuple[bytes, ...]:
        """Key of these pivots; it is the same for pivots that differ in their scaling only."""
        arrays = (*self.pattern, *self.scatter)
        return tuple(x.tobytes() for x in arrays if x.dtype.kind == "i")


class _Start(NamedTuple):
    """The part of the initial state of a run that the choice of pivots needs."""

    q: np.ndarray
    v: np.ndarray
    z: np.ndarray


class StagePivoting:
    """Chooses the pivots of the stage matrix of runs of one mechanism and method, as single runs do.

    The choice depends on the values of the matrix and is repeated for each run; working arrays are shared.

    Parameters
    ----------
    method
        The method.
    workspace
        The mechanism at the start of one of the runs.
    """

    def __init__(self, method: ImplicitRungeKutta, workspace: Workspace):
        self._method, self._workspace = method, workspace
        self._single = CompiledCollocation(method, workspace, None)

    def first_step(self, q: np.ndarray, v: np.ndarray, size: float | None, span: float, control: Control) -> float:
        """Return the size of the first step [s] of a run of length `span` [s]; `size` is that of the spec, if given."""
        if size is None:
            self._workspace.q0, self._workspace.v0 = q, v
            size = first_step(self._workspace, span, control)
        return min(span, size)

    def pivots(self, q: np.ndarray, v: np.ndarray, h: float) -> StagePivots:
        """Return the pivots for steps of `h` from the positions and velocities (3 (B + 1),).

        Raises
        ------
        mbdkit.engine.elimination_order.SingularSystemError
            If the equations of the first step are singular, or need the pivoted solver; the object must not be used
            afterwards.
        """
        start: Any = _Start(q, v, np.zeros(0))
        self._single.start(start, h)
        if self._workspace.solver.pivoted[0]:
            raise SingularSystemError
        if self._method.stage_solver == "fixed-point":  # fixed-point iteration has no stage matrix
            return StagePivots(empty_pattern(), example_of(Scatter), h)
        systems = self._single.bundle.systems
        return StagePivots(systems.pattern, systems.scatter, h)


def collocation_in_lanes(
    method: ImplicitRungeKutta, workspace: Workspace, pivots: StagePivots, control: Control | None
) -> Stages:
    """Return the bundle of a fully implicit method for lanes with these pivots; `control` is None for fixed steps."""
    single = CompiledCollocation(method, workspace, control)
    systems = new_systems(single.rk, pivots.pattern, pivots.scatter, workspace.unknowns)
    return _in_lanes(single.bundle._replace(systems=systems))


def _in_lanes(single: Stages) -> Stages:
    """Return the bundle for lanes that corresponds to that of a single run; `rk` and `settings` hold numbers."""
    lanes: Stages = widened(single)
    kept = LaneKept(widened(single.lam), new_lanes(5), new_lanes(1))
    return lanes._replace(rk=single.rk, settings=single.settings, kept=kept)


def load_stage_pivots(m: Stages, pivots: Sequence[StagePivots]) -> None:
    """Copy the scaling of the pivots of each lane, and discard the stages and counts of earlier runs."""
    for name in ("row_scale", "column_scale", "weight"):
        getattr(m.systems.pattern, name)[...] = np.stack([getattr(chosen.pattern, name) for chosen in pivots], axis=-1)
    for factors in (m.systems.real, m.systems.cplx):
        factors.reference[...] = 0.0
    m.previous.size[...] = np.nan
    m.kept.counts[...] = 0.0


@inlined
def _take_step(c, m, t, h, n):
    solve_stages(c, m, t, h, False, True, KERNELS)
    complete_step(c, m, t, h, KERNELS)
    if c.has_power[0] != 0 and c.watch.has_loops[0] != 0:  # otherwise, the increment is that of the last iteration
        c.watch.distance[0] = distance_by_pivots(c.solver.schur)


def _example() -> LaneRun:
    return new_lane_run(_in_lanes(example_stages()), example_workspace(), 1)


load_lane_collocation = bundle_loader(_example)


@kernel
def drive_collocation(address: int) -> int:
    """Take fixed steps of a fully implicit method; see `mbdkit.integrators.lanes.lane_loop.drive`."""
    return drive(load_lane_collocation(address), _take_step)


@subkernel
def _begin_steps(s, t, running):
    """Write the accelerations at the beginning of the steps, and count their evaluation as a single run would.

    After a rejection, they are known. Otherwise they are those of the last stage, if this is the end of the step.
    """
    c, m = s.run, s.run.method
    first, last = m.first, len(m.rk.c) - 1
    accepted = s.progress.retrying[0] == 0.0
    if s.attempts[0] > 0 and m.rk.c[last] == 1.0:
        for d in range(len(first.acc)):
            first.acc[d] = where(accepted, m.acc[last, d], first.acc[d])
        for k in range(len(first.lam)):
            for r in range(2):
                first.lam[k, r] = where(accepted, m.lam[last, k, r], first.lam[k, r])
        return
    first.known[0] = 0
    first_acceleration(c, m, t)
    hold_counts(c, m, running & accepted)


@subkernel
def _attempt(s, t, h, running):
    """Attempt a step of each lane; see `mbdkit.integrators.lanes.lane_control.LaneStep`.

    As in single runs, the iteration is careful (`mbdkit.integrators.stages.collocation_step.try_step`).
    """
    c, m = s.run, s.run.method
    _begin_steps(s, t, running)
    m.kept.diverged[0] = 0.0
    solve_stages(c, m, t, h, True, running, KERNELS)
    unsolved = m.kept.diverged[0] != 0.0
    complete_step(c, m, t, h, KERNELS)
    hold_counts(c, m, running & (not unsolved))
    estimate_errors(c, m, h, s, KERNELS)
    if c.has_power[0] != 0 and c.watch.has_loops[0] != 0:
        c.watch.distance[0] = distance_by_pivots(c.solver.schur)
    return unsolved


@subkernel
def _evaluate_further(s, t, h, due):
    """Evaluate nothing: the stages of the step suffice for dense output."""


CONTROLLED = LaneStep(_attempt, _evaluate_further, state_inside)
load_controlled = bundle_loader(lambda: new_lane_control(_example(), Control()))


@kernel
def drive_collocation_controlled(address: int) -> int:
    """Take controlled steps of a fully implicit method; see
    `mbdkit.integrators.lanes.lane_control.drive_controlled`.
    """
    return drive_controlled(load_controlled(address), CONTROLLED)


COLLOCATION_IN_LANES = InLanes(drive_collocation, drive_collocation_controlled, collocation_in_lanes)
