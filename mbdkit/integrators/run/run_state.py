"""State, work arrays and results of a run, shared by the compiled step loop and all compiled methods.

The arrays are stored in a bundle (`mbdkit.engine.native.bundle`), whose address is passed to the kernels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels.bundle_types import STATE, Record, State
from mbdkit.engine.kernels.engine_bundles import Scratch, Solver, Topology
from mbdkit.engine.kernels.vectors import add_compensated
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import subkernel
from mbdkit.engine.workspace import example_workspace
from mbdkit.integrators.run.step_guards import GuardState, new_guard_state

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace

#: Relation of the base state of an attempt to the last attempt: equal to its end, equal to its start, or modified.
#: Accordingly, methods may reuse values of the last stage of the last attempt, those of its first stage, or none.
AT_END_OF_LAST, AT_START_OF_LAST, MODIFIED = range(3)

#: Indices of ``counts``: right-hand sides, Jacobians, factorizations, Newton iterations, projections.
RHS, JACOBIANS, FACTORIZATIONS, ITERATIONS, PROJECTIONS = range(5)


class Progress(NamedTuple):
    """Progress of a run; each array has one element."""

    time: np.ndarray  #: Time reached [s], and the low part of its compensated sum.
    time_low: np.ndarray
    next_size: np.ndarray  #: Size of the next step with step size control [s].
    last_size: np.ndarray  #: Size of the last accepted step [s].
    #: Size of the part of the attempted step that the method has taken [s], if that ends at an event of the method; 0
    #: for whole steps.
    part: np.ndarray
    #: Scaled error of the last accepted step; 0 before the first, and if it says nothing about the next step.
    last_error: np.ndarray
    earlier_error: np.ndarray  #: Scaled error of the accepted step before that one, in the same way, and its size [s].
    earlier_size: np.ndarray
    next_row: np.ndarray  #: Number of the next row to be recorded at equidistant times.
    tried_begin: np.ndarray  #: Start and size of the last attempt [s].
    tried_size: np.ndarray
    restart: np.ndarray  #: Start of the next step after a stop or a part of a step [s].
    #: Time of a soft stop besides those of the plan, at which an open run pauses [s]; infinite if there is none.
    pause: np.ndarray
    accepted: np.ndarray  #: Number of accepted steps.
    rejected: np.ndarray  #: Number of rejected steps.
    #: Whether there is a pending step: it is accepted, but its rows are not yet written, and the state is still that at
    #: its start.
    pending: np.ndarray
    retrying: np.ndarray  #: Whether the last attempt was rejected.
    whole: np.ndarray  #: Number of accepted fixed steps; one that is split at a stop counts once.
    passed: np.ndarray  #: Number of stops passed.
    at_stop: np.ndarray  #: Whether the step accepted last ends at a stop.
    after_stop: np.ndarray  #: Whether the next step begins at a stop.
    after_part: np.ndarray  #: Whether the step accepted last is a part of a step, so that the next one is its rest.

    @property
    def counts(self) -> tuple[np.ndarray, ...]:
        """The integer fields."""
        return self[-9:]


class Interval(NamedTuple):
    """Work done since the last recorded row. ``values`` (9,) contains the other fields, of one element each."""

    values: State
    steps: np.ndarray
    last_size: np.ndarray  #: Size of the last step [s].
    iterations: np.ndarray  #: Newton iterations, and the largest number of them in one step.
    iterations_max: np.ndarray
    rejected: np.ndarray  #: Rejected steps.
    projections: np.ndarray
    #: Largest correction by a projection in the mass metric, of positions [m] and of velocities [m/s].
    position_correction: np.ndarray
    velocity_correction: np.ndarray
    baumgarte_term: np.ndarray  #: Largest of Baumgarte's terms [m/s^2, rad/s^2].


INTERVAL_FIELDS = Interval._fields[1:]  #: Columns of ``row_interval``.


def new_progress() -> Progress:
    """Return the progress at the start of a run."""
    reals, counts = np.zeros((13, 1)), np.zeros((9, 1), dtype=np.int64)
    reals[12] = np.inf
    return Progress(*reals, *counts)


def new_interval() -> Interval:
    """Return an interval without steps."""
    values = np.zeros(len(INTERVAL_FIELDS))
    return Interval(values, *values.reshape(-1, 1))


class RunState(NamedTuple):
    """Data of a run for the compiled step loop. Vectors are (3 (B + 1),), ground last; multipliers are (P, 2) by pair.

    Arrays that a step reads of the previous step are declared as `State`; see `mbdkit.engine.kernels.bundle_types`.
    """

    top: Topology  #: The mechanism, with Baumgarte's terms if the run is stabilized by them.
    #: The mechanism without gravity and without Baumgarte's terms, for systems with a given right-hand side.
    still: Topology
    w: Scratch
    solver: Solver
    has_power: np.ndarray  #: (1,) whether work or dissipated energy can change.
    #: State between two steps. `q_low`, `v_low`, `z_low` and `energy_low` are the low parts of compensated sums.
    q: State
    q_low: State
    v: State
    v_low: State
    z: State  #: (Z,) first-order states of force elements, z' = f(t, q, v, z).
    z_low: State
    energy: State  #: (2,) work of loads and drivers, and dissipated energy [J].
    energy_low: State
    #: Base state of an attempt: the state, or in a symmetric projection the state plus the first correction.
    from_q: State
    from_v: State
    from_z: State
    #: (1,) AT_END_OF_LAST, AT_START_OF_LAST or MODIFIED: relation of the base state to the last attempt.
    base_state: State
    dq: State  #: Result of an attempt: increments of positions, velocities and first-order states.
    dv: State
    dz: State
    gain: State  #: (2,) increments of the energies, integrated with the weights of the method.
    own_lam: Record  #: Multipliers computed by the method itself, at the end of the step, in the rows of the pairs.
    est_q: np.ndarray  #: Estimates of the local error, if requested.
    est_v: np.ndarray
    est_z: np.ndarray
    second_q: np.ndarray  #: Second estimates, of lower order, for methods with two estimates.
    second_v: np.ndarray
    second_z: np.ndarray
    #: Result of dense output: positions, velocities, first-order states, energies gained since the start of the step,
    #: multipliers.
    point_q: np.ndarray
    point_v: np.ndarray
    point_z: np.ndarray
    point_gain: np.ndarray
    point_lam: np.ndarray
    new_q: np.ndarray  #: State at the end of the current step, with projection if there is one.
    new_v: np.ndarray
    shift_q: State  #: Change of the state at the end of the step by projection.
    shift_v: State
    #: (P, 2) multipliers of the symmetric projection, for positions and for velocities; the iteration of a step starts
    #: from those of the last step.
    mu: State
    nu: State
    rest: np.ndarray  #: Velocities of a mechanism at rest: zeros.
    x: np.ndarray  #: Work arrays of projections.
    lam: np.ndarray
    miss: np.ndarray
    before_q: np.ndarray  #: State at the start of the last step, if the plan asks for it.
    before_v: np.ndarray
    before_z: np.ndarray
    worst: Record  #: (P,) largest squared norm so far of the constraint residuals Phi of each pair of rows.
    counts: Record  #: (5,) RHS, JACOBIANS, FACTORIZATIONS, ITERATIONS, PROJECTIONS.
    report: np.ndarray  #: (3,) on divergence: largest change, its coordinate, number of iterations.
    progress: Annotated[Progress, STATE]
    interval: Interval
    guards: Annotated[GuardState, STATE]
    first_row: np.ndarray  #: (1,) number of recorded rows in the buffer that have not been collected yet.
    #: Recorded rows: (R,) times, (R, 3 (B + 1)) positions and velocities, (R, Z) first-order states, (R, 2) energies,
    #: (R, 9) intervals, (R, P, 2) multipliers.
    row_time: np.ndarray
    row_q: np.ndarray
    row_v: np.ndarray
    row_z: np.ndarray
    row_energy: np.ndarray
    row_interval: np.ndarray
    row_lam: np.ndarray  #: Empty if the method does not compute multipliers.
    #: Stages of accepted steps, if they are stored as quadrature nodes of time integrals: (N,) times and weights [s],
    #: and (N, 3 (B + 1)) positions and velocities.
    node_time: np.ndarray
    node_weight: np.ndarray
    node_q: np.ndarray
    node_v: np.ndarray
    #: (3,) address of the function ``keep`` of the method, or 0 if stages are not stored; number of stages stored in
    #: `node_time`; number of stages of a step.
    nodes: np.ndarray


def new_run_state(
    workspace: Workspace,
    rows: int,
    z: np.ndarray | None = None,
    *,
    own_multipliers: bool = False,
    stages: int = 0,
    nodes: int = 0,
) -> RunState:
    """Return the bundle of a run at its start.

    Parameters
    ----------
    workspace
        The mechanism and its start.
    rows
        Size of the buffer of recorded states.
    z
        (Z,) first-order states at the start; by default, the initial ones of the mechanism.
    own_multipliers
        Whether the method computes multipliers, which are then recorded.
    stages, nodes
        Number of stages of a step, and size of the buffer of stages that are stored as quadrature nodes.
    """
    top = workspace.stepping_topology
    size, pairs = workspace.mechanism.size, len(top.pairs)
    still = workspace.mechanism.topology._replace(gravity=np.zeros(2))

    def vector() -> np.ndarray:
        return np.zeros(size)

    def by_pair() -> np.ndarray:
        return np.zeros((pairs, 2))

    q, v = workspace.q0.copy(), workspace.v0.copy()
    z = (workspace.mechanism.initial_states if z is None else z).copy()
    return RunState(
        top=top, still=still, w=workspace.scratch, solver=workspace.solver,
        has_power=np.array([int(workspace.mechanism.has_power)]),
        q=q, q_low=vector(), v=v, v_low=vector(), z=z, z_low=np.zeros_like(z),
        energy=np.zeros(2), energy_low=np.zeros(2),
        from_q=q.copy(), from_v=v.copy(), from_z=z.copy(), base_state=np.array([MODIFIED]),
        dq=vector(), dv=vector(), dz=np.zeros_like(z), gain=np.zeros(2), own_lam=by_pair(),
        est_q=vector(), est_v=vector(), est_z=np.zeros_like(z),
        second_q=vector(), second_v=vector(), second_z=np.zeros_like(z),
        point_q=vector(), point_v=vector(), point_z=np.zeros_like(z), point_gain=np.zeros(2), point_lam=by_pair(),
        new_q=vector(), new_v=vector(), shift_q=vector(), shift_v=vector(),
        mu=by_pair(), nu=by_pair(), rest=vector(), x=vector(), lam=by_pair(), miss=by_pair(),
        before_q=q.copy(), before_v=v.copy(), before_z=z.copy(),
        worst=np.zeros(pairs), counts=np.zeros(5, dtype=np.int64), report=np.zeros(3),
        progress=new_progress(), interval=new_interval(), guards=new_guard_state(workspace.mechanism),
        first_row=np.zeros(1, dtype=np.int64),
        row_time=np.zeros(rows), row_q=np.zeros((rows, size)), row_v=np.zeros((rows, size)),
        row_z=np.zeros((rows, len(z))), row_energy=np.zeros((rows, 2)),
        row_interval=np.zeros((rows, len(INTERVAL_FIELDS))),
        row_lam=np.zeros((rows if own_multipliers else 0, pairs, 2)),
        node_time=np.zeros(nodes), node_weight=np.zeros(nodes),
        node_q=np.zeros((nodes, size)), node_v=np.zeros((nodes, size)),
        nodes=np.array([0, 0, stages], dtype=np.int64),
    )  # fmt: skip


@subkernel
def add_increments(c, wanted):
    """Add the increments of a step of the run `c` to its state by compensated sums; in lanes, only where `wanted`."""
    add_compensated(c.q, c.q_low, c.dq, wanted)
    add_compensated(c.v, c.v_low, c.dv, wanted)
    add_compensated(c.z, c.z_low, c.dz, wanted)
    if c.has_power[0] != 0:
        add_compensated(c.energy, c.energy_low, c.gain, wanted)


@subkernel
def keep_node(c, t, weight, q, v):
    """Store a stage of a step of the run `c` as a quadrature node of time integrals."""
    place = c.nodes[1]
    if c.nodes[0] == 0 or place >= len(c.node_time):
        return
    c.node_time[place] = min(
        max(t, c.w.sides[0]), c.w.sides[1]
    )  # motions are evaluated on the side of a discontinuity to which the step belongs
    c.node_weight[place] = weight
    for d in range(len(q)):
        c.node_q[place, d] = q[d]
        c.node_v[place, d] = v[d]
    c.nodes[1] = place + 1


load_run_state = bundle_loader(lambda: new_run_state(example_workspace(), 1))
