"""The spanning tree of a mechanism, whose joints give the coordinates of the formulation ``joint-coordinates``.

Pins, slots, slides, welds, moving centers and drivers of angles can be part of the tree. All other constraints, and
those that close loops, are cut: they are imposed at the levels that the formulation holds, by default on the
accelerations, as in index-1.
"""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.tree import COLUMNS, PLACE, TURN

#: Kinds of constraints that determine the position of a body, and the number of its coordinates that they leave
#: free.
_PLACING = {KINDS["revolute"]: 0, KINDS["moving_center"]: 0, KINDS["point_on_line"]: 1}
_TURNING = (KINDS["fixed_angle"], KINDS["driver_angle"])
#: Number of rows of each kind of constraint that does not have 2 rows.
_ROWS = {KINDS["point_on_line"]: 1, KINDS["fixed_angle"]: 1, KINDS["driver_angle"]: 1}


def spanning_tree(top: Topology) -> np.ndarray:
    """Return a spanning tree with as few coordinates as possible, as the kernels read it.

    The tree grows from ground (Prim's algorithm). The next joint is the one that leaves the fewest coordinates free; on
    a tie, the one closest to ground. Bodies that no joint can connect to the tree have three free coordinates.
    Redundant constraints, which are not solved for, are not part of the tree.

    See `mbdkit.engine.kernels.tree`.
    """
    ground = len(top.mass) - 1
    placing: list[list[tuple[int, int]]] = [[] for _ in range(ground + 1)]
    turning: list[list[tuple[int, int]]] = [[] for _ in range(ground + 1)]
    for k, (kind, a, b, _) in enumerate(top.pairs.tolist()):
        if a == b or top.rows[k] < _ROWS.get(kind, 2) or not (kind in _PLACING or kind in _TURNING):
            continue
        listed = placing if kind in _PLACING else turning
        listed[a].append((k, 0))
        listed[b].append((k, 1))
    depth = [-1] * (ground + 1)
    tree: list[tuple[int, int, int, int, int]] = []
    reached: list[tuple[int, int, int, int, int]] = []

    def turned(body: int) -> tuple[int, int]:
        """Return the pair that determines the angle of a body relative to a body in the tree, and the side of `body` in
        this pair; (-1, 0) if there is no such pair.
        """
        known = (joint for joint in turning[body] if depth[int(top.pairs[joint[0], PAIR.second - joint[1]])] >= 0)
        return next(known, (-1, 0))

    def put(body: int, place: int, side: int, level: int) -> None:
        tree.append((body, place, side, *turned(body)))
        leave(body, level)

    def leave(body: int, level: int) -> None:
        depth[body] = level
        for k, side in placing[body]:
            other = int(top.pairs[k, PAIR.second - side])
            if depth[other] < 0:
                free = _PLACING[int(top.pairs[k, PAIR.kind])] + (turned(other)[0] < 0)
                heappush(reached, (free, level + 1, k, other, 1 - side))

    leave(ground, 0)
    for root in range(ground + 1):
        while reached:
            _, level, k, body, side = heappop(reached)
            if depth[body] < 0:
                put(body, k, side, level)
        if depth[root] < 0:
            put(root, -1, 0, 1)
    return np.array(tree, dtype=np.int64).reshape(-1, COLUMNS)


def is_tree_of_pins(top: Topology, tree: np.ndarray) -> bool:
    """Return whether the articulated-body algorithm can compute the accelerations.

    All constraints must be revolute joints that are part of the tree and have no friction.
    """
    if len(top.frictions):
        return False
    pins = tree[:, PLACE][tree[:, PLACE] >= 0]
    return bool(len(pins) == len(top.pairs) and np.all(top.pairs[:, PAIR.kind] == KINDS["revolute"]))


def cut_joints(mechanism: CompiledMechanism) -> tuple[str, ...]:
    """Return the names of the joints that are not entirely part of the spanning tree."""
    tree = spanning_tree(mechanism.topology)
    kept = {*tree[:, PLACE].tolist(), *tree[:, TURN].tolist()}
    return tuple(
        name for name, pairs in zip(mechanism.joints, mechanism.joint_pairs, strict=True) if not kept.issuperset(pairs)
    )
