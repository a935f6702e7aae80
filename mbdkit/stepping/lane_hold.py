"""Values that are frozen in a lane whose stage iteration has converged, while the iteration continues in others.

A single run simply ends its iteration. For lanes, the values that an iteration writes in place are restored where a
mask is false; see `mbdkit.stepping.stage_iteration.iterate`.
"""

from __future__ import annotations

from numba.extending import overload

from mbdkit.engine.jit.decorators import subkernel
from mbdkit.engine.jit.lane_types import LaneMask, where
from mbdkit.stepping.step_guards import distance_by_pivots


def hold_counts(c, m, wanted):
    """Undo the counts since the last call in lanes that are not `wanted`."""


def hold_finished(c, m, active):
    """Restore the values that an iteration has changed in lanes that are not `active`: multipliers, distance, and
    counts.
    """


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
    if isinstance(wanted, LaneMask):
        return lambda c, m, wanted: _hold_counts(c, m, wanted)
    return lambda c, m, wanted: None


@overload(hold_finished)
def _finished(c, m, active):
    if isinstance(active, LaneMask):
        return lambda c, m, active: _hold_finished(c, m, active)
    return lambda c, m, active: None
