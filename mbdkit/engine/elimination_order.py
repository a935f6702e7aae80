"""Elimination orders of the Schur complement and of the pivoted sparse LU decomposition, computed in advance."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.lu import Factors, Pattern
from mbdkit.engine.kernels.schur import Schur
from mbdkit.engine.linear_systems import SparseFactors

#: Orderings of the columns in order of preference, each with its threshold for diagonal pivots, relative to the largest
#: entry of the column: the natural order, and that by minimum degree in the graph of A + A^T and of A^T A.
PIVOT_STRATEGIES = (("natural", 1e-3), ("symmetric", 1e-3), ("columns", 0.1), ("columns", 1.0))

#: Pivots are accepted if the residual of a trial solution, relative to the right-hand side, is at most this.
ACCURATE = 1e-11

#: If the factors have at most this many times the entries of the matrix, no further strategy is tried.
LITTLE_FILL = 4

#: For matrices with at least so many unknowns, this limit of the fill replaces `LITTLE_FILL`, because more strategies
#: take minutes if the mechanism is a net.
MANY_UNKNOWNS, MUCH_FILL = 5000, 40

#: 1-norm condition number of the equilibrated matrix below which no further scaling is tried.
GOOD_CONDITION = 1e8

#: 1-norm condition number of the equilibrated matrix from which the matrix counts as singular.
WORST_CONDITION = 1e13


class SingularSystemError(Exception):
    """The matrix is singular; `index` is the unknown at which the elimination failed, -1 if not known."""

    def __init__(self, index: int = -1):
        super().__init__(index)
        self.index = index


def neighbours(pairs: Sequence[Sequence[int]], ground: int = -1) -> list[set[int]]:
    """Return, for each pair of constraint rows, the other pairs attached to one of its bodies other than ground.

    Columns of a matrix are neighbours in the same sense if they have an entry in the same row.
    """
    on_body: dict[int, list[int]] = {}
    for k, bodies in enumerate(pairs):
        for body in set(bodies) - {ground}:
            on_body.setdefault(body, []).append(k)
    adjacent: list[set[int]] = [set() for _ in pairs]
    for members in on_body.values():
        for k in members:
            adjacent[k].update(members)
    for k, others in enumerate(adjacent):
        others.discard(k)
    return adjacent


def minimum_degree(adjacent: Sequence[set[int]], rank: Sequence[int] | None = None) -> tuple[list[int], list[set[int]]]:
    """Order the nodes of a graph by minimum degree.

    `adjacent`: for each node, the adjacent nodes. `rank`: nodes of lower rank are eliminated before all nodes of higher
    rank; by default, all have the same rank. Returns nodes in order of elimination, and for each node, the adjacent
    nodes at the time of its elimination: the rows of its column in the factor.
    """
    graph = [set(others) for others in adjacent]
    rank = rank or [0] * len(graph)
    heap = [(rank[node], len(others), node) for node, others in enumerate(graph)]
    heapq.heapify(heap)
    done = [False] * len(graph)
    order: list[int] = []
    while heap:
        _, degree, node = heapq.heappop(heap)
        if done[node] or degree != len(graph[node]):
            continue
        done[node] = True
        order.append(node)
        rest = graph[node]
        for other in rest:
            if len(rest) > 1:
                graph[other] |= rest
                graph[other].discard(other)
            graph[other].discard(node)
            heapq.heappush(heap, (rank[other], len(graph[other]), other))
    return order, graph


def schur_schedule(
    pairs: Sequence[tuple[int, int]], ground: int, order: Sequence[int], below: Sequence[set[int]]
) -> Schur:
    """Allocate the block LDL^T decomposition and precompute its sequence of operations.

    `pairs`: first and second body of each pair of rows, already numbered in elimination order. `ground`: number of the
    ground body. `order`, `below`: result of `sparse_order`, in the numbering before reordering.
    """
    position = {node: k for k, node in enumerate(order)}
    columns = [sorted(position[other] for other in below[node]) for node in order]
    start = np.concatenate([[0], np.cumsum([len(c) for c in columns])]).astype(np.int64)
    block = {(i, k): int(start[k]) + e for k, rows in enumerate(columns) for e, i in enumerate(rows)}
    update = [block[i, j] for rows in columns for e, i in enumerate(rows) for j in rows[:e]]
    on_body: dict[int, list[tuple[int, int]]] = {}
    for k, (a, b) in enumerate(pairs):
        for body, column in ((a, 0), (b, 3)):
            if body != ground:
                on_body.setdefault(body, []).append((k, column))
    coupling = [
        (block[r, k], r, i0, k, j0, body)
        for body, members in on_body.items()
        for x, (k, j0) in enumerate(members)
        for r, i0 in members[x + 1 :]
        if r != k
    ]
    blocks = len(block)
    return Schur(
        start=start,
        row=np.array([i for rows in columns for i in rows], dtype=np.int64),
        update=np.array(update, dtype=np.int64),
        coupling=np.array(coupling, dtype=np.int64).reshape(-1, 6),
        diagonal=np.zeros((len(pairs), 3)),
        whole=np.zeros((len(pairs), 2)),
        below=np.zeros((blocks, 4)),
        scaled=np.zeros((blocks, 4)),
    )


def empty_schur() -> Schur:
    """Return an empty schedule, for mechanisms that always use the pivoted solver."""
    return schur_schedule([], -1, [], [])


class PivotChoice(NamedTuple):
    """A pivot sequence and the scaling for which it was chosen; all arrays (n,), scales in the original order of
    unknowns.
    """

    row_of: np.ndarray
    column_of: np.ndarray
    row_scale: np.ndarray
    column_scale: np.ndarray


def pivot_order(
    n: int, row: np.ndarray, column: np.ndarray, values: np.ndarray, natural: np.ndarray, scales: Sequence[np.ndarray]
) -> PivotChoice:
    """Choose the pivots of a sparse matrix from its values.

    The equilibrated matrix is factorized with each of `PIVOT_STRATEGIES`; the sparsest accurate factors are used.

    - `n`: number of unknowns.
    - `row`, `column`, `values`: (nnz,) row, column and value of each entry.
    - `natural`: (n,) order of the unknowns that causes little fill if the diagonal pivots in this order are acceptable.
    - `scales`: symmetric scalings (n,), each a starting point of the equilibration. The first one that gives a
      well-conditioned matrix is used, otherwise the best one. Small inertias require a different scaling than small
      masses.

    Returns row and column at each pivot position, and the scaling. Raises SingularSystemError if the matrix is singular
    or its condition number is not below `WORST_CONDITION`.
    """
    place = np.empty(n, dtype=np.int64)
    place[natural] = np.arange(n)
    best, least = None, WORST_CONDITION
    for scale in scales:
        row_scale, column_scale = equilibrate(n, row, column, np.abs(values) * scale[row] * scale[column])
        row_scale, column_scale = row_scale * scale, column_scale * scale
        entries = values * row_scale[row] * column_scale[column]
        factors, condition = _sparsest(n, place[row], place[column], entries)
        if factors is not None and condition < least:
            best, least = PivotChoice(factors.row_of, factors.column_of, row_scale, column_scale), condition
        if least < GOOD_CONDITION:
            break
    if best is None:
        raise SingularSystemError
    return best._replace(row_of=natural[best.row_of], column_of=natural[best.column_of])


def _sparsest(n: int, row: np.ndarray, column: np.ndarray, values: np.ndarray) -> tuple[SparseFactors | None, float]:
    """Return the sparsest accurate factors of an equilibrated matrix (n, n) and its 1-norm condition number.

    Returns None and infinity if no factors are accurate.
    """
    probe = _row_sums(n, row, values)
    allowed = LITTLE_FILL if n < MANY_UNKNOWNS else MUCH_FILL
    best = None
    for ordering, threshold in PIVOT_STRATEGIES:
        try:
            factors = SparseFactors(row, column, values, _column_order(ordering, n, row, column), threshold)
        except np.linalg.LinAlgError:
            continue
        with np.errstate(all="ignore"):  # of a matrix that is singular to round-off, the solution may not be finite
            solution = factors.solve(probe[None])[0]
            error = np.max(np.abs(_row_sums(n, row, values * solution[column]) - probe), initial=0.0)
        if error <= ACCURATE * np.max(np.abs(probe), initial=1.0) and (
            best is None or factors.entries < 0.9 * best.entries
        ):
            best = factors
        if best is not None and best.entries <= allowed * len(values):
            break
    if best is None:
        return None, np.inf
    with np.errstate(all="ignore"):
        return best, best.norm_of_inverse() * float(np.max(np.bincount(column, np.abs(values), minlength=n)))


def _row_sums(n: int, row: np.ndarray, values: np.ndarray) -> np.ndarray:
    if not np.iscomplexobj(values):
        return np.bincount(row, values, minlength=n)
    return np.bincount(row, values.real, minlength=n) + 1j * np.bincount(row, values.imag, minlength=n)


def _column_order(ordering: str, n: int, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    if ordering == "natural":
        return np.arange(n)
    if ordering == "symmetric":
        return symmetric_order(n, row, column)
    rows_of: list[list[int]] = [[] for _ in range(n)]
    for i, j in zip(row.tolist(), column.tolist(), strict=True):
        rows_of[j].append(i)
    return np.array(minimum_degree(neighbours(rows_of))[0], dtype=np.int64)


def symmetric_order(n: int, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Return the elimination order (n,) by minimum degree for the pattern of ``A + A^T``, a matrix (n, n)."""
    adjacent: list[set[int]] = [set() for _ in range(n)]
    for i, j in zip(row.tolist(), column.tolist(), strict=True):
        if i != j:
            adjacent[i].add(j)
            adjacent[j].add(i)
    return np.array(minimum_degree(adjacent)[0], dtype=np.int64)


