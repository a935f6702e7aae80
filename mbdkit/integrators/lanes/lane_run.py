"""Data of vectorized runs (`mbdkit.integrators.lanes.lane_loop`) for the compiled loop.

An array of lanes has `WIDTH` values for each element, one for each run; the shapes below do not include this number.
Fields described as numbers are ordinary arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mbdkit.engine.kernels.engine_bundles import LaneSolver, Scratch, Topology
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.singularity_kernels import COLUMNS
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.native.number_arrays import new_complex_lanes, new_lanes
from mbdkit.engine.workspace import Workspace, example_workspace, scratch_of
from mbdkit.expressions.program import MAX_DEPTH
from mbdkit.integrators.run.run_plan import Times
from mbdkit.integrators.run.step_guards import GuardState, new_guard_state
from mbdkit.integrators.stages.explicit import Explicit, explicit_on
from mbdkit.methods.kinds import ExplicitRungeKutta

#: Fields of `Topology` that functions of ordinary numbers read; their shape is (WIDTH, N), so that the values of a run
#: are contiguous.
BY_LANE = ("motion_values", "law_parameters")


class LaneWatch(NamedTuple):
    """State of the guard against a change of branch (`mbdkit.integrators.run.step_guards`), which processes one lane
    after another. The fields are arrays of numbers.
    """

    has_loops: np.ndarray  #: (1,) whether joints close a loop.
    guards: np.ndarray  #: (WIDTH,) addresses of the `GuardState` of each run.
    mass: np.ndarray  #: (WIDTH, B + 1, 3) masses.
    dq: np.ndarray  #: (3 (B + 1),) increment and velocity of one lane.
    v: np.ndarray
    distance: np.ndarray  #: (1,) distance to singularity in the last step; lanes.


class InLanes(NamedTuple):
    """The vectorized form of a family of methods."""

    drive: Callable[[int], int]  #: Loop over fixed steps, and over controlled ones.
    drive_controlled: Callable[[int], Any]
    #: Returns the bundle of the method, from the method, a workspace, pivots, and the control of the step size.
    bundle: Callable[..., Any]


class LaneRun(NamedTuple):
    """Data of `WIDTH` runs; vectors are (3 (B + 1),), ground last. See `mbdkit.integrators.run.run_state.RunState`."""

    top: Topology
    w: Scratch
    solver: LaneSolver
    method: Any  #: `Explicit`, or `mbdkit.integrators.stages.collocation_stages.Stages`.
    has_power: np.ndarray
    q: np.ndarray
    q_low: np.ndarray
    v: np.ndarray
    v_low: np.ndarray
    z: np.ndarray
    z_low: np.ndarray
    energy: np.ndarray
    energy_low: np.ndarray
    from_q: np.ndarray  #: The same arrays as `q`, `v` and `z`: steps are neither rejected nor projected.
    from_v: np.ndarray
    from_z: np.ndarray
    dq: np.ndarray
    dv: np.ndarray
    dz: np.ndarray
    gain: np.ndarray
    worst: np.ndarray
    counts: np.ndarray
    report: np.ndarray
    interval: np.ndarray  #: (2,) iterations since the last recorded state, and the largest number of them in one step.
    guards: GuardState  #: State of the energy guard; the other fields are not used.
    watch: LaneWatch
    times: Times  #: Without stops; the number of steps is the same for all lanes.
    every: np.ndarray  #: (1,) number of steps between recorded states; the same for all lanes.
    squared_misalignment: np.ndarray  #: (P,) and (1,) limits, see `mbdkit.integrators.run.run_plan.GuardLimits`.
    energy_share: np.ndarray
    lost: np.ndarray  #: (1,) 1 in lanes whose run must be repeated alone.
    near: np.ndarray  #: (P, 11) vectors from which the distance to singularity is computed.
    #: (R,) times of the recorded states, the initial one first; (R, 3 (B + 1)) positions and velocities; (R, Z)
    #: first-order states; (R, 2) energies; (R, 2) `interval`.
    row_time: np.ndarray
    row_q: np.ndarray
    row_v: np.ndarray
    row_z: np.ndarray
    row_energy: np.ndarray
    row_interval: np.ndarray
    observed: Observed  #: Values of the recorded states.


def widened(given: Any) -> Any:
    """Return a bundle, or an array, with lanes in place of floating-point numbers; integers stay as they are."""
    if isinstance(given, tuple):
        return type(given)(*map(widened, given))
    kinds = {"f": new_lanes, "c": new_complex_lanes}
    return kinds[given.dtype.kind](*given.shape) if given.dtype.kind in kinds else given


def _widened_scratch(workspace: Workspace, motions: int) -> Scratch:
    """Return working arrays of lanes; the arrays of terms are views of `Scratch.source`, as for a single run."""
    scratch = scratch_of(workspace.mechanism, widened)
    scratch.cs[-1, 0] = 1.0
    return scratch._replace(sides=np.array([-np.inf, np.inf]), stack=np.zeros((MAX_DEPTH + motions, 3)))


def explicit_in_lanes(method: ExplicitRungeKutta, workspace: Workspace) -> Explicit:
    """Return the bundle of an explicit method for lanes."""
    tableau = explicit_on(method, workspace)
    wide: Explicit = widened(tableau)
    in_lanes = ("rates", "accelerations", "z_rates", "q_stage", "z_stage", "lam", "power", "weights", "relative")
    return tableau._replace(**{name: getattr(wide, name) for name in in_lanes})


def new_lane_run(method: Any, workspace: Workspace, rows: int) -> LaneRun:
    """Return the bundle of `WIDTH` runs that record `rows` states, for the bundle of a method; see `LaneStepper`."""
    given = workspace.mechanism.topology
    size, pairs, motions = workspace.mechanism.size, len(given.pairs), len(given.motion_start) - 1
    by_lane = {name: np.zeros((WIDTH, len(getattr(given, name)))) for name in BY_LANE}
    top: Topology = widened(given)._replace(**by_lane, baumgarte=given.baumgarte)
    solver = LaneSolver(widened(workspace.solver.schur), workspace.solver.row_index, np.array([-1]))
    states = len(given.states)
    q, v, z = new_lanes(size), new_lanes(size), new_lanes(states)
    distance, energy_share, lost, start, end, step, last_step = (new_lanes(1) for _ in range(7))
    whole = np.zeros((2, 1), dtype=np.int64)
    return LaneRun(
        top=top, w=_widened_scratch(workspace, motions)._replace(law_values=top.law_parameters),
        solver=solver, method=method, has_power=np.zeros(1, dtype=np.int64),
        q=q, q_low=new_lanes(size), v=v, v_low=new_lanes(size), z=z, z_low=new_lanes(states),
        energy=new_lanes(2), energy_low=new_lanes(2),
        from_q=q, from_v=v, from_z=z, dq=new_lanes(size), dv=new_lanes(size), dz=new_lanes(states), gain=new_lanes(2),
        worst=new_lanes(pairs), counts=new_lanes(5), report=new_lanes(3), interval=new_lanes(2),
        guards=widened(new_guard_state(workspace.mechanism)),
        watch=LaneWatch(
            np.zeros(1, dtype=np.int64), np.zeros(WIDTH, dtype=np.int64), np.zeros((WIDTH, *given.mass.shape)),
            np.zeros(size), np.zeros(size), distance,
        ),
        times=Times(start, end, step, last_step, whole[0], *np.zeros((3, 0))), every=whole[1],
        squared_misalignment=new_lanes(pairs), energy_share=energy_share, lost=lost, near=new_lanes(pairs, COLUMNS),
        row_time=new_lanes(rows), row_q=new_lanes(rows, size), row_v=new_lanes(rows, size),
        row_z=new_lanes(rows, states), row_energy=new_lanes(rows, 2), row_interval=new_lanes(rows, 2),
        observed=widened(Observed.zeros(rows, given)),
    )  # fmt: skip


def example_lane_run() -> LaneRun:
    """Return a bundle that provides the types of its arrays."""
    from mbdkit.methods import rk4

    workspace = example_workspace()
    return new_lane_run(explicit_in_lanes(ExplicitRungeKutta(rk4.tableau()), workspace), workspace, 1)


load_lane_run = bundle_loader(example_lane_run)
load_guards = bundle_loader(lambda: new_guard_state(example_workspace().mechanism))
