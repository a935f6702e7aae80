"""Selection of the contacts that may be near touching, from their gaps at an earlier position.

A gap changes by no more than the bodies have moved since then. In a system of many bodies, most contacts therefore need
not be evaluated at every position (the neighbour lists of L. Verlet, Physical Review 159:98-103, 1967).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbdkit_contact.polygon_features import Feature

MORE = 16
"""All gaps are evaluated again when the number of near contacts exceeds twice the last number by more than this."""


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
        #: Distances (2, C) from the origins of both bodies to the points that define the gap; practically infinite for
        #: a line.
        self._levers = np.array([_levers(one) for one in features]).reshape(-1, 2).T
        self._q, self._gaps, self._most = np.zeros(0), np.zeros(0), 0

    def keep(self, q: np.ndarray, gaps: np.ndarray) -> None:
        """Use the gaps (C,) at a position (n,) as the reference for later bounds."""
        self._q, self._gaps = q.copy(), gaps.copy()
        self._most = 2 * int(np.count_nonzero(gaps <= self.reach)) + MORE

    def bounds(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return lower bounds (C,) of the gaps at a position (n,), and the indices of the contacts that may be near.

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
