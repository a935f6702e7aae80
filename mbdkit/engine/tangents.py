"""The constraint Jacobian and the tangents as sparse arrays, whose patterns are determined once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.engine.iteration_matrix import StateTangents, classes_of
from mbdkit.engine.kernels.equations import GAMMA_V, JACOBIAN, RESIDUAL_Q

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from mbdkit.engine.workspace import Workspace


@dataclass(frozen=True)
class Tangents:
    """Derivatives of the equations of motion for implicit methods, as sparse arrays.

    Their patterns do not depend on the state; the index arrays are shared and read-only, the values are new. Where only
    one direction of a pair of rows is independent in a redundant mechanism, this direction counts as fixed.
    """

    stiffness: csr_array  #: (n, n) K = d(Phi_q^T lam - Q)/dq.
    damping: csr_array  #: (n, n) C = -dQ/dv.
    gamma_v: csr_array  #: (m, n) d gamma/dv = -2 d(Phi_q v + Phi_t)/dq, minus 2 alpha Phi_q with Baumgarte's terms.
    residual_q: csr_array  #: (m, n) d(Phi_q a - gamma)/dq.
    states: StateTangents | None = None  #: Derivatives that involve first-order states; None if no states were given.


class SparseParts:
    """Sparse arrays that are sums of terms of some classes: (n, n), or (m, n) for classes of constraint rows.

    `workspace`: the workspace that evaluates the terms. `classes`: class of the terms of each array.
    """

    def __init__(self, workspace: Workspace, classes: Iterable[int]):
        from scipy.sparse import csr_array

        n = 3 * len(workspace.mechanism.bodies)
        sources, places = [], []
        self._patterns: list[tuple[slice, csr_array]] = []
        self._count = 0
        for rows, source, place in _terms_of(workspace, classes):
            entries, which = np.unique(place, return_inverse=True)
            pattern = csr_array((np.zeros(len(entries)), (entries // n, entries % n)), shape=(rows, n))
            assert pattern.has_canonical_format
            pattern.indices.flags.writeable = pattern.indptr.flags.writeable = False
            sources.append(source)
            places.append(self._count + which)
            self._patterns.append((slice(self._count, self._count + len(entries)), pattern))
            self._count += len(entries)
        self._source, self._place = np.concatenate(sources), np.concatenate(places)

    def arrays(self, source: np.ndarray) -> list[csr_array]:
        """Return the arrays for the values `source` of all terms."""
        values = np.bincount(self._place, source[self._source], self._count)
        arrays = []
        for part, pattern in self._patterns:
            array = copy(pattern)  # shares its indices; a tenth of the time of a new array, which checks them
            array.data = values[part]
            arrays.append(array)
        return arrays


def dense_parts(workspace: Workspace, classes: Iterable[int], source: np.ndarray) -> list[np.ndarray]:
    """Return the arrays of `SparseParts` for the values `source` of all terms as dense ones, for small mechanisms."""
    n = 3 * len(workspace.mechanism.bodies)
    return [
        np.bincount(place, source[own], rows * n).reshape(rows, n) for rows, own, place in _terms_of(workspace, classes)
    ]


def _terms_of(workspace: Workspace, classes: Iterable[int]) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yield the number of rows of the array of each class, and sources and flat indices of its terms."""
    n, class_of, terms = 3 * len(workspace.mechanism.bodies), classes_of(workspace), workspace.terms
    for of_class in classes:
        first, rows = (n, workspace.unknowns - n) if of_class in (JACOBIAN, GAMMA_V, RESIDUAL_Q) else (0, n)
        own = terms.kept((class_of == of_class) & (terms.row >= first))
        yield rows, own.source, (own.row - first) * n + own.column
