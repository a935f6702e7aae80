"""Vectorized runs of collocation methods on the index-1 equations, and of other fully implicit Runge-Kutta methods.

Several runs advance together, one in each *lane* of a SIMD vector (`mbdkit.stepping.lane_loop`). The step is that of
single runs (`mbdkit.stepping.collocation_step`), compiled for lanes. All lanes share the pivots of the stage matrix, so
that only runs with equal pivots can share a loop; `StagePivoting` chooses them as single runs do. The scaling of the
matrix may differ between lanes. A run that later needs other pivots, a more careful iteration or more iterations is
*lost*, that is, repeated alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError, empty_pattern
from mbdkit.engine.kernels.bundle_types import example_of
from mbdkit.engine.kernels.lu import Pattern
from mbdkit.engine.kernels.system import Scatter
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import inlined, kernel
from mbdkit.engine.native.number_arrays import new_lanes
from mbdkit.engine.workspace import Workspace, example_workspace
from mbdkit.methods.kinds import ImplicitRungeKutta
from mbdkit.stepping.collocation import CompiledCollocation
from mbdkit.stepping.collocation_index1 import KERNELS
from mbdkit.stepping.collocation_stages import (
    Coefficients,
    Constraints,
    FirstAcceleration,
    PreviousStep,
    Settings,
    Stages,
    StageStates,
    Systems,
    TangentState,
    example_stages,
    new_systems,
)
from mbdkit.stepping.collocation_step import complete_step, solve_stages
from mbdkit.stepping.lane_loop import drive
from mbdkit.stepping.lane_run import LaneRun, new_lane_run, widened
from mbdkit.stepping.step_guards import distance_by_pivots


class LaneKept(NamedTuple):
    """Copies of values, which are restored in lanes that have converged; see `mbdkit.stepping.stage_iteration`."""

    lam: np.ndarray
    """(s, P, 2) multipliers of the stages."""
    counts: np.ndarray
    """(5,) counts."""


class LaneStages(NamedTuple):
    """The stages of `WIDTH` runs; see `mbdkit.stepping.collocation_stages.Stages`, which has the same fields."""

    rk: Coefficients
    """The arrays of `rk` and of `settings` hold numbers; all others hold lanes."""
    systems: Systems
    settings: Settings
    previous: PreviousStep
    solved_apart: np.ndarray
    turning: np.ndarray
    nodes: np.ndarray
    acc: np.ndarray
    lam: np.ndarray
    q_stage: np.ndarray
    v_stage: np.ndarray
    residual: np.ndarray
    change: np.ndarray
    states: StageStates
    constraints: Constraints
    first: FirstAcceleration
    tangent: TangentState
    power: np.ndarray
    weights: np.ndarray
    spread: np.ndarray
    kept: LaneKept


class StagePivots(NamedTuple):
    """Pivots of the stage matrix of a run, as chosen at its start."""

    pattern: Pattern
    scatter: Scatter

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
            return StagePivots(empty_pattern(), example_of(Scatter))
        systems = self._single.bundle.systems
        return StagePivots(systems.pattern, systems.scatter)


def collocation_in_lanes(method: ImplicitRungeKutta, workspace: Workspace, pivots: StagePivots) -> LaneStages:
    """Return the bundle of a fully implicit method for lanes with these pivots."""
    single = CompiledCollocation(method, workspace, None)
    assert isinstance(single.bundle, Stages)
    systems = new_systems(single.rk, pivots.pattern, pivots.scatter, workspace.unknowns)
    return _in_lanes(single.bundle._replace(systems=systems))


def _in_lanes(single: Stages) -> LaneStages:
    """Return the bundle for lanes that corresponds to that of a single run."""
    given = single._asdict()
    numbers = {name: given.pop(name) for name in ("rk", "settings")}
    lanes = {name: widened(given[name]) for name in LaneStages._fields if name in given}
    return LaneStages(**numbers, **lanes, kept=LaneKept(widened(single.lam), new_lanes(5)))


def load_stage_pivots(m: LaneStages, pivots: Sequence[StagePivots]) -> None:
    """Copy the scaling of the pivots of each lane, and discard the stages of earlier runs."""
    for name in ("row_scale", "column_scale", "weight"):
        getattr(m.systems.pattern, name)[...] = np.stack([getattr(one.pattern, name) for one in pivots], axis=-1)
    for factors in (m.systems.real, m.systems.cplx):
        factors.reference[...] = 0.0
    m.previous.size[...] = np.nan


@inlined
def _take_step(c, m, t, h, n):
    """Solve the stages of a step and write its increments; see `mbdkit.stepping.lane_loop.drive`."""
    solve_stages(c, m, t, h, False, KERNELS)
    complete_step(c, m, t, h, KERNELS)
    if c.has_power[0] != 0 and c.watch.has_loops[0] != 0:  # otherwise, the increment is that of the last iteration
        c.watch.distance[0] = distance_by_pivots(c.solver.schur)


def _example() -> LaneRun:
    """Return a bundle that provides the types of its arrays."""
    return new_lane_run(_in_lanes(example_stages()), example_workspace(), 1)


load_lane_collocation = bundle_loader(_example)


@kernel
def drive_collocation(address: int) -> int:
    """Take the steps of a fully implicit method; see `mbdkit.stepping.lane_loop.drive`."""
    return drive(load_lane_collocation(address), _take_step)
