"""The leg of `leg.py` as a mechanism, and its poses as positions of bodies."""

import numpy as np
from tests.muscles import leg

from mbdkit import Mechanism

SETTINGS = ("quadrant", "polynomial")
"""Keys that only OpenSim needs."""


def leg_mechanism(**changed: object) -> Mechanism:
    """Return the leg with its muscles; `changed` are properties of all muscles."""
    m = Mechanism()
    heights = {"thigh": 0.72, "shank": 0.29}
    for name, (mass, inertia) in leg.BODIES.items():
        m.body(name, mass=mass, inertia=inertia, position=(0.0, heights[name]))
    for name, ((a, at_a), (b, at_b)) in (("hip", leg.HIP), ("knee", leg.KNEE)):
        m.revolute(name, a, b, points=(at_a, at_b))
    m.coordinate("bend", "knee.angle")
    for name, data in leg.MUSCLES.items():
        own = {key: value for key, value in data.items() if key not in SETTINGS}
        m.muscle(name, own.pop("path"), **(own | changed))
    return m


def _turned(point: tuple[float, float], angle: np.ndarray) -> np.ndarray:
    (x, y), c, s = point, np.cos(angle), np.sin(angle)
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def poses(angles: np.ndarray) -> np.ndarray:
    """Return positions (T, 6) of the bodies at angles (T, 2) of hip and knee."""
    hip, shank = angles[:, 0], angles[:, 0] + angles[:, 1]
    thigh = np.array(leg.HIP[0][1]) - _turned(leg.HIP[1][1], hip)
    knee = thigh + _turned(leg.KNEE[0][1], hip)
    return np.column_stack([thigh, hip, knee - _turned(leg.KNEE[1][1], shank), shank])


def directions(angles: np.ndarray, step: float = 1e-6) -> list[np.ndarray]:
    """Return the derivatives (T, 6) of the poses by the two angles."""
    found = []
    for axis in range(2):
        moved = np.zeros(2)
        moved[axis] = step
        found.append((poses(angles + moved) - poses(angles - moved)) / (2 * step))
    return found
