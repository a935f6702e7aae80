"""Misalignment of measured data: that of the joints if the bodies are placed by the data alone."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.joint_sums import JointSums
from mbdkit.inverse_dynamics.fit import Target
from mbdkit.inverse_dynamics.manifold import Manifold, least_norm

ITERATIONS = 4
"""Number of Gauss-Newton steps from the fitted pose; it is so close that few are needed."""

SETTLED = 1e-14
"""Scaled step below which positions are exact to round-off."""

NEGLIGIBLE = 1e-9
"""A direction counts as not observed by the data below this share of the largest singular value of their Jacobian."""

BLIND = 1e-6
"""The residual of a constraint row counts as undetermined if more than this share of the row is not observed by the
data."""


def raw_misalignment(manifold: Manifold, mechanism: CompiledMechanism, target: Target, q: np.ndarray) -> np.ndarray:
    """Return the misalignment of each joint (T, J) [m] for bodies placed by the data alone.

    All bodies are moved freely from the fitted poses, by the smallest displacement that minimises the sum of the
    weighted squared residuals. Where the data do not determine the misalignment of a joint, the result is nan.

    Parameters
    ----------
    q
        (T, n) fitted poses.
    """
    place, none = q.copy(), np.zeros((len(q), manifold.m))
    for _ in range(ITERATIONS):
        observed = target.quantities.jacobian(place) * target.root_weight[:, None] * manifold.scale
        left = (target.values - target.quantities.values(place)) * target.root_weight
        step = least_norm(observed, left, NEGLIGIBLE)
        place += step * manifold.scale
        if np.max(np.abs(step), initial=0.0) < SETTLED:
            break
    residual = manifold.reactions(target.time, place, np.zeros_like(place), none).residual
    found: np.ndarray = JointSums(mechanism).misalignment(residual)
    jacobian = manifold.frames(target.time, q).jacobian * manifold.scale
    seen = np.linalg.pinv(observed, rcond=NEGLIGIBLE) @ observed
    hidden = np.linalg.norm(jacobian - jacobian @ seen, axis=2) > BLIND * np.linalg.norm(jacobian, axis=2)
    names = [row.label.rpartition(".")[0] for row in mechanism.solved_rows]
    for number, name in enumerate(mechanism.joints):
        own = [row for row, joint in enumerate(names) if joint == name]
        if own:
            found[np.any(hidden[:, own], axis=1), number] = np.nan
    return found
