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

SECONDS: list[float] = []
"""Seconds that each compilation took; they are not part of the time of the steps."""


def taylor(motion: Motion) -> tuple[list[Contender], list[str]]:
    """Return heyoka if it is installed."""
    if not importlib.util.find_spec("heyoka"):
        return [], ["heyoka"]
    ladder = TOLERANCES if motion.rods.count == 2 else TOLERANCES[8::6]  # the chain takes a minute to compile
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
    """Return theta'' of many rods of mass 1 by articulated bodies: O(n) operations.

    The force at the inner end of a rod is K A + f, A being the acceleration of that end.
    """
    import heyoka as hy

    half, inertia, n = length / 2, length * length / 3, len(angles)
    biases: list[Any] = [None] * n
    kxx: Any = 0.0
    kxy: Any = 0.0
    kyy: Any = 0.0
    fx: Any = 0.0
    fy: Any = 0.0
    for i in reversed(range(n)):
        c, s, square = hy.cos(angles[i]), hy.sin(angles[i]), rates[i] * rates[i]
        # A of the outer end: A + length (theta'' (-s, c) - theta'^2 (c, s))
        gx, gy = fx - length * square * (kxx * c + kxy * s), fy - length * square * (kxy * c + kyy * s)
        nx, ny = length * (kxy * c - kxx * s), length * (kyy * c - kxy * s)  # K times the lever
        hx, hy_ = nx - half * s, ny + half * c
        turn = inertia + length * (ny * c - nx * s)
        torque = half * c * GRAVITY + length * (gy * c - gx * s)
        mx, my, mz = kxx + 1.0, kxy, kyy + 1.0
        bx, by = gx - half * square * c, gy - half * square * s + GRAVITY
        biases[i] = (hx / turn, hy_ / turn, torque / turn, c, s, square)
        kxx, kxy, kyy = mx - hx * hx / turn, my - hx * hy_ / turn, mz - hy_ * hy_ / turn
        fx, fy = bx - hx * torque / turn, by - hy_ * torque / turn
    accelerations = []
    ax: Any = 0.0
    ay: Any = 0.0
    for x, y, z, c, s, square in biases:
        alpha = -(x * ax + y * ay + z)
        accelerations.append(alpha)
        ax, ay = ax - length * (alpha * s + square * c), ay + length * (alpha * c - square * s)
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
