"""The Hessian of the Lagrangian of a transcription, assembled from those of its collocation points.

CasADi finds the nonzeros of a whole Hessian, and the colors of its columns, in a time that grows with the square of the
number of points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import coo_matrix

Terms = Sequence[tuple[np.ndarray, np.ndarray]]
"""Indices (K,) of unknowns and their factors (K,), of which a variable of the K points is the sum."""


@dataclass(frozen=True)
class PointHessian:
    """The part of the Hessian that belongs to collocation points.

    Attributes
    ----------
    matrix
        Function of the factor of the objective, and of multipliers by name of the condition, that returns the upper
        triangle.
    conditions
        Names of the conditions of which it contains all second derivatives.
    rest
        What else the objective contains.
    """

    matrix: Callable[[ca.MX, Mapping[str, ca.MX]], ca.MX]
    conditions: tuple[str, ...]
    rest: Any

    def whole(self, conditions: Mapping[str, ca.MX], unknowns: ca.MX, sizes: np.ndarray) -> ca.Function:
        """Return the upper triangle of the Hessian of all conditions, for unknowns divided by their sizes."""
        x, factor = ca.MX.sym("x", *unknowns.shape), ca.MX.sym("factor")
        ends = np.cumsum([0, *(value.numel() for value in conditions.values())]).tolist()
        lam = ca.MX.sym("lam", ends[-1])
        multipliers = {
            name: ca.reshape(lam[begin:end], *value.shape)
            for (name, value), begin, end in zip(conditions.items(), ends, ends[1:], strict=False)
        }
        others = [ca.dot(multipliers[name], y) for name, y in conditions.items() if name not in self.conditions]
        other = sum(others, start=factor * self.rest)
        curved = np.flatnonzero(ca.which_depends(other, unknowns, 2, False)).tolist()
        chosen = ca.DM.eye(x.numel())[:, curved]
        few = ca.MX.sym("few", len(curved))
        changed = ca.substitute(other, unknowns, unknowns + ca.mtimes(chosen, few))
        of_few = ca.substitute(ca.hessian(changed, few)[0], few, ca.MX.zeros(len(curved)))
        hessian = self.matrix(factor, multipliers) + ca.triu(ca.mtimes([chosen, of_few, chosen.T]))
        parts = ca.Function("parts", [unknowns, factor, lam], [hessian])
        scale = ca.diag(ca.DM(sizes))
        scaled = ca.mtimes([scale, parts(ca.DM(sizes) * x, factor, lam), scale])
        arguments = [x, ca.MX.sym("p", 0), factor, lam]
        return ca.Function("hessian", arguments, [scaled], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])


def assembled(blocks: ca.MX, pattern: ca.Sparsity, places: Sequence[Terms], count: int) -> ca.MX:
    """Return the upper triangle of the sum of symmetric matrices of all points.

    Parameters
    ----------
    blocks, pattern
        The matrices of all points side by side, and the sparsity of each.
    places
        Where the variables of a point are among the unknowns.
    count
        Number of unknowns.
    """
    rows, columns, factors, sources = [], [], [], []
    for entry, (i, j) in enumerate(zip(*pattern.get_triplet(), strict=True)):
        for (row, first), (column, second) in product(places[i], places[j]):
            chosen = np.flatnonzero((first * second != 0.0) & (row <= column))
            rows.append(row[chosen])
            columns.append(column[chosen])
            factors.append((first * second)[chosen])
            sources.append(chosen * pattern.nnz() + entry)
    column_major, targets = np.unique(np.concatenate(columns) * count + np.concatenate(rows), return_inverse=True)
    shape = len(column_major), blocks.nnz()
    sums = coo_matrix((np.concatenate(factors), (targets, np.concatenate(sources))), shape=shape).tocsc()
    second, first = np.divmod(column_major, count)
    whole = ca.Sparsity.triplet(count, count, first.tolist(), second.tolist())
    return ca.MX(whole, ca.mtimes(ca.DM(sums), blocks.nz[:]))
