"""When an iteration for positions that meet constraints has converged: at a tolerance, or at round-off."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.jit.decorators import subkernel

EPS = float(np.finfo(float).eps)

ROUND_OFF = 1e-17
"""A change of the state that is expected to stay below this, relative to its size, ends the iteration."""

FEW_ROUNDINGS = 4.0
"""A change that no longer shrinks is round-off where it moves positions by no more roundings than these."""

IDLE_RATIO = 0.5
"""Contraction above which a change counts as shrinking no more."""

IDLE, STAGNANT = 3, 1e-12
"""A change that has not shrunk in so many iterations is round-off below this, relative to the size of the state; or
where it is small against what single forces would give."""

RUNAWAY = 1e-6
"""Relative change above which growth from one iteration to the next counts as divergence."""

SLOW = 0.25
"""Contraction above which the tangent is taken anew within the step."""


@subkernel
def relative_sizes(change, x, bodies):
    """Return the largest entry of `change` (s, 3 (B + 1)) relative to the largest of `x`, linear and angular apart.

    Lengths are compared with 1 m at least, angles with 1 rad, and so are velocities; infinite where one is no number.
    """
    size_t = size_r = 1.0
    change_t = change_r = 0.0
    for b in range(bodies):
        size_t = max(size_t, abs(x[3 * b]), abs(x[3 * b + 1]))
        size_r = max(size_r, abs(x[3 * b + 2]))
        for i in range(len(change)):
            now_t = max(abs(change[i, 3 * b]), abs(change[i, 3 * b + 1]))
            now_r = abs(change[i, 3 * b + 2])
            if not now_t + now_r < np.inf:
                return np.inf
            change_t = max(change_t, now_t)
            change_r = max(change_r, now_r)
    return max(change_t / size_t, change_r / size_r)


@subkernel
def is_settled(n, now, ratio, moved, tolerance):
    """Return whether iteration `n` was the last that is needed, by the expected next change or by round-off.

    Parameters
    ----------
    now, ratio
        Relative change of the state, and over that of the iteration before.
    moved
        Relative change of the positions that the step leads to.
    tolerance
        Expected relative change at which the iteration ends.
    """
    if now == 0.0 or (n > 1 and ratio < 0.9 and ratio / (1.0 - ratio) * now <= tolerance):
        return True
    return n > 1 and ratio > IDLE_RATIO and moved <= FEW_ROUNDINGS * EPS
