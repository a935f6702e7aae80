"""Arrays of a run that is differentiated: its state with derivatives with respect to parameters, and the rows that are
recorded.

The run itself is advanced like any other. After each of its steps, a kernel repeats the step with dual numbers
(`mbdkit_builder.dual_types`), from the same base state, which gives the derivatives of the discrete solution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_system
from mbdkit.engine.kernels.bundle_types import State
from mbdkit.engine.kernels.dual_observe import DualStates
from mbdkit.engine.kernels.dual_system import DualSolver, new_dual_solver
from mbdkit.engine.kernels.engine_bundles import Engine, Scratch, Topology
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.projection import position_rows, rate_rows
from mbdkit.engine.kernels.system import DIVERGED, OK, solved_rows
from mbdkit.engine.kernels.table_rows import STATE_ROW
from mbdkit.engine.native.arithmetic import larger_derivatives, largest_quotient, value_of, with_value
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import subkernel
from mbdkit.engine.native.number_arrays import Duals, new_complex_duals, new_duals
from mbdkit.engine.workspace import Workspace, example_workspace, scratch_of
from mbdkit.integrators.run.run_state import MODIFIED

MOST_PROJECTIONS = 50
#: Largest number of iterations of a projection, and relative change of the derivatives at which the iteration ends.
NEGLIGIBLE = 1e-14


class DualRun(NamedTuple):
    """A differentiated run for compiled code. Arrays are dual unless stated otherwise; shapes are as in `RunState`."""

    top: Topology
    still: Topology
    w: Scratch
    solver: DualSolver
    has_power: np.ndarray  #: (1,) number: whether work or dissipated energy can change.
    q: State  #: State between two steps.
    v: State
    z: State
    energy: State
    from_q: np.ndarray  #: Base state of the step.
    from_v: np.ndarray
    from_z: np.ndarray
    q_low: np.ndarray
    v_low: np.ndarray  #: Low parts of compensated sums; numbers that are zero here.
    base_state: State  #: (1,) number: ``RunState.base_state`` before the step.
    dq: np.ndarray
    dv: np.ndarray
    dz: np.ndarray
    gain: np.ndarray
    projected: np.ndarray  #: (1,) number: whether the run has projected the end of the step.
    #: (1,) dual number: each derivative is 1 over the size of its parameter, or 0 if there is no parameter for it.
    unit: np.ndarray
    rest: np.ndarray  #: Velocities of a mechanism at rest: zeros.
    end_q: np.ndarray  #: Positions at the end of a step, before projection.
    push: np.ndarray  #: (3 (B + 1),) and (P, 2) work arrays of projections, and of stages on the constraints.
    mu: np.ndarray
    miss: np.ndarray
    counts: np.ndarray  #: (5,) numbers: counts of the kernels that are called, which nothing reads.
    row_q: np.ndarray  #: Recorded states, (R, ...).
    row_v: np.ndarray
    row_energy: np.ndarray
    #: Stages of the steps, if they are stored: (N,) times and (N,) weights, which are numbers, and (N, ...) states.
    node_time: np.ndarray
    node_weight: np.ndarray
    node_q: np.ndarray
    node_v: np.ndarray
    nodes: State  #: (2,) numbers: whether the stages are stored, and how many there are in `node_time`.


@dataclass(frozen=True)
class Seeds:
    """Derivatives, with respect to K parameters, of the input of a run.

    Attributes
    ----------
    arrays
        Derivatives (..., K) of arrays of a `Topology` by its field, of the initial state by the names ``q`` and ``v``,
        and of other arrays that results depend on; arrays without derivatives are absent.
    scale
        (K,) size of each parameter.
    """

    arrays: Mapping[str, np.ndarray]
    scale: np.ndarray

    @property
    def count(self) -> int:
        """Number of parameters."""
        return len(self.scale)

    def get(self, name: str) -> np.ndarray | None:
        """Return the derivatives of an array; None if it has none."""
        return self.arrays.get(name)

    def only(self, some: slice) -> Seeds:
        """Return the derivatives with respect to the parameters in a slice."""
        return Seeds({name: x[..., some] for name, x in self.arrays.items()}, self.scale[some])


NO_SEEDS = Seeds({}, np.zeros(0))  #: No parameters.


def constants(values: np.ndarray, derivatives: np.ndarray | None = None) -> Duals:
    """Return an array of dual numbers with these values and derivatives (..., K), which are 0 if none are given."""
    x = new_duals(*values.shape)
    x[..., 0] = values
    if derivatives is not None:
        x[..., 1 : 1 + derivatives.shape[-1]] = derivatives
    return x


def with_derivatives(given: Any) -> Any:
    """Return a bundle, or an array, with dual numbers in place of floating-point numbers; integers stay as they are."""
    if isinstance(given, tuple):
        return type(given)(*map(with_derivatives, given))
    if given.dtype.kind == "c":
        return new_complex_duals(*given.shape)
    return constants(given) if given.dtype.kind == "f" else given


def dual_topology(top: Topology, seeds: Seeds, laws: np.ndarray) -> Topology:
    """Return a mechanism whose numbers have derivatives.

    Parameters
    ----------
    laws
        The laws compiled for dual numbers, in the form of ``top.laws``.
    """
    fields = {
        name: constants(values, seeds.get(name)) if values.dtype.kind == "f" else values
        for name, values in top._asdict().items()
    }
    return Topology(**fields)._replace(laws=laws)


def dual_scratch(workspace: Workspace) -> Scratch:
    """Return working arrays of dual numbers.

    Times are numbers. The limits of the times at which motions are evaluated are shared with the workspace.
    """
    scratch = scratch_of(workspace.mechanism, with_derivatives)
    return scratch._replace(time=np.zeros(1), sides=workspace.scratch.sides)


def new_dual_run(workspace: Workspace, seeds: Seeds, laws: np.ndarray, rows: int, nodes: int) -> DualRun:
    """Return the bundle of a differentiated run at its start.

    Parameters
    ----------
    workspace
        The mechanism and its start; its working arrays are used for the values.
    seeds
        Derivatives of the mechanism and of the start with respect to up to `DIRECTIONS` parameters.
    laws
        See `dual_topology`.
    rows, nodes
        Sizes of the buffers of recorded states and of stages.
    """
    mechanism = workspace.mechanism
    top = dual_topology(workspace.stepping_topology, seeds, laws)
    nothing = new_duals(2)
    size, pairs = mechanism.size, len(top.pairs)
    numbers = Engine(workspace.stepping_topology, workspace.scratch, workspace.solver)
    vector = [new_duals(size) for _ in range(7)]
    unit = constants(np.zeros(1), 1.0 / seeds.scale[None])
    places = top.states[:, STATE_ROW.parameter]
    z = np.ascontiguousarray(top.law_parameters[places]).view(Duals)
    return DualRun(
        top=top, still=top._replace(gravity=nothing, baumgarte=nothing),
        w=dual_scratch(workspace)._replace(law_values=top.law_parameters),
        solver=new_dual_solver(numbers, mechanism.row_index), has_power=np.array([int(mechanism.has_power)]),
        q=constants(workspace.q0, seeds.get("q")), v=constants(workspace.v0, seeds.get("v")), z=z, energy=new_duals(2),
        from_q=vector[0], from_v=vector[1], from_z=new_duals(len(places)),
        q_low=np.zeros(size), v_low=np.zeros(size), base_state=np.array([MODIFIED]),
        dq=vector[2], dv=vector[3], dz=new_duals(len(places)), gain=new_duals(2),
        projected=np.zeros(1, dtype=np.int64), unit=unit,
        rest=vector[4], end_q=vector[5], push=vector[6], mu=new_duals(pairs, 2), miss=new_duals(pairs, 2),
        counts=np.zeros(5, dtype=np.int64),
        row_q=new_duals(rows, size), row_v=new_duals(rows, size), row_energy=new_duals(rows, 2),
        node_time=np.zeros(nodes), node_weight=np.zeros(nodes),
        node_q=new_duals(nodes, size), node_v=new_duals(nodes, size), nodes=np.array([int(nodes > 0), 0]),
    )  # fmt: skip


def _example() -> DualRun:
    return new_dual_run(example_workspace(), NO_SEEDS, np.zeros((0, 3), dtype=np.int64), 1, 0)


load_dual_run = bundle_loader(_example)


@subkernel
def take_base(c, n):
    """Begin the differentiated step `c` at the base state of the step that the run `n` has taken."""
    for d in range(len(c.q)):
        c.from_q[d] = with_value(c.q[d], n.from_q[d])
        c.from_v[d] = with_value(c.v[d], n.from_v[d])
    for d in range(len(c.z)):
        c.from_z[d] = with_value(c.z[d], n.from_z[d])


@subkernel
def _project(c, n):
    """Differentiate the projection of the end of a step, positions ``c.end_q`` and velocities `c.v`; return a status.

    The projected positions p satisfy ``M (p - q) + Phi_q(p)^T mu = 0`` and ``Phi(p) = 0``. Their derivatives follow by
    the iteration of `mbdkit.engine.kernels.projection.project_positions` with the values of the run.
    """
    t = n.progress.time[0]
    still, w = c.still, c.w
    bodies = len(still.mass) - 1
    for d in range(len(c.q)):
        c.q[d] = with_value(c.end_q[d], n.q[d])
    converged = False
    for _ in range(MOST_PROJECTIONS):
        position_rows(still, w, t, c.q)
        solved_rows(still, w, c.q, c.rest)
        for k in range(len(w.phi)):
            for r in range(2):
                w.gamma[k, r] = -w.phi[k, r]
        for b in range(bodies):
            for i in range(3):
                w.force[3 * b + i] = still.mass[b, i] * (c.end_q[3 * b + i] - c.q[3 * b + i])
        status = solve_system(still, w, c.solver, True, c.push, c.mu, True)
        if status != OK:
            return status
        for d in range(3 * bodies):
            c.q[d] = with_value(c.q[d] + c.push[d], n.q[d])
        if relative_change(c, c.push, c.q, 1.0) < NEGLIGIBLE:
            converged = True
            break
    if not converged:
        return DIVERGED
    for _ in range(2):  # the equations are linear; the second solution removes rounding errors
        position_rows(still, w, t, c.q)
        solved_rows(still, w, c.q, c.v)
        rate_rows(still, w.jac, w.phi_t, c.v, c.miss)
        for k in range(len(w.gamma)):
            for r in range(2):
                w.gamma[k, r] = -c.miss[k, r]
        status = solve_system(still, w, c.solver, False, c.push, c.mu, True)
        if status != OK:
            return status
        for d in range(3 * bodies):
            c.v[d] += c.push[d]
    for d in range(len(c.v)):
        c.v[d] = with_value(c.v[d], n.v[d])
    return OK


@subkernel
def relative_change(c, change, x, factor):
    """Return the largest derivative of `factor` times a change of `x`, relative to the largest derivative of `x`.

    Derivatives are at least as large as the largest value over the size of the parameter: this lower bound is needed
    because derivatives that cancel to zero consist of round-off.
    """
    most, size, value = factor * change[0], x[0], 0.0
    for d in range(len(x) - 3):
        most = larger_derivatives(most, factor * change[d])
        size = larger_derivatives(size, x[d])
        value = max(value, abs(value_of(x[d])))
    return largest_quotient(most, size + value * c.unit[0])


@subkernel
def advance(c, n, row):
    """Advance the derivatives by a step, and return a status.

    The end of the step, with the values of the run, is recorded in a row unless `row` is negative.
    """
    if c.projected[0] != 0:
        for d in range(len(c.q)):
            c.end_q[d] = c.q[d] + c.dq[d]
            c.v[d] += c.dv[d]
        status = _project(c, n)
        if status != OK:
            return status
    else:
        for d in range(len(c.q)):
            c.q[d] = with_value(c.q[d] + c.dq[d], n.q[d])
            c.v[d] = with_value(c.v[d] + c.dv[d], n.v[d])
    for d in range(len(c.z)):
        c.z[d] = with_value(c.z[d] + c.dz[d], n.z[d])
    if c.has_power[0] != 0:
        for k in range(2):
            c.energy[k] = with_value(c.energy[k] + c.gain[k], n.energy[k])
    c.base_state[0] = n.base_state[0]
    if row >= 0:
        for d in range(len(c.q)):
            c.row_q[row, d] = c.q[d]
            c.row_v[row, d] = c.v[d]
        for k in range(2):
            c.row_energy[row, k] = c.energy[k]
    return OK


def dual_states(run: DualRun, workspace: Workspace, time: np.ndarray, q: Duals, v: Duals) -> DualStates:
    """Return states of a differentiated run for `mbdkit.engine.kernels.dual_observe.observe_duals`."""
    baumgarte = new_duals(2)
    observed: Observed = with_derivatives(Observed.zeros(len(time), workspace.mechanism.topology))
    q, v = (np.ascontiguousarray(x).view(Duals) for x in (q, v))
    top, power, lack = run.top._replace(baumgarte=baumgarte), new_duals(len(time), 2), new_duals(*q.shape[:-1])
    return DualStates(top, run.w, run.solver, time, q, v, observed, power, lack)
