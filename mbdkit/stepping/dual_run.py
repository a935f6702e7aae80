"""Arrays of a run that is differentiated: its state with derivatives by parameters, and the rows that are recorded.

The run itself is advanced as any other. After each of its steps, a kernel repeats the step with dual numbers
(`mbdkit.engine.jit.dual_types`), from the same base state, and so obtains the derivatives of the discrete solution.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mbdkit.engine.example_workspace import example_workspace
from mbdkit.engine.jit.bundle import bundle_loader
from mbdkit.engine.jit.decorators import subkernel
from mbdkit.engine.jit.dual_arrays import ITEM, Duals, new_complex_duals, new_duals
from mbdkit.engine.jit.dual_types import with_value
from mbdkit.engine.kernels.dual_observe import DualStates
from mbdkit.engine.kernels.dual_system import DualSolver, new_dual_solver
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.system import Engine, Scratch, Topology
from mbdkit.engine.workspace import Workspace, new_scratch
from mbdkit.stepping.run_state import MODIFIED


class DualRun(NamedTuple):
    """A differentiated run for compiled code. Arrays are dual unless stated otherwise; shapes are as in `RunState`."""

    top: Topology
    still: Topology
    w: Scratch
    solver: DualSolver
    has_power: np.ndarray
    """(1,) number: whether work or dissipated energy can change."""
    q: np.ndarray
    """State between two steps."""
    v: np.ndarray
    energy: np.ndarray
    from_q: np.ndarray
    """Base state of the step."""
    from_v: np.ndarray
    v_low: np.ndarray
    """Zeros; numbers."""
    base_state: np.ndarray
    """(1,) number: as in `RunState`, before the step."""
    dq: np.ndarray
    dv: np.ndarray
    gain: np.ndarray
    rest: np.ndarray
    """Zeros."""
    new_q: np.ndarray
    """State at the end of a step, before projection."""
    new_v: np.ndarray
    push: np.ndarray
    """(3 (B + 1),) and (P, 2) work arrays of projections."""
    mu: np.ndarray
    miss: np.ndarray
    counts: np.ndarray
    """(5,) numbers: counts, which are not used."""
    row_q: np.ndarray
    """Recorded states, (R, ...)."""
    row_v: np.ndarray
    row_energy: np.ndarray
    node_time: np.ndarray
    """Stages of the steps, if they are kept: (N,) times and (N,) weights, which are numbers, and (N, ...) states."""
    node_weight: np.ndarray
    node_q: np.ndarray
    node_v: np.ndarray
    nodes: np.ndarray
    """(2,) numbers: whether the stages are kept, and how many there are in `node_time`."""


Seeds = Mapping[str, np.ndarray]
"""Derivatives of arrays of a `Topology` by its field, (..., K) for K parameters; arrays without derivatives are absent.
Those of the initial state have the names ``q`` and ``v``."""


def constants(values: np.ndarray, derivatives: np.ndarray | None = None) -> Duals:
    """Return an array of dual numbers with given derivatives (..., K), or without."""
    x = new_duals(*values.shape)
    x[..., 0] = values
    if derivatives is not None:
        x[..., 1 : 1 + derivatives.shape[-1]] = derivatives
    return x


def with_derivatives(given: Any) -> Any:
    """Return a bundle with arrays of dual numbers in place of arrays of floating-point numbers; or such an array."""
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
    """Return working arrays of dual numbers; times are numbers, and share the clamps of motions with the workspace."""
    plain, offsets = new_scratch(workspace.mechanism)
    scratch: Scratch = with_derivatives(plain)
    views = {}
    for name, begin in offsets.items():
        if name != "mass":
            rows, columns = getattr(plain, name).shape
            views[name] = scratch.source[begin : begin + rows * columns].reshape(rows, columns, ITEM)
    return scratch._replace(time=plain.time, sides=workspace.scratch.sides, **views)


def new_dual_run(workspace: Workspace, seeds: Seeds, laws: np.ndarray, rows: int, nodes: int) -> DualRun:
    """Return the bundle of a differentiated run at its start.

    Parameters
    ----------
    workspace
        The mechanism and its start; its working arrays are used for the values.
    seeds
        Derivatives of the mechanism and of the start by up to `DIRECTIONS` parameters.
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
    vector = [new_duals(size) for _ in range(8)]
    return DualRun(
        top=top, still=top._replace(gravity=nothing, baumgarte=nothing), w=dual_scratch(workspace),
        solver=new_dual_solver(numbers, mechanism.row_index), has_power=np.array([int(mechanism.has_power)]),
        q=constants(workspace.q0, seeds.get("q")), v=constants(workspace.v0, seeds.get("v")), energy=new_duals(2),
        from_q=vector[0], from_v=vector[1], v_low=np.zeros(size), base_state=np.array([MODIFIED]),
        dq=vector[2], dv=vector[3], gain=new_duals(2), rest=vector[4], new_q=vector[5], new_v=vector[6],
        push=vector[7], mu=new_duals(pairs, 2), miss=new_duals(pairs, 2), counts=np.zeros(5, dtype=np.int64),
        row_q=new_duals(rows, size), row_v=new_duals(rows, size), row_energy=new_duals(rows, 2),
        node_time=np.zeros(nodes), node_weight=np.zeros(nodes),
        node_q=new_duals(nodes, size), node_v=new_duals(nodes, size), nodes=np.array([int(nodes > 0), 0]),
    )  # fmt: skip


def _example() -> DualRun:
    return new_dual_run(example_workspace(), {}, np.zeros((0, 3), dtype=np.int64), 1, 0)


load_dual_run = bundle_loader(_example)


@subkernel
def take_base(c, n):
    """Begin the differentiated step `c` at the base state of the step that the run `n` has taken."""
    for d in range(len(c.q)):
        c.from_q[d] = with_value(c.q[d], n.from_q[d])
        c.from_v[d] = with_value(c.v[d], n.from_v[d])


@subkernel
def advance(c, n, row):
    """Advance the derivatives by a step; its end, with the values of the run, is recorded in a row unless it is < 0."""
    for d in range(len(c.q)):
        c.q[d] = with_value(c.q[d] + c.dq[d], n.q[d])
        c.v[d] = with_value(c.v[d] + c.dv[d], n.v[d])
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


def dual_states(run: DualRun, workspace: Workspace, time: np.ndarray, q: Duals, v: Duals) -> DualStates:
    """Return states of a differentiated run for `mbdkit.engine.kernels.dual_observe.observe_duals`."""
    baumgarte = new_duals(2)
    observed: Observed = with_derivatives(Observed.zeros(len(time), workspace.mechanism.topology))
    q, v = (np.ascontiguousarray(x).view(Duals) for x in (q, v))
    return DualStates(run.top._replace(baumgarte=baumgarte), run.w, run.solver, time, q, v, observed)
