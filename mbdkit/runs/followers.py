"""Bodies that no data observe, such as a worn device: they follow a measured motion, and act on its mechanism."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Never

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.seam import OwnSeam


@dataclass(frozen=True)
class AddedForces:
    """Forces on a mechanism in T frames.

    Attributes
    ----------
    names, bodies
        Names of the L forces, and of the bodies on which they act.
    force, point, torque
        (T, L, 2) forces [N], (T, L, 2) points of application in the global frame [m], and (T, L) free torques [N m].
    """

    names: tuple[str, ...]
    bodies: tuple[str, ...]
    force: np.ndarray
    point: np.ndarray
    torque: np.ndarray


class Follower(ABC):
    """Bodies that follow the motion of a mechanism by their own dynamics.

    Attributes
    ----------
    worn
        Whether measured forces of the ground contain them. If they do not, the ground carries their weight and inertia
        in addition to what was measured.
    deviations
        Typical standard deviations of uncertain numbers by name, such as ``misfit_x``; they are sources of error bars.
    """

    worn: bool
    deviations: Mapping[str, float]

    @abstractmethod
    def forces(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> AddedForces:
        """Return the forces at `time` (T,) for a motion of the mechanism: positions, velocities and accelerations (T,
        n), with x, y and angle of each body. Raise MbdkitError if the bodies cannot follow it.
        """

    @abstractmethod
    def changed(self, change: Mapping[str, float]) -> Follower:
        """Return these bodies with changes of uncertain numbers, by name; a change of a positive number is that of its
        logarithm.
        """


@OwnSeam
def follower(value: Never, name: str, mechanism: Mechanism, /) -> Follower:
    """Return the bodies with which a value of a key of models, given by its name, extends a mechanism without them.

    Raise SpecError, whose key begins with that of the section, such as ``devices.NAME``, if they do not fit it.
    """
    raise NotImplementedError
