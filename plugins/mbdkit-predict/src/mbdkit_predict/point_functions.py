"""Functions of CasADi of one collocation point, and of the end of an interval with Gauss methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdkit_predict.casadi_system import CasadiSystem
from mbdkit_predict.objective import Objective

#: Symbols that are not known at the start and the end of a motion, only at collocation points.
OF_STATE = ("a", "lam", "u")
OF_POINTS = ("q", "v", "a", "lam", "mu", "z", "u")  #: Unknowns with a column for each collocation point.
ARGUMENTS = "q", "v", "a", "lam", "z", "u"  #: First arguments of `PointFunctions.stage`.


class Held(NamedTuple):
    """Operations whose values are given: their indices among the instructions of a function."""

    function: ca.Function
    operations: tuple[int, ...]


class PointFunctions:
    """Functions of a collocation point.

    Parameters
    ----------
    path
        Values of the conditions along the path.
    weight
        Weight of all bodies [N].
    held
        Operations whose values are given; none by default.

    Attributes
    ----------
    stage
        Joints and fibres, q', z', integrands, forces, and path. Its last argument has the values that are given.
    unheld
        The same results without this argument, with all operations as they are.
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

    def __init__(
        self, system: CasadiSystem, objective: Objective, path: ca.SX, weight: float, held: Held | None = None
    ):
        m = len(system.constraint_names)
        mu = ca.SX.sym("mu", m)
        given = [*system.symbols.values(), mu]
        position, velocity, _ = system.constraints(*given[:-1])
        turn = ca.mtimes(ca.jacobian(position, system.q).T, mu) if m else 0.0
        results = [
            ca.vertcat(position, velocity, system.equilibrium(*given[:-1])), system.v + turn, system.rates(*given[:-1]),
            objective.integrands, system.residual(*given[:-1]) / weight, path,
        ]  # fmt: skip
        sides = ca.SX.sym("sides", 0 if held is None else len(held.operations))
        self.unheld = ca.Function("point", given, ca.cse(results)) if held is None else held.function
        if held is not None:
            replaced = dict(zip(held.operations, ca.vertsplit(sides), strict=True))
            results = operations_of(held.function, given, replaced).results
        known = {**system.symbols, "mu": mu}
        given.append(sides)
        variables = ca.vertcat(*(known[name] for name in OF_POINTS), system.p, system.t, ca.SX.sym("h"))
        self.curvature = _curvature_function(system, results, variables, sides)
        self.slopes = ca.Function("slopes", given, [ca.cse(ca.jacobian(ca.vertcat(*results), variables))])
        self.integrands = ca.Function("integrands", given, [results[3]])
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
    return at_node(system, moved, ca.vertcat(position, velocity), further=(shift, jumps)), weight[:, None]


def _curvature_function(system: CasadiSystem, results: Sequence[ca.SX], variables: ca.SX, sides: ca.SX) -> ca.Function:
    closed, position_rates, rates, integrands, balance, path = results
    slopes, motion = ca.vertcat(position_rates, system.a, rates), ca.vertcat(balance, closed)
    costates, of_motion, of_path, weights = (ca.SX.sym("lam", x.numel()) for x in (slopes, motion, path, integrands))
    lagrangian = (
        ca.dot(of_motion, motion)
        + ca.dot(of_path, path)
        + variables[-1] * (ca.dot(weights, integrands) - ca.dot(costates, slopes))
    )
    hessian, _ = ca.hessian(lagrangian, variables)
    return ca.Function("curvature", [variables, costates, of_motion, of_path, weights, sides], [ca.cse(hessian)])


class Operations(NamedTuple):
    """The instructions of a function, in their order."""

    nodes: list[ca.SX]  #: Value of each instruction; 0 of those that have none.
    parents: list[list[int]]  #: Instructions whose values each of them uses.
    results: list[ca.SX]


def operations_of(function: ca.Function, given: Sequence[ca.SX], replaced: Mapping[int, ca.SX]) -> Operations:
    """Return the operations of a function of scalars, some of which are replaced."""
    work, nodes, parents = dict[int, int](), list[ca.SX](), list[list[int]]()
    results = [ca.SX(function.sparsity_out(k), 0.0) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation, takes, gives = (getattr(function, f"instruction_{x}")(k) for x in ("id", "input", "output"))
        own = list[int]()
        if operation == ca.OP_INPUT:
            node = given[takes[0]].nz[takes[1]]
        elif operation == ca.OP_CONST:
            node = ca.SX(function.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            results[gives[0]].nz[gives[1]], node = nodes[work[takes[0]]], ca.SX(0.0)
        else:
            own = [work[place] for place in takes]
            operate = ca.SX.unary if len(own) == 1 else ca.SX.binary
            node = operate(operation, *(nodes[place] for place in own))
        nodes.append(replaced.get(k, node))
        parents.append(own)
        if operation != ca.OP_OUTPUT:
            work[gives[0]] = k
    return Operations(nodes, parents, results)
