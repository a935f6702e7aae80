"""Quantities of muscles in states of runs and of inverse dynamics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from mbdkit.base import elementary, higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.quantities.states import NONE, States
from mbdkit_biomech.muscles.acting_muscles import ActingMuscle
from mbdkit_biomech.muscles.energetics import fiber_power, metabolic_power
from mbdkit_biomech.muscles.muscle import Muscle

#: Quantities of muscles that are functions of other quantities.
ENERGETICS: Mapping[str, Callable[..., np.ndarray]] = {"fiber_power": fiber_power, "metabolic_power": metabolic_power}


def _of_each(function: Callable[..., np.ndarray], *arrays: np.ndarray) -> np.ndarray:
    """Return a function of arrays (T,); for arrays of objects, such as symbols, that of each of their elements."""
    if all(x.dtype != object for x in arrays):
        return function(*arrays)
    return np.array([np.asarray(function(*row)).item() for row in zip(*arrays, strict=True)], dtype=object)


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


class MuscleValues:
    """Values of the quantities of muscles in T states.

    Parameters
    ----------
    states
        The states; those of inverse dynamics have `Muscles` in their `handles`.
    """

    def __init__(self, states: States):
        self.states = states
        self.given: Muscles | None = states.handles.get("muscles")
        self.acting: tuple[ActingMuscle, ...] = states.mechanism.extensions.get("muscles", ())

    def array(self, name: str) -> np.ndarray:
        """Return an array (T, M) of `Muscles`, or the excitations of a run; empty if there are no muscles.

        Raises
        ------
        SpecError
            If the states have derivatives, but the derivatives of this array are not known.
        """
        if name in ENERGETICS and (self.given is not None or self.acting):
            return self._energetics(name)
        if self.given is not None:
            return np.asarray(getattr(self.given, name))
        if not (acting := self.acting):
            return NONE
        if (column := {"length": 0, "rate": 1, "force": 2, "power": 3}.get(name)) is not None:
            return np.asarray(self.states.observed.forces[:, [one.place for one in acting], column])
        return np.stack([self._of_acting_muscle(k, one, name) for k, one in enumerate(acting)], axis=1)

    def _energetics(self, name: str) -> np.ndarray:
        """Return the power of the fibres, or the power that muscles consume, (T, M).

        In inverse dynamics, the excitation is assumed to equal the activation.
        """
        own = self.given
        if self.states.q.ndim > 2:
            raise SpecError(f"derivatives of {name} of muscles with respect to parameters are not known")
        muscles = tuple(force.force.muscle for force in self.acting) if own is None else own.muscles
        function, names = ENERGETICS[name], ["activation", "excitation" if own is None else "activation"]
        names = ["force"] if name == "fiber_power" else names
        arrays = [self.array(of) for of in (*names, "fiber_length", "fiber_rate")]
        columns = [_of_each(partial(function, one), *(x[:, k] for x in arrays)) for k, one in enumerate(muscles)]
        return np.stack(columns, axis=1)

    def _of_acting_muscle(self, number: int, one: ActingMuscle, name: str) -> np.ndarray:
        """Return the activation, the excitation, or the length or rate of the fibres of a muscle of a run (T,)."""
        muscle = one.force.muscle
        if name == "activation":
            return self.states.z[:, one.activation]
        if muscle.tendon == "elastic" and name != "excitation":
            place = one.activation + 1
            return self.states.z[:, place] if name == "fiber_length" else self.states.observed.state_rates[:, place]
        if self.states.q.ndim > 2:
            raise SpecError(f"muscles.{one.force.name}.{name} has no known derivatives with respect to parameters")
        if name == "excitation":
            if one.excitation is None:
                return one.force.excitation_at(self.states.time)
            return np.asarray(higher_layers.state_values(*one.excitation, self.states))
        along = self.array("length")[:, number] - muscle.tendon_length
        fiber = elementary.hypot(along, muscle.thickness)
        return np.asarray(fiber if name == "fiber_length" else self.array("rate")[:, number] * along / fiber)
