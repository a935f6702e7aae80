"""Nested dissection: an elimination order for nets, whose loops run in two directions.

A separator is a small set of nodes without which a graph falls apart into two parts. If it is eliminated after them,
the parts cause no fill between each other. Applied again to each part, this leads to a factorization of a plane net of
n nodes in n^1.5 operations (A. George, SIAM J. Numer. Anal. 10 (1973) 345-363); minimum degree takes more. Chains,
trees and ladders have hardly any fill in either order.

Separators are found from distances in the graph alone, all of them integers, so that the order is the same on every
machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from mbdkit.engine.elimination_order import minimum_degree

#: Nested dissection is tried if there are at least this many nodes, and if the factorization in order of minimum degree
#: takes at least this many products of blocks per node. In smaller nets it gains nothing.
FEWEST_NODES, MUCH_FILL = 300, 30

#: Mean number of adjacent nodes above which nested dissection is not tried: the joints of a body with hundreds of
#: joints cannot be separated.
MOST_NEIGHBOURS = 30

#: Parts with at most this many nodes are not divided, which would save a few per cent of the products but take long.
SMALLEST_PART = 100

#: Shares of the nodes that are tried for the first of two parts.
SHARES = (0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65)

#: A separator whose parts have sizes of 2:1 counts as longer than an even one by a third of this share. The value was
#: found on nets of 700 to 4000 bodies.
UNEVENNESS = 0.25

#: Largest share of the nodes that a part may have; otherwise separators would move to the corners.
LARGEST_PART = 0.7

Division = tuple[set[int], set[int], set[int]]  #: A separator, and the two parts that it leaves.


def sparse_order(adjacent: Sequence[set[int]]) -> tuple[list[int], list[set[int]]]:
    """Return the order by minimum degree or, in large nets, that by nested dissection if it takes fewer products.

    The result has the format of `minimum_degree`.

    `adjacent`: for each node, the adjacent nodes.
    """
    order, below = minimum_degree(adjacent)
    nodes = len(order)
    is_sparse = sum(map(len, adjacent)) <= MOST_NEIGHBOURS * nodes
    if nodes >= FEWEST_NODES and is_sparse and products(below) >= MUCH_FILL * nodes:
        other, other_below = minimum_degree(adjacent, dissection(adjacent))
        if products(other_below) < products(below):
            return other, other_below
    return order, below


def products(below: Sequence[set[int]]) -> int:
    """Return the number of products of blocks in the factorization."""
    return sum(len(rows) * (len(rows) + 3) // 2 for rows in below)


def dissection(adjacent: Sequence[set[int]]) -> list[int]:
    """Return the rank of each node: nodes of lower rank are eliminated first, the first separator last."""
    rank = [-len(adjacent)] * len(adjacent)
    parts = [(set(range(len(adjacent))), 0)]
    while parts:
        part, depth = parts.pop()
        if len(part) > SMALLEST_PART:
            separator, *rest = _divided(adjacent, part)
            for node in separator:
                rank[node] = -depth
            parts += [(part, depth + 1) for part in rest]
    return rank


def _divided(adjacent: Sequence[set[int]], part: set[int]) -> Division:
    ends = _distances(adjacent, part, min(part))
    if len(ends) < len(part):
        return set(), set(ends), part - set(ends)
    best = min((_between(adjacent, *halves) for halves in _halves(adjacent, part)), key=_length)
    while True:  # move the separator towards either side as long as this shortens it (Ashcraft and Liu 1998)
        separator, first, second = best
        moved = _between(adjacent, first | separator, second), _between(adjacent, first, second | separator)
        shorter = min(moved, key=_length)
        if _length(shorter) >= _length(best):
            return best
        best = shorter


def _length(division: Division) -> float:
    """Return the number of nodes of a separator, increased if its parts are uneven."""
    separator, first, second = division
    nodes = len(separator) + len(first) + len(second)
    if max(len(first), len(second)) > LARGEST_PART * nodes:
        return math.inf
    return len(separator) * (1 + UNEVENNESS * abs(len(first) - len(second)) / nodes)


def _halves(adjacent: Sequence[set[int]], part: set[int]) -> Iterator[tuple[set[int], set[int]]]:
    """Yield divisions of the nodes into two sets, across the net, along it, and diagonally.

    The difference of the distances from two nodes that are far apart is a coordinate of all nodes. In a square net, two
    opposite corners give one coordinate, and the other two corners give another. Nodes are divided by their order in
    each coordinate, in the sum and in the difference of both.
    """

    def across(root: int) -> tuple[dict[int, int], dict[int, int]]:
        distances = _distances(adjacent, part, root)
        return distances, _distances(adjacent, part, max(part, key=lambda node: (distances[node], -node)))

    first = _distances(adjacent, part, min(part))
    a, b = across(max(part, key=lambda node: (first[node], -node)))
    middle = [node for node in part if abs(a[node] - b[node]) <= 1]
    c, d = across(max(middle, key=lambda node: (a[node] + b[node], -node)))
    for x, y in ((1, 0), (0, 1), (1, 1), (1, -1)):
        ranked = sorted(part, key=lambda node: (x * (a[node] - b[node]) + y * (c[node] - d[node]), node))
        for share in SHARES:
            count = int(share * len(part))
            yield set(ranked[:count]), set(ranked[count:])


def _distances(adjacent: Sequence[set[int]], part: set[int], root: int) -> dict[int, int]:
    """Return the number of edges from `root` to each node that can be reached within `part`."""
    results, layer, distance = {root: 0}, {root}, 0
    while layer:
        layer = {other for node in layer for other in adjacent[node] if other in part and other not in results}
        distance += 1
        results.update(dict.fromkeys(layer, distance))
    return results


def _between(adjacent: Sequence[set[int]], first: set[int], second: set[int]) -> Division:
    """Divide a graph by the fewest nodes that touch all edges between two sets.

    They form a minimum vertex cover of a bipartite graph, which follows from a maximum matching (König's theorem).
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    left = sorted(node for node in first if not adjacent[node].isdisjoint(second))
    beyond = [sorted(adjacent[node] & second) for node in left]
    right = sorted({node for some in beyond for node in some})
    place = {node: column for column, node in enumerate(right)}
    columns = [[place[node] for node in some] for some in beyond]
    row = [k for k, some in enumerate(columns) for _ in some]
    entries = [column for some in columns for column in some]
    matrix = csr_array(([1] * len(row), (row, entries)), shape=(len(left), len(right)))
    match = maximum_bipartite_matching(matrix, perm_type="column").tolist()
    row_of = {column: k for k, column in enumerate(match) if column >= 0}
    todo = [k for k, column in enumerate(match) if column < 0]
    free, reached = set(todo), set()  # rows and columns on alternating paths from unmatched rows
    while todo:
        for column in columns[todo.pop()]:
            if column not in reached:
                reached.add(column)
                if row_of[column] not in free:
                    free.add(row_of[column])
                    todo.append(row_of[column])
    separator = {node for k, node in enumerate(left) if k not in free} | {right[column] for column in reached}
    return separator, first - separator, second - separator
