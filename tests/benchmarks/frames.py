"""Chains, trees, ladders and nets of uniform rods that are pinned together, of any size, at rest under gravity.

A frame is a graph in the plane: an edge is a rod of 1 kg/m, a node a pin through all rods that meet there (as many
revolute joints as rods, less one), and some nodes are pinned to the ground. No row is redundant: a cell of a ladder is
a four-bar linkage that hangs on the cell above, and so is a row of cells of a net, which moves as one. All angles are
generic, so that no cell is near its dead centre.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import mbdkit

Node = tuple[int, int]
Place = Callable[[Node], tuple[float, float]]


def chain(bodies: int) -> mbdkit.Mechanism:
    """Return rods in a row, from the horizontal."""
    return frame((((k, 0), (k + 1, 0)) for k in range(bodies)), lambda node: (node[0], 0.0), {(0, 0)})


def tree(bodies: int) -> mbdkit.Mechanism:
    """Return rods that fork at every end; the k-th rod ends in node k and begins where rod k // 2 ends."""
    angle, place = {0: -1.2}, {0: (0.0, 0.0)}
    for k in range(1, bodies + 1):
        x, y = place[k // 2]
        angle[k] = angle[k // 2] + (0.5 if k % 2 else -0.5) / k.bit_length()
        place[k] = (x + math.cos(angle[k]), y + math.sin(angle[k]))
    return frame((((k // 2, 0), (k, 0)) for k in range(1, bodies + 1)), lambda node: place[node[0]], {(0, 0)})


def ladder(bodies: int) -> mbdkit.Mechanism:
    """Return two hanging rails with rungs: a third as many loops as bodies, as many bodies as threes allow."""
    cells = max(1, round(bodies / 3))
    rods: list[tuple[Node, Node]] = []
    for k in range(cells):
        rods += [((k, 0), (k + 1, 0)), ((k, 1), (k + 1, 1)), ((k + 1, 0), (k + 1, 1))]

    def place(node: Node) -> tuple[float, float]:
        k, side = node
        return 0.3 * k + (1.0 + 0.05 * (k % 2)) * side, -0.9 * k - 0.1 * math.sin(k) - 0.2 * side

    return frame(rods, place, {(0, 0), (0, 1)})


def net(bodies: int) -> mbdkit.Mechanism:
    """Return a hanging grid of rods, about as wide as high: loops in two directions, half as many as bodies."""
    height = max(1, round(math.sqrt(bodies / 2)))
    width = max(2, round((bodies / height + 1) / 2))
    rods: list[tuple[Node, Node]] = []
    for row in range(height):
        for column in range(width):
            rods.append(((row, column), (row + 1, column)))
            if column > 0:
                rods.append(((row + 1, column - 1), (row + 1, column)))

    def place(node: Node) -> tuple[float, float]:
        row, column = node
        return column + 0.3 * row + 0.05 * math.sin(2.1 * row + column), 0.05 * math.cos(1.7 * column + row) - row

    return frame(rods, place, {(0, column) for column in range(width)})


def frame(rods: Iterable[tuple[Node, Node]], place: Place, fixed: set[Node]) -> mbdkit.Mechanism:
    """Return the mechanism of a graph.

    Parameters
    ----------
    rods
        The two nodes of each rod.
    place
        Where a node is (x, y) [m].
    fixed
        Nodes that are pinned to the ground.
    """
    mechanism = mbdkit.Mechanism()
    at: dict[Node, list[str]] = {}
    for number, (a, b) in enumerate(rods, start=1):
        (x1, y1), (x2, y2) = place(a), place(b)
        length = math.hypot(x2 - x1, y2 - y1)
        rod = mechanism.body(
            f"rod{number}",
            mass=length,
            inertia=length**3 / 12,
            position=((x1 + x2) / 2, (y1 + y2) / 2),
            angle=math.atan2(y2 - y1, x2 - x1),
        )
        at.setdefault(a, []).append(rod)
        at.setdefault(b, []).append(rod)
    for node, meeting in at.items():
        held = [mechanism.ground, *meeting] if node in fixed else meeting
        for number in range(1, len(held)):
            name = f"J{len(mechanism.joints) + 1}"
            mechanism.revolute(name, held[number - 1], held[number], at=place(node))
    return mechanism
