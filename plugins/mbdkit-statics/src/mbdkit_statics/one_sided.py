"""Equilibria at which a force has a corner, such as a rope that is just taut or a stop that just touches.

The stiffness there depends on the side to which the mechanism moves. It is evaluated beside the equilibrium: along
directions drawn at random, which leave it on every side of each corner, and along the softest motions of these sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mbdkit_statics.prepared_mechanism import PreparedMechanism
from mbdkit_statics.reduced import DENSE, State, reduce, symmetric_modes

#: Distance from the equilibrium at which stiffnesses are evaluated, as a share of the mechanism's size, or in rad.
BESIDE = 1e-6

#: The stiffness has a corner if its change between two sides is not proportional to their distance: at a distance that
#: is smaller by this factor, it is more than half as large.
CLOSER = 8.0

#: Changes of the stiffness up to this share of its largest entry are no corners; nor are changes up to rounding errors.
CHANGE = 1e-7

#: A corner of the equilibrium is also one at this share of the distance `BESIDE`; others lie beside it, such as the
#: position in which a body that presses a stiff floor by 1e-7 m leaves it.
HERE = 1e-3

#: Number of random directions, each of which is examined on both sides; 12 corners that are independent of each other
#: divide the neighbourhood into more sides than that, so that not all may be found.
DIRECTIONS = 24

FLAT = 1e-9  #: Stiffnesses up to this share of the largest one of a side count as zero.


@dataclass(frozen=True)
class Sides:
    """Stiffness on the sides of an equilibrium with a corner.

    Attributes
    ----------
    least
        Lowest stiffness on each side, for unit mass [1/s^2].
    along
        Lowest of the stiffnesses that resist a motion on the side to which this motion leads.
    is_symmetric
        Whether the stiffness is symmetric on all sides, so that the potential decides the stability.
    differ
        Whether the sides differ. Otherwise, only the formula has a corner, as ``max(x, 0) + min(x, 0)``.
    """

    least: np.ndarray
    along: float
    is_symmetric: bool
    differ: bool

    @property
    def verdict(self) -> str:
        """``stable`` if no side is soft, ``unstable`` if a motion leads to where it is driven on, else ``corner``."""
        if not self.is_symmetric:
            return "corner"
        return "unstable" if self.along < 0.0 else "stable" if np.min(self.least) > 0.0 else "corner"


def sides_of(statics: PreparedMechanism, at: State) -> Sides | None:
    """Return the stiffness on the sides of an equilibrium; None if no force has a corner there.

    Mechanisms of more than `DENSE` coordinates are not examined.
    """
    p = statics.equations
    if p.n > DENSE or statics.freedoms == 0:
        return None
    here = reduce(statics, at)
    basis = here.basis
    size = np.ones(p.n)
    size.reshape(-1, 3)[:, :2] = statics.workspace.mechanism.length
    draw = np.random.default_rng(0)

    def beside(direction: np.ndarray, share: float) -> np.ndarray:
        moved = basis @ direction
        small = reduce(statics, at._replace(q=at.q + share * BESIDE * moved / np.max(np.abs(moved) / size)))
        turn = small.basis.T @ (p.mass[:, None] * basis)  # the basis of a null space may change its signs
        return np.asarray(turn.T @ small.stiffness @ turn)

    first = np.asarray(draw.standard_normal(basis.shape[1]))
    largest = np.max(np.abs(beside(first, 1.0)))
    negligible = np.maximum(CHANGE * largest, np.abs(basis).T @ here.blur @ np.abs(basis))

    def jumps(far_change: np.ndarray, near_change: np.ndarray) -> bool:
        """Return whether a change of the stiffness is not proportional to the distance."""
        size = np.abs(near_change)
        return bool(np.any((size > 0.5 * np.abs(far_change)) & (size > negligible)))

    for share in (1.0, HERE):
        far, near = ([beside(first, side * part) for side in (1.0, -1.0)] for part in (share, share / CLOSER))
        differ = jumps(far[0] - far[1], near[0] - near[1])
        if not differ and not jumps(far[0] - here.stiffness, near[0] - here.stiffness):
            return None
    least, along, is_symmetric = [], np.inf, True
    for direction in _directions(first, draw):
        for side in (1.0, -1.0):
            stiffness = beside(direction, side)
            is_symmetric = is_symmetric and bool(np.allclose(stiffness, stiffness.T, rtol=0, atol=CHANGE * largest))
            values, modes = symmetric_modes(0.5 * (stiffness + stiffness.T))
            flat = FLAT * float(np.max(np.abs(values)))
            least.append(0.0 if abs(values[0]) <= flat else values[0])
            for soft in (*modes[:, values < -flat].T, direction / np.linalg.norm(direction)):
                for way in (soft, -soft):
                    resisted = float(way @ beside(way, 1.0) @ way)
                    along = min(along, 0.0 if abs(resisted) <= flat else resisted)
    return Sides(np.array(least), along, is_symmetric, differ)


def _directions(first: np.ndarray, draw: np.random.Generator) -> Iterator[np.ndarray]:
    yield first
    for _ in range(0 if len(first) == 1 else DIRECTIONS):
        yield np.asarray(draw.standard_normal(len(first)))
