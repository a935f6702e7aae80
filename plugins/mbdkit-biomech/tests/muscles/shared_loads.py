"""Problems of load sharing, and their solution by CasADi."""

from __future__ import annotations

import casadi
import numpy as np

from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme

FRAMES, EQUATIONS, MUSCLES = 12, 3, 9


def problems(reserves: float = 0.0) -> Programme:
    """Return random programmes that have solutions, with weights."""
    random = np.random.default_rng(4)
    arms = random.normal(0, 0.04, (FRAMES, EQUATIONS, MUSCLES)) * (random.random((EQUATIONS, MUSCLES)) < 0.5)
    for joint in range(EQUATIONS):
        arms[:, joint, joint], arms[:, joint, joint + EQUATIONS] = -0.04, 0.04
    matrix = arms * random.uniform(800, 5000, (FRAMES, 1, MUSCLES))
    right = (matrix @ random.uniform(0.01, 0.6, (FRAMES, MUSCLES, 1)))[..., 0]
    low, high = np.full((FRAMES, MUSCLES), 0.01), np.ones((FRAMES, MUSCLES))
    weight = random.uniform(0.5, 2.0, MUSCLES)
    if reserves:
        own = np.broadcast_to(reserves * np.eye(EQUATIONS), (FRAMES, EQUATIONS, EQUATIONS))
        free = np.full((FRAMES, EQUATIONS), np.inf)
        matrix, low, high = np.concatenate([matrix, own], axis=2), np.hstack([low, -free]), np.hstack([high, free])
        weight = np.append(weight, np.ones(EQUATIONS))
    return Programme(matrix, right, low, high, weight)


def by_casadi(programme: Programme, row: int, p: int, least: float | None = None) -> np.ndarray:
    """Return the solution of a frame by an active-set method (p = 2) or an interior-point method of CasADi."""
    count = programme.matrix.shape[2]
    x = casadi.SX.sym("x", count)
    share = x / programme.weight
    cost = casadi.sum1(share**p if p % 2 == 0 else casadi.fabs(share) ** p)
    equations = {"x": x, "f": cost, "g": programme.matrix[row] @ x / programme.size[row]}
    if p == 2:
        solver = casadi.qpsol("s", "qrqp", equations, {"print_iter": False, "print_header": False})
    else:
        options = {"print_level": 0, "sb": "yes", "tol": 1e-13, "constr_viol_tol": 1e-13, "acceptable_iter": 0}
        more = {"bound_relax_factor": 0.0, "dual_inf_tol": 1e-13, "compl_inf_tol": 1e-13}
        solver = casadi.nlpsol("s", "ipopt", equations, {"ipopt": options | more, "print_time": False})
    right = programme.right[row] / programme.size[row]
    low, high = programme.low[row], programme.high[row]
    start = np.where(np.isfinite(high), 0.3, 0.01)
    return np.array(solver(x0=start, lbx=low, ubx=high, lbg=right, ubg=right)["x"]).ravel()
