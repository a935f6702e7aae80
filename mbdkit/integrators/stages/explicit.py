"""Explicit Runge-Kutta methods: one compiled step for every tableau, with error estimates and dense output.

The tableau can have more stages than the step requires; the additional ones are evaluated for dense output only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from mbdkit.engine.formulation import FORMULATIONS
from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.applied_forces import any_forces, applied_forces, state_rates, take_states
from mbdkit.engine.kernels.articulated import articulated_accelerations
from mbdkit.engine.kernels.bundle_types import RealMatrix, State
from mbdkit.engine.kernels.system import NOT_FINITE, OK, evaluate_powers, prepare
from mbdkit.engine.kernels.tree import accelerate_coordinates, coordinates_of, place_bodies, turn_tree
from mbdkit.engine.kernels.vectors import copy, fill, stays_finite
from mbdkit.engine.native.arithmetic import any_of
from mbdkit.engine.native.bundle import PinnedBundle, bundle_loader
from mbdkit.engine.native.functions import entry, inlined, subkernel
from mbdkit.engine.spanning_tree import is_tree_of_pins, spanning_tree
from mbdkit.integrators.run.run_state import AT_END_OF_LAST, FACTORIZATIONS, MODIFIED, RHS, keep_node, load_run_state
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.integrators.stages.relative import (
    BASE,
    BASE_RATES,
    V_STAGE,
    Relative,
    Y,
    end_of_step,
    errors_of_bodies,
    new_relative,
)
from mbdkit.integrators.stages.stage_polynomials import dense_gains, weights_at
from mbdkit.registry.target import Target

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.integrators.run.step_control import Control
    from mbdkit.methods.kinds import ExplicitRungeKutta


class Explicit(NamedTuple):
    """Coefficients and stages of an explicit method: S stages of the step, E stages including those of dense output."""

    a: np.ndarray  #: (E, E) coefficients.
    b: np.ndarray  #: (S,) weights of the step.
    c: np.ndarray  #: (E,) nodes.
    error: np.ndarray  #: (0, 1 or 2, S) weights of the error estimates; the estimate of higher order comes first.
    #: (E, degree) dense output: weight i at theta is ``sum_k dense[i, k] theta^(k + 1)``; no rows if there is none.
    dense: np.ndarray
    rates: State  #: (E, 3 (B + 1)) velocities and accelerations of the stages.
    accelerations: State
    z_rates: State  #: (E, Z) derivatives of the first-order states at the stages.
    q_stage: np.ndarray
    z_stage: np.ndarray
    lam: Annotated[RealMatrix, 2]
    power: State  #: (E, 2) power of loads and drivers, and dissipated power, at the stages [W].
    weights: np.ndarray  #: (E,) work array: weights of dense output.
    #: (2,) whether the last stage of a step is the first one of the next; number of stages evaluated so far.
    status: State
    relative: Relative


def new_explicit(
    method: ExplicitRungeKutta, size: int, pairs: int, states: int = 0, relative: Relative | None = None
) -> Explicit:
    """Return the bundle of a method; `size` is that of vectors, `pairs` and `states` are numbers of the mechanism."""
    a, b, c = method.tableau.floats()
    error, dense = np.zeros((0, len(b))), np.zeros((0, 1))
    if method.pair is not None:
        error, dense = method.pair.error, method.pair.dense
        if len(method.pair.c) > len(c):
            a, c = method.pair.a, method.pair.c
    stages = len(c)
    return Explicit(
        a=np.ascontiguousarray(a),
        b=b,
        c=np.ascontiguousarray(c),
        error=np.ascontiguousarray(error),
        dense=np.ascontiguousarray(dense),
        rates=np.zeros((stages, size)),
        accelerations=np.zeros((stages, size)),
        z_rates=np.zeros((stages, states)),
        q_stage=np.zeros(size),
        z_stage=np.zeros(states),
        lam=np.zeros((pairs, 2)),
        power=np.zeros((stages, 2)),
        weights=np.zeros(stages),
        status=np.array([int(method.tableau.is_first_same_as_last), 0]),
        relative=new_relative(size) if relative is None else relative,
    )


def explicit_on(method: ExplicitRungeKutta, workspace: Workspace) -> Explicit:
    """Return the bundle of a method for the mechanism and the formulation of a workspace."""
    top, size, relative = workspace.mechanism.topology, workspace.mechanism.size, None
    if FORMULATIONS[workspace.formulation].coordinates == "joint":
        tree = spanning_tree(top)
        relative = new_relative(size, tree, of_pins=is_tree_of_pins(top, tree))
    return new_explicit(method, size, len(top.pairs), len(top.states), relative)


def _example() -> Explicit:
    from mbdkit.methods import rk4
    from mbdkit.methods.kinds import ExplicitRungeKutta

    return new_explicit(ExplicitRungeKutta(rk4.tableau()), 6, 0)


load_explicit = bundle_loader(_example)


@subkernel
def stage_state(base, h, weights, slopes, i, out):
    """Write ``base + h sum_{j < i} weights[i, j] slopes[j]`` into `out`."""
    fill(out, 0.0)
    for j in range(i):
        w = weights[i, j]
        if w != 0.0:
            k = slopes[j]
            for d in range(len(out)):
                out[d] += w * k[d]
    for d in range(len(out)):
        out[d] = base[d] + h * out[d]


@subkernel
def _increment(h, weights, slopes, out):
    """Write ``h sum_j weights[j] slopes[j]`` into `out`."""
    fill(out, 0.0)
    for j in range(len(weights)):
        if any_of(weights[j] != 0.0):
            w, k = h * weights[j], slopes[j]
            for d in range(len(out)):
                out[d] += w * k[d]


@inlined
def is_relative(m):
    """Return whether the stages of a method are those of joint coordinates."""
    return len(m.relative.tree) > 0


@inlined
def _solve_stage(c, m, i, v):
    """Evaluate the accelerations of the bodies, the rates of first-order states and the power in stage `i`, with the
    velocities `v` of the bodies; return a status.
    """
    if len(c.top.states) > 0:
        take_states(c.top, c.w, m.z_stage)
    c.counts[RHS] += 1
    c.counts[FACTORIZATIONS] += 1
    status = solve_accelerations(c.top, c.w, c.solver, m.q_stage, v, m.accelerations[i], m.lam, False)
    if status == OK:
        if len(c.top.states) > 0:
            state_rates(c.top, c.w, v, m.z_rates[i])
        if c.has_power[0] != 0:
            m.power[i, 0], m.power[i, 1] = evaluate_powers(c.top, c.w, m.q_stage, v, m.lam)
    return status


@subkernel
def _solve_tree_of_pins(c, m, t, i):
    """Evaluate the accelerations of the coordinates of a tree of pins in stage `i` by articulated bodies.

    The bodies are placed only if forces or states depend on where they are.
    """
    r = m.relative
    c.counts[RHS] += 1
    if any_forces(c.top):
        place_bodies(c.top, c.w, r.tree, t, r.vectors[Y], m.rates[i], m.q_stage, r.vectors[V_STAGE])
        if len(c.top.states) > 0:
            take_states(c.top, c.w, m.z_stage)
        applied_forces(c.top, c.w, m.q_stage, r.vectors[V_STAGE])
        has_forces = True
    else:
        turn_tree(c.top, c.w, r.tree, t, r.vectors[Y], m.rates[i], m.q_stage, r.vectors[V_STAGE])
        has_forces = False
    articulated_accelerations(
        c.top, c.w.cs, r.tree, has_forces, c.w.force, r.vectors[V_STAGE], r.bodies, m.accelerations[i]
    )
    if len(c.top.states) > 0:
        state_rates(c.top, c.w, r.vectors[V_STAGE], m.z_rates[i])
    if c.has_power[0] != 0:
        m.power[i, 0], m.power[i, 1] = evaluate_powers(c.top, c.w, m.q_stage, r.vectors[V_STAGE], m.lam)


@subkernel
def evaluate_stages(c, m, t, h, first, last):
    """Evaluate stages `first` to `last - 1` of the method `m` from the base state of the run `c`; return a status."""
    r, joint = m.relative, is_relative(m)
    if joint:
        coordinates_of(c.top, r.tree, c.from_q, c.from_v, r.vectors[BASE], r.vectors[BASE_RATES])
    base, base_rates, place = c.from_q, c.from_v, m.q_stage
    if joint:
        base, base_rates, place = r.vectors[BASE], r.vectors[BASE_RATES], r.vectors[Y]
    for i in range(first, last):
        if i == 0:
            copy(base_rates, m.rates[0])
            copy(base, place)
            copy(c.from_z, m.z_stage)
        else:
            stage_state(base, h, m.a, m.rates, i, place)
            stage_state(base_rates, h, m.a, m.accelerations, i, m.rates[i])
            if len(c.top.states) > 0:
                stage_state(c.from_z, h, m.a, m.z_rates, i, m.z_stage)
        if len(r.bodies) > 0:
            _solve_tree_of_pins(c, m, t + m.c[i] * h, i)
            continue
        v = m.rates[i]
        if joint:
            place_bodies(c.top, c.w, r.tree, t + m.c[i] * h, r.vectors[Y], m.rates[i], m.q_stage, r.vectors[V_STAGE])
            v = r.vectors[V_STAGE]
        else:
            prepare(c.top, c.w, t + m.c[i] * h, m.q_stage)
        status = _solve_stage(c, m, i, v)
        if status != OK:
            return status
        if joint:
            accelerate_coordinates(c.top, c.w, r.tree, r.vectors[Y], r.vectors[V_STAGE], m.accelerations[i])
    return OK


@subkernel
def add_up_stages(c, m, t, h):
    """Write the increments of the state by a step from `t` into ``c.dq``, ``c.dv`` and ``c.dz``, and those of the
    energies.
    """
    _increment(h, m.b, m.rates, c.dq)
    _increment(h, m.b, m.accelerations, c.dv)
    if is_relative(m):
        end_of_step(c, m.relative, t + h)
    if len(c.top.states) > 0:
        _increment(h, m.b, m.z_rates, c.dz)
    if c.has_power[0] != 0:
        for k in range(2):
            c.gain[k] = 0.0
            for i in range(len(m.b)):
                c.gain[k] += h * m.b[i] * m.power[i, k]


@subkernel
def estimate_errors(c, m, t, h, out):
    """Write one or two estimates of the local error of a step from `t` into arrays of `out`."""
    r = m.relative
    _increment(h, m.error[0], m.rates, out.est_q)
    _increment(h, m.error[0], m.accelerations, out.est_v)
    if is_relative(m):
        errors_of_bodies(c, r, t + h, out.est_q, out.est_v, m.q_stage, r.vectors[V_STAGE])
    if len(m.error) > 1:
        _increment(h, m.error[1], m.rates, out.second_q)
        _increment(h, m.error[1], m.accelerations, out.second_v)
        if is_relative(m):
            errors_of_bodies(c, r, t + h, out.second_q, out.second_v, m.q_stage, r.vectors[V_STAGE])
    if len(out.est_z) > 0:
        _increment(h, m.error[0], m.z_rates, out.est_z)
        if len(m.error) > 1:
            _increment(h, m.error[1], m.z_rates, out.second_z)


@subkernel
def evaluate_point(c, m, t, h, theta, out):
    """Write the state of the run `c` at the share `theta` of a step from `t` into arrays of `out`; needs all stages."""
    r = m.relative
    weights_at(m.dense, theta, m.weights)
    _increment(h, m.weights, m.rates, out.point_q)
    _increment(h, m.weights, m.accelerations, out.point_v)
    _increment(h, m.weights, m.z_rates, out.point_z)
    if is_relative(m):
        for d in range(len(out.point_q)):
            out.point_q[d] += r.vectors[BASE, d]
            out.point_v[d] += r.vectors[BASE_RATES, d]
        place_bodies(c.top, c.w, r.tree, t + theta * h, out.point_q, out.point_v, m.q_stage, r.vectors[V_STAGE])
        copy(m.q_stage, out.point_q)
        copy(r.vectors[V_STAGE], out.point_v)
    else:
        for d in range(len(out.point_q)):
            out.point_q[d] += c.from_q[d]
            out.point_v[d] += c.from_v[d]
    for d in range(len(out.point_z)):
        out.point_z[d] += c.from_z[d]
    dense_gains(h, m.weights, m.power, out.point_gain)


@subkernel
def reuse_first_stage(c, m):
    """Copy the first stage if the last step has evaluated it; return the number of known stages."""
    stages = len(m.b)
    known = 0
    if m.status[1] > 0 and c.base_state[0] != MODIFIED:
        if c.base_state[0] == AT_END_OF_LAST:
            if m.status[0] != 0 and m.status[1] >= stages:
                copy(m.rates[stages - 1], m.rates[0])
                copy(m.accelerations[stages - 1], m.accelerations[0])
                copy(m.z_rates[stages - 1], m.z_rates[0])
                m.power[0, 0], m.power[0, 1] = m.power[stages - 1, 0], m.power[stages - 1, 1]
                known = 1
        else:
            known = 1
    m.status[1] = 0
    return known


@subkernel
def keep_stages(c, m, t, h):
    """Store the stages of a step of `m` from the base state of the run `c` as quadrature nodes of time integrals."""
    r, joint = m.relative, is_relative(m)
    base, place = c.from_q, m.q_stage
    if joint:
        base, place = r.vectors[BASE], r.vectors[Y]
    for i in range(len(m.b)):
        if i == 0:
            copy(base, place)
        else:
            stage_state(base, h, m.a, m.rates, i, place)
        v = m.rates[i]
        if joint:
            place_bodies(c.top, c.w, r.tree, t + m.c[i] * h, r.vectors[Y], m.rates[i], m.q_stage, r.vectors[V_STAGE])
            v = r.vectors[V_STAGE]
        keep_node(c, t + m.c[i] * h, h * m.b[i], m.q_stage, v)


@entry
def keep(run, method, t, h, unused):
    """Store the stages of the last attempt as quadrature nodes; see `mbdkit.integrators.loop.step_loop`."""
    keep_stages(load_run_state(run), load_explicit(method), t, h)
    return OK


@entry
def attempt(run, method, t, h, want_error):
    """Compute a step from the base state; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_explicit(method)
    stages = len(m.b)
    first = reuse_first_stage(c, m)
    status = evaluate_stages(c, m, t, h, first, stages)
    if status != OK:
        return status
    m.status[1] = stages
    add_up_stages(c, m, t, h)
    if not (stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv) and stays_finite(c.from_z, c.dz)):
        return NOT_FINITE
    if want_error != 0.0:
        estimate_errors(c, m, t, h, c)
    return OK


@entry
def dense(run, method, t, h, theta):
    """Write the state at ``t + theta h`` within the last attempt; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_explicit(method)
    stages = len(m.c)
    if m.status[1] < stages:
        status = evaluate_stages(c, m, t, h, len(m.b), stages)
        if status != OK:
            return status
        m.status[1] = stages
    evaluate_point(c, m, t, h, theta, c)
    return OK


class CompiledExplicit(CompiledMethod):
    """Explicit Runge-Kutta methods."""

    attempt, dense, keep = attempt, dense, keep
    duals = Target("mbdkit.integrators.duals.dual_steps:ExplicitDuals")
    hint = "a smaller time.step or an implicit integrator may help"

    def __init__(self, method: ExplicitRungeKutta, workspace: Workspace, control: Control | None = None):
        super().__init__(workspace)
        self.bundle = explicit_on(method, workspace)
        self.pinned = PinnedBundle(self.bundle)
        self.has_dense_output = len(self.bundle.dense) > 0
        self.stages = len(self.bundle.b)
