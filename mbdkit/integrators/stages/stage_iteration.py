"""The iteration for the stages of a step, shared by collocation methods and Lobatto pairs, single runs and lanes.

A lane is one of several runs that advance together, one in each element of a SIMD vector.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.system import DIVERGED, OK
from mbdkit.engine.native.arithmetic import any_of, is_lanes, is_refused, renewed, where
from mbdkit.engine.native.functions import inlined, overload, subkernel
from mbdkit.integrators.run.run_state import ITERATIONS
from mbdkit.integrators.run.step_guards import distance_by_pivots
from mbdkit.integrators.stages.convergence import (
    FEWEST_WITH_ONE_TANGENT,
    SLOW,
    STALLED,
    STEADY,
    confirms,
    has_failed,
    is_converged,
    is_stalled,
    loses_steadiness,
    predicts_failure,
    report_divergence,
)


def hold_counts(c, m, wanted):
    """Undo the counts since the last call in lanes that are not `wanted`."""


def hold_finished(c, m, active):
    """Restore the values that an iteration has changed in lanes that are not `active`: multipliers, distance to
    singularity, and counts.
    """


def note_failures(m, now, goes_on):
    """Note in which lanes the iteration does not go on, and make their accelerations NaN.

    Only the failure of a change `now` that is finite is noted: others may have causes to which single runs react.
    """


@subkernel
def _note_failures(m, now, goes_on):
    m.kept.diverged[0] = where(goes_on | (not now < np.inf), m.kept.diverged[0], 1.0)
    m.acc[0, 0] = where(goes_on, m.acc[0, 0], np.nan)


@subkernel
def _hold_counts(c, m, wanted):
    for k in range(len(c.counts)):
        c.counts[k] = m.kept.counts[k] = where(wanted, c.counts[k], m.kept.counts[k])


@subkernel
def _hold_finished(c, m, active):
    kept = m.kept.lam
    for i in range(len(kept)):
        for k in range(len(kept[0])):
            for r in range(2):
                m.lam[i, k, r] = kept[i, k, r] = where(active, m.lam[i, k, r], kept[i, k, r])
    if c.watch.has_loops[0] != 0:
        c.watch.distance[0] = where(active, distance_by_pivots(c.solver.schur), c.watch.distance[0])
    _hold_counts(c, m, active)


@overload(hold_counts)
def _counts(c, m, wanted):
    if is_lanes(wanted):
        return lambda c, m, wanted: _hold_counts(c, m, wanted)
    return lambda c, m, wanted: None


@overload(hold_finished)
def _finished(c, m, active):
    if is_lanes(active):
        return lambda c, m, active: _hold_finished(c, m, active)
    return lambda c, m, active: None


@overload(note_failures)
def _failures(m, now, goes_on):
    if is_lanes(goes_on):
        return lambda m, now, goes_on: _note_failures(m, now, goes_on)
    return lambda m, now, goes_on: None


@inlined
def iterate(c, m, t, h, until, strategy, kernels):
    """Solve the equations of the stages, which have been predicted and evaluated; return a status.

    The tangents are evaluated at the mean of the predicted stages. They are evaluated again after the first iteration
    from free flight, and where the iteration contracts slowly. This takes the fewest iterations. For stiff forces,
    however, it can lead to another solution of the stage equations: the predicted stages may be far away, and an
    iteration with new tangents finds the solution nearest to them.

    A careful iteration therefore keeps the tangents of the start of the step, as RADAU5 does, and ends as soon as its
    rate predicts that it will not converge (`predicts_failure`). It can only converge to the solution that belongs to
    the start. With step size control, a step that fails is repeated with a smaller step size.

    An eager iteration evaluates the tangents again wherever it no longer contracts well, and once more when it has
    converged: it ends only if the change with the tangents of the solution is not larger (`confirms`). Tangents of
    stages far from the solution contain forces of stiff beams that are not in balance. These can make a free motion
    appear stiff, so that its error hardly changes and the iteration seems to converge.

    In lanes, the iteration continues until every lane has converged or failed. A lane that has converged keeps its
    stages, so that it makes the same iterations as the single run; the accelerations of a lane that fails become NaN.

    Parameters
    ----------
    c, m
        Bundles of the run and of the stages.
    t, h
        Start of the step and its size [s].
    until
        The `IterationLimit`, and the relative change at which the iteration ends.
    strategy
        Whether the iteration is careful, whether it is eager, whether the stages are predicted by free flight, and, in
        lanes, which ones take a step.
    kernels
        The equations of the stages (`mbdkit.integrators.stages.collocation_stages.StageKernels`).
    """
    limit, tolerance = until
    careful, eager, free_flight, active = strategy
    stale = active
    taken_at = idle = 0.0
    n = 0
    before = earlier = np.inf
    peak = 0.0
    is_last = False
    while True:
        if any_of(stale):
            status = kernels.tangents(c, m, t, h, careful, stale)
            if status != OK:
                return status
            hold_counts(c, m, stale)
            taken_at = renewed(float(n), taken_at, stale)
        status = kernels.changes(c, m, t, h, before)
        if status != OK:
            return status
        c.counts[ITERATIONS] += 1
        n += 1
        hold_finished(c, m, active)
        kernels.move(c, m, h, active)
        now, moved = kernels.sizes(c, m, h)
        ratio = now / before
        done = is_converged(n, now, ratio, tolerance)
        stalled = (not done) & is_stalled(n, now, ratio)
        if any_of(stalled):
            idle = idle + where(stalled & kernels.counts_as_idle(now), 1.0, 0.0)
            done = done | (stalled & kernels.round_off(c, m, h, now, moved, idle))
        if eager:
            is_last = any_of(done) and not (is_last and any_of(confirms(now, before)))
            if is_last:
                done = now < 0.0  # nowhere
        active = active & (not done)
        if not any_of(active):
            return OK
        peak = max(peak, now)
        growth = ratio
        if eager:
            growth = where(n - taken_at > 1, ratio, 0.0)  # with new tangents, changes may grow
        fails = has_failed(n, limit.most[0], now, growth) | loses_steadiness(n, limit, peak, earlier, tolerance)
        if careful:
            fails = fails | predicts_failure(n, limit.most[0], now, ratio, tolerance)
        goes_on = not (active & fails)
        if is_refused(goes_on):
            report_divergence(c, n, m.change, len(m.change))
            return DIVERGED
        note_failures(m, now, goes_on)
        active = active & goes_on
        if n % STEADY == 0:
            earlier, peak = peak, 0.0
        contracts_slowly = (n - taken_at >= FEWEST_WITH_ONE_TANGENT) & (ratio > SLOW)
        if eager:
            contracts_slowly = ratio > STALLED
        stale = active & (not careful) & (contracts_slowly | (is_last or (free_flight and n == 1)))
        before = now
