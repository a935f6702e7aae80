"""Accelerations, reactions, forces and energies at states with derivatives; see `mbdkit.engine.kernels.observe`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.acting import joint_values
from mbdkit.engine.kernels.applied_forces import applied_forces
from mbdkit.engine.kernels.bundle_types import example_of
from mbdkit.engine.kernels.dual_system import DualSolver, new_dual_solver
from mbdkit.engine.kernels.engine_bundles import Engine, Scratch, Topology
from mbdkit.engine.kernels.observe import Observed, describe
from mbdkit.engine.kernels.system import OK, constraint_rows, evaluate_powers, prepare
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import kernel
from mbdkit.engine.native.number_arrays import new_duals


class DualStates(NamedTuple):
    """T states with derivatives, and the quantities computed from them. Arrays are dual unless stated otherwise."""

    top: Topology
    w: Scratch
    solver: DualSolver
    time: np.ndarray  #: (T,) times [s]; numbers.
    q: np.ndarray  #: (T, 3 (B + 1)) positions and velocities, ground last.
    v: np.ndarray
    observed: Observed  #: Values of the states; the distance to singularity is not computed.
    power: np.ndarray  #: (T, 2) power of loads, drivers and active laws, and the dissipated power [W].
    lack: np.ndarray  #: (T, 3 (B + 1)) residual forces ``M a + Phi_q^T lam - Q`` of states with given accelerations.


def _example() -> DualStates:
    engine = example_of(Engine)

    def dual(given: Any) -> Any:
        if isinstance(given, tuple):
            return type(given)(*map(dual, given))
        return new_duals(*given.shape) if given.dtype.kind == "f" else given

    w = dual(engine.w)._replace(time=engine.w.time, sides=engine.w.sides)
    top = dual(engine.top)
    six = np.zeros((0, 6), dtype=np.int64)  # `Observed.zeros` reads a column of the springs
    observed = dual(Observed.zeros(0, engine.top._replace(springs=six)))
    solver = new_dual_solver(engine, engine.solver.row_index)
    q, v, power, lack = new_duals(0, 0), new_duals(0, 0), new_duals(0, 2), new_duals(0, 0)
    return DualStates(top, w, solver, np.zeros(0), q, v, observed, power, lack)


load_dual_states = bundle_loader(_example)


@kernel
def observe_duals(address: int) -> tuple[int, int]:
    """Evaluate the states of a `DualStates`; return a status and the number of states evaluated."""
    c = load_dual_states(address)
    top, w, out = c.top, c.w, c.observed
    for r in range(len(c.time)):
        q, v, lam = c.q[r], c.v[r], out.lam[r]
        prepare(top, w, c.time[r], q)
        status = solve_accelerations(top, w, c.solver, q, v, out.acc[r], lam, True)
        if status != OK:
            return status, r
        c.power[r, 0], c.power[r, 1] = evaluate_powers(top, w, q, v, lam)
        describe(top, w, q, v, out, r)
        joint_values(top, w, q, lam, out.reactions[r], out.joints[r])
    return OK, len(c.time)


@kernel
def describe_duals(address: int) -> None:
    """Evaluate the states of a `DualStates` whose accelerations and multipliers (of all rows) are given.

    This is needed if they do not follow from the mechanism alone. With actuators, for example, the residual forces are
    the forces of the actuators.
    """
    c = load_dual_states(address)
    top, w, out, lack = c.top, c.w, c.observed, c.lack
    for r in range(len(c.time)):
        q, v, acc, lam = c.q[r], c.v[r], out.acc[r], out.lam[r]
        prepare(top, w, c.time[r], q)
        constraint_rows(top, w, q, v)
        applied_forces(top, w, q, v)
        for b in range(len(top.mass) - 1):
            for i in range(3):
                # what the mass needs, minus what acts; reactions are added below
                pull = acc[3 * b + i] - top.gravity[i] if i < 2 else acc[3 * b + i]
                lack[r, 3 * b + i] = top.mass[b, i] * pull - w.force[3 * b + i]
        for k in range(len(top.pairs)):
            for side in range(2):
                first = 3 * top.pairs[k, PAIR.first + side]
                for i in range(3):
                    for row in range(2):
                        lack[r, first + i] += w.jac[k, 6 * row + 3 * side + i] * lam[k, row]
        c.power[r, 0], c.power[r, 1] = evaluate_powers(top, w, q, v, lam)
        describe(top, w, q, v, out, r)
        joint_values(top, w, q, lam, out.reactions[r], out.joints[r])