def equilibrate(n: int, row: np.ndarray, column: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column factors that scale the largest entry of each row and column to about 1 (Ruiz 2001).

    The factors are powers of two, so that scaling does not cause rounding errors.

    Raises SingularSystemError if a row or column is empty or an entry is not finite.
    """
    if not np.all(np.isfinite(sizes)):
        raise SingularSystemError
    row_scale, column_scale = np.ones(n), np.ones(n)
    for _ in range(4):
        scaled = sizes * row_scale[row] * column_scale[column]
        row_largest, column_largest = np.zeros(n), np.zeros(n)
        np.maximum.at(row_largest, row, scaled)
        np.maximum.at(column_largest, column, scaled)
        empty = (row_largest == 0) | (column_largest == 0)
        if np.any(empty):
            raise SingularSystemError(int(np.argmax(empty)))
        row_scale /= np.sqrt(row_largest)
        column_scale /= np.sqrt(column_largest)
    return power_of_two(row_scale), power_of_two(column_scale)


def power_of_two(x: np.ndarray) -> np.ndarray:
    """Return the powers of two nearest to `x`. Scaling by them causes no rounding errors."""
    share, exponent = np.frexp(x)
    return np.asarray(np.ldexp(1.0, exponent - (share < np.sqrt(0.5))))


def symbolic_lu(n: int, row: np.ndarray, column: np.ndarray, choice: PivotChoice) -> tuple[Pattern, np.ndarray]:
    """Compute the sparsity pattern of the factors for a fixed pivot sequence.

    Returns patterns of A and of its factors in pivot order, and index of each given entry among the values of A.
    """
    row_of, column_of, row_scale, column_scale = choice
    row_place, column_place = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    row_place[row_of] = np.arange(n)
    column_place[column_of] = np.arange(n)
    i, j = row_place[row], column_place[column]
    sort = np.lexsort((j, i))
    position = np.empty(len(row), dtype=np.int64)
    position[sort] = np.arange(len(row))
    a_start = np.searchsorted(i[sort], np.arange(n + 1)).astype(np.int64)
    a_column = j[sort].astype(np.int64)
    lower: list[list[int]] = []
    upper: list[list[int]] = []
    columns = a_column.tolist()
    bounds = a_start.tolist()
    for r in range(n):
        pattern = set(columns[bounds[r] : bounds[r + 1]])
        pattern.add(r)
        todo = [c for c in pattern if c < r]
        heapq.heapify(todo)
        below: list[int] = []
        while todo:
            k = heapq.heappop(todo)
            below.append(k)
            for c in upper[k]:
                if c not in pattern:
                    pattern.add(c)
                    if c < r:
                        heapq.heappush(todo, c)
        lower.append(below)
        upper.append(sorted(c for c in pattern if c > r))
    l_start, l_column = _flat(lower)
    u_start, u_column = _flat(upper)
    weight = (row_scale[row] * column_scale[column])[sort]
    result = Pattern(
        a_start, a_column, l_start, l_column, u_start, u_column, row_of, column_of, row_scale, column_scale, weight
    )
    return result, position


def _flat(rows: list[list[int]]) -> tuple[np.ndarray, np.ndarray]:
    start = np.concatenate([[0], np.cumsum([len(r) for r in rows])]).astype(np.int64)
    return start, np.array([c for r in rows for c in r], dtype=np.int64)


def empty_pattern() -> Pattern:
    """Return the pattern of a 0 x 0 matrix."""
    none = np.zeros(0, dtype=np.int64)
    zero, scale = np.zeros(1, dtype=np.int64), np.zeros(0)
    return Pattern(zero, none, zero, none, zero, none, none, none, scale, scale, scale)


def new_factors(pattern: Pattern, dtype: type) -> Factors:
    """Return storage for the values of a matrix with this pattern and of its factors."""
    n = len(pattern.row_of)
    return Factors(
        a=np.zeros(len(pattern.a_column), dtype),
        lower=np.zeros(len(pattern.l_column), dtype),
        upper=np.zeros(len(pattern.u_column), dtype),
        pivot=np.zeros(n, dtype),
        reference=np.zeros(n),
        work=np.zeros(n, dtype),
    )
