"""Derivatives with respect to the values in tables of force laws, whose numbers are the pieces of a cubic spline.

The numbers are linear in the values. Their derivatives, a full matrix, are computed only where they are read; products
with it, which the adjoint needs, follow from one system of equations with the transposed matrix of the spline.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbdkit.base.traced_numbers import recorded_functions
from mbdkit.integrators.duals.dual_run import Seeds


@dataclass(frozen=True, eq=False)
class TableValues:
    """Values of a table of n points that are parameters.

    Attributes
    ----------
    first
        Index of the first number that depends on them in ``Topology.law_parameters``.
    lengths
        (n,) lengths of the table.
    columns, places
        (N,) indices of the values among the parameters, and among the values of the table.
    """

    first: int
    lengths: np.ndarray
    columns: np.ndarray
    places: np.ndarray

    @property
    def rows(self) -> slice:
        """The numbers in ``Topology.law_parameters`` that depend on the values: five for each piece."""
        return slice(self.first, self.first + 5 * (len(self.lengths) - 1))

    def slopes(self, some: slice = slice(None)) -> np.ndarray:
        """Return the derivatives (5 (n - 1), N) of these numbers with respect to some of the values."""
        units = np.eye(len(self.lengths))[:, self.places[some]]
        return np.asarray(recorded_functions()["_cubic_pieces"](self.lengths, units))

    def contract(self, bars: np.ndarray) -> np.ndarray:
        """Return derivatives (N,) with respect to the values, given those with respect to the numbers (5 (n - 1),)."""
        if len(self.lengths) < 4:
            return np.asarray(bars @ self.slopes())
        from scipy.linalg import solve_banded

        h, x = np.diff(self.lengths), self.lengths
        *powers, stored = bars.reshape(-1, 5).T
        area = np.cumsum(stored[::-1])[::-1] - stored
        c0, c1, c2, c3 = (c + area * h**k / k for k, c in enumerate(powers, 1))
        # the coefficients of a piece are those of Hermite's polynomial, of its values and slopes at both ends
        by_slope = np.zeros(len(x))
        by_slope[:-1] += c1 - 2.0 * c2 / h + c3 / h**2
        by_slope[1:] += c3 / h**2 - c2 / h
        secant = 3.0 * c2 / h - 2.0 * c3 / h**2
        # the slopes solve a tridiagonal system, whose first and last equations are those of not-a-knot ends
        first, last = x[2] - x[0], x[-1] - x[-3]
        bands = np.zeros((3, len(x)))
        bands[0, 1:] = *h[1:], last
        bands[1] = h[1], *(2.0 * (h[:-1] + h[1:])), h[-2]
        bands[2, :-1] = first, *h[:-1]
        right = solve_banded((1, 1), bands, by_slope)
        secant[:-1] += 3.0 * h[1:] * right[1:-1]
        secant[1:] += 3.0 * h[:-1] * right[1:-1]
        secant[:2] += right[0] / first * np.array([(h[0] + 2.0 * first) * h[1], h[0] ** 2])
        secant[-2:] += right[-1] / last * np.array([h[-1] ** 2, (h[-1] + 2.0 * last) * h[-2]])
        by_value = np.append(c0 - secant / h, 0.0)
        by_value[1:] += secant / h
        return np.asarray(by_value[self.places])


class ArraysWithTables(Mapping[str, np.ndarray]):
    """Derivatives (..., K) of arrays by name; those of the numbers of laws contain values of tables.

    `arrays`: derivatives with respect to all other parameters. `size`: number of the numbers of laws.
    """

    def __init__(self, arrays: Mapping[str, np.ndarray], tables: Sequence[TableValues], size: int, count: int):
        self._arrays, self.tables, self._size, self._count = arrays, tables, size, count

    def __getitem__(self, name: str) -> np.ndarray:
        return self._of_laws if name == "law_parameters" else self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter({**self._arrays, "law_parameters": None})

    def __len__(self) -> int:
        return sum(1 for _ in self)

    @cached_property
    def _of_laws(self) -> np.ndarray:
        given = self._arrays.get("law_parameters")
        slopes = np.zeros((self._size, self._count)) if given is None else given.copy()
        for table in self.tables:
            slopes[table.rows, table.columns] = table.slopes()
        return slopes

    def touched_laws(self) -> np.ndarray:
        """Return (L,) whether the numbers of laws depend on parameters."""
        given = self._arrays.get("law_parameters")
        touched = np.zeros(self._size, dtype=bool) if given is None else np.any(given, axis=-1)
        for table in self.tables:
            touched[table.rows] = True
        return touched

    def contract(self, name: str, bars: np.ndarray) -> np.ndarray:
        """Return derivatives (K,) with respect to the parameters, given those with respect to an array."""
        given = self._arrays.get(name)
        slope = np.zeros(self._count) if given is None else np.tensordot(bars, given, bars.ndim)
        if name == "law_parameters":
            for table in self.tables:
                slope[table.columns] += table.contract(bars[table.rows])
        return slope


def touched_laws(seeds: Seeds) -> np.ndarray | None:
    """Return (L,) whether the numbers of laws depend on parameters; None if none does."""
    if isinstance(seeds.arrays, ArraysWithTables):
        return seeds.arrays.touched_laws()
    slopes = seeds.get("law_parameters")
    return None if slopes is None else np.any(slopes, axis=-1)


def contract(seeds: Seeds, name: str, bars: np.ndarray) -> np.ndarray:
    """Return derivatives (K,) with respect to the parameters, given those with respect to an array."""
    if isinstance(seeds.arrays, ArraysWithTables):
        return seeds.arrays.contract(name, bars)
    slopes = seeds.get(name)
    return np.zeros(seeds.count) if slopes is None else np.tensordot(bars, slopes, bars.ndim)
