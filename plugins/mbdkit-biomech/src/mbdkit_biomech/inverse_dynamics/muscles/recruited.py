"""Results of recruitment: the muscles of a motion, the moments that they share, and their tensions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import Shared
from mbdkit_biomech.inverse_dynamics.muscles.soft_targets import Targets


@dataclass(frozen=True)
class Contraction:
    """Muscles of a motion in T frames: their geometry and possible forces. Arrays are (T, M), except `pull`.

    Attributes
    ----------
    length, rate
        Lengths of the paths [m] and their rates [m/s].
    fiber_length, fiber_rate
        Lengths of the fibres [m] and their rates [m/s]; nan where they are not needed.
    capacity, passive
        Increase of the tension per unit of activation, and tension at zero activation [N].
    pull
        (T, n, M) generalized forces of unit tensions.
    """

    length: np.ndarray
    rate: np.ndarray
    fiber_length: np.ndarray
    fiber_rate: np.ndarray
    capacity: np.ndarray
    passive: np.ndarray
    pull: np.ndarray


@dataclass(frozen=True)
class Sharing:
    """The actuators that muscles and reserves replace in T frames, and the programmes that determine their shares.

    Attributes
    ----------
    arms
        (T, U, M) values of the actuators that have the same effect as unit tensions.
    driven
        (U,) whether muscles act on an actuator that is not residual, so that muscles and reserves replace it.
    programme
        The convex programmes. The unknowns are the activations of the M muscles and the shares of the reserves; the
        equations are those of the driven actuators. Soft targets add equations and unknowns after these.
    """

    arms: np.ndarray
    driven: np.ndarray
    programme: Programme


@dataclass(frozen=True)
class Recruited:
    """Muscles that produce a motion in T frames.

    Attributes
    ----------
    contraction, sharing, shared
        The muscles, the programmes that determine their shares, and the solution.
    targets
        Soft targets, with EMG that recruitment has calibrated.
    activation, force, power
        (T, M) activations, tensions [N], and powers that the muscles supply to the bodies [W].
    beside
        (T, U) values that actuators and reserves exert in addition to the muscles.
    actuators
        (T, U + R, 2) values of the actuators and of the reserves [N, N m] and their powers [W]. For driven actuators
        (see `Sharing`), these are the net values that muscles and reserves produce together; the other actuators act in
        addition to the muscles.
    lam
        (T, m) multipliers of the independent constraint rows, with the forces of the muscles.
    """

    contraction: Contraction
    sharing: Sharing
    shared: Shared
    targets: Targets
    activation: np.ndarray
    force: np.ndarray
    power: np.ndarray
    beside: np.ndarray
    actuators: np.ndarray
    lam: np.ndarray
