"""Vectorized runs with controlled step size: each lane has its own time, step size and error, and ends independently.

A *lane* is one of several runs that advance together in the elements of SIMD vectors. In each turn of the loop, every
lane attempts one step of its own; some lanes accept their step, others reject it. Lanes that have reached their end do
not change until the last one has ended. The functions of a step and of its control are those of single runs, compiled
for lanes; masks replace branches. A method provides its step as `LaneStep`. A run that needs a projection, or whose
step fails for other reasons than its error or the divergence of its stage equations, is lost (repeated alone); see
`mbdkit.integrators.lanes.lane_loop`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.misalignment import raise_misalignments
from mbdkit.engine.kernels.system import prepare
from mbdkit.engine.kernels.vectors import add_compensated, stays_finite
from mbdkit.engine.native.arithmetic import any_of, below, number_in, put_in, where
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import kernel, subkernel
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.native.number_arrays import new_lanes
from mbdkit.integrators.interface import ROUNDING
from mbdkit.integrators.lanes.lane_loop import drive_explicit, lose, observe_row, watch_branches
from mbdkit.integrators.lanes.lane_run import InLanes, LaneRun, example_lane_run, explicit_in_lanes, load_guards
from mbdkit.integrators.loop.step_loop import ROW_MARGIN
from mbdkit.integrators.run.run_plan import NEAR
from mbdkit.integrators.run.run_state import FACTORIZATIONS, ITERATIONS, RHS, Progress, add_increments
from mbdkit.integrators.run.step_control import (
    MIN_LAST_ERROR,
    Control,
    ControlData,
    control_data,
    factor_after_acceptance,
    factor_after_rejection,
    fitted_size,
    is_too_small,
    local_error,
)
from mbdkit.integrators.run.step_guards import begin_energy, distance_by_pivots, energy_jump, note_jump
from mbdkit.integrators.stages.explicit import add_up_stages, estimate_errors, evaluate_point, evaluate_stages
from mbdkit.trust.criteria import ENERGY_JUMP

STEPS, SIZE, REJECTED = range(3)  #: Indices of `LaneControl.work`.

ENDED, FULL = 0, 1  #: Results of `drive_controlled`: all runs have ended, or the buffer of recorded states is full.


class LaneStep(NamedTuple):
    """The parts of a method that `drive_controlled` calls; `s` is the `LaneControl`."""

    #: ``(s, t, h, running)``: write the increments of the steps of size `h` from `t`, the estimates of their errors,
    #: and the distance to singularity if joints close a loop. Counts change only where `running`. Return in which lanes
    #: the stage equations have not been solved, so that single runs reject the step.
    attempt: Callable[..., bool]
    #: ``(s, t, h, due)``: evaluate what only dense output needs, and count it where it is `due`.
    evaluate_further: Callable[..., None]
    #: ``(c, m, t, h, theta, s)``: write the state of the run at the share `theta` of its step into arrays of `s`.
    evaluate_point: Callable[..., None]


class LaneControl(NamedTuple):
    """`WIDTH` runs with controlled step size. Shapes of vectors and of recorded values are as in `LaneRun`."""

    run: LaneRun
    #: Its fields with tolerances and sizes hold lanes, the others numbers: the controller is the same in all lanes.
    control: ControlData
    progress: Progress  #: All its fields hold lanes; the attempted size is 0 in lanes that are not running.
    running: np.ndarray  #: (1,) 1 in lanes that have not ended and are not lost.
    est_q: np.ndarray  #: Estimates of the local error, see `mbdkit.integrators.run.run_state.RunState`.
    est_v: np.ndarray
    est_z: np.ndarray
    second_q: np.ndarray
    second_v: np.ndarray
    second_z: np.ndarray
    new_q: np.ndarray  #: State at the end of the attempted step.
    new_v: np.ndarray
    point_q: np.ndarray  #: Result of dense output.
    point_v: np.ndarray
    point_z: np.ndarray
    point_gain: np.ndarray
    #: (3,) STEPS, SIZE, REJECTED: steps since the last recorded state, size of the last one, rejected steps.
    work: np.ndarray
    row_work: np.ndarray  #: (R, 3) the values of `work` at each recorded state.
    #: (WIDTH,) number of recorded states of each run; an array of numbers, as are the next two fields.
    rows: np.ndarray
    #: (1,) distance of recorded states in time [s], if `LaneRun.every` is 0, which otherwise counts accepted steps.
    interval: np.ndarray
    attempts: np.ndarray  #: (1,) number of turns of the loop so far.
    max_steps: np.ndarray  #: (1,) number of accepted steps after which a run that has not ended is lost; lanes.


@subkernel
def _is_full(s):
    is_full = False
    for lane in range(WIDTH):
        is_full = is_full or (number_in(s.running[0], lane) != 0.0 and s.rows[lane] >= len(s.row_work))
    return is_full


@subkernel
def _write_rows(s, due, t, q, v, z, gain):
    """Store a state in those lanes in which `due` is not 0, and begin a new interval there."""
    c = s.run
    for lane in range(WIDTH):
        if number_in(due, lane) == 0.0:
            continue
        row = s.rows[lane]
        c.row_time[row] = put_in(c.row_time[row], lane, number_in(t, lane))
        for d in range(len(q)):
            c.row_q[row, d] = put_in(c.row_q[row, d], lane, number_in(q[d], lane))
            c.row_v[row, d] = put_in(c.row_v[row, d], lane, number_in(v[d], lane))
        for d in range(len(z)):
            c.row_z[row, d] = put_in(c.row_z[row, d], lane, number_in(z[d], lane))
        for k in range(2):
            c.row_energy[row, k] = put_in(c.row_energy[row, k], lane, number_in(c.energy[k] + gain[k], lane))
            c.row_interval[row, k] = put_in(c.row_interval[row, k], lane, number_in(c.interval[k], lane))
            c.interval[k] = put_in(c.interval[k], lane, 0.0)
        for k in range(len(s.work)):
            s.row_work[row, k] = put_in(s.row_work[row, k], lane, number_in(s.work[k], lane))
            s.work[k] = put_in(s.work[k], lane, 0.0)
        s.rows[lane] += 1


@subkernel
def _attempt_explicit(s, t, h, running):
    """Evaluate the stages of a step of each lane, add them up, and count evaluations as a single run would."""
    c, m = s.run, s.run.method
    stages, first = len(m.b), 0
    right_sides, factorizations = c.counts[RHS], c.counts[FACTORIZATIONS]
    known = s.progress.retrying[0]
    if s.attempts[0] > 0 and m.status[0] != 0:  # the first stage is known in all lanes
        accepted = known == 0.0
        for d in range(len(m.rates[0])):
            m.rates[0, d] = where(accepted, m.rates[stages - 1, d], m.rates[0, d])
            m.accelerations[0, d] = where(accepted, m.accelerations[stages - 1, d], m.accelerations[0, d])
        for d in range(len(c.z)):
            m.z_rates[0, d] = where(accepted, m.z_rates[stages - 1, d], m.z_rates[0, d])
        for k in range(2):
            m.power[0, k] = where(accepted, m.power[stages - 1, k], m.power[0, k])
        first, known = 1, 0.0 * known
    evaluate_stages(c, m, t, h, first, stages)
    c.counts[RHS] = where(running, c.counts[RHS] - known, right_sides)
    factorized = 0.0 * known if len(m.relative.bodies) > 0 else known  # trees of pins factorize nothing
    c.counts[FACTORIZATIONS] = where(running, c.counts[FACTORIZATIONS] - factorized, factorizations)
    add_up_stages(c, m, t, h)
    estimate_errors(c, m, t, h, s)
    if c.watch.has_loops[0] != 0:
        c.watch.distance[0] = distance_by_pivots(c.solver.schur)
    return running & False


@subkernel
def _evaluate_further(s, t, h, due):
    """Evaluate the stages that only dense output needs, and count them in lanes in which it is due."""
    c, m = s.run, s.run.method
    right_sides, factorizations = c.counts[RHS], c.counts[FACTORIZATIONS]
    evaluate_stages(c, m, t, h, len(m.b), len(m.c))
    c.counts[RHS] = where(due, c.counts[RHS], right_sides)
    c.counts[FACTORIZATIONS] = where(due, c.counts[FACTORIZATIONS], factorizations)


@subkernel
def _lose_near_singularities(s, accepted):
    """Mark lanes near a singular position as lost, because their single runs would be projected."""
    c = s.run
    for lane in range(WIDTH):
        farthest = load_guards(c.watch.guards[lane]).farthest[0]
        if number_in(accepted, lane) != 0.0 and number_in(c.watch.distance[0], lane) < NEAR * farthest:
            c.lost[0] = put_in(c.lost[0], lane, 1.0)


@subkernel
def _check_energy(s, at, accepted):
    """Record the energy balance of the accepted steps, which end at `at`.

    A lane is lost if a single run would reject its step because of the energy.
    """
    c = s.run
    guards = c.guards
    prepare(c.top, c.w, at, s.new_q)
    jump, total, kinetic, rounding = energy_jump(c, guards, c.gain, s.new_q, s.new_v)
    lose(c, accepted & (not abs(jump) <= ENERGY_JUMP * max(kinetic, guards.kinetic[0]) + rounding))
    jump, rounding = where(accepted, jump, 0.0), where(accepted, rounding, 0.0)
    total, kinetic = where(accepted, total, guards.energy[0]), where(accepted, kinetic, guards.kinetic[0])
    note_jump(guards, at, jump, total, kinetic, rounding, c.energy_share[0])
    lose(c, guards.exceeded[0] != 0.0)


@subkernel
def _choose_sizes(s, t, h, error, unsolved, accepted, rejected):
    control, progress = s.control, s.progress
    after = factor_after_acceptance(control, h, error, progress) * h
    goes_on = accepted & (t + h < s.run.times.end[0])
    size = where(goes_on, after, progress.next_size[0])
    progress.next_size[0] = where(rejected, factor_after_rejection(control, not unsolved, error) * h, size)
    progress.earlier_error[0] = where(accepted, progress.last_error[0], progress.earlier_error[0])
    progress.last_error[0] = where(accepted, max(error, MIN_LAST_ERROR), progress.last_error[0])
    progress.earlier_size[0] = where(accepted, progress.last_size[0], progress.earlier_size[0])
    progress.last_size[0] = where(accepted, h, progress.last_size[0])
    progress.retrying[0] = where(rejected, 1.0, where(accepted, 0.0, progress.retrying[0]))
    progress.rejected[0] += where(rejected, 1.0, 0.0)
    progress.accepted[0] += where(accepted, 1.0, 0.0)
    s.work[REJECTED] += where(rejected, 1.0, 0.0)
    s.work[STEPS] += where(accepted, 1.0, 0.0)
    s.work[SIZE] = where(accepted, h, s.work[SIZE])


@subkernel
def _write_inner_rows(s, step, t, h, reached, accepted):
    c, m, progress, interval = s.run, s.run.method, s.progress, s.interval[0]
    start, end = c.times.start[0], c.times.end[0]
    last, reached = end - ROW_MARGIN * interval, reached + ROUNDING * max(abs(start), abs(end))
    at = start + progress.next_row[0] * interval
    due = accepted & (at <= reached) & (at < last)
    if any_of(due):
        step.evaluate_further(s, t, h, due)
    while any_of(due):
        step.evaluate_point(c, m, t, h, min(1.0, (at - t) / h), s)
        _write_rows(s, where(due, 1.0, 0.0), at, s.point_q, s.point_v, s.point_z, s.point_gain)
        progress.next_row[0] += where(due, 1.0, 0.0)
        at = start + progress.next_row[0] * interval
        due = due & (at <= reached) & (at < last)


@subkernel
def _advance(s, at, ended, accepted):
    """Add the increments of the accepted steps to the states, and move the times to their ends `at`."""
    c, progress = s.run, s.progress
    add_increments(c, accepted)
    add_compensated(progress.time, progress.time_low, progress.tried_size, accepted)
    progress.time[0] = where(accepted & ended, at, progress.time[0])
    t = progress.time[0]
    if c.watch.has_loops[0] != 0:
        watch_branches(c, t, where(accepted, 1.0, 0.0))
    raise_misalignments(c.top, c.w, t, c.q, c.worst)
    for k in range(len(c.worst)):
        c.worst[k] = where(progress.accepted[0] > 0.0, c.worst[k], 0.0)  # the initial state is not a step
        lose(c, c.worst[k] > c.squared_misalignment[k])


@subkernel
def _attempt(s, step):
    c, control, progress = s.run, s.control, s.progress
    end, every = c.times.end[0], c.every[0]
    running = s.running[0] != 0.0
    t = progress.time[0]
    h = fitted_size(t, min(progress.next_size[0], control.max_size[0]), end)
    lose(c, running & is_too_small(control, t, h, end))
    progress.tried_size[0] = h = where(running, h, 0.0)
    iterations = c.counts[ITERATIONS]
    unsolved = step.attempt(s, t, h, running)
    iterations = c.counts[ITERATIONS] - iterations
    solved = running & (not unsolved)
    lose(c, solved & (not (stays_finite(c.q, c.dq) & stays_finite(c.v, c.dv))))
    error = local_error(control, s, c)
    lose(c, solved & (not error < np.inf))
    accepted, rejected = solved & (error <= 1.0), running & (unsolved | (error > 1.0))
    c.interval[0] += iterations
    c.interval[1] = where(accepted, max(c.interval[1], iterations), c.interval[1])
    if c.watch.has_loops[0] != 0:
        _lose_near_singularities(s, where(accepted, 1.0, 0.0))
    for d in range(len(c.q)):
        s.new_q[d] = c.q[d] + c.dq[d]
        s.new_v[d] = c.v[d] + c.dv[d]
    ended = t + h >= end
    reached = where(ended, end, t + h)
    _check_energy(s, reached, accepted)
    _choose_sizes(s, t, h, error, unsolved, accepted, rejected)
    if every == 0:
        _write_inner_rows(s, step, t, h, reached, accepted)
    _advance(s, reached, ended, accepted)
    due = accepted & ended
    if every > 0:
        due = accepted & (ended | (progress.accepted[0] == every * below(progress.accepted[0] / every)))
    s.point_gain[0] = s.point_gain[1] = 0.0
    _write_rows(s, where(due, 1.0, 0.0), progress.time[0], c.q, c.v, c.z, s.point_gain)
    lose(c, running & (not (accepted & ended)) & (progress.accepted[0] >= s.max_steps[0]))
    s.running[0] = where((c.lost[0] != 0.0) | (accepted & ended), 0.0, s.running[0])
    s.attempts[0] += 1


@subkernel
def _most_rows(s):
    """Return the largest number of recorded states, after repeating the last one of lanes that have fewer."""
    c, most = s.run, 0
    for lane in range(WIDTH):
        most = max(most, s.rows[lane])
    for lane in range(WIDTH):
        for row in range(s.rows[lane], most):
            c.row_time[row] = put_in(c.row_time[row], lane, number_in(c.row_time[row - 1], lane))
            for d in range(len(c.q)):
                c.row_q[row, d] = put_in(c.row_q[row, d], lane, number_in(c.row_q[row - 1, d], lane))
                c.row_v[row, d] = put_in(c.row_v[row, d], lane, number_in(c.row_v[row - 1, d], lane))
            for k in range(2):
                c.row_energy[row, k] = put_in(c.row_energy[row, k], lane, number_in(c.row_energy[row - 1, k], lane))
    return most


@kernel
def accelerate(address: int) -> None:
    """Write the accelerations in the initial states of the runs into the first stage."""
    c = load_lane_control(address).run
    m = c.method
    prepare(c.top, c.w, c.times.start[0], c.q)
    solve_accelerations(c.top, c.w, c.solver, c.q, c.v, m.accelerations[0], m.lam, True)


@subkernel
def drive_controlled(s, step):
    """Take steps until all runs in a `LaneControl` have ended or the buffer is full; return ENDED or FULL.

    If all runs have ended, the values of the recorded states are computed. `step` is the `LaneStep` of the method.
    """
    c = s.run
    if s.attempts[0] == 0:
        begin_energy(c, c.guards, s.progress.time[0], c.q, c.v)
        s.point_gain[0] = s.point_gain[1] = 0.0
        _write_rows(s, s.running[0], s.progress.time[0], c.q, c.v, c.z, s.point_gain)
    while any_of(s.running[0] != 0.0):
        if _is_full(s):
            return FULL
        _attempt(s, step)
    for r in range(_most_rows(s)):
        observe_row(c, r)
    return ENDED


EXPLICIT = LaneStep(_attempt_explicit, _evaluate_further, evaluate_point)


@kernel
def drive_explicit_controlled(address: int) -> int:
    """Take the steps of an explicit method; see `drive_controlled`."""
    return drive_controlled(load_lane_control(address), EXPLICIT)


def control_in_lanes(control: Control) -> ControlData:
    """Return step-size control for lanes, with the coefficients of one of the runs."""
    given = control_data(control, 0.0)
    return given._replace(rtol=new_lanes(1), atol=new_lanes(3), min_size=new_lanes(1), max_size=new_lanes(1))


def new_lane_control(run: LaneRun, control: Control) -> LaneControl:
    """Return the bundle of runs with controlled step size that record as many states as those of `run` can."""
    size, rows = len(run.q), len(run.row_time)
    vectors = ("est_q", "est_v", "second_q", "second_v", "new_q", "new_v", "point_q", "point_v")
    return LaneControl(
        run=run, control=control_in_lanes(control),
        progress=Progress(*(new_lanes(1) for _ in Progress._fields)), running=new_lanes(1),
        **{name: new_lanes(size) for name in vectors},
        **{name: new_lanes(len(run.z)) for name in ("est_z", "second_z", "point_z")},
        point_gain=new_lanes(2), work=new_lanes(3), row_work=new_lanes(rows, 3),
        rows=np.zeros(WIDTH, dtype=np.int64), interval=np.zeros(1), attempts=np.zeros(1, dtype=np.int64),
        max_steps=new_lanes(1),
    )  # fmt: skip


load_lane_control = bundle_loader(lambda: new_lane_control(example_lane_run(), Control()))

EXPLICIT_IN_LANES = InLanes(
    drive_explicit, drive_explicit_controlled, lambda method, workspace, *others: explicit_in_lanes(method, workspace)
)
