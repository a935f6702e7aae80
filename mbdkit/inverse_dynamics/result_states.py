"""The states of a result of inverse dynamics, as runs record them: reactions, forces and energies."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_simpson

from mbdkit.base.errors import RunError
from mbdkit.engine.joint_sums import JointSums
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.observed_states import GivenForces, StateObserver
from mbdkit.inverse_dynamics.compute import Inverse
from mbdkit.runs.recorded_columns import ConstraintRows, RecordedStates
from mbdkit.stepping.interface import Stretch


def recorded_states(result: Inverse) -> RecordedStates:
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
    stretch = Stretch(motion.time, q, v, work, dissipated, np.zeros((count, 6)))
    start = float(observed.kinetic[0] + observed.potential[0])
    rows, joints = ConstraintRows(workspace.mechanism), JointSums(workspace.mechanism)
    return RecordedStates(stretch, observed, np.zeros(count), start, rows, joints)
