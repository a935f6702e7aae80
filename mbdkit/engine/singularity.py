"""Distance to singularity: how near the joints of a mechanism are to blocking each other, or to letting go.

It is the smallest singular value of the constraint Jacobian of the independent rows in the mass metric,
``D Phi_q M^-1/2``, where D makes the rows orthonormal, those of one point's x and y as a pair, so that the value does
not depend on the directions of the axes: 1 where no joint feels another, 0 where the rows are dependent. Near a
singular position it falls in proportion to the way that is left; accelerations lose digits in proportion to its
inverse, multipliers to the square of that.

Along a run it is found by inverse iteration with two vectors on ``D Phi_q M^-1 Phi_q^T D^T``, with the factors that the
accelerations were solved with, from the vectors of the row before, and the smaller Ritz value is taken (Parlett, The
Symmetric Eigenvalue Problem, 1998): an upper bound, true to about 1 %.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.kernels.singularity_kernels import COLUMNS, L_XX, L_YX, L_YY, independent_jacobian
from mbdkit.engine.self_stress import scaled_matrix, smallest_stress

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.workspace import Workspace

NEAR = 0.05
"""Distance below which a failure is put down to a singular position."""


def new_vectors(workspace: Workspace) -> np.ndarray:
    """Return (P, 11) zeros, what `singularity_distance` keeps between the rows of a run."""
    return np.zeros((len(workspace.mechanism.topology.pairs), COLUMNS))


def nearest_singularity(workspace: Workspace, t: float, q: np.ndarray) -> tuple[float, str]:
    """Return how far a position is from the nearest singular one, and which joint has the largest part in it.

    Parameters
    ----------
    workspace
        The mechanism.
    t
        Time [s].
    q
        (3 (B + 1),) position, ground last, or (3 B,) without it.

    Returns
    -------
    distance : float
        Smallest singular value of the scaled Jacobian, to round-off; 1 with fewer than two rows, 0 where the Jacobian
        is no finite number.
    joint : str
        Name of the joint whose rows hold the largest part of the left singular vector; empty without rows.
    """
    mechanism = workspace.mechanism
    top, w, rows = mechanism.topology, workspace.scratch, mechanism.solved_rows
    if not rows:
        return 1.0, ""
    full = np.zeros(mechanism.size)
    full[: min(len(q), len(full))] = q[: len(full)]
    near = new_vectors(workspace)
    independent_jacobian(workspace.engine, float(t), full, np.zeros_like(full), near)
    pair, place = np.array([row.pair for row in rows]), np.array([row.place for row in rows])
    blocks = w.jac.reshape(-1, 2, 2, 3) * np.sqrt(top.weight[top.pairs[:, 1:3]])[:, None]
    with np.errstate(all="ignore"):
        first = blocks[:, 0] / near[:, L_XX, None, None]
        second = (blocks[:, 1] - near[:, L_YX, None, None] * first) / near[:, L_YY, None, None]
    values = np.stack([first, second], axis=1)[pair, place].reshape(len(rows), 6)
    finite = np.all(np.isfinite(values), axis=1)
    if not np.all(finite):
        return 0.0, _joint_of(mechanism, int(pair[np.argmin(finite)]))
    ends = 3 * np.repeat(top.pairs[pair, 1:3], 3, axis=1) + np.tile(np.arange(3), 2)
    held = ends < mechanism.size - 3
    row = np.broadcast_to(np.arange(len(rows))[:, None], ends.shape)
    vector, smallest = smallest_stress(scaled_matrix(len(rows), row[held], ends[held], values[held]))
    share = np.zeros(len(top.pairs))
    np.add.at(share, pair, vector**2)
    parts = [float(np.sum(share[list(members)])) for members in mechanism.joint_pairs]
    return smallest, mechanism.joints[int(np.argmax(parts))]


def describe_nearness(workspace: Workspace, t: float, q: np.ndarray) -> str:
    """Return in words that a position is nearly singular, and where; empty where it is not.

    Parameters
    ----------
    workspace
        The mechanism.
    t
        Time [s].
    q
        (3 (B + 1),) position, as in `nearest_singularity`.
    """
    try:
        distance, joint = nearest_singularity(workspace, t, q)
    except np.linalg.LinAlgError:
        return ""
    if not joint or distance > NEAR:
        return ""
    return f"the mechanism is in a singular position, or next to one, at joint '{joint}' (distance {distance:.1g})"


def _joint_of(mechanism: CompiledMechanism, pair: int) -> str:
    """Return the name of the joint that a pair of rows belongs to."""
    return next(name for name, held in zip(mechanism.joints, mechanism.joint_pairs, strict=True) if pair in held)
