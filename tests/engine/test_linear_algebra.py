"""The block LDL^T of the Schur complement and the sparse LU, uncompiled, against dense NumPy."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbdkit.engine.elimination_order import (
    SingularSystemError,
    minimum_degree,
    neighbours,
    new_factors,
    pivot_order,
    schur_schedule,
    symbolic_lu,
)
from mbdkit.engine.kernels import lu, schur
from mbdkit.engine.kernels.table_rows import BODIES
from tests.margins import assert_within

Graph = list[tuple[int, int]]


def chain_graph(n: int) -> Graph:
    return [(n, 0)] + [(i, i + 1) for i in range(n - 1)]


def tree_graph(n: int, rng: np.random.Generator) -> Graph:
    return [(n if i == 0 else int(rng.integers(0, i)), i) for i in range(n)]


def ladder_graph(n: int) -> Graph:
    sides = [(2 * n, 0), (2 * n, n)] + [(s + i, s + i + 1) for s in (0, n) for i in range(n - 1)]
    return sides + [(i, n + i) for i in range(n)]


def tangled_graph(n: int, rng: np.random.Generator) -> Graph:
    pairs = tree_graph(n, rng)
    return pairs + [tuple(int(x) for x in rng.choice(n + 1, 2, replace=False)) for _ in range(n // 2)]  # type: ignore[misc]


GRAPHS: dict[str, Any] = {
    "one": lambda rng: (1, [(1, 0)]),
    "chain": lambda rng: (12, chain_graph(12)),
    "tree": lambda rng: (20, tree_graph(20, rng)),
    "ladder": lambda rng: (14, ladder_graph(7)),
    "tangle": lambda rng: (16, tangled_graph(16, rng)),
    "two joints between the same bodies": lambda rng: (3, [(3, 0), (0, 1), (0, 1), (1, 2)]),
}


class Blocks:
    """A random Schur complement over a graph of pairs of rows, dense and scheduled."""

    def __init__(self, bodies: int, graph: Graph, rng: np.random.Generator):
        order, below = minimum_degree(neighbours(graph, bodies))
        ends = [graph[k] for k in order]
        self.pairs = np.array([(0, a, b, -1) for a, b in ends], dtype=np.int64)
        self.rows = rng.integers(1, 3, size=len(ends))
        self.jac = rng.normal(size=(len(ends), 12))
        self.jac[self.rows == 1, 6:] = 0.0
        self.weight = rng.uniform(0.2, 5.0, size=(bodies + 1, 3))
        self.weight[bodies] = 0.0
        self.schedule = schur_schedule(ends, bodies, order, below)

    def factor(self) -> int:
        top: Any = SimpleNamespace(pairs=self.pairs, rows=self.rows, weight=self.weight)
        return int(schur.factor(top, self.jac, self.schedule))

    def solve(self, b: np.ndarray) -> np.ndarray:
        x = b.copy()
        schur.solve(self.schedule, x)
        return x

    def dense(self) -> np.ndarray:
        n, bodies = len(self.pairs), len(self.weight)
        full = np.zeros((n, 2, bodies, 3))
        for k, (_, a, b, _) in enumerate(self.pairs):
            full[k, :, a] += self.jac[k].reshape(2, 2, 3)[:, 0]
            full[k, :, b] += self.jac[k].reshape(2, 2, 3)[:, 1]
        flat = full.reshape(2 * n, 3 * bodies)
        matrix = (flat * self.weight.ravel()) @ flat.T
        for k in np.flatnonzero(self.rows == 1):
            matrix[2 * k + 1, 2 * k + 1] = 1.0
        return matrix


@pytest.mark.parametrize("name", GRAPHS)
@pytest.mark.parametrize("seed", range(4))
def test_the_block_factorization_solves_the_schur_complement(name: str, seed: int) -> None:
    # expected: numpy.linalg.solve of the dense matrix; error relative to its condition
    rng = np.random.default_rng(seed)
    blocks = Blocks(*GRAPHS[name](rng), rng)
    matrix = blocks.dense()
    b = rng.normal(size=(len(blocks.pairs), 2))
    b[blocks.rows == 1, 1] = 0.0
    assert blocks.factor() == -1
    expected = np.linalg.solve(matrix, b.ravel()).reshape(-1, 2)
    bound = 1e-12 * max(1.0, 1e-3 * np.linalg.cond(matrix)) * np.abs(expected).max()
    np.testing.assert_allclose(blocks.solve(b), expected, rtol=0, atol=bound)


def factor_nnz(graph: Graph, bodies: int) -> int:
    _, below = minimum_degree(neighbours(graph, bodies))
    return sum(len(b) for b in below)


@pytest.mark.parametrize("n", [1, 2, 3, 10, 200])
def test_the_order_is_free_of_fill_on_a_chain(n: int) -> None:
    # expected: a tridiagonal matrix has n - 1 blocks below its diagonal, and so has its factor
    assert factor_nnz(chain_graph(n), n) == n - 1


def test_fill_of_a_ladder_grows_with_its_length_and_not_faster() -> None:
    long, short = (factor_nnz(ladder_graph(n), 2 * n) for n in (200, 100))
    assert long < 2.1 * short


def test_every_pair_is_eliminated_once() -> None:
    rng = np.random.default_rng(0)
    graph = tangled_graph(40, rng)
    order, _ = minimum_degree(neighbours(graph, 40))
    assert sorted(order) == list(range(len(graph)))


@pytest.mark.parametrize("name", ["chain", "tree", "ladder"])
def test_a_repeated_row_is_reported_as_a_vanished_pivot(name: str) -> None:
    # expected: two pairs with equal rows on equal bodies make the matrix singular
    rng = np.random.default_rng(1)
    bodies, graph = GRAPHS[name](rng)
    blocks = Blocks(bodies, [*graph, graph[2]], rng)
    twins = [k for k in range(len(blocks.pairs)) if tuple(blocks.pairs[k, BODIES]) == graph[2]]
    blocks.jac[twins[0]] = blocks.jac[twins[1]]
    blocks.rows[twins] = 2
    blocks.jac[twins, 6:] = rng.normal(size=6)
    assert blocks.factor() in range(len(blocks.pairs))


def test_numbers_that_are_not_finite_are_reported_too() -> None:
    rng = np.random.default_rng(2)
    blocks = Blocks(*GRAPHS["tree"](rng), rng)
    blocks.jac[3, 0] = np.nan
    assert blocks.factor() >= 0


class Sparse:
    """A random sparse matrix with a zero block on its diagonal, as of a constrained system."""

    def __init__(self, n: int, m: int, rng: np.random.Generator, dtype: type):
        matrix = np.zeros((n + m, n + m), dtype)
        matrix[:n, :n] = np.diag(rng.uniform(0.5, 2.0, n))
        for _ in range(3 * n):
            i, j = rng.integers(0, n, 2)
            matrix[i, j] += rng.normal() + (1j * rng.normal() if dtype is complex else 0.0)
        for r in range(m):
            places = rng.choice(n, 4, replace=False)
            matrix[n + r, places] = rng.normal(size=4)
            matrix[places, n + r] = rng.normal(size=4)
        self.matrix = matrix
        self.row, self.column = np.nonzero(matrix)
        self.values = matrix[self.row, self.column]

    def pattern(self) -> tuple[lu.Pattern, np.ndarray]:
        n = len(self.matrix)
        natural = np.random.default_rng(n).permutation(n)  # any order will do, the matrix is small
        choice = pivot_order(n, self.row, self.column, self.values, natural, [np.ones(n)])
        return symbolic_lu(n, self.row, self.column, choice)


@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize(("n", "m"), [(4, 0), (6, 3), (30, 12), (60, 25)])
@pytest.mark.parametrize("seed", range(3))
def test_sparse_lu_solves_real_and_complex_systems(dtype: type, n: int, m: int, seed: int) -> None:
    # expected: numpy.linalg.solve, also for new values on the same pattern and pivots
    rng = np.random.default_rng(seed)
    sparse = Sparse(n, m, rng, dtype)
    pattern, position = sparse.pattern()
    factors = new_factors(pattern, sparse.values.dtype.type)
    for change in (0.0, 0.02):
        values = sparse.values * (1 + change * rng.normal(size=len(sparse.values)))
        matrix = np.zeros_like(sparse.matrix)
        matrix[sparse.row, sparse.column] = values
        factors.a[position] = values * pattern.weight[position]
        assert lu.factorize(pattern, factors) == -1
        b = rng.normal(size=n + m).astype(dtype)
        x, r = np.zeros((2, n + m), dtype)
        lu.substitute(pattern, factors, b, x)
        expected = np.linalg.solve(matrix, b)
        bound = 1e-12 * max(1.0, 1e-3 * np.linalg.cond(matrix)) * np.abs(expected).max()
        np.testing.assert_allclose(x, expected, rtol=0, atol=bound)
        worst = lu.residual(pattern, factors, b, x, r)
        np.testing.assert_allclose(r, b - matrix @ x, rtol=0, atol=1e-12 * np.abs(x).max())
        assert_within(worst, 1e-10)


def test_pivots_that_have_worn_out_are_reported() -> None:
    rng = np.random.default_rng(0)
    sparse = Sparse(6, 3, rng, float)
    pattern, position = sparse.pattern()
    factors = new_factors(pattern, np.float64)
    factors.a[position] = sparse.values * pattern.weight[position]
    first = (sparse.row == pattern.row_of[0]) & (sparse.column == pattern.column_of[0])
    factors.a[position[first]] = 0.0
    assert lu.factorize(pattern, factors) == 0


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_a_matrix_without_pivots_is_singular_and_no_solution_comes_back(value: float) -> None:
    rng = np.random.default_rng(0)
    sparse = Sparse(6, 3, rng, float)
    sparse.values[sparse.row == 7] = value
    with pytest.raises(SingularSystemError):
        sparse.pattern()
