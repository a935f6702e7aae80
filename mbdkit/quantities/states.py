"""States of a mechanism, and arrays computed from them that contain the values of quantities."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mbdkit.base import elementary, higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.contact_forces import contact_values
from mbdkit.engine.ground_reactions import ground_reactions
from mbdkit.engine.joint_sums import JointSums, joint_sums
from mbdkit.engine.kernels.observe import Observed
from mbdkit_biomech.muscles.acting_muscles import ActingMuscle
from mbdkit_biomech.muscles.energetics import fiber_power, metabolic_power
from mbdkit_biomech.muscles.muscle import Muscle

NONE = np.zeros(0)


ENERGETICS = ("fiber_power", "metabolic_power")
"""Quantities of muscles that are functions of other quantities."""


def _by_muscle(muscles: Sequence[Muscle], *arrays: np.ndarray) -> Iterator[tuple[Muscle, tuple[np.ndarray, ...]]]:
    """Yield each muscle with its columns (T,) of arrays (T, M)."""
    for index, muscle in enumerate(muscles):
        yield muscle, tuple(x[:, index] for x in arrays)


@dataclass(frozen=True)
class Muscles:
    """Muscles in T states of inverse dynamics; all arrays are (T, M).

    Attributes
    ----------
    length, rate
        Lengths of the paths [m] and their rates [m/s].
    fiber_length, fiber_rate
        Lengths of the fibres [m] and their rates [m/s].
    activation, force, power
        Activations, tensions [N], and powers that the muscles supply to the bodies [W].
    muscles
        The muscles.
    """

    length: np.ndarray
    rate: np.ndarray
    fiber_length: np.ndarray
    fiber_rate: np.ndarray
    activation: np.ndarray
    force: np.ndarray
    power: np.ndarray
    muscles: tuple[Muscle, ...]


@dataclass(frozen=True)
class States:
    """T states of a mechanism.

    All arrays except `time` may have an additional last axis with the value, followed by its derivatives with respect
    to parameters.

    Parameters
    ----------
    mechanism
        The mechanism.
    time
        (T,) times [s].
    q, v
        (T, 3 (B + 1)) positions and velocities, ground last.
    observe
        Function that returns accelerations, residuals, reactions, forces and energies of the states. It is called at
        most once, when they are needed.
    work, dissipated
        (T,) work of loads and drivers, and dissipated energy, since the start [J]; empty if not known.
    start_energy
        Total energy at the start of the run [J]; (T,) for states of several runs.
    actuators
        (T, A, 2) value and power of each actuator of inverse dynamics.
    muscles
        Muscles of inverse dynamics; None if there are none.
    elapsed
        (T,) wall time since the first step [s]; empty if not known.
    multipliers
        (T, m) multipliers computed by the method; None if the method has computed none, as at the start.
    z
        (T, Z) first-order states; empty if they are not known.
    """

    mechanism: CompiledMechanism
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    observe: Callable[[], Observed]
    work: np.ndarray = field(default_factory=lambda: NONE)
    dissipated: np.ndarray = field(default_factory=lambda: NONE)
    start_energy: float | np.ndarray = 0.0
    actuators: np.ndarray = field(default_factory=lambda: NONE)
    muscles: Muscles | None = None
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
        found = np.zeros_like(self.coordinate)
        for place, joint in enumerate(known.friction, first):
            # The value of an angle is the torque on the second body. That of a length is a tension, which pulls the
            # second body back.
            sign = 1.0 if known.joint_units[joint] == "rad" else -1.0
            found[:, joint] = sign * self.observed.forces[:, place, 2]
        return found

    @cached_property
    def _contacts(self) -> dict[str, np.ndarray]:
        """Quantities (T, C) of the contacts by name."""
        return contact_values(self.mechanism.contacts, self.q, self.v, self.z)

    @cached_property
    def _ground_reactions(self) -> dict[str, np.ndarray]:
        """Quantities of the bodies that may touch the ground by name."""
        return ground_reactions(self.mechanism.contacts, self._contacts)

    def of_contacts(self, name: str, *, of_ground: bool = False) -> np.ndarray:
        """Return a quantity (T, C) of the contacts, or (T, F) or (T, F, 2) of the bodies that may touch the ground.

        Empty if there are no contacts. The values do not contain derivatives, and the table of quantities refuses them.
        """
        if not self.mechanism.contacts:
            return NONE
        return (self._ground_reactions if of_ground else self._contacts)[name]

    def of_muscles(self, name: str) -> np.ndarray:
        """Return an array (T, M) of `Muscles`, or the excitations of a run; empty if there are no muscles.

        Raises
        ------
        SpecError
            If the states have derivatives, but the derivatives of this array are not known.
        """
        if name in ENERGETICS and (self.muscles is not None or self.mechanism.muscles):
            return self._energetics(name)
        if self.muscles is not None:
            return np.asarray(getattr(self.muscles, name))
        acting = self.mechanism.muscles
        if not acting:
            return NONE
        column = {"length": 0, "rate": 1, "force": 2, "power": 3}.get(name)
        if column is not None:
            first = len(self.mechanism.forces)
            return np.asarray(self.observed.forces[:, first : first + len(acting), column])
        return np.stack([self._of_acting_muscle(k, one, name) for k, one in enumerate(acting)], axis=1)

    def _energetics(self, name: str) -> np.ndarray:
        """Return the power of the fibres, or the power that muscles consume, (T, M).

        In inverse dynamics, the excitation is assumed to equal the activation.
        """
        own = self.muscles
        if self.q.ndim > 2:
            raise SpecError(f"derivatives of {name} of muscles with respect to parameters are not known")
        muscles = tuple(one.force.muscle for one in self.mechanism.muscles) if own is None else own.muscles
        length, rate = self.of_muscles("fiber_length"), self.of_muscles("fiber_rate")
        if name == "fiber_power":
            columns = [fiber_power(one, *x) for one, x in _by_muscle(muscles, self.of_muscles("force"), length, rate)]
        else:
            activation = self.of_muscles("activation")
            excitation = self.of_muscles("excitation") if own is None else activation
            every = _by_muscle(muscles, activation, excitation, length, rate)
            columns = [metabolic_power(one, *x) for one, x in every]
        return np.stack(columns, axis=1)

    def _of_acting_muscle(self, number: int, one: ActingMuscle, name: str) -> np.ndarray:
        """Return the activation, the excitation, or the length or rate of the fibres of a muscle of a run (T,)."""
        muscle = one.force.muscle
        if name == "activation":
            return self.z[:, one.activation]
        if muscle.tendon == "elastic" and name != "excitation":
            place = one.activation + 1
            return self.z[:, place] if name == "fiber_length" else self.observed.state_rates[:, place]
        if self.q.ndim > 2:
            raise SpecError(f"muscles.{one.force.name}.{name} has no known derivatives with respect to parameters")
        if name == "excitation":
            if one.excitation is None:
                return one.force.excitation_at(self.time)
            return np.asarray(higher_layers.state_values(*one.excitation, self))
        along = self.of_muscles("length")[:, number] - muscle.tendon_length
        fiber = elementary.hypot(along, muscle.thickness)
        return np.asarray(fiber if name == "fiber_length" else self.of_muscles("rate")[:, number] * along / fiber)

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
