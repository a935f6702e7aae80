"""The two motions of the race, each with its end known far below 1e-12 m by two ways that share nothing.

The digits are those of `tests.witness.double_pendulum` and `tests.witness.hundred_rods`; `collocate` is one of the two
ways to the second.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

from tests.witness import hundred_rods
from tests.witness.double_pendulum import HORIZONTAL

from .rods import Array, RightSide, Rods


@dataclass(frozen=True)
class Motion:
    """Rods in a row, let go at rest.

    Parameters
    ----------
    name, title
        For files and for readers.
    rods
        The rods.
    angle
        Of every rod at the start, from the +x axis [rad].
    end
        When positions are compared [s].
    limit
        Seconds of the processor after which a run of it has shown that nothing finer will be fast.
    """

    name: str
    title: str
    rods: Rods
    angle: float
    end: float
    limit: float

    @property
    def model(self) -> dict[str, Any]:
        """Return the model of an mbdkit spec."""
        rods = self.rods
        return {"name": "n-pendulum", "n": rods.count, "length": rods.length, "mass": rods.mass, "angle": self.angle}

    @property
    def start(self) -> Array:
        """Return the state (theta, theta') at the start, shape (2 n,)."""
        return np.repeat([self.angle, 0.0], self.rods.count)

    def miss(self, centres: Array) -> float:
        """Return the largest distance of any rod's centre from the reference at the end [m]; `centres` is (n, 2)."""
        return float(np.max(np.hypot(*(np.asarray(centres, dtype=float) - reference(self)).T)))


DOUBLE_PENDULUM = Motion(
    name="double-pendulum",
    title="Double pendulum, rods of 1 m from the horizontal, 5 s",
    rods=Rods(2),
    angle=HORIZONTAL.start_angle,
    end=5.0,
    limit=0.5,
)
CHAIN = Motion(
    name="chain",
    title="Chain of 100 rods, 1 m in all, from 0.5 rad off the vertical, 1 s",
    rods=Rods(100, 0.01, 0.01),
    angle=hundred_rods.START,
    end=hundred_rods.END,
    limit=1.5,
)
MOTIONS = (DOUBLE_PENDULUM, CHAIN)


@functools.cache
def reference(motion: Motion) -> Array:
    """Return the centres at the end (n, 2) [m]."""
    if motion == CHAIN:
        return motion.rods.centres(np.array(hundred_rods.ANGLES))
    return HORIZONTAL.positions[HORIZONTAL.at(motion.end)]


def collocate(right_side: RightSide, start: Array, end: float, steps: int, stages: int) -> Array:
    """Return the state at `end` by Gauss collocation in equal steps, iterated to stagnation, in the type of `start`."""
    kind = start.dtype.type
    a, b, c = gauss_coefficients(stages, kind)
    size = kind(end) / steps
    state, lost = start.copy(), np.zeros_like(start)
    slopes = np.repeat(np.asarray(right_side(kind(0), state))[None], stages, axis=0)
    for step in range(steps):
        before = np.inf
        while True:
            places = state + size * (a @ slopes)
            new = np.stack([right_side(size * (step + c[i]), place) for i, place in enumerate(places)])
            change, slopes = float(np.max(np.abs(new - slopes))), new
            if change == 0 or (change >= before and change <= 1e-12 * np.max(np.abs(slopes))):
                break
            before = change
        gain = size * (b @ slopes) + lost
        moved = state + gain
        lost = gain - (moved - state)
        state = moved
    return state


def gauss_coefficients(stages: int, kind: Any) -> tuple[Array, Array, Array]:
    """Return (a, b, c) of Gauss collocation, from the roots of Legendre's polynomial with 50 digits."""
    with mpmath.workdps(50):
        roots = mpmath.polyroots(mpmath.taylor(lambda x: mpmath.legendre(stages, x), 0, stages)[::-1], maxsteps=200)
        points = sorted((mpmath.re(root) + 1) / 2 for root in roots)
        powers = mpmath.matrix([[point**k for k in range(stages)] for point in points])
        inverse = powers**-1

        def integrals(upper: Any) -> list[Any]:
            moments = mpmath.matrix([[upper ** (k + 1) / (k + 1) for k in range(stages)]])
            return list(moments * inverse)

        a = [[kind(mpmath.nstr(x, 30)) for x in integrals(point)] for point in points]
        b = [kind(mpmath.nstr(x, 30)) for x in integrals(mpmath.mpf(1))]
        c = [kind(mpmath.nstr(point, 30)) for point in points]
    return np.array(a), np.array(b), np.array(c)
