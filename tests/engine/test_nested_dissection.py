"""Nested dissection: separators against exhaustive search, fill against NumPy, growth against George's bound."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from mbdkit.engine.elimination_order import minimum_degree
from mbdkit.engine.nested_dissection import _between, dissection, products, sparse_order

Graph = list[set[int]]


def graph_of(nodes: int, edges: list[tuple[int, int]]) -> Graph:
    adjacent: Graph = [set() for _ in range(nodes)]
    for a, b in edges:
        adjacent[a].add(b)
        adjacent[b].add(a)
    return adjacent


def grid(size: int, shuffled: bool = False) -> Graph:
    """Return a square grid of `size` by `size` nodes."""
    label = np.arange(size**2).reshape(size, size)
    if shuffled:
        label = np.random.default_rng(size).permutation(size**2).reshape(size, size)
    edges = [
        *zip(label[1:].flat, label[:-1].flat, strict=True),
        *zip(label[:, 1:].flat, label[:, :-1].flat, strict=True),
    ]
    return graph_of(size**2, [(int(a), int(b)) for a, b in edges])


def parts_without(adjacent: Graph, removed: set[int]) -> list[int]:
    """Return the numbers of nodes of the connected parts that are left."""
    left, sizes = set(range(len(adjacent))) - removed, []
    while left:
        todo, size = [left.pop()], 0
        while todo:
            size += 1
            reached = adjacent[todo.pop()] & left
            left -= reached
            todo += reached
        sizes.append(size)
    return sizes


@pytest.mark.parametrize("shuffled", [False, True])
def test_the_last_separator_of_a_grid_is_short_and_divides_it(shuffled: bool) -> None:
    # expected: a line of a square grid of 20 by 20 nodes has 20 nodes
    adjacent = grid(20, shuffled)
    rank = dissection(adjacent)
    separator = {node for node in range(400) if rank[node] == 0}
    assert len(separator) <= 20
    assert max(parts_without(adjacent, separator)) <= 0.7 * 400


@pytest.mark.parametrize("seed", range(5))
def test_a_separator_has_the_fewest_nodes_that_touch_all_edges(seed: int) -> None:
    # expected: exhaustive search in a random bipartite graph
    rng = np.random.default_rng(seed)
    edges = [(int(a), int(b) + 5) for a, b in zip(*np.nonzero(rng.random((5, 5)) < 0.35), strict=True)]
    separator, first, second = _between(graph_of(10, edges), set(range(5)), set(range(5, 10)))
    fewest = next(n for n in range(6) if any(all(set(e) & set(c) for e in edges) for c in combinations(range(10), n)))
    assert len(separator) == fewest
    assert all(separator & set(edge) for edge in edges)
    assert first | second | separator == set(range(10))


def test_parts_that_are_not_connected_are_ordered_too() -> None:
    adjacent = graph_of(420, [(i, i + 1) for i in range(419) if i % 140 != 139])
    assert sorted(minimum_degree(adjacent, dissection(adjacent))[0]) == list(range(420))


def test_the_fill_is_that_of_the_factors() -> None:
    # expected: entries of the Cholesky factor of a random positive definite matrix on this graph, by NumPy
    adjacent = grid(26)
    order, below = sparse_order(adjacent)
    assert order != minimum_degree(adjacent)[0]
    rng = np.random.default_rng(0)
    matrix = np.diag([1.0 + len(others) for others in adjacent])
    for a, others in enumerate(adjacent):
        for b in others:
            matrix[a, b] = matrix[b, a] = -rng.uniform(0.5, 1.0)
    factor = np.linalg.cholesky(matrix[np.ix_(order, order)])
    assert np.count_nonzero(factor) == len(order) + sum(len(rows) for rows in below)


def test_products_in_square_grids_grow_with_the_power_3_2_of_their_nodes() -> None:
    # expected: A. George, SIAM J. Numer. Anal. 10 (1973); in order of minimum degree, the exponent is 1.7
    counts = [products(sparse_order(grid(size))[1]) for size in (32, 64)]
    assert np.log(counts[1] / counts[0]) / np.log(4) < 1.6


def test_small_graphs_and_graphs_with_little_fill_keep_the_order_of_minimum_degree() -> None:
    ladder = graph_of(1000, [(i, i + 2) for i in range(998)] + [(i, i + 1) for i in range(0, 1000, 2)])
    for adjacent in (grid(12), ladder):
        assert sparse_order(adjacent) == minimum_degree(adjacent)
