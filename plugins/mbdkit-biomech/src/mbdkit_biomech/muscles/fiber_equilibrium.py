"""Equilibrium of fibres with an elastic tendon in predictions, where velocity and force are unknowns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from mbdkit_biomech.muscles.acting_muscles import SHORTEST
from mbdkit_biomech.muscles.force_curves import CURVES
from mbdkit_biomech.muscles.hill_laws import fiber_pull, tendon_gap
from mbdkit_biomech.muscles.muscle import Muscle


@dataclass(frozen=True)
class FiberEquilibrium:
    """The equilibrium of the fibres of a muscle; see `mbdkit_predict.exported_elements.ElementEquilibrium`."""

    muscle: Muscle
    state: ClassVar[str] = "fiber_length"
    unknowns: ClassVar[tuple[str, str]] = ("fiber_velocity", "tendon_force")
    recorded: ClassVar[tuple[str, str]] = ("fiber_rate", "force")
    lowest: ClassVar[tuple[float, float]] = (-math.inf, 0.0)
    starts: ClassVar[tuple[float, float]] = (0.0, 0.1)

    @property
    def sizes(self) -> tuple[float, float]:
        """Largest velocity [m/s] and force [N] of the fibres."""
        return self.muscle.max_velocity * self.muscle.optimal_length, self.muscle.max_force

    def in_si(self, rate: Any, force: Any, law: Mapping[str, Any]) -> tuple[Any, Any]:
        """Return the velocity of the fibres [m/s] and the force of the tendon [N]."""
        return law["max_speed"] * rate, law["max_force"] * force

    def conditions(self, rate: object, force: object, length: object, law: Mapping[str, object]) -> tuple[Any, Any]:
        """Return the force of the fibres along the tendon less that of the tendon, as a share of the largest force; and
        the room for the tendon less its length, as a share of it (with the curves `millard`, a difference of forces).
        """
        curves = CURVES[self.muscle.curves]
        return fiber_pull(rate, law, curves) - force, tendon_gap(length, force, law, curves)

    def at_rest(self, lengths: np.ndarray) -> np.ndarray:
        """Return the lengths of the fibres on a slack tendon for lengths of the muscle [m]."""
        own = self.muscle
        along = np.maximum(lengths - own.tendon_length, SHORTEST * own.optimal_length)
        return np.asarray(np.hypot(along, own.thickness))


def equilibrium_of(muscle: Muscle) -> FiberEquilibrium | None:
    """Return the equilibrium of the fibres of a muscle with an elastic tendon; None if the tendon is rigid."""
    return FiberEquilibrium(muscle) if muscle.tendon == "elastic" else None
