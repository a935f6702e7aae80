"""Criteria of the verdict on measured motions: the times of the rows, and their unit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbdkit.base.text import shown
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured
from mbdkit_biomech.inverse_dynamics.signals.rounded_times import grid_of, rounded_to

#: Acceleration [m/s^2] with which the accelerations of a mechanism without gravity are compared.
STANDARD_GRAVITY = 9.81

#: The unit of time is examined if a coordinate changes by at least this much, in longest links or radians.
MOVED = 0.1

#: Times look like milliseconds if the median interval exceeds `COARSE` times sqrt(length / gravity), while no
#: acceleration exceeds `SLOW` times gravity.
#:
#: Samples so far apart do not resolve a motion under gravity, and yet the motion seems to be quasi-static.
COARSE, SLOW = 1.0, 1e-3

#: Times look too short if the median interval is below `FINE` times sqrt(length / gravity), while the root mean square
#: of an acceleration exceeds `FAST` times gravity.
FINE, FAST = 1e-4, 1e3

#: The times of the rows are examined if the longest and the shortest interval differ by more than this share of the
#: mean interval.
UNEVEN = 0.01

#: Limits for implausible times.
#:
#: A share tells whether the columns fit the given times or evenly spaced times better. Apart from noise, it is 0 if the
#: given times are right, and 1 if the evenly spaced times are right. The given times are implausible if the share
#: exceeds both `EVEN` and `CERTAIN` times the standard deviation of the share due to noise.
EVEN, CERTAIN = 0.5, 6.0

CERTAIN_OF_GRID = 3.0  #: Replaces `CERTAIN` if the given times are rounded, evenly spaced times.


def uneven_times(measured: Measured) -> Iterator[str]:
    """Yield a sentence if the columns fit evenly spaced times better than the given times."""
    time, steps = measured.time, np.diff(measured.time)
    if len(time) < 6 or np.ptp(steps) <= UNEVEN * np.mean(steps) or np.max(steps) > 1.9 * np.median(steps):
        return  # evenly spaced, possibly with missing rows
    even, product, square = np.linspace(time[0], time[-1], len(time)), 0.0, 0.0
    for x in measured.values.T:
        given, smooth = off_neighbours(time, x), off_neighbours(even, x)
        if np.any(noise := np.mean(smooth**2)):
            product += float(np.sum(given * (given - smooth)) / noise)
            square += float(np.sum((given - smooth) ** 2) / noise)
    grid = grid_of(time)
    certain = CERTAIN if rounded_to(time) is None else CERTAIN_OF_GRID
    if not product > max(EVEN * square, certain * np.sqrt(square)):
        return
    cause = "they probably have jitter" if grid is None else f"they are probably rounded to {grid:g} s"
    yield (
        f"the columns fit evenly spaced times better than the given times, whose intervals vary from "
        f"{steps.min():.6g} to {steps.max():.6g} s (share {product / square:.2g}, doubtful above {EVEN:g}; certain to "
        f"{product / np.sqrt(square):.3g} standard deviations, doubtful above {certain:g}): {cause}; derivatives "
        "depend on them."
    )


def unit_of_time(result: Inverse) -> Iterator[str]:
    """Yield a sentence if accelerations, compared with gravity, are so small or large that the times seem to have
    another unit.
    """
    motion, length = result.motion, result.problem.fitter.manifold.length
    if len(motion.time) < 3 or not length > 0:
        return
    moved = float(np.max(np.ptp(motion.q.reshape(len(motion.q), -1, 3), axis=0) / [length, length, 1.0]))
    gravity = float(np.linalg.norm(result.problem.names.mechanism.gravity)) or STANDARD_GRAVITY
    interval, natural = float(np.median(np.diff(motion.time))), float(np.sqrt(length / gravity))
    share = np.abs(motion.a.reshape(len(motion.a), -1, 3)) * [1.0, 1.0, length] / gravity
    rms = float(np.max(np.sqrt(np.mean(share**2, axis=0))))
    if moved < MOVED:
        return
    rows = f"the median interval of the rows is {interval:.4g} s, {interval / natural:.3g} times sqrt(length / gravity)"
    if interval > COARSE * natural and np.max(share) < SLOW:
        column = result.problem.spec.motion.time
        frames = " (if they are numbers of frames, divide them by the frame rate)" if round(interval, 9) == 1.0 else ""
        cause = (
            f"they look like milliseconds; write `time: {{column: {shown(column.column)}, unit: ms}}`{frames}"
            if column.factor == 1.0
            else f"are the times in {shown(column.unit)}?"
        )
        yield (
            f"{rows} (doubtful above {COARSE:g}), and no acceleration exceeds {np.max(share):.2g} of gravity (doubtful "
            f"below {SLOW:g}), so that inertia has no effect: {cause}"
        )
    elif interval < FINE * natural and rms > FAST:
        yield (
            f"{rows} (doubtful below {FINE:g}), and accelerations are {rms:.2g} times gravity (doubtful above "
            f"{FAST:g}): are the times in {shown(result.problem.spec.motion.time.unit)}?"
        )


def off_neighbours(time: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the deviations (T - 4,) of samples from the cubic polynomials through two neighbours on both sides."""
    count = len(time) - 4
    near = [slice(shift, shift + count) for shift in (0, 1, 3, 4)]
    at, values = time[2:-2], x[2:-2].copy()
    for own in near:
        weight = np.ones(count)
        for other in near:
            if other != own:
                weight *= (at - time[other]) / (time[own] - time[other])
        values -= weight * x[own]
    return values
