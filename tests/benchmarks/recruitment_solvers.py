"""``python -m tests.benchmarks.recruitment_solvers``: time and residual of solvers for the sharing of loads.

18 muscles share the moments of six joints in 151 frames, without reserves and with p = 2. Solvers that are not
installed are left out: ``pip install quadprog osqp clarabel daqp``.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable

import numpy as np

from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import share_loads

FRAMES, EQUATIONS, MUSCLES = 151, 6, 18
Solve = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def problems() -> Programme:
    """Return random problems that have solutions: activations of 0.01 to 0.6, moment arms of about 4 cm."""
    random = np.random.default_rng(1)
    arms = random.normal(0, 0.04, (FRAMES, EQUATIONS, MUSCLES)) * (random.random((EQUATIONS, MUSCLES)) < 0.4)
    for joint in range(EQUATIONS):  # each joint has a flexor and an extensor
        arms[:, joint, joint], arms[:, joint, joint + EQUATIONS] = -0.04, 0.04
    matrix = arms * random.uniform(800, 5000, (FRAMES, 1, MUSCLES))
    right = (matrix @ random.uniform(0.01, 0.6, (FRAMES, MUSCLES, 1)))[..., 0]
    bounds = np.full((FRAMES, MUSCLES), 0.01), np.ones((FRAMES, MUSCLES))
    return Programme(matrix, right, *bounds, np.ones(MUSCLES))


def _quadprog(a: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    import quadprog

    eye = np.eye(len(low))
    c, d = np.hstack([a.T, eye, -eye]), np.hstack([b, low, -high])
    return np.asarray(quadprog.solve_qp(2 * eye, np.zeros(len(low)), c, d, meq=len(b))[0])


def _osqp(a: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    import osqp
    from scipy import sparse

    solver, eye = osqp.OSQP(), sparse.eye(len(low))
    rows = sparse.vstack([sparse.csc_matrix(a), eye], format="csc")
    settings = {"verbose": False, "eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 20000}
    solver.setup(sparse.csc_matrix(2 * eye), np.zeros(len(low)), rows, np.r_[b, low], np.r_[b, high], **settings)
    return np.asarray(solver.solve().x)


def _clarabel(a: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    import clarabel
    from scipy import sparse

    eye, settings = sparse.eye(len(low)), clarabel.DefaultSettings()
    settings.verbose = False
    rows = sparse.vstack([sparse.csc_matrix(a), eye, -eye], format="csc")
    cones = [clarabel.ZeroConeT(len(b)), clarabel.NonnegativeConeT(2 * len(low))]
    right = np.r_[b, high, -low]
    return np.asarray(
        clarabel.DefaultSolver(sparse.csc_matrix(2 * eye), np.zeros(len(low)), rows, right, cones, settings).solve().x
    )


def _daqp(a: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    from ctypes import c_int

    import daqp

    sense = np.array([0] * len(low) + [5] * len(b), dtype=c_int)
    return np.asarray(
        daqp.solve(
            2 * np.eye(len(low)), np.zeros(len(low)), np.ascontiguousarray(a), np.r_[high, b], np.r_[low, b], sense
        )[0]
    )


def _slsqp(a: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    from scipy.optimize import minimize

    equations = {"type": "eq", "fun": lambda x: a @ x - b, "jac": lambda x: a}
    options = {"maxiter": 500, "ftol": 1e-14}
    bounds = list(zip(low, high, strict=True))
    start = np.full(len(low), 0.3)
    return np.asarray(
        minimize(lambda x: x @ x, start, jac=lambda x: 2 * x, bounds=bounds, constraints=equations, options=options).x
    )


SOLVERS: dict[str, tuple[str, Solve]] = {
    "quadprog": ("quadprog", _quadprog),
    "OSQP": ("osqp", _osqp),
    "Clarabel": ("clarabel", _clarabel),
    "daqp": ("daqp", _daqp),
    "SciPy SLSQP": ("scipy", _slsqp),
}


def main() -> None:
    """Print the table."""
    programme = problems()
    start = time.perf_counter()
    ours = share_loads(programme, 2.0)
    elapsed = time.perf_counter() - start
    start = time.perf_counter()
    share_loads(programme, 2.0)
    elapsed = min(elapsed, time.perf_counter() - start)
    print(f"{'solver':12s} {'ms/frame':>9s} {'residual [N m]':>15s} {'difference':>11s}")

    def row(name: str, seconds: float, x: np.ndarray) -> None:
        residual = np.max(np.abs((programme.matrix @ x[..., None])[..., 0] - programme.right))
        print(f"{name:12s} {1e3 * seconds / FRAMES:9.3f} {residual:15.1e} {np.max(np.abs(x - ours.value)):11.1e}")

    row("shared_loads", elapsed, ours.value)
    for name, (module, solve) in SOLVERS.items():
        if importlib.util.find_spec(module) is None:
            continue
        frames = zip(programme.matrix, programme.right, programme.low, programme.high, strict=True)
        start = time.perf_counter()
        found = np.array([solve(*frame) for frame in frames])
        row(name, time.perf_counter() - start, found)


if __name__ == "__main__":
    main()
