"""Mass and inertia of the shapes of MJCF."""

from __future__ import annotations

import math

import numpy as np

#: Number of sizes by type of geom.
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}


def volume_and_inertia(kind: str, size: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the volume [m^3] of a shape along its z axis, and its principal moments of inertia (3,) for unit density
    [m^5].

    Parameters
    ----------
    kind, size
        Type and size of a geom as in MuJoCo; sizes are half lengths and radii.
    """
    if kind == "sphere":
        volume = 4 / 3 * math.pi * size[0] ** 3
        return volume, np.full(3, 0.4 * volume * size[0] ** 2)
    if kind == "ellipsoid":
        volume = 4 / 3 * math.pi * float(np.prod(size[:3]))
        return volume, 0.2 * volume * _pairs(size[:3] ** 2)
    if kind == "box":
        volume = 8 * float(np.prod(size[:3]))
        return volume, volume / 3 * _pairs(size[:3] ** 2)
    r, half = float(size[0]), float(size[1])
    wall, caps = 2 * math.pi * r**2 * half, 4 / 3 * math.pi * r**3 * (kind == "capsule")
    across = wall * (half**2 / 3 + r**2 / 4) + caps * (0.4 * r**2 + half**2 + 0.75 * half * r)
    return wall + caps, np.array([across, across, wall * r**2 / 2 + caps * 0.4 * r**2])


def _pairs(squares: np.ndarray) -> np.ndarray:
    x, y, z = squares
    return np.array([y + z, x + z, x + y])
