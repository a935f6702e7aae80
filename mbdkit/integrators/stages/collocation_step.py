"""One step of a collocation method, the same for all formulations: predictor, iteration, increments, error estimate,
dense output.

The parts that depend on the formulation are passed in as `mbdkit.integrators.stages.collocation_stages.StageKernels`.
Numba compiles these kernels once for each such record, into the entries of the formulation's own file. Kernels that
take the record are inlined: otherwise the addresses of its functions would remain in the compiled entry, which then
could not be cached.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.applied_forces import state_rates, take_states
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, OK, prepare
from mbdkit.engine.kernels.tree import accelerate_coordinates
from mbdkit.engine.kernels.vectors import copy, fill, fill_rows, stays_finite
from mbdkit.engine.native.arithmetic import any_of, is_refused, renewed, usable
from mbdkit.engine.native.functions import entry, inlined, separate, subkernel
from mbdkit.integrators.run.run_state import (
    AT_END_OF_LAST,
    AT_START_OF_LAST,
    FACTORIZATIONS,
    ITERATIONS,
    RHS,
    keep_node,
    load_run_state,
)
from mbdkit.integrators.stages.collocation_stages import NEWTON, load_stages, solves_multipliers
from mbdkit.integrators.stages.convergence import stays_near
from mbdkit.integrators.stages.element_states import add_up_states
from mbdkit.integrators.stages.simplified_newton import filter_estimate, leading
from mbdkit.integrators.stages.stage_iteration import iterate
from mbdkit.integrators.stages.stage_polynomials import (
    dense_gains,
    extrapolate,
    extrapolate_pairs,
    extrapolation_weights,
    stage_mean,
    stage_mean_of_pairs,
    stage_states,
    weights_at,
)
from mbdkit.integrators.stages.stages_on_tree import (
    begin_on_tree,
    bodies_at_end,
    first_state,
    is_on_tree,
    place_point,
    place_stages,
    restore_bodies,
    take_coordinates,
    take_mean_on_tree,
)
from mbdkit.integrators.stages.turning_beams import predict_turned, take_middle_stage, turns_far, turns_stages


@subkernel
def _predict(m, t, h):
    """Extrapolate the stages of the previous step, or use free flight; return whether free flight is used.

    In lanes, return whether it is used in all of them. In free flight, accelerations are zero. They are not set to the
    acceleration at the start of the step, because a stiff force may be far from constant over the step. If the tangents
    turn with beams, values of the previous step are used as they are, except for the nodes of beams
    (`mbdkit.integrators.stages.turning_beams`).
    """
    size = m.previous.size[0]
    known = abs(size) > 0.0
    if turns_stages(m) and any_of(known):
        return False
    if not any_of(known):
        fill_rows(m.acc, 0.0)
        for i in range(len(m.lam)):
            fill_rows(m.lam[i], 0.0)
        fill_rows(m.states.rate, 0.0)
        for i in range(len(m.constraints.mu)):
            fill_rows(m.constraints.mu[i], 0.0)
        fill_rows(m.constraints.shift, 0.0)
        return True
    extrapolation_weights((t - m.previous.begin[0]) / size, h / size, m.rk.c, m.weights)
    extrapolate(m.weights, m.acc, m.spread)
    for i in range(len(m.acc)):
        for d in range(len(m.acc[0])):
            m.acc[i, d] = renewed(m.acc[i, d], 0.0, known)
    extrapolate(m.weights, m.states.rate, m.states.z)
    if solves_multipliers(m):  # otherwise, multipliers follow from accelerations
        extrapolate_pairs(m.weights, m.lam, m.constraints.phi)
    return False


@subkernel
def evaluate_stages(c, m, h):
    """Evaluate positions, velocities and first-order states of every stage; the step begins at ``m.previous.begin``."""
    stage_states(c, m, h)
    add_up_states(c, m, h, 0, len(c.top.states))
    shift = m.constraints.shift
    for i in range(len(shift)):
        for j in range(len(shift)):
            w = h * m.rk.a[i, j]
            for d in range(len(c.q) - 3):
                m.q_stage[i, d] -= w * shift[j, d]
    if is_on_tree(m):
        place_stages(c, m, h)


@subkernel
def choose_tangent_state(c, m, t, h, at_start, wanted):
    """Choose the state where the tangents are taken: the start of the step, the mean of all stages, or the middle one
    if the tangents turn with beams.

    In lanes (`mbdkit.integrators.stages.collocation_stages.StageKernels`), the mean is taken only where `wanted`. In
    the other lanes, tangents are evaluated again at the same state and are bitwise identical.
    """
    tangent = m.tangent
    if at_start:
        q, v, acc = first_state(c, m)
        tangent.time[0] = t
        copy(q, tangent.q)
        copy(v, tangent.v)
        copy(acc, tangent.acc)
        for k in range(len(tangent.lam)):
            copy(m.first.lam[k], tangent.lam[k])
        return
    if turns_stages(m):
        take_middle_stage(m, t, h)
        return
    if is_on_tree(m):
        take_mean_on_tree(c, m, t, h)
        return
    share = 0.0
    for i in range(len(m.rk.c)):
        share += m.rk.c[i] / len(m.rk.c)
    tangent.time[0] = renewed(t + share * h, tangent.time[0], wanted)
    stage_mean(m.q_stage, tangent.q, wanted)
    stage_mean(m.v_stage, tangent.v, wanted)
    stage_mean(m.acc, tangent.acc, wanted)
    stage_mean_of_pairs(m.lam, tangent.lam, wanted)


@subkernel
def move_stages(c, m, h, active):
    """Change the accelerations of the stages, in lanes only where `active`, and evaluate the stages."""
    for i in range(len(m.rk.c)):
        for d in range(len(c.q) - 3):
            m.acc[i, d] = renewed(m.acc[i, d] + m.change[i, d], m.acc[i, d], active)
    evaluate_stages(c, m, h)


@subkernel
def every_change_is_idle(now):
    """Return True unless the change is infinite or NaN: any other stalled change counts as idle."""
    return now < np.inf


@inlined
def solve_stages(c, m, t, h, careful, wanted, kernels):
    """Solve the stage equations by simplified Newton, or fixed-point iteration; return a status.

    In lanes, equations are solved only where `wanted`.
    """
    if m.solved_apart[0] > 0:
        c.counts[ITERATIONS] += m.solved_apart[0]
        m.solved_apart[0] = 0
        m.previous.begin[0], m.previous.size[0] = t, h
        evaluate_stages(c, m, h)
        return OK
    free_flight = _predict(m, t, h)
    if turns_stages(m):
        predict_turned(c, m, h)
    m.previous.begin[0], m.previous.size[0] = t, np.nan  # stages of a failed attempt must not be extrapolated
    evaluate_stages(c, m, h)
    settings = m.settings
    strategy = careful, turns_stages(m), free_flight, wanted
    status = iterate(c, m, t, h, (settings.limit, settings.tolerance[0]), strategy, kernels)
    if status == OK and turns_stages(m) and turns_far(c, m):
        c.report[0] = np.inf
        status = DIVERGED
    if status != OK:
        return status
    near = stays_near(c, m.acc, h)
    if is_refused(near):
        c.report[0] = np.inf
        return DIVERGED
    m.acc[0, 0] = usable(m.acc[0, 0], near)
    m.previous.size[0] = usable(h, abs(m.acc[0, 0]) < np.inf)  # unknown in lanes that have failed
    return OK


@subkernel
def _keep_first_acceleration(c, m):
    """Take over the acceleration at the beginning of the step from the last attempt, or mark it as unknown."""
    s = len(m.rk.c)
    first = m.first
    if (
        c.base_state[0] == AT_END_OF_LAST
        and first.known[0] != 0
        and m.rk.c[s - 1] == 1.0
        and not solves_multipliers(m)  # in other formulations, stages do not satisfy the index-1 equations
    ):
        for k in range(len(first.lam)):
            copy(m.lam[s - 1, k], first.lam[k])
        copy(m.states.rate[s - 1], m.states.first_rate)
        copy(m.acc[s - 1], first.acc)  # the last stage of the previous step is the beginning of this one
    elif c.base_state[0] != AT_START_OF_LAST:
        first.known[0] = 0


@separate
def first_acceleration(c, m, t):
    """Solve for the acceleration at the beginning of a step unless it is known; return a status."""
    first = m.first
    if first.known[0] != 0:
        return OK
    q, v, acc = first_state(c, m)
    prepare(c.top, c.w, t, q)
    take_states(c.top, c.w, c.from_z)
    status = solve_accelerations(c.top, c.w, c.solver, q, v, acc, first.lam, False)
    if status == OK:
        state_rates(c.top, c.w, v, m.states.first_rate)
        if is_on_tree(m):
            copy(acc, first.acc)
            accelerate_coordinates(c.top, c.w, m.on_tree.relative.tree, c.from_q, v, first.acc)
        c.counts[RHS] += 1
        c.counts[FACTORIZATIONS] += 1
        first.known[0] = 1
    return status


@subkernel
def increments(c, m, h):
    """Write the increments of positions, velocities and first-order states by the step."""
    fill(c.dq, 0.0)
    fill(c.dv, 0.0)
    fill(c.dz, 0.0)
    n3 = len(c.q) - 3
    for i in range(len(m.rk.c)):
        w1, w2 = h * m.rk.b[i], h * h * m.rk.b2[i]
        for d in range(n3):
            c.dv[d] += w1 * m.acc[i, d]
            c.dq[d] += w2 * m.acc[i, d]
        for e in range(len(c.dz)):
            c.dz[e] += w1 * m.states.rate[i, e]
    for d in range(n3):
        c.dq[d] += h * c.from_v[d] + h * c.v_low[d]  # including the low part of the compensated velocity
    for j in range(len(m.constraints.shift)):
        w = h * m.rk.b[j]
        for d in range(n3):
            c.dq[d] -= w * m.constraints.shift[j, d]


@subkernel
def keep_stages(c, m, t, h):
    """Store the states of the stages of a step, of a collocation method or a Lobatto pair, as quadrature nodes of time
    integrals.
    """
    for i in range(len(m.rk.c)):
        keep_node(c, t + m.rk.c[i] * h, h * m.rk.b[i], m.q_stage[i], m.v_stage[i])


@entry
def keep(run, method, t, h, unused):
    """Store the stages of the last attempt as quadrature nodes; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_stages(method)
    take_coordinates(c, m)
    evaluate_stages(c, m, h)
    restore_bodies(c, m)
    keep_stages(c, m, t, h)
    return OK


