"""Interpolation within a step, whose times are given by their share `theta` of the step."""

from __future__ import annotations

from mbdkit.engine.native.functions import subkernel


@subkernel
def fade(theta: float) -> float:
    """Return ``3 theta^2 - 2 theta^3``, which rises from 0 to 1 and has zero slope at both ends."""
    return theta * theta * (3.0 - 2.0 * theta)


@subkernel
def hermite(theta, step, start, change, start_rate, end_rate):
    """Return value and rate of the cubic that begins at `start`, ends at ``start + change``, with given rates."""
    rest, at_start, at_end = 1.0 - theta, step * start_rate, step * end_rate
    value = start + fade(theta) * change + theta * rest * (rest * at_start - theta * at_end)
    slope = 6.0 * theta * rest * change + rest * (1.0 - 3.0 * theta) * at_start + theta * (3.0 * theta - 2.0) * at_end
    return value, slope / step
