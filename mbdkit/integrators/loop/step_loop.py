"""The compiled step loop of every compiled method, with fixed or controlled step size.

A method provides two compiled functions (`mbdkit.engine.native.kernel`) that receive two addresses: `run`, of the
bundle of the run (`mbdkit.integrators.run.run_state`), and `method`, of the method's own bundle.

``attempt(run, method, t, h, want_error)``
    Computes a step of size `h` from the base state ``from_q, from_v, from_z``, which it does not change. Writes ``dq``,
    ``dv`` and ``dz``; if ``has_power``, ``gain``; the multipliers of the method, if it has any, into ``own_lam``; and
    if `want_error` is not 0, the estimates ``est_q, est_v, est_z``. ``base_state`` describes how the base state is
    related to the last attempt. A method with events of its own may end the step at one of them: it writes the size of
    this part of the step into ``progress.part``. At its start, it may change the state by an event (`MODIFIED`).
``dense(run, method, t, h, theta)``
    Writes ``point_q, point_v, point_z, point_gain`` and ``point_lam``: the state at ``t + theta h`` within the last
    attempt.
``keep(run, method, t, h, unused)``
    Stores the stages of the last attempt as quadrature nodes of time integrals, with the weights of the method
    (`mbdkit.integrators.run.run_state.keep_node`).

All return a status of `mbdkit.engine.kernels.system`. The loop calls them by their addresses, so that it is compiled
once for all methods.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.interpolation import fade
from mbdkit.engine.kernels.misalignment import raise_misalignments
from mbdkit.engine.kernels.projection import mass_norm, project_positions, project_velocities
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, OK, constraint_rows, prepare
from mbdkit.engine.kernels.vectors import copy, fill, stays_finite
from mbdkit.engine.native.calls import call_entry
from mbdkit.engine.native.functions import kernel, subkernel
from mbdkit.integrators.interface import ROUNDING, SAME_TIME, SIMULTANEOUS
from mbdkit.integrators.loop.projected_step import project, take
from mbdkit.integrators.run.run_plan import NEAR_SINGULARITY, NO_PROJECTION, PLAIN, SYMMETRIC, load_plan
from mbdkit.integrators.run.run_state import (
    AT_END_OF_LAST,
    AT_START_OF_LAST,
    ITERATIONS,
    MODIFIED,
    PROJECTIONS,
    add_increments,
    load_run_state,
)
from mbdkit.integrators.run.step_control import (
    MIN_LAST_ERROR,
    factor_after_acceptance,
    factor_after_rejection,
    fitted_size,
    is_too_small,
    local_error,
)
from mbdkit.integrators.run.step_guards import (
    begin_energy,
    distance_to_singularity,
    energies,
    energy_jump,
    limit_status,
    note_jump,
    watch_branch,
)
from mbdkit.integrators.run.step_path import has_room, load_path, store_end, store_state

TOO_SMALL = 5  #: Status: the step size fell below the smallest one.

AT_STOP = 8  #: Status: a step has ended at a stop; the values that the method stores are not valid for the next step.

#: Statuses of attempts: `CompiledMethod.resume` is to be called before another one, or no step can succeed.
PAUSED, REFUSED = 9, 10

#: Status of a look into a step (`Reacting.add_forces`): it is to be taken again with the size that is now
#: ``tried_size``.
SHORTER = 11

#: Least size of the step after one that was shortened by a look into it, relative to the size planned before.
LEAST_AFTER = 0.1

#: A row recorded by `interval` that is closer to the end than this share of the interval is replaced by the row at the
#: end.
ROW_MARGIN = 1e-9


@subkernel
def _has_ended(plan, progress):
    if plan.control.controlled[0]:
        return progress.time[0] >= plan.times.end[0]
    return progress.whole[0] >= plan.times.steps[0]


@subkernel
def _is_pause(plan, progress):
    """Return whether the next stop is the pause of the run, and not one of the plan."""
    n = progress.passed[0]
    return n >= len(plan.times.stops) or progress.pause[0] < plan.times.stops[n]


@subkernel
def _next_stop(plan, progress):
    return progress.pause[0] if _is_pause(plan, progress) else plan.times.stops[progress.passed[0]]


@subkernel
def _margin(plan, progress):
    """Return the margin of the next stop; 0 at a soft one, where nothing but held values is discontinuous."""
    return 0.0 if _is_pause(plan, progress) else plan.times.margins[progress.passed[0]]


@subkernel
def _is_soft(plan, number, time):
    """Return whether the stop of the plan with this number is a soft one at `time`."""
    times = plan.times
    return 0 <= number < len(times.stops) and times.margins[number] == 0.0 and times.stops[number] == time


@subkernel
def _end_of_whole_step(plan, progress):
    """Return the end of the whole fixed step to which the next step belongs; stops split fixed steps."""
    times, n = plan.times, progress.whole[0] + 1
    return times.start[0] + n * times.step[0] if n < times.steps[0] else times.end[0]


@subkernel
def _is_end_of_whole_step(plan, progress, stop):
    """Return whether the next stop and the end of a fixed step are equal up to rounding errors."""
    return abs(stop - _end_of_whole_step(plan, progress)) <= SAME_TIME * _margin(plan, progress)


@subkernel
def _chosen_step(plan, progress):
    """Return the start and the size of the next step, and whether it ends at a stop."""
    times = plan.times
    stop = _next_stop(plan, progress)
    if plan.control.controlled[0]:
        t = progress.restart[0] if progress.after_stop[0] != 0 else progress.time[0]
        target = min(stop, times.end[0])
        h = fitted_size(t, min(progress.next_size[0], plan.control.max_size[0]), target)
        return t, h, stop < times.end[0] and h == stop - t
    # a product, since the rounding errors of a sum would grow with the number of steps
    whole, end = times.start[0] + progress.whole[0] * times.step[0], _end_of_whole_step(plan, progress)
    is_split = progress.after_stop[0] != 0 and not _is_soft(plan, progress.passed[0] - 1, whole)
    is_rest = is_split or progress.after_part[0] != 0
    t = progress.restart[0] if is_rest else whole
    # the step before a soft stop on the grid is the same without the stop, which is known only later in an open run
    is_kept = _is_soft(plan, progress.passed[0], end) and not _is_pause(plan, progress)
    if not is_kept and (stop < end or _is_end_of_whole_step(plan, progress, stop)):
        return t, stop - t, True
    if is_rest:
        return t, end - t, False
    return t, times.step[0] if progress.whole[0] < times.steps[0] - 1 else times.last_step[0], False


@subkernel
def _end_of_step(plan, progress, t, h, at_stop):
    """Return the end of a step of size `h` from `t`, and whether it is the last of the run."""
    times = plan.times
    if progress.part[0] != 0.0:
        return t + h, False
    if at_stop:
        return _next_stop(plan, progress), False
    last = t + h >= times.end[0] if plan.control.controlled[0] else progress.whole[0] + 1 >= times.steps[0]
    return times.end[0] if last else t + h, last


@subkernel
def _baumgarte_term(c, t):
    """Return the largest ``|2 alpha (Phi_q v + Phi_t) + beta^2 Phi|`` at the state."""
    prepare(c.top, c.w, t, c.q)
    return constraint_rows(c.top, c.w, c.q, c.v)


@subkernel
def _reject(c, plan, h, solved, error):
    progress = c.progress
    progress.next_size[0] = factor_after_rejection(plan.control, solved, error) * h
    progress.retrying[0] = 1
    progress.rejected[0] += 1
    c.interval.rejected[0] += 1
    c.base_state[0] = AT_START_OF_LAST


@subkernel
def _accept(c, plan, t, h, error, at_stop):
    """Accept a step of size `h` from `t`, and choose the size of the next.

    Size and error of a step that ends at a stop or an event say little about the next step; its error and those of the
    steps before are discarded.
    """
    progress, interval = c.progress, c.interval
    interval.steps[0] += 1
    interval.last_size[0] = h
    if plan.control.controlled[0]:
        factor = factor_after_acceptance(plan.control, h, error, progress)
        is_short = at_stop or progress.part[0] != 0.0
        if is_short:
            progress.next_size[0] = factor * h if factor < 1.0 else max(progress.next_size[0], factor * h)
        elif t + h < plan.times.end[0]:  # the last step is shortened, so its size says nothing about the next
            progress.next_size[0] = factor * h
        progress.earlier_error[0] = 0.0 if is_short else progress.last_error[0]
        progress.last_error[0] = 0.0 if is_short else max(error, MIN_LAST_ERROR)
        progress.earlier_size[0] = progress.last_size[0]
    progress.retrying[0] = 0
    progress.at_stop[0] = at_stop
    progress.last_size[0] = h
    progress.pending[0] = 1


@subkernel
def _note_projection(c):
    """Count a projection, and record the size of its correction."""
    interval = c.interval
    interval.projections[0] += 1
    mass = 0.0
    for b in range(len(c.top.mass) - 1):
        mass += c.top.mass[b, 0]
    moved_q, moved_v = mass_norm(c.top.mass, mass, c.shift_q, c.rest), mass_norm(c.top.mass, mass, c.shift_v, c.rest)
    interval.position_correction[0] = max(interval.position_correction[0], moved_q)
    interval.velocity_correction[0] = max(interval.velocity_correction[0], moved_v)


@subkernel
def _note_end_of_step(c, plan, t):
    """Record the energy of the state reached at `t`, unless it is known from the attempt. Requires `prepare` there."""
    guards, mode = c.guards, plan.projection.mode[0]
    if not plan.control.controlled[0] and mode != PLAIN:
        jump, total, kinetic, rounding = energy_jump(c, guards, c.gain, c.q, c.v)
        if mode != NO_PROJECTION or plan.baumgarte[0]:  # stabilization changes the energy as well
            jump = 0.0
        note_jump(guards, t, jump, total, kinetic, rounding, plan.limits.energy_jump[0])
    elif c.base_state[0] == MODIFIED:  # the state was projected
        kinetic, potential, _ = energies(c.top, c.w, c.q, c.v)
        guards.energy[0] = kinetic + potential


@subkernel
def _shows(plan, progress, t, h, at_stop, path):
    """Return whether a state at the end of the next step or within it is recorded, stored, or read by the stepper."""
    recording, times = plan.recording, plan.times
    if path != 0 or at_stop or recording.start_of_step[0] != 0 or _end_of_step(plan, progress, t, h, at_stop)[1]:
        return True
    if recording.every[0] > 0:
        return (progress.whole[0] + 1) % recording.every[0] == 0
    return times.start[0] + progress.next_row[0] * recording.interval[0] <= t + (1.0 + ROW_MARGIN) * h


@subkernel
def _try_step(run, method, attempt, plan, path):
    """Attempt the next step with its projection, and accept or reject it; return a status.

    An accepted step is then pending: its increments are known, but the state is still that at its start.
    """
    c = load_run_state(run)
    progress, interval, control, mode = c.progress, c.interval, plan.control, plan.projection.mode[0]
    guards = c.guards
    t, h, at_stop = _chosen_step(plan, progress)
    if control.controlled[0] and not at_stop and is_too_small(control, t, h, plan.times.end[0]):
        return TOO_SMALL
    progress.tried_begin[0], progress.tried_size[0] = t, h
    # a repeated attempt has the same base state; a symmetric projection displaces it itself
    if mode != SYMMETRIC and progress.retrying[0] == 0:
        copy(c.q, c.from_q)
        copy(c.v, c.from_v)
        copy(c.z, c.from_z)
    if plan.baumgarte[0]:
        interval.baumgarte_term[0] = max(interval.baumgarte_term[0], _baumgarte_term(c, t))
    if np.isnan(guards.energy[0]):
        begin_energy(c, guards, t, c.q, c.v)
    before = c.counts[ITERATIONS]
    progress.part[0] = 0.0
    if c.w.reacting.add_forces[0] != 0:
        c.w.reacting.shows[0] = _shows(plan, progress, t, h, at_stop, path)
    c.w.faulty[0] = -1  # only a force law that fails in this attempt is to be named if the run stops
    status = take(run, method, attempt, t, h, control.controlled[0], plan.projection)
    iterations = c.counts[ITERATIONS] - before
    if progress.part[0] != 0.0:
        h, at_stop = progress.part[0], False
    error, planned = 0.0, h
    projected = jumped = False
    at = jump = total = kinetic = rounding = 0.0
    looks = c.w.reacting.add_forces
    while status == OK and control.controlled[0]:
        error = local_error(plan.control, c, c)
        # where forces switch, an error that is too large says nothing about the part of the step before
        if looks[1] == 0 or not (error <= 1.0 or looks[2] != 0):
            break
        # error control sees only the motion: a step that would pass over the begin or end of a contact ends there
        status = call_entry(looks[1], run, method, t, h, error)
        if status != SHORTER:
            break
        h, at_stop, c.base_state[0], progress.part[0] = progress.tried_size[0], False, AT_START_OF_LAST, 0.0
        status = take(run, method, attempt, t, h, control.controlled[0], plan.projection)
        h = progress.part[0] if progress.part[0] != 0.0 else h
    # the distance is estimated from the factors of the last solution, at negligible cost
    if status == OK and error <= 1.0:
        distance = 1.0
        if guards.has_loops[0] != 0.0:
            distance = guards.distance[0] = distance_to_singularity(c, guards.vectors)
        at, _ = _end_of_step(plan, progress, t, h, at_stop)
        due = (progress.accepted[0] + 1) % plan.projection.every[0] == 0
        if mode == NEAR_SINGULARITY:
            due = distance < plan.projection.near[0] * guards.farthest[0]
        # before the projection, which changes the energy, and while the step can still be rejected
        if control.controlled[0] or mode == PLAIN:
            prepare(c.top, c.w, at, c.new_q)
            jump, total, kinetic, rounding = energy_jump(c, guards, c.gain, c.new_q, c.new_v)
            if plan.baumgarte[0]:  # Baumgarte's terms do work that is not counted
                jump = 0.0
            most = plan.limits.rejected_jump[0] * max(kinetic, guards.kinetic[0]) + rounding
            jumped = control.controlled[0] != 0 and not abs(jump) <= most
    if status == OK and error <= 1.0 and not jumped:
        status, projected = project(run, at, mode, due, plan.projection.bound[0])
    interval.iterations[0] += iterations
    if control.controlled[0] and (status in (DIVERGED, NOT_FINITE) or not error <= 1.0 or jumped):
        guards.jumped[0] = jumped
        _reject(c, plan, h, status == OK and not jumped, error)
        return OK
    if status != OK:
        c.base_state[0] = MODIFIED
        return status
    interval.iterations_max[0] = max(interval.iterations_max[0], iterations)
    if control.controlled[0] or mode == PLAIN:  # otherwise, the energy balance is checked when the state is advanced
        note_jump(guards, at, jump, total, kinetic, rounding, plan.limits.energy_jump[0])
    if projected:
        _note_projection(c)
    _accept(c, plan, t, h, error, at_stop)
    if h < planned and progress.part[0] == 0.0:
        progress.next_size[0] = max(progress.next_size[0], LEAST_AFTER * planned)
    c.base_state[0] = MODIFIED if projected or at_stop else AT_END_OF_LAST
    return OK


@subkernel
def _write_row(c, row, t, q, v, z, gain, lam):
    c.row_time[row] = t
    copy(q, c.row_q[row])
    copy(v, c.row_v[row])
    copy(z, c.row_z[row])
    for k in range(2):
        c.row_energy[row, k] = c.energy[k] + gain[k]
    for k in range(len(c.interval.values)):
        c.row_interval[row, k] = c.interval.values[k]
        c.interval.values[k] = 0.0
    if len(c.row_lam) > 0:
        for k in range(len(lam)):
            c.row_lam[row, k, 0], c.row_lam[row, k, 1] = lam[k, 0], lam[k, 1]


@subkernel
def _evaluate_inside(run, method, dense, t, h, theta, mode):
    """Write the state at the share `theta` of the last attempt into ``point_q`` and others; return a status.

    The correction of the end of the step by projection is blended in by a cubic of theta.
    """
    c = load_run_state(run)
    status = call_entry(dense, run, method, t, h, theta)
    if status == OK and mode in (PLAIN, NEAR_SINGULARITY):
        share = fade(theta)
        for d in range(len(c.q)):
            c.point_q[d] += share * c.shift_q[d]
            c.point_v[d] += share * c.shift_v[d]
    return status


@subkernel
def _store_inside(run, method, dense, path, mode):
    """Store the states within the pending step in the path at an address; nan where dense output fails."""
    c, shares = load_run_state(run), load_path(path).shares
    for part in range(len(shares)):
        t, h = c.progress.tried_begin[0], c.progress.last_size[0]
        if _evaluate_inside(run, method, dense, t, h, shares[part], mode) != OK:
            for x in (c.point_q, c.point_v, c.point_z):
                fill(x, np.nan)
        store_state(path, part, c.point_q, c.point_v, c.point_z)


@subkernel
def _dense_row(run, method, dense, row, t, h, at, mode):
    """Write the state at a time within the pending step, by dense output; return a status.

    If states are projected, the result is projected as well.
    """
    c = load_run_state(run)
    status = _evaluate_inside(run, method, dense, t, h, min(1.0, (at - t) / h), mode)
    if status != OK:
        return status
    if mode == PLAIN:
        status = project_positions(c.still, c.w, c.solver, at, c.point_q, c.est_q, c.rest, c.x, c.lam)
        if status != OK:
            return status
        copy(c.est_q, c.point_q)
        status = project_velocities(c.still, c.w, c.solver, at, c.point_q, c.point_v, c.x, c.lam)
        if status != OK:
            return status
        c.counts[PROJECTIONS] += 1
    _write_row(c, row, at, c.point_q, c.point_v, c.point_z, c.point_gain, c.point_lam)
    return OK


@subkernel
def _write_inner_rows(run, method, dense, plan, rows):
    """Write the rows by interval within the pending step after `rows` others; return a status and the new number.

    A row at the end of the step belongs to it, and not to the next one: where the step ends at an event or at a stop,
    it shows the limit from before. The buffer may be full before all are written: the step then stays pending.
    """
    c = load_run_state(run)
    progress, interval = c.progress, plan.recording.interval[0]
    start, end = plan.times.start[0], plan.times.end[0]
    t, h = progress.tried_begin[0], progress.last_size[0]
    reached, _ = _end_of_step(plan, progress, t, h, progress.at_stop[0] != 0)
    if progress.at_stop[0] != 0 or progress.part[0] != 0.0:
        reached += SIMULTANEOUS * max(1.0, abs(reached))
    else:
        reached += ROUNDING * max(abs(start), abs(end))
    at = start + progress.next_row[0] * interval
    while rows < len(c.row_time) and at <= reached and at < end - ROW_MARGIN * interval:
        status = _dense_row(run, method, dense, rows, t, h, at, plan.projection.mode[0])
        if status != OK:
            return status, rows
        rows += 1
        progress.next_row[0] += 1.0
        at = start + progress.next_row[0] * interval
    return OK, rows


@subkernel
def _pass_stop(plan, progress):
    """Move the time to the stop at which the pending step ends; return whether a fixed step is complete.

    The time is that before the stop, so that a row there shows the left-hand limit. Rows of the fixed grid keep the
    time of the grid, on either side of the stop, except at impacts, where the velocities of both sides differ.
    """
    stop, is_pause = _next_stop(plan, progress), _is_pause(plan, progress)
    complete = plan.control.controlled[0] != 0 or _is_end_of_whole_step(plan, progress, stop)
    progress.time[0], progress.time_low[0] = stop - _margin(plan, progress), 0.0
    if complete:
        if not plan.control.controlled[0] and (is_pause or plan.times.impacts[progress.passed[0]] == 0):
            progress.time[0] = _end_of_whole_step(plan, progress)
        progress.whole[0] += 1
    progress.restart[0] = stop
    if is_pause:
        progress.pause[0] = np.inf
    else:
        progress.passed[0] += 1
    return complete


@subkernel
def _advance_time(plan, progress):
    """Move the time to the end of the pending step.

    Returns whether that is the end of the run, and whether it is the end of a whole step.
    """
    t, h = progress.tried_begin[0], progress.last_size[0]
    reached, last = _end_of_step(plan, progress, t, h, progress.at_stop[0] != 0)
    progress.accepted[0] += 1
    progress.pending[0] = 0
    progress.after_stop[0] = progress.at_stop[0]
    progress.after_part[0] = progress.part[0] != 0.0
    if progress.after_part[0] != 0:
        progress.time[0] = progress.restart[0] = reached
        progress.time_low[0] = 0.0
        return False, False
    if progress.at_stop[0] != 0:
        return False, _pass_stop(plan, progress)
    progress.whole[0] += 1
    if plan.control.controlled[0]:  # the time is a compensated sum of controlled steps
        y = h + progress.time_low[0]
        progress.time[0] = t + y
        progress.time_low[0] = y - (progress.time[0] - t)
        if last:
            progress.time[0] = plan.times.end[0]
    else:
        progress.time[0] = reached if last else plan.times.start[0] + progress.whole[0] * plan.times.step[0]
        if not last and _is_soft(plan, progress.passed[0], progress.time[0]):
            progress.restart[0] = progress.time[0]
            progress.passed[0] += 1
            progress.after_stop[0] = 1
    return last, True


@subkernel
def _advance(c, plan):
    """Add the increments of the pending step to the state.

    Returns a status, whether the run has ended, and whether this is the end of a whole step.
    """
    if not (stays_finite(c.q, c.dq) and stays_finite(c.v, c.dv) and stays_finite(c.z, c.dz)):
        return NOT_FINITE, False, False
    if plan.recording.start_of_step[0]:
        copy(c.q, c.before_q)
        copy(c.v, c.before_v)
        copy(c.z, c.before_z)
    if plan.projection.mode[0] != NO_PROJECTION:
        for d in range(len(c.q)):
            c.dq[d] += c.shift_q[d]
            c.dv[d] += c.shift_v[d]
    add_increments(c, True)
    last, whole = _advance_time(plan, c.progress)
    t = c.progress.time[0]
    if c.guards.has_loops[0] != 0.0:
        watch_branch(c.guards, c.top.mass, t, c.dq, c.v)
    raise_misalignments(c.still, c.w, t, c.q, c.worst)
    _note_end_of_step(c, plan, t)
    return limit_status(c.guards, c.worst, plan.limits), last, whole


@subkernel
def _has_room(c):
    """Return whether the buffer has room for the stages of another step; true if stages are not stored."""
    return c.nodes[0] == 0 or c.nodes[1] + c.nodes[2] <= len(c.node_time)


@kernel
def look_inside(run: int, method: int, dense: int, t: float, h: float, theta: float, mode: int) -> int:
    """Evaluate dense output of the last attempt into ``point_q, point_v, point_z``; return a status."""
    return _evaluate_inside(run, method, dense, t, h, theta, mode)


@kernel
def drive(run: int, method: int, attempt: int, dense: int, plan: int, budget: int, path: int) -> tuple[int, int]:
    """Attempt up to `budget` steps; return (status, rows in the buffer). See `drive_steps`."""
    return drive_steps(run, method, attempt, dense, plan, budget, path)


@subkernel
def drive_steps(run: int, method: int, attempt: int, dense: int, plan: int, budget: int, path: int) -> tuple[int, int]:
    """Attempt up to `budget` steps; return (status, rows in the buffer).

    Parameters
    ----------
    run, method
        Addresses of the bundles of the run and of the method.
    attempt, dense
        Addresses of the method's functions.
    plan
        Address of the plan (`mbdkit.integrators.run.run_plan.RunPlan`).
    budget
        Number of attempts; rows of a pending step are written even if it is 0.
    path
        Address of the `mbdkit.integrators.run.step_path.StepPath` that receives the steps; 0 if they are not stored.
    """
    c, planned = load_run_state(run), load_plan(plan)
    progress, every = c.progress, planned.recording.every[0]
    rows, attempts = c.first_row[0], 0
    while True:
        if progress.pending[0] == 0:
            if _has_ended(planned, progress) or attempts >= budget or rows >= len(c.row_time):
                return OK, rows
            if not (_has_room(c) and has_room(path)):
                return OK, rows
            attempts += 1
            status = _try_step(run, method, attempt, planned, path)
            if status != OK:
                return status, rows
            if progress.pending[0] == 0:  # the step was rejected
                continue
        if every == 0:
            status, rows = _write_inner_rows(run, method, dense, planned, rows)
            if status != OK or rows >= len(c.row_time):
                return status, rows
        if c.nodes[0] != 0:
            status = call_entry(c.nodes[0], run, method, progress.tried_begin[0], progress.last_size[0], 0.0)
            if status != OK:
                return status, rows
        if path != 0:
            _store_inside(run, method, dense, path, planned.projection.mode[0])
        status, last, whole = _advance(c, planned)
        if status == NOT_FINITE:
            return status, rows
        if path != 0:
            store_end(path, attempts, progress.time[0], c.q, c.v, c.z)
        if last or (every > 0 and whole and progress.whole[0] % every == 0):
            c.point_gain[0] = c.point_gain[1] = 0.0
            _write_row(c, rows, progress.time[0], c.q, c.v, c.z, c.point_gain, c.own_lam)
            rows += 1
        if status == OK and progress.after_stop[0] != 0:
            return AT_STOP, rows
        if status != OK:
            return status, rows