@inlined
def estimate_errors(c, m, h, out, kernels):
    """Write estimates of the local error of positions and velocities into arrays of `out`.

    They are computed by the embedded formula of Hairer and Wanner (1996), IV.8: ``h gamma0`` times the difference
    between the acceleration at the beginning and that of the collocation polynomial there, filtered by the system of
    the first eigenvalue. They are of order s + 1 in h.
    """
    extrapolation_weights(0.0, 0.0, m.rk.c, m.weights)  # each row has the weights of the polynomial at the beginning
    rate = h * leading(m.rk)
    for d in range(len(c.q) - 3):
        gap = m.first.acc[d]
        for i in range(len(m.rk.c)):
            gap -= m.weights[0, i] * m.acc[i, d]
        out.est_v[d] = rate * gap
    if m.settings.solver[0] == NEWTON:
        filter_estimate(c, m, kernels.estimate_side, out.est_v)
    for d in range(len(c.q) - 3):
        out.est_q[d] = rate * out.est_v[d]
    for e in range(len(c.z)):
        gap = m.states.first_rate[e]
        for i in range(len(m.rk.c)):
            gap -= m.weights[0, i] * m.states.rate[i, e]
        out.est_z[e] = rate * gap / (1.0 - rate * min(m.states.slope[e], 0.0))


