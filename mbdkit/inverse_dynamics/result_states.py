"""The states of a result of inverse dynamics, as runs record them: reactions, forces and energies."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_simpson

from mbdkit.base.errors import RunError
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.observed_states import GivenForces, StateObserver
from mbdkit.inverse_dynamics.compute import Inverse
from mbdkit.quantities.states import States


def recorded_states(result: Inverse) -> States:
    """Return the states of the motion with accelerations, reactions, forces and energies."""
    motion, dynamics = result.motion, result.dynamics
    workspace, manifold = result.problem.prepared.workspace, result.problem.fitter.manifold
    count = len(motion.time)
    found = manifold.reactions(motion.time, motion.q, motion.v, dynamics.lam)
    q, v, a = (np.column_stack([x, np.zeros((count, 3))]) for x in (motion.q, motion.v, motion.a))
    observer = StateObserver(workspace)
    observed: Observed = observer.arrays(count)
    singular = observer.observe(motion.time, q, v, observed, GivenForces(a, found.lam, found.reactions))
    if singular is not None:
        where = workspace.mechanism.unknown_name(singular.unknown)
        raise RunError(f"no unique solution near {where} at t = {motion.time[singular.row]:.6g} s")
    supplied = found.powers[:, 0] + dynamics.power.sum(axis=1) + result.loads.power.sum(axis=1)
    work, dissipated = (cumulative_simpson(x, x=motion.time, initial=0) for x in (supplied, found.powers[:, 1]))
    start = float(observed.kinetic[0] + observed.potential[0])
    return States(
        workspace.mechanism,
        motion.time,
        q,
        v,
        lambda: observed,
        work=work,
        dissipated=dissipated,
        start_energy=start,
        actuators=np.stack([dynamics.value, dynamics.power], axis=-1),
        elapsed=np.zeros(count),
    )
