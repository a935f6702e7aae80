"""States of a mechanism, and arrays computed from them that contain the values of quantities."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from mbdkit.base.frozen import dataclass, field
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.observed_states import JointSums, joint_sums

V = TypeVar("V")

NONE = np.zeros(0)


@dataclass(frozen=True)
class States:
    """T states of a mechanism.

    All arrays except `time` may have an additional last axis with the value, followed by its derivatives with respect
    to parameters.

    - `time`: (T,) times [s].
    - `q`, `v`: (T, 3 (B + 1)) positions and velocities, ground last.
    - `observe`: function that returns accelerations, residuals, reactions, forces and energies of the states. It is
      called at most once, when they are needed.
    - `work`, `dissipated`: (T,) work of loads and drivers, and dissipated energy, since the start [J]; empty if not
      known.
    - `start_energy`: total energy at the start of the run [J]; (T,) for states of several runs.
    - `handles`: what inverse dynamics knows of kinds of plugins, by group.
    - `elapsed`: (T,) wall time since the first step [s]; empty if not known.
    - `multipliers`: (T, m) multipliers computed by the method; None if the method has computed none, as at the start.
    - `z`: (T, Z) first-order states; empty if they are not known.
    - `is_for_events`: whether the values are those of expressions of events, whose signs should not change by rounding
      errors.
    """

    is_for_events: ClassVar[bool] = False

    mechanism: CompiledMechanism
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    observe: Callable[[], Observed]
    work: np.ndarray = field(default_factory=lambda: NONE)
    dissipated: np.ndarray = field(default_factory=lambda: NONE)
    start_energy: float | np.ndarray = 0.0
    handles: Mapping[str, Any] = field(default_factory=dict)
    elapsed: np.ndarray = field(default_factory=lambda: NONE)
    multipliers: np.ndarray | None = None
    z: np.ndarray = field(default_factory=lambda: NONE)

    @cached_property
    def observed(self) -> Observed:
        """Accelerations, residuals, reactions, forces and energies of the states."""
        return self.observe()

    def by_body(self, x: np.ndarray) -> np.ndarray:
        """Reshape coordinates (T, 3 (B + 1)) to (T, B, 3), without ground."""
        return x[:, :-3].reshape(len(x), x.shape[1] // 3 - 1, 3, *x.shape[2:])

    @property
    def coordinate(self) -> np.ndarray:
        """(T, J) angle or travel of each joint [rad or m]."""
        return self.observed.joints[:, :, 0]

    @property
    def sums(self) -> JointSums:
        """Sums over the pairs of constraint rows of each joint."""
        return joint_sums(self.mechanism)

    @cached_property
    def misalignment(self) -> np.ndarray:
        """(T, J) misalignment [m]."""
        return self.sums.misalignment(self.observed.phi)

    @cached_property
    def reactions(self) -> np.ndarray:
        """(T, J, 3) reaction force (x, y) [N] and torque [N m] of each joint."""
        x = self.observed.reactions
        summed = self.sums.sum(x.reshape(*x.shape[:2], math.prod(x.shape[2:])))
        return summed.reshape(*summed.shape[:2], *x.shape[2:])

    @property
    def forces(self) -> np.ndarray:
        """(T, F, 5) length, rate, value, power and potential of each force element and load."""
        return self.observed.forces[:, : len(self.mechanism.forces)]

    @property
    def friction(self) -> np.ndarray:
        """(T, J) friction torque [N m] or force [N] of each joint on its second body, along the joint's coordinate."""
        known = self.mechanism
        first = known.first_friction
        torques = np.zeros_like(self.coordinate)
        for column, joint in enumerate(known.friction, first):
            # The value of an angle is the torque on the second body. That of a length is a tension, which pulls the
            # second body back.
            sign = 1.0 if known.joint_units[joint] == "rad" else -1.0
            torques[:, joint] = sign * self.observed.forces[:, column, 2]
        return torques

    def of(self, compute: Callable[[States], V]) -> V:
        """Return what a function or class computes from these states; it is called once."""
        computed: dict[Callable[[States], Any], Any] = self.__dict__.setdefault("_computed", {})
        if compute not in computed:
            computed[compute] = compute(self)
        return cast(V, computed[compute])

    @cached_property
    def multiplier(self) -> np.ndarray:
        """(T, m) index-1 multipliers."""
        return self.sums.by_row(self.observed.lam)

    @cached_property
    def total_energy(self) -> np.ndarray:
        """(T,) kinetic and potential energy [J]."""
        return np.asarray(self.observed.kinetic + self.observed.potential)

    @cached_property
    def balance(self) -> np.ndarray:
        """(T,) change of total energy since the start, plus dissipated energy, minus work [J]."""
        return np.asarray(self.total_energy + self.dissipated - self.work - self.start_energy)