@inlined
def complete_step(c, m, t, h, kernels):
    """Write the increments of the state and of the energies by a step whose stages are solved; return a status."""
    if c.has_power[0] != 0:
        status = kernels.powers(c, m, t, h)
        if status != OK:
            return status
        dense_gains(h, m.rk.b, m.power, c.gain)
    increments(c, m, h)
    return OK


@inlined
def try_step(c, m, t, h, want_error, kernels):
    """Try a step from the base state; return a status. See `mbdkit.integrators.loop.step_loop`."""
    begin_on_tree(c, m)
    status = _try(c, m, t, h, want_error, kernels)
    restore_bodies(c, m)
    if status == OK and is_on_tree(m):
        bodies_at_end(c, m, t + h, h, want_error)
    return status


@inlined
def _try(c, m, t, h, want_error, kernels):
    """Try a step from a base state of bodies or of the coordinates of a tree; return a status.

    With step size control the iteration is careful (see `mbdkit.integrators.stages.stage_iteration.iterate`). Fixed
    steps cannot be made smaller, so the fast iteration is tried first, and the careful one if it diverges.
    """
    _keep_first_acceleration(c, m)
    careful = want_error != 0.0
    change = coordinate = iterations = 0.0
    while True:
        if careful:
            status = first_acceleration(c, m, t)
            if status != OK:
                return status
        status = solve_stages(c, m, t, h, careful, True, kernels)
        if status != DIVERGED or careful or m.settings.solver[0] != NEWTON or turns_stages(m):
            break
        careful = True
        change, coordinate, iterations = c.report[0], c.report[1], c.report[2]
    if status == DIVERGED and iterations > 0.0:  # the report is that of the fast iteration
        c.report[0], c.report[1], c.report[2] = change, coordinate, iterations
    if status != OK:
        return status
    status = complete_step(c, m, t, h, kernels)
    if status != OK:
        return status
    if not (stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv) and stays_finite(c.from_z, c.dz)):
        return NOT_FINITE
    if want_error != 0.0:
        status = first_acceleration(c, m, t)
        if status != OK:
            return status
        estimate_errors(c, m, h, c, kernels)
    return OK


