"""Factors, least squares and null spaces of the kernels, against LAPACK."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit.base.quadrature import gauss_legendre
from mbdkit.engine.elimination_order import symmetric_order
from mbdkit.engine.linear_systems import SparseFactors, factors_of, inverse_of, least_norm, product
from mbdkit.engine.self_stress import MOST_DENSE, SMALL, scaled_matrix, self_stresses, smallest_stress
from mbdkit.methods import gauss, radau_iia

EPS = float(np.finfo(float).eps)


def sparse_matrix(n: int, rng: np.random.Generator, *, is_complex: bool) -> np.ndarray:
    """Return a regular matrix with a few entries in each row, and some zeros on its diagonal."""
    matrix = np.where(rng.random((n, n)) < min(1.0, 3.0 / n), rng.normal(size=(n, n)), 0.0)
    matrix[rng.permutation(n), np.arange(n)] = rng.uniform(1.0, 3.0, n)
    return matrix * np.exp(1j * rng.uniform(0.0, 1.0, (n, n))) if is_complex else matrix


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("threshold", [1.0, 0.01])
@pytest.mark.parametrize("n", [1, 2, 7, 40, 150])
def test_solutions_agree_with_lapack_to_the_condition_number(n: int, threshold: float, is_complex: bool) -> None:
    rng = np.random.default_rng(n)
    matrix, right = sparse_matrix(n, rng, is_complex=is_complex), rng.normal(size=(3, n))
    row, column = np.nonzero(matrix)
    factors = SparseFactors(row, column, matrix[row, column], symmetric_order(n, row, column), threshold)
    expected = np.linalg.solve(matrix, right.T).T
    error = np.max(np.abs(factors.solve(right) - expected)) / np.max(np.abs(expected))
    assert error < 10.0 * n / threshold * EPS * np.linalg.cond(matrix)
    assert sorted(factors.row_of.tolist()) == sorted(factors.column_of.tolist()) == list(range(n))
    exact = np.linalg.norm(np.linalg.inv(matrix), 1)
    assert exact / 3.0 <= factors.norm_of_inverse() <= exact * (1.0 + 1e-6)


def test_refinement_removes_the_errors_of_small_pivots() -> None:
    matrix = np.array([[1e-9, 1.0], [1.0, 1.0]])
    row, column = np.nonzero(matrix)
    factors = SparseFactors(row, column, matrix[row, column], np.arange(2), 0.0)
    right = np.array([1.0, 2.0])
    assert np.max(np.abs(factors.solve(right[None])[0] - np.linalg.solve(matrix, right))) > 1e-9
    np.testing.assert_allclose(factors.solve_refined(right), np.linalg.solve(matrix, right), rtol=1e-14)


@pytest.mark.parametrize("matrix", [np.zeros((2, 2)), np.array([[1.0, 2.0], [2.0, 4.0]]), np.array([[np.nan]])])
def test_singular_matrices_are_refused(matrix: np.ndarray) -> None:
    with pytest.raises(np.linalg.LinAlgError):
        factors_of(matrix)


def test_values_of_the_same_entry_are_added() -> None:
    ones = np.zeros(3, dtype=int)
    factors = SparseFactors(ones, ones, np.array([1.0, 2.0, 5.0]), np.arange(1), 1.0)
    assert factors.solve(np.array([[4.0]])) == 0.5


@pytest.mark.parametrize("is_complex", [False, True])
def test_inverses_and_products(is_complex: bool) -> None:
    rng = np.random.default_rng(0)
    matrix, other = sparse_matrix(6, rng, is_complex=is_complex), rng.normal(size=(6, 4))
    np.testing.assert_allclose(inverse_of(matrix), np.linalg.inv(matrix), rtol=0, atol=1e-13)
    np.testing.assert_allclose(product(matrix, other), matrix @ other, rtol=0, atol=1e-13)
    np.testing.assert_allclose(product(matrix, other[:, 0]), matrix @ other[:, 0], rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("rows", "columns", "rank"), [(3, 7, 3), (7, 3, 3), (6, 8, 4), (8, 6, 3), (5, 5, 0), (0, 3, 0)]
)
def test_least_squares_of_least_norm(rows: int, columns: int, rank: int) -> None:
    rng = np.random.default_rng(rows)
    matrix, right = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, columns)), rng.normal(size=rows)
    expected = np.linalg.lstsq(matrix, right, rcond=1e-12)[0]
    np.testing.assert_allclose(least_norm(matrix, right, 1e-12), expected, rtol=0, atol=1e-12)


def jacobian(m: int, n: int, dependent: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return the entries of a sparse matrix whose last rows are combinations of others."""
    dense = np.where(rng.random((m, n)) < min(0.5, 8.0 / n), rng.normal(size=(m, n)), 0.0)
    for k in range(dependent):
        some = rng.choice(m - dependent, 3, replace=False)
        dense[m - 1 - k] = rng.normal(size=3) @ dense[some]
    dense /= np.maximum(np.linalg.norm(dense, axis=1, keepdims=True), 1e-300)
    row, column = np.nonzero(dense)
    return row, column, dense[row, column]


