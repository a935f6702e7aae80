"""Products and decompositions of stacks of matrices, against exact products and the properties that define them."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit.engine.linear_systems import (
    complete_qr,
    least_norms,
    products,
    pseudoinverses,
    singular_values,
    solve_triangles,
    symmetric_eigenvectors,
)

FRAMES = 7
SHAPES = [(1, 1), (3, 5), (6, 6), (9, 4), (4, 0)]


def stack(rows: int, columns: int) -> np.ndarray:
    return np.random.default_rng(rows + 10 * columns).normal(size=(FRAMES, rows, columns))


@pytest.mark.parametrize("inner", [0, 1, 3, 4, 10])
def test_products_of_integers_are_exact(inner: int) -> None:
    rng = np.random.default_rng(inner)
    a, b = rng.integers(-99, 99, (FRAMES, 3, inner)), rng.integers(-99, 99, (FRAMES, inner, 5))
    np.testing.assert_array_equal(products(a, b), a @ b)
    np.testing.assert_array_equal(products(a[0], b), a[0] @ b)
    np.testing.assert_array_equal(products(a, b[:1]), a @ b[0])
    np.testing.assert_array_equal(products(a, b[:, :, 2]), (a @ b)[:, :, 2])


@pytest.mark.parametrize(("rows", "columns"), SHAPES)
def test_orthogonal_factors_are_orthogonal_and_reproduce_the_matrix(rows: int, columns: int) -> None:
    matrices = stack(rows, columns)
    matrices[0] = np.triu(matrices[0])  # needs no reflections
    q, r = complete_qr(matrices)
    np.testing.assert_allclose(np.swapaxes(q, 1, 2) @ q, np.broadcast_to(np.eye(rows), q.shape), atol=3e-15)
    np.testing.assert_allclose(q @ r, matrices, atol=1e-14)
    np.testing.assert_array_equal(np.tril(r, -1), 0.0)


def test_triangular_systems() -> None:
    triangles = np.triu(stack(5, 5)) + 3.0 * np.eye(5)
    x = 1.0 + np.arange(5.0 * FRAMES).reshape(FRAMES, 5)
    np.testing.assert_allclose(solve_triangles(triangles, np.einsum("tij,tj->ti", triangles, x)), x, rtol=1e-13)
    np.testing.assert_allclose(
        solve_triangles(triangles, np.einsum("tji,tj->ti", triangles, x), transposed=True), x, rtol=1e-13
    )
    triangles[3, 2, 2] = 0.0
    with pytest.raises(np.linalg.LinAlgError):
        solve_triangles(triangles, x)


@pytest.mark.parametrize(("rows", "columns"), SHAPES[:-1])
def test_pseudoinverses_have_the_four_properties_of_penrose(rows: int, columns: int) -> None:
    matrices = stack(rows, columns)
    matrices[0, :, -1] = matrices[0, :, 0]  # rank-deficient
    found = pseudoinverses(matrices, 1e-12)
    left, right = matrices @ found, found @ matrices
    np.testing.assert_allclose(left @ matrices, matrices, atol=1e-13)
    np.testing.assert_allclose(right @ found, found, atol=1e-11)
    np.testing.assert_allclose(left, np.swapaxes(left, 1, 2), atol=1e-13)
    np.testing.assert_allclose(right, np.swapaxes(right, 1, 2), atol=1e-13)
    values = stack(rows, 1)[:, :, 0]
    np.testing.assert_allclose(least_norms(matrices, values, 1e-12), np.einsum("tij,tj->ti", found, values), atol=1e-12)


@pytest.mark.parametrize(("rows", "columns"), [(6, 6), (9, 4), (4, 9)])
def test_singular_values_of_matrices_with_known_ones(rows: int, columns: int) -> None:
    expected = 10.0 ** -np.arange(min(rows, columns))
    u, v = complete_qr(stack(rows, 3))[0], complete_qr(stack(columns, 3))[0]
    matrices = (u[:, :, : len(expected)] * expected) @ np.swapaxes(v[:, :, : len(expected)], 1, 2)
    np.testing.assert_allclose(
        singular_values(matrices), np.broadcast_to(expected, (FRAMES, len(expected))), atol=3e-15
    )


def test_eigenvectors_of_second_differences_are_sines() -> None:
    n = 12
    matrix = np.diag(np.full(n - 1, 1.0), 1) + np.diag(np.full(n - 1, 1.0), -1) - 2.0 * np.eye(n)
    values, vectors = symmetric_eigenvectors(matrix)
    place = np.arange(1, n + 1)
    np.testing.assert_allclose(values, 2.0 * np.cos(np.pi * place[::-1] / (n + 1)) - 2.0, atol=1e-14)
    sines = np.sqrt(2.0 / (n + 1)) * np.sin(np.pi * np.outer(place, place[::-1]) / (n + 1))
    np.testing.assert_allclose(np.abs(vectors.T @ sines), np.eye(n), atol=1e-14)