@subkernel
def state_inside(c, m, t, h, theta, out):
    """Write state and energies at the time ``t + theta h`` in the last attempt, from its collocation polynomial, into
    arrays of `out`.
    """
    take_coordinates(c, m)
    n3 = len(c.q) - 3
    weights = m.dense_weights
    fill(out.point_q, 0.0)
    fill(out.point_v, 0.0)
    weights_at(m.rk.dense_q, theta, weights)
    for i in range(len(m.rk.c)):
        w = h * h * weights[i]
        for d in range(n3):
            out.point_q[d] += w * m.acc[i, d]
    weights_at(m.rk.dense_v, theta, weights)
    for i in range(len(m.rk.c)):
        w = h * weights[i]
        for d in range(n3):
            out.point_v[d] += w * m.acc[i, d]
    for e in range(len(out.point_z)):
        total = 0.0
        for i in range(len(m.rk.c)):
            total += weights[i] * m.states.rate[i, e]
        out.point_z[e] = c.from_z[e] + h * total
    for d in range(len(c.q)):
        out.point_q[d] += c.from_q[d] + theta * h * c.from_v[d]
        out.point_v[d] += c.from_v[d]
    for i in range(len(m.constraints.shift)):
        w = h * weights[i]
        for d in range(n3):
            out.point_q[d] -= w * m.constraints.shift[i, d]
    dense_gains(h, weights, m.power, out.point_gain)
    restore_bodies(c, m)
    if is_on_tree(m):
        place_point(c, m, t + theta * h, out)
