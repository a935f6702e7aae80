"""The compiled driver: takes the steps of every compiled family, in fixed or controlled sizes, projected or not.

A family brings two compiled functions (`mbdkit.engine.jit.entry`), which find the run and their own bundle at the
addresses `common` and `own`:

``attempt(common, own, t, h, want_error)``
    Tries a step of size `h` from the base state ``from_q, from_v``, which it leaves alone; writes ``dq, dv``, where
    ``has_power`` says so ``gain``, the method's own multipliers into ``own_lam``, and with `want_error` other than 0
    ``est_q, est_v``. ``moved`` tells how the base state stands to the last attempt.
``dense(common, own, t, h, theta)``
    Writes ``point_q, point_v, point_gain`` and ``point_lam``: the state at ``t + theta h`` within the last attempt.

Both return a status of `mbdkit.engine.kernels.system`.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.jit.decorators import kernel, subkernel
from mbdkit.engine.jit.entry import call_entry
from mbdkit.engine.kernels.misalignment import raise_misalignments
from mbdkit.engine.kernels.projection import (
    mass_norm,
    project_positions,
    project_velocities,
)
from mbdkit.engine.kernels.system import (
    DIVERGED,
    NOT_FINITE,
    OK,
    constraint_rows,
    prepare,
)
from mbdkit.engine.kernels.vectors import add_compensated, copy, stays_finite
from mbdkit.stepping.projected_step import NO_PROJECTION, PLAIN, SYMMETRIC, project, take
from mbdkit.stepping.run_state import ADVANCED, ALTERED, PROJECTIONS, SAME, load_common

TIME, TIME_LOW, SIZE, LAST_ERROR, NEXT_ROW, TAKEN = range(6)
"""``clock``: time reached and its low part; size of the next step, if it is controlled; scaled error of the
last accepted step, 0 before there is one; number of the next row by interval; size of the last step."""

STEPS, LAST_SIZE, SUM, MOST, REJECTED, CORRECTIONS, POSITION, VELOCITY, ACCELERATION = range(9)
"""``tally`` since the last recorded row: steps; size of the last; iterations, summed and largest; rejected steps;
projections; largest corrections of positions [m] and velocities [m/s]; largest Baumgarte term [m/s^2]."""

ACCEPTED, ALL_REJECTED, PENDING, RETRY = range(4)
"""``numbers``: steps accepted and rejected so far; whether rows of an accepted step are still to be written; whether
the last attempt was rejected."""

TOO_SMALL = 5
"""Status: the step would have to be smaller than the floor under it."""

SAFETY, LEAST, LARGEST, AFTER_FAILURE = 0.9, 0.2, 6.0, 0.25
"""Control of the step: margin, bounds on its change, and its change where the equations could not be solved."""


@subkernel
def _scaled_norm(c, rtol, atol, x_q, x_v):
    """Return the root mean square of errors over ``atol + rtol |y|``, y the larger of both ends of the step."""
    total = 0.0
    n = len(c.q) - 3
    for d in range(n):
        scale_q = atol + rtol * max(abs(c.from_q[d]), abs(c.from_q[d] + c.dq[d]))
        scale_v = atol + rtol * max(abs(c.from_v[d]), abs(c.from_v[d] + c.dv[d]))
        total += (x_q[d] / scale_q) ** 2 + (x_v[d] / scale_v) ** 2
    return np.sqrt(total / (2 * n))


@subkernel
def _scaled_error(c, rtol, atol, estimates):
    """Return the local error over the tolerance; of two estimates, their product over the norm of both (Hairer)."""
    error = _scaled_norm(c, rtol, atol, c.est_q, c.est_v)
    if estimates == 2:
        rough = _scaled_norm(c, rtol, atol, c.second_q, c.second_v)
        if error > 0.0:
            error = error * error / np.sqrt(error * error + 0.01 * rough * rough)
    return error


@subkernel
def _baumgarte_term(c, t):
    """Return the largest ``|2 alpha (Phi_q v + Phi_t) + beta^2 Phi|`` at the state."""
    prepare(c.top, c.w, t, c.q)
    return constraint_rows(c.top, c.w, c.q, c.v)


@subkernel
def _write_row(c, row, t, q, v, gain, lam):
    """Write a recorded state, and begin a new interval."""
    c.row_time[row] = t
    copy(q, c.row_q[row])
    copy(v, c.row_v[row])
    for k in range(2):
        c.row_energy[row, k] = c.energy[k] + gain[k]
    for k in range(len(c.tally)):
        c.row_tally[row, k] = c.tally[k]
        c.tally[k] = 0.0
    if len(c.row_lam) > 0:
        for k in range(len(lam)):
            c.row_lam[row, k, 0], c.row_lam[row, k, 1] = lam[k, 0], lam[k, 1]


@subkernel
def _dense_row(common, own, dense, row, t, h, at, mode):
    """Write the state between two steps, by dense output; return a status.

    A correction of the end of the step fades in smoothly; where states are projected, this one is as well.
    """
    c = load_common(common)
    theta = min(1.0, (at - t) / h)
    status = call_entry(dense, common, own, t, h, theta)
    if status != OK:
        return status
    if mode == PLAIN:
        fade = theta * theta * (3.0 - 2.0 * theta)
        for d in range(len(c.q)):
            c.point_q[d] += fade * c.shift_q[d]
            c.point_v[d] += fade * c.shift_v[d]
        status = project_positions(c.still, c.w, c.solver, at, c.point_q, c.est_q, c.rest, c.x, c.lam)
        if status != OK:
            return status
        copy(c.est_q, c.point_q)
        status = project_velocities(c.still, c.w, c.solver, at, c.point_q, c.point_v, c.x, c.lam)
        if status != OK:
            return status
        c.counts[PROJECTIONS] += 1
    _write_row(c, row, at, c.point_q, c.point_v, c.point_gain, c.point_lam)
    return OK


@subkernel
def _book(c, bring):
    """Add the energies of a step to their sums, with compensation."""
    for m in range(2):
        y = bring[m] + c.energy_low[m]
        new = c.energy[m] + y
        c.energy_low[m] = y - (new - c.energy[m])
        c.energy[m] = new


@kernel
def look_inside(common, own, dense, t, h, theta):
    """Evaluate dense output of the last attempt into ``point_q, point_v``; return a status."""
    return call_entry(dense, common, own, t, h, theta)


@kernel
def drive(
    common, own, attempt, dense, numbers, budget, controlled, start, step, end, total, last_step, every, interval,
    rtol, atol, exponent, share, estimates, floor, mode, project_every, bound, baumgarte, inside,
):  # fmt: skip
    """Take up to `budget` steps; return (status, rows written).

    Parameters
    ----------
    common, own
        Addresses of the run and of the method's bundle.
    attempt, dense
        Addresses of the method's functions.
    numbers : (4,) int array
        ACCEPTED, ALL_REJECTED, PENDING, RETRY.
    controlled
        Whether the size of steps is controlled by their error.
    start, step, end, total, last_step
        Time of the start, size of fixed steps, end, number of fixed steps, size of the last of them.
    every
        Record every k-th step, and the end; 0: by `interval`.
    interval
        Record at these distances in time, and the end.
    rtol, atol, exponent, share, estimates
        Control: tolerances of the estimate, 1 over its order in h, share of the last error, number of estimates.
    floor
        Least size of a step relative to the largest time or span.
    mode, project_every, bound
        NO_PROJECTION, PLAIN or SYMMETRIC; projection every k steps, or of those where constraints are missed by more
        than `bound` (0: all).
    baumgarte
        Whether the constraints are stabilized so.
    inside
        Whether the state before each step is kept.
    """
    c = load_common(common)
    clock, tally = c.clock, c.tally
    rows, most = 0, len(c.row_time)
    status = OK
    while status == OK:
        if numbers[PENDING] == 0:
            finished = clock[TIME] >= end if controlled else numbers[ACCEPTED] >= total
            if finished or budget <= 0 or rows >= most:
                break
            if controlled:
                t, h = clock[TIME], clock[SIZE]
                if t + 1.01 * h >= end:
                    h = end - t
                elif t + 2.0 * h > end:
                    h = 0.5 * (end - t)
                if not h > floor and t + 1.01 * h < end:
                    status = TOO_SMALL
                    break
            else:
                t = start + numbers[ACCEPTED] * step
                h = step if numbers[ACCEPTED] < total - 1 else last_step
            if mode != SYMMETRIC and numbers[RETRY] == 0:
                copy(c.q, c.from_q)
                copy(c.v, c.from_v)
            if baumgarte:
                tally[ACCELERATION] = max(tally[ACCELERATION], _baumgarte_term(c, t))
            due = (numbers[ACCEPTED] + 1) % project_every == 0
            before = c.counts[3]
            c.w.faulty[0] = -1  # where a run stops, the last attempt counts
            status = take(common, own, attempt, t, h, controlled, mode)
            iterations = c.counts[3] - before
            error = 0.0
            projected = False
            if status == OK and controlled:
                error = _scaled_error(c, rtol, atol, estimates)
            if status == OK and error <= 1.0:
                at = end if (controlled and t + h >= end) or numbers[ACCEPTED] + 1 == total else t + h
                status, projected = project(common, at, mode, due, bound)
            tally[SUM] += iterations
            if controlled and (status in (DIVERGED, NOT_FINITE) or not error <= 1.0):
                factor = AFTER_FAILURE
                if status == OK and error < np.inf:
                    factor = max(LEAST, SAFETY * error ** (-exponent))
                status = OK
                clock[SIZE] = factor * h
                c.moved[0] = SAME
                numbers[RETRY] = 1
                numbers[ALL_REJECTED] += 1
                tally[REJECTED] += 1
                budget -= 1
                continue
            if status != OK:
                c.moved[0] = ALTERED
                break
            tally[MOST] = max(tally[MOST], iterations)
            tally[STEPS] += 1
            tally[LAST_SIZE] = h
            if projected:
                tally[CORRECTIONS] += 1
                mass = 0.0
                for b in range(len(c.top.mass) - 1):
                    mass += c.top.mass[b, 0]
                tally[POSITION] = max(tally[POSITION], mass_norm(c.top.mass, mass, c.shift_q, c.rest))
                tally[VELOCITY] = max(tally[VELOCITY], mass_norm(c.top.mass, mass, c.shift_v, c.rest))
            if controlled:
                factor = LARGEST
                if error > 0.0:
                    factor = SAFETY * error ** (-(exponent - 0.75 * share))
                    if clock[LAST_ERROR] > 0.0:
                        factor *= clock[LAST_ERROR] ** share
                factor = min(LARGEST, max(LEAST, factor))
                if numbers[RETRY] != 0:
                    factor = min(1.0, factor)
                if t + h < end:  # the last step is cut to fit
                    clock[SIZE] = factor * h
                clock[LAST_ERROR] = max(error, 1e-4)
            numbers[RETRY] = 0
            clock[TAKEN] = h
            budget -= 1
            numbers[PENDING] = 1
            c.moved[0] = ALTERED if projected else ADVANCED
        # the step is taken: rows inside it, then its end
        h = clock[TAKEN]
        t = clock[TIME] if controlled else start + numbers[ACCEPTED] * step
        last = t + h >= end if controlled else numbers[ACCEPTED] + 1 >= total
        reached = end if last else t + h
        if every == 0:
            at = start + clock[NEXT_ROW] * interval
            while status == OK and rows < most and at <= reached and at < end - 1e-9 * interval:
                status = _dense_row(common, own, dense, rows, t, h, at, mode)
                if status == OK:
                    rows += 1
                    clock[NEXT_ROW] += 1.0
                    at = start + clock[NEXT_ROW] * interval
            if status != OK or rows >= most:
                break
        if not (stays_finite(c.q, c.dq) and stays_finite(c.v, c.dv)):
            status = NOT_FINITE
            break
        if inside:
            copy(c.q, c.before_q)
            copy(c.v, c.before_v)
        if mode != NO_PROJECTION:
            for d in range(len(c.q)):
                c.dq[d] += c.shift_q[d]
                c.dv[d] += c.shift_v[d]
        add_compensated(c.q, c.q_low, c.dq)
        add_compensated(c.v, c.v_low, c.dv)
        if c.has_power[0] != 0:
            _book(c, c.gain)
        numbers[ACCEPTED] += 1
        numbers[PENDING] = 0
        if controlled:
            y = h + clock[TIME_LOW]
            clock[TIME] = t + y
            clock[TIME_LOW] = y - (clock[TIME] - t)
            if last:
                clock[TIME] = end
        else:
            clock[TIME] = reached if last else start + numbers[ACCEPTED] * step
        raise_misalignments(c.still, c.w, clock[TIME], c.q, c.worst)
        if last or (every > 0 and numbers[ACCEPTED] % every == 0):
            c.point_gain[0] = c.point_gain[1] = 0.0
            _write_row(c, rows, clock[TIME], c.q, c.v, c.point_gain, c.own_lam)
            rows += 1
    return status, rows
