"""The consistent state nearest to a given one in the mass metric, computed by Newton's method in Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.kernels.projection import EPS, FEW_ROUNDINGS, MOST_ITERATIONS, STAGNANT

ROUND_OFF = FEW_ROUNDINGS * EPS
"""Relative change of the coordinates that counts as rounding error."""


class ConstrainedSystem(Protocol):
    """The methods of `mbdkit.engine.equations_of_motion.EquationsOfMotion` that projections use."""

    n: int
    mass: np.ndarray

    def solve(self, t: float, q: np.ndarray, force: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve ``M x + Phi_q^T mu = force``, ``Phi_q x = rows``."""
        ...

    def constraints(self, t: float, q: np.ndarray) -> np.ndarray:
        """Return Phi."""
        ...

    def constraint_rates(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return ``Phi_q v + Phi_t``."""
        ...

    def relative_change(self, q: np.ndarray, dq: np.ndarray) -> float:
        """Return the largest change of a coordinate relative to the largest coordinate of the same kind."""
        ...


def nearest_positions(p: ConstrainedSystem, t: float, q: np.ndarray) -> np.ndarray:
    """Return the positions (n,) nearest to `q` in the mass metric that satisfy all constraints at time `t`.

    The counter of projections is not increased.

    Raises StepError: ``newton-failed`` if the iteration does not converge.
    """
    return converged(p, q, lambda at: p.solve(t, at, p.mass * (q - at), -p.constraints(t, at))[0])


def converged(p: ConstrainedSystem, q: np.ndarray, step: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
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


def nearest_velocities(p: ConstrainedSystem, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the velocities (n,) nearest to `v` in the mass metric with ``Phi_q v + Phi_t = 0``.

    The equations are linear; a second solution removes the rounding error of the first. The counter of projections is
    not increased.
    """
    none = np.zeros(p.n)
    for _ in range(2):
        v = v + p.solve(t, q, none, -p.constraint_rates(t, q, v))[0]
    return v
