"""heyoka: Taylor series of the rods' angles, compiled by LLVM for each system, order and tolerance."""

from __future__ import annotations

import functools
import importlib.util
import time
from typing import Any

import numpy as np

from .contender import TOLERANCES, Contender, Outcome, lost, timed
from .motions import Motion
from .rods import GRAVITY

COARSE = (1e-1, 1e-2, 1e-4, 1e-6, 1e-9)
"""Tolerances for the chain, whose errors are between 1e-5 and 1e-12 m: each one takes a minute to compile at first, and
a few seconds from heyoka's cache on the disk."""

SECONDS: list[float] = []
"""Seconds that each compilation took; they are not part of the time of the steps."""


def taylor(motion: Motion) -> tuple[list[Contender], list[str]]:
    """Return heyoka if it is installed."""
    if not importlib.util.find_spec("heyoka"):
        return [], ["heyoka"]
    ladder = TOLERANCES if motion.rods.count == 2 else COARSE
    return [Contender("heyoka", "Taylor", functools.partial(_heyoka, motion), ladder)], []


def _two(angles: list[Any], rates: list[Any], length: float) -> list[Any]:
    """Return theta'' of two rods by Cramer's rule; see `Rods.right_side`."""
    import heyoka as hy

    (a, b), (u, v), gravity = angles, rates, GRAVITY / length
    cosine, sine = 0.5 * hy.cos(a - b), 0.5 * hy.sin(a - b)
    p = -1.5 * gravity * hy.cos(a) - sine * v * v
    q = -0.5 * gravity * hy.cos(b) + sine * u * u
    determinant = 4 / 9 - cosine * cosine
    return [(p / 3 - cosine * q) / determinant, (4 / 3 * q - cosine * p) / determinant]


def _many(angles: list[Any], rates: list[Any], length: float) -> list[Any]:
    """Return theta'' of many rods of length 1 and mass 1 by articulated bodies: O(n) operations.

    The force at the inner end of a rod is K A + f, A being the acceleration of that end. Other equal lengths only scale
    gravity.
    """
    import heyoka as hy

    gravity, n = GRAVITY / length, len(angles)
    biases: list[Any] = [None] * n
    kxx: Any = 0.0
    kxy: Any = 0.0
    kyy: Any = 0.0
    fx: Any = 0.0
    fy: Any = 0.0
    for i in reversed(range(n)):
        c, s, square = hy.cos(angles[i]), hy.sin(angles[i]), rates[i] * rates[i]
        # A of the outer end: A + theta'' (-s, c) - theta'^2 (c, s)
        gx, gy = fx - square * (kxx * c + kxy * s), fy - square * (kxy * c + kyy * s)
        nx, ny = kxy * c - kxx * s, kyy * c - kxy * s  # K times the lever
        hx, hy_ = nx - 0.5 * s, ny + 0.5 * c
        inverse = 1.0 / (1 / 3 + ny * c - nx * s)
        torque = 0.5 * c * gravity + gy * c - gx * s
        bx, by = gx - 0.5 * square * c, gy - 0.5 * square * s + gravity
        x, y, z = hx * inverse, hy_ * inverse, torque * inverse
        biases[i] = (x, y, z, c, s, square)
        kxx, kxy, kyy = kxx + 1.0 - hx * x, kxy - hx * y, kyy + 1.0 - hy_ * y
        fx, fy = bx - hx * z, by - hy_ * z
    accelerations = []
    ax: Any = 0.0
    ay: Any = 0.0
    for x, y, z, c, s, square in biases:
        alpha = -(x * ax + y * ay + z)
        accelerations.append(alpha)
        ax, ay = ax - (alpha * s + square * c), ay + (alpha * c - square * s)
    return accelerations


@functools.cache
def _integrator(motion: Motion, tolerance: float) -> Any:
    import heyoka as hy

    n = motion.rods.count
    angles, rates = ([hy.make_vars(f"{name}{i}") for i in range(n)] for name in ("theta", "omega"))
    accelerations = (_two if n == 2 else _many)(angles, rates, motion.rods.length)
    system = [*zip(angles, rates, strict=True), *zip(rates, accelerations, strict=True)]
    begin = time.perf_counter()
    made = hy.taylor_adaptive(system, motion.start.tolist(), tol=tolerance, compact_mode=n > 10)
    SECONDS.append(time.perf_counter() - begin)
    return made


def _heyoka(motion: Motion, tolerance: float) -> Outcome:
    """Run to the end; without a largest step, some tolerances take one step from rest at the horizontal to the end."""
    made = _integrator(motion, tolerance)
    made.time = 0.0
    made.state[:] = motion.start
    reached, wall, cpu = timed(lambda: made.propagate_until(motion.end, max_delta_t=motion.end / 50))
    count = motion.rods.count
    if "time_limit" not in str(reached[0]) or not np.all(np.isfinite(made.state)):
        return lost(count, wall, cpu)
    return Outcome(wall, cpu, motion.rods.centres(made.state[:count]))
