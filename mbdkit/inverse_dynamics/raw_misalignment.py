"""Misalignment of measured data: how far the bodies miss their joints where the data alone place them."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.joint_sums import JointSums
from mbdkit.inverse_dynamics.fit import Target
from mbdkit.inverse_dynamics.manifold import Manifold, least_norm

ITERATIONS = 4
"""Gauss-Newton steps from the fitted pose, which is near, so that they converge."""

SETTLED = 1e-14
"""Scaled step below which positions are found to rounding."""

NEGLIGIBLE = 1e-9
"""Share of the largest singular value of the Jacobian of the data below which they do not see a direction."""

BLIND = 1e-6
"""Share of a constraint row that the data do not see, above which its gap counts as undetermined."""


def raw_misalignment(manifold: Manifold, mechanism: CompiledMechanism, target: Target, q: np.ndarray) -> np.ndarray:
    """Return the misalignment of each joint (T, J) [m] of bodies placed by the data alone.

    All bodies are moved freely from the fitted poses, by the smallest displacement that makes the sum of the weighted
    squared residuals least. Where the data do not determine the gap of a joint, the result is nan.

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