@pytest.mark.parametrize(
    ("m", "n", "dependent"), [(5, 9, 0), (5, 9, 1), (40, 60, 3), (12, 9, 0), (MOST_DENSE + 20, 450, 2)]
)
def test_self_stresses_span_the_null_space(m: int, n: int, dependent: int) -> None:
    rng = np.random.default_rng(m + n)
    row, column, value = jacobian(m, n, dependent, rng)
    matrix = scaled_matrix(m, row, column, value)
    dense = np.zeros((m, n))
    dense[row, column] = value
    u, values, _ = np.linalg.svd(dense, full_matrices=True)
    count = m - np.count_nonzero(values > SMALL)
    found = self_stresses(matrix, dependent)
    assert found.shape == (m, count)
    # expected: the same projection onto the null space
    np.testing.assert_allclose(found @ found.T, u[:, m - count :] @ u[:, m - count :].T, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.T @ found, np.eye(count), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("m", "n"), [(1, 4), (6, 6), (30, 50), (9, 6), (MOST_DENSE + 20, 450)])
def test_the_smallest_singular_value_and_its_vector(m: int, n: int) -> None:
    rng = np.random.default_rng(m)
    row, column, value = jacobian(m, n, int(m > 1), rng)
    value[-1] += 1e-4
    vector, smallest = smallest_stress(scaled_matrix(m, row, column, value))
    dense = np.zeros((m, n))
    dense[row, column] = value
    values = np.linalg.svd(dense, compute_uv=False)
    expected = values[-1] if m <= n else 0.0
    assert smallest == pytest.approx(expected, rel=1e-9, abs=1e-14)
    assert np.linalg.norm(vector @ dense) == pytest.approx(expected, rel=1e-9, abs=1e-14)


@pytest.mark.parametrize("tableau", [gauss.tableau(1), gauss.tableau(3), gauss.tableau(6), radau_iia.tableau(5)])
def test_eigensystems_of_tableaus_are_those_of_their_matrices(tableau: object) -> None:
    values, vectors, inverse = tableau.eigensystem()  # type: ignore[attr-defined]
    a = tableau.floats()[0]  # type: ignore[attr-defined]
    np.testing.assert_allclose(vectors * values @ inverse, a, rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=0), 1.0, rtol=1e-15)


@pytest.mark.parametrize("count", [1, 2, 5, 16])
def test_gauss_legendre_quadrature(count: int) -> None:
    nodes, weights = gauss_legendre(count)
    expected = np.polynomial.legendre.leggauss(count)
    np.testing.assert_allclose(nodes, expected[0], rtol=0, atol=4e-16)
    np.testing.assert_allclose(weights, expected[1], rtol=0, atol=4e-15)
