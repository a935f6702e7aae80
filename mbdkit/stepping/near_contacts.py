"""Which of many contacts may be near to touching, from their gaps at an earlier position.

Gaps change by no more than the bodies have moved since then, so that most of the contacts among many bodies need not be
evaluated at every position (the neighbour lists of L. Verlet, Physical Review 159:98-103, 1967).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbdkit.stepping.polygon_features import Feature

MORE = 16
"""Number of contacts that may come near, besides a doubling, before all gaps are evaluated again."""


class NearContacts:
    """Lower bounds of the gaps of contacts, each with one feature.

    Parameters
    ----------
    features
        The features of the contacts.
    reach
        Gap up to which a contact is near [m].
    """

    def __init__(self, features: Sequence[Feature], reach: float):
        self.reach = reach
        self._bodies = np.array([one.bodies for one in features], dtype=int).reshape(-1, 2).T
        #: Distances from the origins of both bodies to points by which the gap is given (2, C); a line has no ends.
        self._levers = np.array([_levers(one) for one in features]).reshape(-1, 2).T
        self._q, self._gaps, self._most = np.zeros(0), np.zeros(0), 0

    def keep(self, q: np.ndarray, gaps: np.ndarray) -> None:
        """Use the gaps (C,) at a position (n,) from now on."""
        self._q, self._gaps = q.copy(), gaps.copy()
        self._most = 2 * int(np.count_nonzero(gaps <= self.reach)) + MORE

    def bounds(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return lower bounds (C,) of the gaps at a position (n,), and the numbers of the contacts that may be near;
        None if all gaps should be evaluated.
        """
        if not len(self._q):
            return None
        moved = np.append(q - self._q, np.zeros(3)).reshape(-1, 3)
        shift, turn = np.hypot(moved[:, 0], moved[:, 1]), np.abs(moved[:, 2])
        first, second = self._bodies
        bounds = self._gaps - shift[first] - shift[second]
        if np.any(turn):
            bounds -= turn[first] * self._levers[0] + turn[second] * self._levers[1]
        near = np.flatnonzero(bounds <= self.reach)
        return (bounds, near) if len(near) <= self._most else None


def _levers(feature: Feature) -> tuple[float, float]:
    x, y, _, *others = feature.numbers
    on_first = np.hypot(others[0], others[1]) if feature.kind[0] in ("circles", "hole") else 1e200
    return float(on_first), float(np.hypot(x, y))
