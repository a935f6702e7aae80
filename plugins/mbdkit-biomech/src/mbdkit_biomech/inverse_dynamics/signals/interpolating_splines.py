"""Splines through samples, from B-splines.

SciPy solves the equations of the coefficients by LAPACK, whose rounding errors depend on the processor. Source: C. de
Boor, A Practical Guide to Splines, 2001, chapters 9, 10 and 13.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.engine.linear_systems import SparseFactors

#: Orders and values (...) of the derivatives that are prescribed at an end.
End = Sequence[tuple[int, np.ndarray]]


@dataclass(frozen=True)
class Spline:
    """A spline with values of any shape.

    Attributes
    ----------
    knots, coefficients
        (n + degree + 1,) knots in ascending order, and (n, ...) coefficients of the B-splines.
    degree
        Degree of the pieces.
    """

    knots: np.ndarray
    coefficients: np.ndarray
    degree: int

    def __call__(self, x: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the values (X, ...) of a derivative at places (X,); outer pieces continue beyond the ends."""
        knots, c, degree = self.knots, self.coefficients, self.degree
        more = (slice(None), *(None,) * (c.ndim - 1))
        for _ in range(order):
            width = knots[degree + 1 : -1] - knots[1 : -degree - 1]
            c = degree * np.diff(c, axis=0) / np.where(width > 0.0, width, 1.0)[more]
            knots, degree = knots[1:-1], degree - 1
        first, basis = b_splines(knots, degree, x)
        out = np.zeros((len(x), *c.shape[1:]))
        for j in range(degree + 1):
            out += basis[j][more] * c[first + j]
        return out


def b_splines(knots: np.ndarray, degree: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the index (X,) of the first B-spline that is not zero at each place, and the values (degree + 1, X) of
    this one and the following ones.
    """
    count = len(knots) - degree - 1
    piece = np.clip(np.searchsorted(knots, x, side="right") - 1, degree, count - 1)
    values = np.zeros((degree + 1, len(x)))
    values[0] = 1.0
    for k in range(1, degree + 1):
        carried = np.zeros(len(x))
        for j in range(k):
            right, left = knots[piece + j + 1], knots[piece + j + 1 - k]
            share = values[j] / (right - left)
            values[j] = carried + (right - x) * share
            carried = (x - left) * share
        values[k] = carried
    return piece - degree, values


def interpolating_spline(x: np.ndarray, values: np.ndarray, degree: int, ends: tuple[End, End] | None = None) -> Spline:
    """Return the spline of an odd degree through samples; without `ends`, the polynomial through fewer than
    ``degree + 1`` samples.

    Parameters
    ----------
    x, values
        (T,) ascending places and (T, ...) values.
    ends
        Derivatives at the first and at the last place, ``(degree - 1) / 2`` at each. By default, the pieces next to the
        ends extend over ``(degree + 1) / 2`` intervals (not-a-knot conditions).

    Raises
    ------
    ValueError
        If there are not enough samples, or their places do not ascend.
    """
    inner = x[1:-1] if ends is not None else x[(degree + 1) // 2 : len(x) - (degree + 1) // 2]
    if ends is None and 1 < len(x) <= degree:
        degree, inner = len(x) - 1, x[:0]
    knots = np.concatenate([np.full(degree + 1, x[0]), inner, np.full(degree + 1, x[-1])])
    conditions = (0, 0) if ends is None else (len(ends[0]), len(ends[1]))
    count = len(knots) - degree - 1
    if len(x) + sum(conditions) != count or np.any(np.diff(x) <= 0.0):
        raise ValueError(f"a spline of degree {degree} needs more samples, at ascending places")
    first, basis = b_splines(knots, degree, x)
    rows = np.tile(np.arange(len(x)) + conditions[0], degree + 1)
    columns = (first + np.arange(degree + 1)[:, None]).ravel()
    parts, right = [(rows, columns, basis.ravel())], np.empty((count, *values.shape[1:]))
    right[conditions[0] : conditions[0] + len(x)] = values
    for end, begin in enumerate((0, conditions[0] + len(x))):
        near = np.arange(degree + 1) + (count - degree - 1) * end
        unit = np.zeros((count, degree + 1))
        unit[near, np.arange(degree + 1)] = 1.0
        for row, (order, value) in enumerate(() if ends is None else ends[end], start=begin):
            slopes = Spline(knots, unit, degree)(x[[-end]], order)[0]
            parts.append((np.full(degree + 1, row), near, slopes))
            right[row] = value
    row_of, column_of, entry = (np.concatenate(one) for one in zip(*parts, strict=True))
    solved = SparseFactors(row_of, column_of, entry, np.arange(count), 1.0).solve(right.reshape(count, -1).T)
    return Spline(knots, np.ascontiguousarray(solved.T).reshape(right.shape), degree)
