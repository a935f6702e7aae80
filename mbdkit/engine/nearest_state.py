"""Newton's method in Python, which finds positions near given ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.kernels.projection import EPS, FEW_ROUNDINGS, MOST_ITERATIONS, STAGNANT

ROUND_OFF = FEW_ROUNDINGS * EPS  #: Relative change of the coordinates that counts as rounding error.


class MeasuredSystem(Protocol):
    """The method of `EquationsOfMotion` by which an iteration is found to have converged."""

    def relative_change(self, q: np.ndarray, dq: np.ndarray) -> float:
        """Return the largest change of a coordinate relative to the largest coordinate of the same kind."""
        ...


def converged(p: MeasuredSystem, q: np.ndarray, step: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return the positions (n,) to which Newton's method with these steps converges from `q`; raises StepError."""
    before = np.inf
    for _ in range(MOST_ITERATIONS):
        change = step(q)
        q = q + change
        now = p.relative_change(q, change)
        if now <= ROUND_OFF or (now >= 0.5 * before and now < STAGNANT):
            return q
        before = now
    raise StepError("newton-failed", f"no position that satisfies the joints was found in {MOST_ITERATIONS} iterations")
