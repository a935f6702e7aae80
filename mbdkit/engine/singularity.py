"""Distance to singularity: a measure of how close the constraints of a mechanism are to becoming dependent.

The distance is the smallest singular value of ``D Phi_q M^-1/2``, the constraint Jacobian of the independent rows in
the mass metric. The block-diagonal matrix D makes the two rows (x, y) of each pair orthonormal, so that the value does
not depend on the orientation of the axes. It is 1 if the joints do not interact, and 0 if the rows are dependent. Near
a singular position it is proportional to the displacement that leads to this position. The rounding errors of
accelerations grow with its inverse, those of multipliers with the square of its inverse.

During a run the distance is computed by inverse iteration with two vectors on ``D Phi_q M^-1 Phi_q^T D^T``. The
iteration reuses the matrix factors from the solution for the accelerations and starts from the two vectors found for
the previous recorded state. The distance is the square root of the smaller Ritz value (Parlett, The Symmetric
Eigenvalue Problem, 1998). This is an upper bound of the exact distance, at most 1 % too large.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.text import listed
from mbdkit.engine.kernels.singularity_kernels import COLUMNS, L_XX, L_YX, L_YY, independent_jacobian
from mbdkit.engine.kernels.table_rows import BODIES
from mbdkit.engine.self_stress import scaled_matrix, smallest_stress

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.workspace import Workspace

NEAR = 0.05  #: Distance below which a failure is attributed to a singular position.


def new_vectors(mechanism: CompiledMechanism) -> np.ndarray:
    """Return (P, 11) zeros: the initial vectors of `singularity_distance`, which are reused from one recorded state of
    a run to the next.
    """
    return np.zeros((len(mechanism.topology.pairs), COLUMNS))


def nearest_singularity(workspace: Workspace, t: float, q: np.ndarray) -> tuple[float, str]:
    """Return the distance of a position to singularity and the joint with the largest component in the singular vector.

    `workspace`: the mechanism. `t`: time [s]. `q`: (3 (B + 1),) position, ground last, or (3 B,) without it. Returns
    smallest singular value of the scaled Jacobian, accurate to round-off; 1 with fewer than two rows, 0 if the Jacobian
    is not finite, and name of the joint whose rows have the largest component in the left singular vector; empty
    without rows. If the Jacobian is not finite, a joint whose rows are not.
    """
    mechanism = workspace.mechanism
    top, w, rows = mechanism.topology, workspace.scratch, mechanism.solved_rows
    if not rows:
        return 1.0, ""
    full = np.zeros(mechanism.size)
    full[: min(len(q), len(full))] = q[: len(full)]
    near = new_vectors(mechanism)
    independent_jacobian(workspace.engine, float(t), full, np.zeros_like(full), near)
    pair, places = np.array([row.pair for row in rows]), np.array([row.place for row in rows])
    blocks = w.jac.reshape(-1, 2, 2, 3) * np.sqrt(top.weight[top.pairs[:, BODIES]])[:, None]
    with np.errstate(all="ignore"):
        first = blocks[:, 0] / near[:, L_XX, None, None]
        second = (blocks[:, 1] - near[:, L_YX, None, None] * first) / near[:, L_YY, None, None]
    values = np.stack([first, second], axis=1)[pair, places].reshape(len(rows), 6)
    finite = np.all(np.isfinite(values), axis=1)
    if not np.all(finite):
        return 0.0, mechanism.joints[top.pair_joint[pair[np.argmin(finite)]]]
    ends = 3 * np.repeat(top.pairs[pair, BODIES], 3, axis=1) + np.tile(np.arange(3), 2)
    held = ends < mechanism.size - 3
    row = np.broadcast_to(np.arange(len(rows))[:, None], ends.shape)
    vector, smallest = smallest_stress(scaled_matrix(len(rows), row[held], ends[held], values[held]))
    share = np.zeros(len(top.pairs))
    np.add.at(share, pair, vector**2)
    parts = [float(np.sum(share[list(members)])) for members in mechanism.joint_pairs]
    return smallest, mechanism.joints[int(np.argmax(parts))]


def describe_nearness(workspace: Workspace, t: float, q: np.ndarray) -> str:
    """Return a clause stating that a position is nearly singular, and at which joint; empty if it is not.

    It names the angles of drivers, which cannot turn a linkage past a dead centre.

    `workspace`: the mechanism. `t`: time [s]. `q`: (3 (B + 1),) position, as in `nearest_singularity`.
    """
    try:
        distance, joint = nearest_singularity(workspace, t, q)
    except np.linalg.LinAlgError:
        return ""
    if not joint or distance > NEAR:
        return ""
    mechanism = workspace.mechanism
    angles = [*q[2 : mechanism.size - 3 : 3], 0.0]
    number = {name: place for place, name in enumerate((*mechanism.bodies, "ground"))}
    turned = [
        f"driver '{name}' at {angles[number[b]] - angles[number[a]]:.6g} rad"
        for name, (a, b), unit in zip(mechanism.joints, mechanism.joint_bodies, mechanism.joint_units, strict=True)
        if name in mechanism.drivers and unit == "rad"
    ]
    at = f", with {listed(turned, 'and')}, as at a dead centre, which no step size passes" if turned else ""
    return f"the mechanism is in or near a singular position at joint '{joint}' (distance {distance:.1g}){at}"
