"""Forces of contacts with Coulomb friction for given responses, as arrays."""

from __future__ import annotations

import numpy as np

from mbdkit_contact.kernels.pivoting import new_cones, solve_cones


def coulomb(
    response: np.ndarray, normal: np.ndarray, tangent: np.ndarray, friction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal and tangential forces (k,) of k contacts; see `mbdkit_contact.kernels.pivoting.Cones`."""
    cones = new_cones(len(normal))
    cones.response[:], cones.free[:] = response, np.concatenate([normal, tangent])
    cones.friction[:] = friction
    assert solve_cones(cones, len(normal))
    along, across = np.split(cones.forces, 2)
    return along, across
