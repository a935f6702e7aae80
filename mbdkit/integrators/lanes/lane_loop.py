"""Vectorized runs: the loop over fixed steps, and the values of the recorded states.

Several runs of mechanisms with the same topology advance together, one in each SIMD lane
(`mbdkit_builder.lane_types`). Parameters, initial states, steps and loads may differ, the number of steps may
not. The functions of a step are those of single runs, compiled for lanes; only the loop over steps is simpler, because
it does not depend on the lane. A lane in which an exceptional case occurs (a value that is not finite, a small pivot, a
guard) is *lost*: it remains in the loop, but its run is repeated alone.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.acting import joint_values
from mbdkit.engine.kernels.applied_forces import state_rates, take_states
from mbdkit.engine.kernels.misalignment import raise_misalignments
from mbdkit.engine.kernels.observe import describe
from mbdkit.engine.kernels.singularity_kernels import singularity_distance
from mbdkit.engine.kernels.system import prepare
from mbdkit.engine.kernels.vectors import copy, stays_finite
from mbdkit.engine.native.arithmetic import number_in, where
from mbdkit.engine.native.functions import inlined, kernel, subkernel
from mbdkit.engine.native.levels import WIDTH
from mbdkit.integrators.lanes.lane_run import load_guards, load_lane_run
from mbdkit.integrators.run.run_state import ITERATIONS, add_increments
from mbdkit.integrators.run.step_guards import begin_energy, distance_by_pivots, energy_jump, note_jump, watch_branch
from mbdkit.integrators.stages.explicit import add_up_stages, evaluate_stages


@subkernel
def lose(c, condition):
    """Mark the lanes in which a condition holds as lost."""
    c.lost[0] = where(condition, 1.0, c.lost[0])


@subkernel
def watch_branches(c, t, moved):
    """Update the paths of lanes by the step that ends at `t`; see `mbdkit.integrators.run.step_guards.watch_branch`.

    Only lanes in which `moved` is not 0 are updated.
    """
    watch = c.watch
    for lane in range(WIDTH):
        if number_in(moved, lane) == 0.0:
            continue
        guards = load_guards(watch.guards[lane])
        guards.distance[0] = number_in(watch.distance[0], lane)
        guards.kinetic[0] = number_in(c.guards.kinetic[0], lane)
        for d in range(len(c.q)):
            watch.dq[d] = number_in(c.dq[d], lane)
            watch.v[d] = number_in(c.v[d], lane)
        watch_branch(guards, watch.mass[lane], number_in(t, lane), watch.dq, watch.v)


@subkernel
def _write_row(c, row, t):
    c.row_time[row] = t
    copy(c.q, c.row_q[row])
    copy(c.v, c.row_v[row])
    copy(c.z, c.row_z[row])
    for k in range(2):
        c.row_energy[row, k] = c.energy[k]
        c.row_interval[row, k] = c.interval[k]
        c.interval[k] = 0.0


@subkernel
def observe_row(c, r):
    """Compute the values of a recorded state; see `mbdkit.engine.kernels.observe.observe`."""
    top, w, out = c.top, c.w, c.observed
    q, v, acc, lam = c.row_q[r], c.row_v[r], out.acc[r], out.lam[r]
    prepare(top, w, c.row_time[r], q)
    take_states(top, w, c.row_z[r])
    solve_accelerations(top, w, c.solver, q, v, acc, lam, True)
    state_rates(top, w, v, out.state_rates[r])
    out.singularity_distance[r] = singularity_distance(top, w, c.solver, c.near)
    describe(top, w, q, v, out, r)
    joint_values(top, w, q, lam, out.reactions[r], out.joints[r])
    total = out.kinetic[r] + out.potential[r]
    for d in range(len(acc)):
        total += abs(acc[d])
    for k in range(len(lam)):
        total += abs(lam[k, 0]) + abs(lam[k, 1])
    lose(c, not abs(total) < np.inf)


@inlined
def drive(c, take_step):
    """Take all steps of the runs in a `LaneRun`, and compute the values of the recorded states; return their number.

    Parameters
    ----------
    take_step
        ``(c, m, t, h, n)``: write the increments of step `n` by the method `m`, and the distance to singularity if
        joints close a loop.
    """
    m, times = c.method, c.times
    start, step, steps, every = times.start[0], times.step[0], times.steps[0], c.every[0]
    _write_row(c, 0, start)
    rows = 1
    begin_energy(c, c.guards, start, c.q, c.v)
    for n in range(steps):
        t = start + n * step
        h = where(n < steps - 1, step, times.last_step[0])
        before = c.counts[ITERATIONS]
        take_step(c, m, t, h, n)
        iterations = c.counts[ITERATIONS] - before
        c.interval[0] += iterations
        c.interval[1] = max(c.interval[1], iterations)
        lose(c, not (stays_finite(c.q, c.dq) & stays_finite(c.v, c.dv)))
        if len(c.z) > 0:
            lose(c, not stays_finite(c.z, c.dz))
        add_increments(c, True)
        t = where(n < steps - 1, start + (n + 1) * step, times.end[0])
        if c.watch.has_loops[0] != 0:
            watch_branches(c, t, where(c.lost[0] == 0.0, 1.0, 0.0))
        raise_misalignments(c.top, c.w, t, c.q, c.worst)
        jump, total, kinetic, rounding = energy_jump(c, c.guards, c.gain, c.q, c.v)
        note_jump(c.guards, t, jump, total, kinetic, rounding, c.energy_share[0])
        for k in range(len(c.worst)):
            lose(c, c.worst[k] > c.squared_misalignment[k])
        lose(c, c.guards.exceeded[0] != 0.0)
        if (n + 1) % every == 0 or n == steps - 1:
            _write_row(c, rows, t)
            rows += 1
    for r in range(rows):
        observe_row(c, r)
    return rows


@subkernel
def take_explicit_step(c, m, t, h, n):
    """Take step `n` of an explicit method; after the first step, its first stage may be the last one before."""
    stages = len(m.b)
    first = 0
    if n > 0 and m.status[0] != 0:
        copy(m.rates[stages - 1], m.rates[0])
        copy(m.accelerations[stages - 1], m.accelerations[0])
        copy(m.z_rates[stages - 1], m.z_rates[0])
        m.power[0, 0], m.power[0, 1] = m.power[stages - 1, 0], m.power[stages - 1, 1]
        first = 1
    evaluate_stages(c, m, t, h, first, stages)
    add_up_stages(c, m, t, h)
    if c.watch.has_loops[0] != 0:
        c.watch.distance[0] = distance_by_pivots(c.solver.schur)


@kernel
def drive_explicit(address: int) -> int:
    """Take the steps of an explicit method; see `drive`."""
    return drive(load_lane_run(address), take_explicit_step)
