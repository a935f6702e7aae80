"""The bodies of a mechanism as functions of joint coordinates, and the forces in the joints of the spanning tree.

Joint coordinates are those of the spanning tree of runs: angles of bodies, travels along slots, and the positions of
bodies that no joint of the tree places. Positions q, velocities v and accelerations a of all bodies follow from them
joint by joint from ground. With T the derivative of v with respect to the rates of the coordinates, the joints of the
tree do no work on T, so that the equations of motion

    T^T (M a + Phi_q^T lam - Q) = 0

contain the multipliers of cut joints only. Those of the tree follow from what remains of the equations of each body,
from the leaves to ground.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.tree import BODY, PLACE, TURN, accelerate_coordinates, coordinates_of, place_bodies
from mbdkit.engine.kernels.tree_displacements import accelerate_bodies
from mbdkit.engine.spanning_tree import spanning_tree


class Motion(NamedTuple):
    """Positions, velocities and accelerations of all bodies or coordinates, arrays of numbers of any kind."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


class InterpretedTree:
    """The coordinates of the spanning tree of a mechanism with B bodies.

    Attributes
    ----------
    places : (n,) array of int
        Index of each coordinate among the 3 B numbers x, y, angle of the bodies.
    rows : set of int
        Indices of the constraint rows of the joints of the tree.
    """

    def __init__(self, top: Topology, row_index: np.ndarray):
        self._tree, self._size = spanning_tree(top), 3 * len(top.mass)
        free, self.rows = np.ones(self._size - 3, dtype=bool), set[int]()
        for body, place, _, turn, _ in self._tree.tolist():
            is_line = place >= 0 and top.rows[place] == 1
            free[3 * body : 3 * body + 3] = [place < 0 or is_line, place < 0, turn < 0]
            self.rows |= {int(row_index[k, r]) - len(free) for k in (place, turn) if k >= 0 for r in range(top.rows[k])}
        self.places = np.flatnonzero(free)

    def bodies(self, run: Any, top: Topology, w: Any, t: Any, own: Motion) -> Motion:
        """Return the motion (3 B,) of all bodies, given that of the coordinates (n,)."""
        y, q = self._filled(own), Motion(*(np.full(self._size, 0.0, dtype=object) for _ in own))
        run(place_bodies)(top, w, self._tree, t, y.q, y.v, q.q, q.v)
        run(accelerate_bodies)(top, w, self._tree, y.q, y.v, q.v, y.a)
        return Motion(*(x[:-3] for x in (q.q, q.v, y.a)))

    def coordinates(self, run: Any, top: Topology, w: Any, whole: Motion) -> Motion:
        """Return the motion (n,) of the coordinates, given that of all bodies (3 B,)."""
        q = Motion(*(np.concatenate([x, np.zeros(3)]).astype(object) for x in whole))
        y, rates = (np.full(self._size, 0.0, dtype=object) for _ in range(2))
        run(coordinates_of)(top, self._tree, q.q, q.v, y, rates)
        run(accelerate_coordinates)(top, w, self._tree, y, q.v, q.a)
        return Motion(*(x[self.places] for x in (y, rates, q.a)))

    def multipliers(self, top: Topology, jac: np.ndarray, left: np.ndarray) -> Iterator[tuple[int, int, Any]]:
        """Yield pair, row and multiplier of the joints of the tree, given the Jacobian of the rows of pairs (P, 12) and
        what is `left` (3 B,) of the equations of motion without these multipliers.
        """
        left = np.concatenate([left, np.zeros(3)])
        for n in reversed(self._tree):
            for k, parts in ((n[PLACE], slice(2)), (n[TURN], slice(2, 3))):
                if k < 0:
                    continue
                first, second = (3 * int(top.pairs[k, side]) for side in (PAIR.first, PAIR.second))
                rows, own = jac[k].reshape(2, 2, 3)[: top.rows[k]], 3 * int(n[BODY])
                known = rows[:, int(own == second), parts]
                for r, multiplier in enumerate(_balancing(known, left[own : own + 3][parts])):
                    left[first : first + 3] = left[first : first + 3] + rows[r, 0] * multiplier
                    left[second : second + 3] = left[second : second + 3] + rows[r, 1] * multiplier
                    yield int(k), r, multiplier

    def _filled(self, motion: Motion) -> Motion:
        y = Motion(*(np.full(self._size, 0.0, dtype=object) for _ in motion))
        for whole, x in zip(y, motion, strict=True):
            whole[self.places] = x
        return y


def _balancing(rows: np.ndarray, left: np.ndarray) -> Sequence[Any]:
    """Return the multipliers lam of one or two rows with ``rows^T lam = -left``; by least squares if one row has two
    components.
    """
    if len(rows) == 1:
        return [-(rows[0] @ left) / (rows[0] @ rows[0])]
    (a, b), (c, d) = rows
    return [(c * left[1] - d * left[0]) / (a * d - b * c), (b * left[0] - a * left[1]) / (a * d - b * c)]
