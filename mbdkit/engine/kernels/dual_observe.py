"""Accelerations, reactions, forces and energies at states with derivatives; see `mbdkit.engine.kernels.observe`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.jit.bundle import bundle_loader
from mbdkit.engine.jit.decorators import kernel
from mbdkit.engine.jit.dual_arrays import new_duals
from mbdkit.engine.kernels.acting import force_values, joint_values, marker_values
from mbdkit.engine.kernels.applied_forces import potential_energy
from mbdkit.engine.kernels.bundle_types import example_of
from mbdkit.engine.kernels.cross_sections import beam_values
from mbdkit.engine.kernels.dual_system import DualSolver, new_dual_solver
from mbdkit.engine.kernels.observe import Observed, kinetic_energy, reactions_of, residuals_of
from mbdkit.engine.kernels.system import OK, Engine, Scratch, Topology, prepare, solve_accelerations


class DualStates(NamedTuple):
    """T states with derivatives, and what is computed from them. Arrays are dual unless stated otherwise."""

    top: Topology
    w: Scratch
    solver: DualSolver
    time: np.ndarray
    """(T,) times [s]; numbers."""
    q: np.ndarray
    """(T, 3 (B + 1)) positions and velocities, ground last."""
    v: np.ndarray
    observed: Observed
    """Values of the states; the distance to singularity is not computed."""


def _example() -> DualStates:
    engine = example_of(Engine)

    def dual(given: tuple[np.ndarray, ...]) -> list[np.ndarray]:
        return [new_duals(*x.shape) if x.dtype.kind == "f" else x for x in given]

    w = Scratch(*dual(engine.w))._replace(time=engine.w.time, sides=engine.w.sides)
    top = Topology(*dual(engine.top))
    six = np.zeros((0, 6), dtype=np.int64)  # `Observed.zeros` reads a column of the springs
    observed = Observed(*dual(Observed.zeros(0, engine.top._replace(springs=six))))
    solver = new_dual_solver(engine, engine.solver.row_index)
    return DualStates(top, w, solver, np.zeros(0), new_duals(0, 0), new_duals(0, 0), observed)


load_dual_states = bundle_loader(_example)


@kernel
def observe_duals(address):
    """Evaluate the states of a `DualStates`; return a status and the number of states evaluated."""
    c = load_dual_states(address)
    top, w, out = c.top, c.w, c.observed
    for r in range(len(c.time)):
        q, v, lam = c.q[r], c.v[r], out.lam[r]
        prepare(top, w, c.time[r], q)
        status = solve_accelerations(top, w, c.solver, q, v, out.acc[r], lam, True)
        if status != OK:
            return status, r
        force_values(top, w, q, v, out.forces[r])
        marker_values(top, w, q, v, out.markers[r])
        beam_values(top, w, out.beams[r])
        residuals_of(top, w, q, v, out.phi[r], out.phi_rate[r])
        reactions_of(top, w, lam, out.reactions[r])
        joint_values(top, w, q, lam, out.reactions[r], out.joints[r])
        out.kinetic[r] = kinetic_energy(top, v)
        out.potential[r], _ = potential_energy(top, w, q)
    return OK, len(c.time)
