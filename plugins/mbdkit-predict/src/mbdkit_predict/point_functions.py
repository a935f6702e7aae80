"""Functions of CasADi of one collocation point, and of the end of an interval with Gauss methods."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from mbdkit_predict.casadi_system import CasadiSystem
from mbdkit_predict.objective import Objective

#: Symbols that are not known at the start and the end of a motion, only at collocation points.
OF_STATE = ("a", "lam", "u")
OF_POINTS = ("q", "v", "a", "lam", "mu", "z", "u")  #: Unknowns with a column for each collocation point.


class PointFunctions:
    """Functions of a collocation point.

    Parameters
    ----------
    path
        Values of the conditions along the path.
    weight
        Weight of all bodies [N].

    Attributes
    ----------
    stage
        Joints and fibres, q', z', integrands, forces, and path.
    slopes
        Derivatives of these results by `OF_POINTS`, parameters, time, and length of the interval.
    integrands
        The integrands alone.
    curvature
        The Hessian of the part of the Lagrangian of a point, by the same variables.
    projection
        The end of an interval with Gauss methods: its values are zero in the projection. Its arguments are the state,
        parameters and the time there, how far the state is from that of the collocation, and the multipliers nu and
        kappa.
    weights
        Weights (2 n + Z, 1) of the states in the projection.
    """

    def __init__(self, system: CasadiSystem, objective: Objective, path: ca.SX, weight: float):
        m = len(system.constraint_names)
        mu = ca.SX.sym("mu", m)
        given = [*system.symbols.values(), mu]
        position, velocity, _ = system.constraints(*given[:-1])
        turn = ca.mtimes(ca.jacobian(position, system.q).T, mu) if m else 0.0
        results = [
            ca.vertcat(position, velocity, system.equilibrium(*given[:-1])), system.v + turn, system.rates(*given[:-1]),
            objective.integrands, system.residual(*given[:-1]) / weight, path,
        ]  # fmt: skip
        known = {**system.symbols, "mu": mu}
        variables = ca.vertcat(*(known[name] for name in OF_POINTS), system.p, system.t, ca.SX.sym("h"))
        self.curvature = _curvature_function(system, results, variables)
        self.slopes = ca.Function("slopes", given, [ca.cse(ca.jacobian(ca.vertcat(*results), variables))])
        self.integrands = ca.Function("integrands", given, [objective.integrands])
        self.stage = ca.Function("point", given, ca.cse(results))
        self.projection, self.weights = _projection_function(system)


def at_node(system: CasadiSystem, *expressions: ca.SX, further: tuple[ca.SX, ...] = ()) -> ca.Function:
    """Return expressions as a function of the state (2 n + Z,), the parameters, the time, and further symbols."""
    state = ca.vertcat(system.q, system.v, system.z)
    unknown = {name: ca.SX.zeros(*system.symbols[name].shape) for name in OF_STATE}
    plain = ca.substitute([*expressions], [system.symbols[name] for name in unknown], list(unknown.values()))
    return ca.Function("node", [state, system.p, system.t, *further], plain)


def _projection_function(system: CasadiSystem) -> tuple[ca.Function, np.ndarray]:
    m, n = len(system.constraint_names), len(system.q0)
    given = list(system.symbols.values())
    position, velocity, _ = system.constraints(*given)
    jacobian = ca.jacobian(position, system.q)
    is_held = np.array(ca.which_depends(position, system.q, 1)) if m else np.zeros(n, dtype=bool)
    start = [np.concatenate([system.q0, system.v0, system.z0]), system.p0, 0.0]
    mass = np.array(at_node(system, ca.diag(ca.jacobian(system.residual(*given), system.a)))(*start)).ravel()
    weight = np.concatenate([np.ones(n), np.where(is_held, mass, 1.0), np.ones(system.z.numel())])
    shift, jumps = ca.SX.sym("shift", len(weight)), ca.SX.sym("jumps", 2 * m)
    pushes = ca.mtimes(jacobian.T, ca.reshape(jumps, m, 2)) if m else ca.SX.zeros(n, 2)
    moved = ca.DM(weight) * shift - ca.vertcat(ca.vec(pushes), ca.SX.zeros(system.z.numel()))
    projection = at_node(system, moved, ca.vertcat(position, velocity), further=(shift, jumps))
    return projection, weight[:, None]


def _curvature_function(system: CasadiSystem, results: Sequence[ca.SX], variables: ca.SX) -> ca.Function:
    closed, position_rates, rates, integrands, balance, path = results
    slopes, motion = ca.vertcat(position_rates, system.a, rates), ca.vertcat(balance, closed)
    costates, of_motion, of_path, weights = (ca.SX.sym("lam", x.numel()) for x in (slopes, motion, path, integrands))
    lagrangian = (
        ca.dot(of_motion, motion)
        + ca.dot(of_path, path)
        + variables[-1] * (ca.dot(weights, integrands) - ca.dot(costates, slopes))
    )
    hessian, _ = ca.hessian(lagrangian, variables)
    return ca.Function("curvature", [variables, costates, of_motion, of_path, weights], [ca.cse(hessian)])
