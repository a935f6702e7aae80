"""The values of every archive array that has a row for each recorded state.

To add an array, add its entry to `mbdkit.archive.layout` and its value to `COLUMNS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.joint_sums import JointSums
from mbdkit.engine.kernels.observe import Observed
from mbdkit.stepping.interface import Stretch


class ConstraintRows:
    """Picks the constraint rows of the archive, in its order, out of arrays of pairs."""

    def __init__(self, mechanism: CompiledMechanism):
        self._pair = np.array([row.pair for row in mechanism.rows], dtype=np.int64)
        self._place = np.array([row.place for row in mechanism.rows], dtype=np.int64)

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return the values (T, m) of rows, from those of pairs (T, P, 2)."""
        return values[:, self._pair, self._place]


@dataclass
class RecordedStates:
    """T states to be recorded, and the values that follow from them.

    Parameters
    ----------
    stretch
        The states, with work and dissipated energy.
    observed
        Accelerations, residuals, reactions and energies of the states.
    elapsed
        (T,) wall time since the first step [s].
    start_energy
        Total energy of the start of the run [J].
    rows, joints
        Order of the constraint rows, and joints, of the mechanism.
    """

    stretch: Stretch
    observed: Observed
    elapsed: np.ndarray
    start_energy: float
    rows: ConstraintRows
    joints: JointSums

    def by_body(self, x: np.ndarray) -> np.ndarray:
        """Return a vector (T, 3 (B + 1)) as (T, B, 3), without ground."""
        return x[:, :-3].reshape(len(x), -1, 3)

    @cached_property
    def misalignment(self) -> np.ndarray:
        """(T, J) misalignment [m]."""
        return self.joints.misalignment(self.observed.phi)

    @cached_property
    def reactions(self) -> np.ndarray:
        """(T, J, 3) force (x, y) [N] and torque [N m] of each joint."""
        return self.joints.sum(self.observed.reactions)

    @cached_property
    def multiplier(self) -> np.ndarray:
        """(T, m) index-1 multipliers."""
        return self.rows.of(self.observed.lam)

    @cached_property
    def total_energy(self) -> np.ndarray:
        """(T,) kinetic and potential energy [J]."""
        return np.asarray(self.observed.kinetic + self.observed.potential)

    @property
    def balance(self) -> np.ndarray:
        """(T,) change of energy that dissipation and work do not account for [J]."""
        return np.asarray(self.total_energy + self.stretch.dissipated - self.stretch.work - self.start_energy)

    @property
    def method_multiplier(self) -> np.ndarray:
        """(T, m) multipliers that the method carries; those of index 1 at the start, before it has any."""
        return self.multiplier if self.stretch.multipliers is None else self.stretch.multipliers


COLUMNS: Mapping[str, Callable[[RecordedStates], np.ndarray]] = {
    "time": lambda s: s.stretch.time,
    "trajectory/position": lambda s: s.by_body(s.stretch.q),
    "trajectory/velocity": lambda s: s.by_body(s.stretch.v),
    "trajectory/acceleration": lambda s: s.by_body(s.observed.acc),
    "trajectory/elapsed_s": lambda s: s.elapsed,
    "joints/misalignment": lambda s: s.misalignment,
    "joints/velocity_misalignment": lambda s: s.joints.misalignment(s.observed.phi_rate),
    "joints/angle_misalignment": lambda s: s.joints.angle_misalignment(s.observed.phi),
    "joints/reaction_force": lambda s: s.reactions[:, :, :2],
    "joints/reaction_torque": lambda s: s.reactions[:, :, 2],
    "constraints/position_residual": lambda s: s.rows.of(s.observed.phi),
    "constraints/velocity_residual": lambda s: s.rows.of(s.observed.phi_rate),
    "constraints/multiplier": lambda s: s.multiplier,
    "constraints/method_multiplier": lambda s: s.method_multiplier,
    "constraints/singularity_distance": lambda s: s.observed.singularity_distance,
    "energy/kinetic": lambda s: s.observed.kinetic,
    "energy/potential": lambda s: s.observed.potential,
    "energy/total": lambda s: s.total_energy,
    "energy/dissipated": lambda s: s.stretch.dissipated,
    "energy/work": lambda s: s.stretch.work,
    "energy/balance": lambda s: s.balance,
}
"""Values by the key of the array (`mbdkit.archive.layout.Array.key`); only those that a run records are computed."""
