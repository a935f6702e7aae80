"""The consistent state nearest to a given one in the mass metric, for callers in Python."""

from __future__ import annotations

from mbdkit.engine.kernels.accelerations import solve_system
from mbdkit.engine.kernels.bundle_types import RealVector
from mbdkit.engine.kernels.equations import _put, _take, load_equations
from mbdkit.engine.kernels.projection import (
    EPS,
    FEW_ROUNDINGS,
    MOST_ITERATIONS,
    STAGNANT,
    largest_size,
    position_rows,
    project_velocities,
)
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, OK, solved_rows
from mbdkit.engine.native.functions import inlined, kernel


@inlined
def _nearest_positions(eq, t, p, rest):
    """Write the positions nearest to ``eq.q`` that satisfy the constraints at `t` into `p`; return a status.

    This is the iteration of `mbdkit.engine.kernels.projection.project_positions`, which ends when the constraints hold.
    Here it ends when the positions no longer change, because callers may start far from the constraints; then they are
    the nearest ones too.
    """
    top, w = eq.top, eq.w
    for d in range(len(p)):
        p[d] = eq.q[d]
    unit, before = top.length[0], 1.0 / EPS
    for _ in range(MOST_ITERATIONS):
        position_rows(top, w, t, p)
        solved_rows(top, w, p, rest)
        for k in range(len(w.phi)):
            for r in range(2):
                w.gamma[k, r] = -w.phi[k, r]
        for b in range(len(top.mass) - 1):
            for i in range(3):
                w.force[3 * b + i] = top.mass[b, i] * (eq.q[3 * b + i] - p[3 * b + i])
        status = solve_system(top, w, eq.solver, True, eq.a, eq.lam, False)
        if status != OK:
            return status
        change = 0.0
        for d in range(len(p) - 3):
            p[d] += eq.a[d]
            change = max(change, abs(eq.a[d]) if d % 3 == 2 else abs(eq.a[d]) / unit)
        change /= largest_size(top, p)
        if change <= FEW_ROUNDINGS * EPS or (change > 0.5 * before and change < STAGNANT):
            return OK
        if not change < 1.0 / EPS:
            return DIVERGED
        before = change
    return DIVERGED


@kernel
def nearest_state(
    address: int, t: float, q: RealVector, v: RealVector, p: RealVector, rest: RealVector, positions: bool,
    velocities: bool, near_q: RealVector, near_v: RealVector,
) -> int:  # fmt: skip
    """Write the consistent state nearest to `q` and `v` (n,) into `near_q` and `near_v` (n,); return a status.

    Only `positions`, only `velocities`, which are those at the position `q`, or both are projected. `p` and `rest`
    (3 (B + 1),) are work arrays; `rest` is zero. `address` is that of `mbdkit.engine.kernels.equations.Equations`.
    """
    eq = load_equations(address)
    top = eq.top
    top.gravity[0] = top.gravity[1] = 0.0  # of a solution for the forces of the mechanism
    _put(eq.q, q)
    _put(eq.v, v)
    _put(p, q)
    status = OK
    if positions:
        status = _nearest_positions(eq, t, p, rest)
    if velocities and status == OK:
        status = project_velocities(top, eq.w, eq.solver, t, p, eq.v, eq.a, eq.lam)
    if status == OK:
        finite = _take(p, near_q)
        if not (_take(eq.v, near_v) and finite):
            status = NOT_FINITE
    return status
