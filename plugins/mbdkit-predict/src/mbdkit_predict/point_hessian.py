"""First and second derivatives of a transcription, assembled from those of its collocation points.

CasADi finds the nonzeros of a whole Hessian, and the colors of its columns, in a time that grows with the square of the
number of points. For a whole Jacobian, it evaluates as many directional derivatives as a point has variables.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class PointHessian:
    """The part of the Hessian that belongs to collocation points.

    Attributes
    ----------
    variables
        The variables of each of the K points, linear functions of the unknowns, as columns (V, K).
    blocks
        Function of the factor of the objective, and of multipliers by name of the condition, that returns the Hessians
        of all points side by side, (V, K V).
    conditions
        Names of the conditions of which it contains all second derivatives.
    rest
        The objective as an expression of the unknowns and, linearly, of integrals.
    sums
        Symbol of these integrals in it, (I, 1).
    integrals
        The integrals as an expression of the unknowns, (I, 1).
    """

    variables: ca.MX
    blocks: Callable[[ca.MX, Mapping[str, ca.MX]], ca.MX]
    conditions: tuple[str, ...]
    rest: ca.MX
    sums: ca.MX
    integrals: ca.MX

    def whole(self, conditions: Mapping[str, ca.MX], unknowns: ca.MX, sizes: np.ndarray) -> ca.Function:
        """Return the upper triangle of the Hessian of all conditions, for unknowns divided by their sizes."""
        x, factor = ca.MX.sym("x", *unknowns.shape), ca.MX.sym("factor")
        ends = np.cumsum([0, *(value.numel() for value in conditions.values())]).tolist()
        lam = ca.MX.sym("lam", ends[-1])
        parts = zip(conditions.items(), ca.vertsplit(lam, ends), strict=True)
        multipliers = {name: ca.reshape(part, *value.shape) for (name, value), part in parts}
        others = [ca.dot(multipliers[name], y) for name, y in conditions.items() if name not in self.conditions]
        other = sum(others, start=factor * self.rest)
        depends = ca.which_depends(other, ca.vertcat(unknowns, self.sums), 2, False)
        curved = np.flatnonzero(depends[: x.numel()]).tolist()
        chosen = ca.DM.eye(x.numel())[:, curved]
        few = ca.MX.sym("few", len(curved))
        changed = ca.substitute(other, unknowns, unknowns + ca.mtimes(chosen, few))
        mixed = ca.jacobian(ca.jacobian(changed, self.sums).T, few)
        given, values = [few, self.sums], [ca.MX.zeros(len(curved)), self.integrals]
        of_few, mixed = ca.substitute([ca.hessian(changed, few)[0], mixed], given, values)
        crossed = ca.mtimes([chosen, mixed.T, ca.jacobian(self.integrals, unknowns)])
        blocks = self.blocks(factor, multipliers)
        of_points = ca.MX(ca.diagcat(*ca.horzsplit(blocks.sparsity(), blocks.shape[0])), blocks.nz[:])
        places = ca.sparsify(ca.evalf(ca.jacobian(ca.vec(self.variables), unknowns)))
        of_others = ca.mtimes([chosen, of_few, chosen.T]) + crossed + crossed.T
        hessian = ca.triu(ca.mtimes([places.T, of_points, places]) + of_others)
        function = ca.Function("hessian", [unknowns, factor, lam], [hessian])
        scale = ca.diag(ca.DM(sizes))
        scaled = ca.mtimes([scale, function(ca.DM(sizes) * x, factor, lam), scale])
        arguments = [x, ca.MX.sym("p", 0), factor, lam]
        return ca.Function("hessian", arguments, [scaled], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])


@dataclass(frozen=True)
class PointJacobian:
    """The derivatives of all conditions.

    Attributes
    ----------
    variables
        As in `PointHessian`.
    results
        Symbol of the results (R, K) of a function of these variables at each of the K points.
    blocks
        The Jacobians of all points side by side, (R, K V).
    conditions
        The values of all conditions, one column, as an expression of the unknowns and of `results`.
    values
        The results, as an expression of the unknowns.
    """

    variables: ca.MX
    results: ca.MX
    blocks: ca.MX
    conditions: ca.MX
    values: ca.MX

    def whole(self, unknowns: ca.MX, sizes: np.ndarray) -> ca.Function:
        """Return the values of all conditions and their derivatives, for unknowns divided by their sizes."""
        sides = ca.horzsplit(self.blocks.sparsity(), self.variables.shape[0])
        of_points = ca.MX(ca.diagcat(*sides), self.blocks.nz[:])
        places = ca.sparsify(ca.evalf(ca.jacobian(ca.vec(self.variables), unknowns)))
        by_results = ca.jacobian(self.conditions, ca.vec(self.results))
        slopes = ca.jacobian(self.conditions, unknowns) + ca.mtimes([by_results, of_points, places])
        function = ca.Function("jacobian", [unknowns, self.results], [self.conditions, slopes])
        x, scale = ca.MX.sym("x", *unknowns.shape), ca.diag(ca.DM(sizes))
        at = ca.mtimes(scale, x)
        values, slopes = function(at, ca.Function("results", [unknowns], [self.values])(at))
        names = ["x", "p"], ["g", "jac_g_x"]
        return ca.Function("jacobian", [x, ca.MX.sym("p", 0)], [values, ca.mtimes(slopes, scale)], *names)
