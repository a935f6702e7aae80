"""Derivatives of a transcription, assembled from those of its collocation points.

CasADi finds the nonzeros of a whole Hessian, and the colors of its columns, in a time that grows with the square of the
number of points, and evaluates a Jacobian once for each color.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np


class PointValues:
    """Values of a function at K points, for which a program contains symbols.

    Parameters
    ----------
    variables
        The arguments of each point, linear functions of the unknowns, as columns (V, K).
    function, jacobian
        The function of V variables with R values, and its Jacobian (R, V).

    Attributes
    ----------
    symbols
        Symbols (R, K) of the values.
    """

    def __init__(self, variables: ca.MX, function: ca.Function, jacobian: ca.Function):
        self._variables, self._jacobian, count = variables, jacobian, variables.shape[1]
        self.symbols = ca.MX.sym("at_points", function.size1_out(0), count)
        self._values = function.map(count)(variables)

    def put_into(self, *expressions: ca.MX) -> list[ca.MX]:
        """Return expressions with the values in place of their symbols."""
        return list(ca.graph_substitute(expressions, [self.symbols], [self._values]))

    def jacobian(self, conditions: ca.MX, unknowns: ca.MX, sizes: np.ndarray) -> ca.Function:
        """Return the Jacobian of conditions, for unknowns divided by their sizes, as the optimizer takes it."""
        count = self.symbols.shape[1]
        blocks = self._jacobian.map(count)(self._variables)
        of_points = ca.MX(ca.diagcat(*[self._jacobian.sparsity_out(0)] * count), blocks.nz[:])
        places = ca.sparsify(ca.evalf(ca.jacobian(ca.vec(self._variables), unknowns)))
        by_values = ca.jacobian(conditions, ca.vec(self.symbols))
        whole = ca.jacobian(conditions, unknowns) + ca.mtimes([by_values, of_points, places])
        whole = ca.mtimes(whole, ca.diag(ca.DM(sizes)))
        function = ca.Function("slopes", [unknowns], self.put_into(conditions, whole))
        x = ca.MX.sym("x", *unknowns.shape)
        arguments = [x, ca.MX.sym("p", 0)]
        return ca.Function("jac_g", arguments, function(ca.DM(sizes) * x), ["x", "p"], ["g", "jac_g_x"])


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
        What else the objective contains.
    """

    variables: ca.MX
    blocks: Callable[[ca.MX, Mapping[str, ca.MX]], ca.MX]
    conditions: tuple[str, ...]
    rest: ca.MX

    def whole(self, conditions: Mapping[str, ca.MX], unknowns: ca.MX, sizes: np.ndarray) -> ca.Function:
        """Return the upper triangle of the Hessian of all conditions, for unknowns divided by their sizes."""
        x, factor = ca.MX.sym("x", *unknowns.shape), ca.MX.sym("factor")
        ends = np.cumsum([0, *(value.numel() for value in conditions.values())]).tolist()
        lam = ca.MX.sym("lam", ends[-1])
        parts = zip(conditions.items(), ca.vertsplit(lam, ends), strict=True)
        multipliers = {name: ca.reshape(part, *value.shape) for (name, value), part in parts}
        others = [ca.dot(multipliers[name], y) for name, y in conditions.items() if name not in self.conditions]
        other = sum(others, start=factor * self.rest)
        curved = np.flatnonzero(ca.which_depends(other, unknowns, 2, False)).tolist()
        chosen = ca.DM.eye(x.numel())[:, curved]
        few = ca.MX.sym("few", len(curved))
        changed = ca.substitute(other, unknowns, unknowns + ca.mtimes(chosen, few))
        of_few = ca.substitute(ca.hessian(changed, few)[0], few, ca.MX.zeros(len(curved)))
        blocks = self.blocks(factor, multipliers)
        of_points = ca.MX(ca.diagcat(*ca.horzsplit(blocks.sparsity(), blocks.shape[0])), blocks.nz[:])
        places = ca.sparsify(ca.evalf(ca.jacobian(ca.vec(self.variables), unknowns)))
        hessian = ca.triu(ca.mtimes([places.T, of_points, places]) + ca.mtimes([chosen, of_few, chosen.T]))
        function = ca.Function("hessian", [unknowns, factor, lam], [hessian])
        scale = ca.diag(ca.DM(sizes))
        scaled = ca.mtimes([scale, function(ca.DM(sizes) * x, factor, lam), scale])
        arguments = [x, ca.MX.sym("p", 0), factor, lam]
        return ca.Function("hessian", arguments, [scaled], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])
