"""Values of the archive arrays that have one row per recorded state.

To add an array, add its entry to `mbdkit.archive.layout` and its value to `COLUMNS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.joint_sums import JointSums
from mbdkit.engine.kernels.observe import Observed
from mbdkit.stepping.interface import Stretch


@dataclass(frozen=True)
class ObservedRows:
    """States and reactions of B bodies and J joints at T times.

    Parameters
    ----------
    time
        (T,) [s].
    position, velocity
        (T, B, 3) [m, rad] and [m/s, rad/s].
    force
        (T, J, 2) reaction forces [N].
    torque
        (T, J) reaction torques [N m].
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    torque: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[ObservedRows]) -> ObservedRows:
        """Return consecutive rows as one."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


class ConstraintRows:
    """Selects the constraint rows, in the order of the archive, from arrays indexed by pair."""

    def __init__(self, mechanism: CompiledMechanism):
        self._pair = np.array([row.pair for row in mechanism.rows], dtype=np.int64)
        self._place = np.array([row.place for row in mechanism.rows], dtype=np.int64)

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return the values of the rows (T, m) from those of the pairs (T, P, 2)."""
        return values[:, self._pair, self._place]


@dataclass
class RecordedStates:
    """T states to be recorded, and values computed from them.

    Parameters
    ----------
    stretch
        The states, with work and dissipated energy.
    observed
        Accelerations, residuals, reactions and energies of the states.
    elapsed
        (T,) wall time since the first step [s].
    start_energy
        Total energy at the start of the run [J]; (T,) for states of several runs.
    rows, joints
        Constraint rows and joints of the mechanism, in the order of the archive.
    """

    stretch: Stretch
    observed: Observed
    elapsed: np.ndarray
    start_energy: float | np.ndarray
    rows: ConstraintRows
    joints: JointSums

    def by_body(self, x: np.ndarray) -> np.ndarray:
        """Reshape coordinates (T, 3 (B + 1)) to (T, B, 3), without ground."""
        return x[:, :-3].reshape(len(x), -1, 3)

    @cached_property
    def misalignment(self) -> np.ndarray:
        """(T, J) misalignment [m]."""
        return self.joints.misalignment(self.observed.phi)

    @cached_property
    def reactions(self) -> np.ndarray:
        """(T, J, 3) reaction force (x, y) [N] and torque [N m] of each joint."""
        return self.joints.sum(self.observed.reactions)

    @property
    def essence(self) -> ObservedRows:
        """States and reactions, which the estimate of their errors compares with those of other runs."""
        q, v, reactions = self.stretch.q, self.stretch.v, self.reactions
        return ObservedRows(
            self.stretch.time, self.by_body(q), self.by_body(v), reactions[:, :, :2], reactions[:, :, 2]
        )

    @cached_property
    def multiplier(self) -> np.ndarray:
        """(T, m) index-1 multipliers."""
        return self.rows.of(self.observed.lam)

    @cached_property
    def total_energy(self) -> np.ndarray:
        """(T,) kinetic and potential energy [J]."""
        return np.asarray(self.observed.kinetic + self.observed.potential)

    @cached_property
    def balance(self) -> np.ndarray:
        """(T,) change of total energy since the start, plus dissipated energy, minus work [J]."""
        return np.asarray(self.total_energy + self.stretch.dissipated - self.stretch.work - self.start_energy)

    @property
    def method_multiplier(self) -> np.ndarray:
        """(T, m) multipliers computed by the method; index-1 multipliers at the start, where it has none."""
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
    "joints/reaction_force_first": lambda s: s.observed.joints[:, :, 2:4],
    "joints/reaction_force_second": lambda s: s.observed.joints[:, :, 4:6],
    "joints/angle": lambda s: s.observed.joints[:, :, 0],
    "joints/driver_power": lambda s: s.observed.joints[:, :, 1],
    "forces/length": lambda s: s.observed.forces[:, :, 0],
    "forces/rate": lambda s: s.observed.forces[:, :, 1],
    "forces/value": lambda s: s.observed.forces[:, :, 2],
    "forces/power": lambda s: s.observed.forces[:, :, 3],
    "forces/potential": lambda s: s.observed.forces[:, :, 4],
    "markers/position": lambda s: s.observed.markers[:, :, :2],
    "markers/velocity": lambda s: s.observed.markers[:, :, 2:],
    "beams/axial": lambda s: s.observed.beams[:, :, 0],
    "beams/shear": lambda s: s.observed.beams[:, :, 1],
    "beams/moment": lambda s: s.observed.beams[:, :, 2],
    "beams/strain_energy": lambda s: s.observed.beams[:, :, 3],
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
"""Functions for the values of arrays, by `mbdkit.archive.layout.Array.key`; called only for the recorded arrays."""
