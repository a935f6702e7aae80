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

from math import hypot, sqrt
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.jit.decorators import inlined, kernel, subkernel
from mbdkit.engine.kernels.lu import substitute
from mbdkit.engine.kernels.system import constraint_rows, independent_rows, load_engine, prepare
from mbdkit.engine.self_stress import scaled_matrix, smallest_stress

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.workspace import Workspace

CLOSE = 0.03
"""Residual of the Ritz vector, relative to its eigenvalue, that ends the iteration: bounds the error of the square."""

MOST_ITERATIONS = 40
"""Iterations after which the bound found so far is taken."""

FEWEST_AT_FIRST = 4
"""Iterations from a start that knows nothing."""

NOISE = 0.1
"""Part of a fixed vector that is mixed into the second one, which might be orthogonal to what comes up next."""

INDEPENDENT = 1e-12
"""Part of the second image's square that must be left beside the first for the second to count."""

NEAR = 0.05
"""Distance below which a failure is put down to a singular position."""

COLUMNS = 11
"""Columns of what is kept from row to row: two vectors, their images, and the factor of each pair."""


def new_vectors(workspace: Workspace) -> np.ndarray:
    """Return (P, 11) zeros, what `singularity_distance` keeps between the rows of a run."""
    return np.zeros((len(workspace.mechanism.topology.pairs), COLUMNS))


@subkernel
def _pair_factors(pairs, rows, jac, weight, near):
    """Write the Cholesky factor of each pair's block of Phi_q M^-1 Phi_q^T into the last columns; return how many."""
    count = 0
    for k in range(len(pairs)):
        a, b = pairs[k, 1], pairs[k, 2]
        d00 = d01 = d11 = 0.0
        for i in range(3):
            wa, wb = weight[a, i], weight[b, i]
            d00 += wa * jac[k, i] * jac[k, i] + wb * jac[k, 3 + i] * jac[k, 3 + i]
            d01 += wa * jac[k, i] * jac[k, 6 + i] + wb * jac[k, 3 + i] * jac[k, 9 + i]
            d11 += wa * jac[k, 6 + i] * jac[k, 6 + i] + wb * jac[k, 9 + i] * jac[k, 9 + i]
        near[k, 8] = near[k, 10] = 1.0
        near[k, 9] = 0.0
        if rows[k] > 0:
            near[k, 8] = sqrt(d00)
        if rows[k] == 2:
            near[k, 9] = d01 / near[k, 8]
            near[k, 10] = sqrt(max(d11 - near[k, 9] * near[k, 9], 0.0))
        if rows[k] > 0:
            count += 1
    return count


@inlined
def _noise(n, multiplier):
    """Return term `n` of a sequence that is spread evenly over (-0.5, 0.5)."""
    x = (n + 1) * multiplier
    return x - np.floor(x) - 0.5


@subkernel
def _disturb(rows, near):
    """Mix noise into the second vector; return whether the first one knew anything before it is made up."""
    known = 0.0
    for k in range(len(rows)):
        known += near[k, 0] * near[k, 0] + near[k, 1] * near[k, 1]
    for k in range(len(rows)):
        for r in range(rows[k]):
            if known == 0.0:
                near[k, r] = _noise(2 * k + r, 0.7548776662466927)
            near[k, 2 + r] += NOISE * _noise(2 * k + r, 0.6180339887498949)
    return known > 0.0


@subkernel
def _scale(near):
    """Write the right sides ``D^-1 x`` of both vectors where their images will stand."""
    for k in range(len(near)):
        l00, l10, l11 = near[k, 8], near[k, 9], near[k, 10]
        for c in range(0, 4, 2):
            near[k, 4 + c] = l00 * near[k, c]
            near[k, 5 + c] = l10 * near[k, c] + l11 * near[k, c + 1]


@subkernel
def _solve_both(start, row, diagonal, below, near):
    """Solve with the Schur complement for both right sides in place; see `mbdkit.engine.kernels.schur.solve`."""
    n = len(diagonal)
    for k in range(n):
        x0, x1, y0, y1 = near[k, 4], near[k, 5], near[k, 6], near[k, 7]
        for e in range(start[k], start[k + 1]):
            i = row[e]
            b00, b01, b10, b11 = below[e, 0], below[e, 1], below[e, 2], below[e, 3]
            near[i, 4] -= b00 * x0 + b01 * x1
            near[i, 5] -= b10 * x0 + b11 * x1
            near[i, 6] -= b00 * y0 + b01 * y1
            near[i, 7] -= b10 * y0 + b11 * y1
    for k in range(n - 1, -1, -1):
        d00, d01, d11 = diagonal[k, 0], diagonal[k, 1], diagonal[k, 2]
        x0, x1 = d00 * near[k, 4] + d01 * near[k, 5], d01 * near[k, 4] + d11 * near[k, 5]
        y0, y1 = d00 * near[k, 6] + d01 * near[k, 7], d01 * near[k, 6] + d11 * near[k, 7]
        for e in range(start[k], start[k + 1]):
            i = row[e]
            b00, b01, b10, b11 = below[e, 0], below[e, 1], below[e, 2], below[e, 3]
            x0 -= b00 * near[i, 4] + b10 * near[i, 5]
            x1 -= b01 * near[i, 4] + b11 * near[i, 5]
            y0 -= b00 * near[i, 6] + b10 * near[i, 7]
            y1 -= b01 * near[i, 6] + b11 * near[i, 7]
        near[k, 4], near[k, 5], near[k, 6], near[k, 7] = x0, x1, y0, y1


@inlined
def _solve_pivoted(rows, row_index, pattern, factors, right, solution, near):
    """Solve with the pivoted system for both right sides in place."""
    for c in range(4, 8, 2):
        right[:] = 0.0
        for k in range(len(near)):
            for r in range(rows[k]):
                right[row_index[k, r]] = -near[k, c + r]
        substitute(pattern, factors, right, solution)
        for k in range(len(near)):
            for r in range(rows[k]):
                near[k, c + r] = solution[row_index[k, r]]


@subkernel
def _products(rows, near):
    """Scale the solutions to the images y of both vectors x; return x.x, y.y and x.y, three of each kind."""
    x00 = x01 = x11 = y00 = y01 = y11 = h00 = h01 = h11 = 0.0
    for k in range(len(near)):
        l00, l10, l11 = near[k, 8], near[k, 9], near[k, 10]
        a0, a1, b0, b1 = near[k, 0], near[k, 1], near[k, 2], near[k, 3]
        p0, p1 = l00 * near[k, 4] + l10 * near[k, 5], l11 * near[k, 5]
        q0, q1 = l00 * near[k, 6] + l10 * near[k, 7], l11 * near[k, 7]
        if rows[k] < 2:
            p1 = q1 = 0.0
            if rows[k] == 0:
                p0 = q0 = 0.0
        near[k, 4], near[k, 5], near[k, 6], near[k, 7] = p0, p1, q0, q1
        x00 += a0 * a0 + a1 * a1
        x01 += a0 * b0 + a1 * b1
        x11 += b0 * b0 + b1 * b1
        y00 += p0 * p0 + p1 * p1
        y01 += p0 * q0 + p1 * q1
        y11 += q0 * q0 + q1 * q1
        h00 += a0 * p0 + a1 * p1
        h01 += 0.5 * (a0 * q0 + a1 * q1 + b0 * p0 + b1 * p1)
        h11 += b0 * q0 + b1 * q1
    return x00, x01, x11, y00, y01, y11, h00, h01, h11


@subkernel
def _turn(near, along, size0, size1, z0, z1):
    """Make the images orthonormal, turn them by (z0, z1), and let them be the next vectors."""
    for k in range(len(near)):
        for r in range(2):
            e0 = near[k, 4 + r]
            e1 = (near[k, 6 + r] - along * e0) * size1
            e0 *= size0
            near[k, r] = z0 * e0 + z1 * e1
            near[k, 2 + r] = z0 * e1 - z1 * e0


@inlined
def singularity_distance(top, w, solver, near):
    """Return the distance to singularity where `solve_accelerations` has just been; 1 with fewer than two pairs.

    `near` (P, 11) is kept from one row to the next. ``w.right`` and ``w.solution`` are lost.
    """
    distance = 1.0
    if _pair_factors(top.pairs, top.rows, w.jac, top.weight, near) > 1:
        fewest = 1 if _disturb(top.rows, near) else FEWEST_AT_FIRST
        for iteration in range(MOST_ITERATIONS):
            _scale(near)
            if solver.pivoted[0] != 0:
                _solve_pivoted(
                    top.rows, solver.row_index, solver.pattern, solver.factors, w.right, w.solution, near
                )  # fmt: skip
            else:
                s = solver.schur
                _solve_both(s.start, s.row, s.diagonal, s.below, near)
            x00, x01, x11, y00, y01, y11, h00, h01, h11 = _products(top.rows, near)
            smallest = off = along = size0 = size1 = z0 = z1 = 0.0
            if 0.0 < y00 < np.inf and 0.0 <= y11 < np.inf:
                # the second image without its part along the first, and of the vectors what belongs to them
                along = y01 / y00
                rest = y11 - along * y01
                size0 = 1.0 / sqrt(y00)
                if rest > INDEPENDENT * y11:
                    size1 = 1.0 / sqrt(rest)
                g00 = h00 * size0 * size0
                g01 = (h01 - along * h00) * size0 * size1
                g11 = (h11 - 2.0 * along * h01 + along * along * h00) * size1 * size1
                z0, z1, smallest = 1.0, 0.0, g00
                if size1 > 0.0:
                    smallest = (g00 * g11 - g01 * g01) / (0.5 * (g00 + g11) + hypot(0.5 * (g00 - g11), g01))
                    e00, e11 = abs(g00 - smallest), abs(g11 - smallest)
                    length = hypot(max(e00, e11), g01)
                    if length > 0.0:
                        z0, z1 = (e11 / length, -g01 / length) if e11 >= e00 else (-g01 / length, e00 / length)
                c0 = z0 * size0 - along * z1 * size1
                c1 = z1 * size1
                off = (c0 * c0 * x00 + 2.0 * c0 * c1 * x01 + c1 * c1 * x11) / (smallest * smallest) - 1.0
            if not 0.0 < smallest < np.inf:  # also where it is no number
                near[:, :8] = 0.0
                distance = 0.0
                break
            _turn(near, along, size0, size1, z0, z1)
            distance = min(sqrt(smallest), 1.0)
            if iteration + 1 >= fewest and off <= CLOSE * CLOSE:
                break
    return distance


@kernel
def independent_jacobian(engine, t, q, v, near):
    """Evaluate the Jacobian of the rows that are solved for into ``w.jac``, and the pairs' factors into `near`."""
    h = load_engine(engine)
    top, w = h.top, h.w
    prepare(top, w, t, q)
    constraint_rows(top, w, q, v)
    independent_rows(top, w.cs, w.jac, w.gamma, w.loose)
    _pair_factors(top.pairs, top.rows, w.jac, top.weight, near)


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
        first = blocks[:, 0] / near[:, 8, None, None]
        second = (blocks[:, 1] - near[:, 9, None, None] * first) / near[:, 10, None, None]
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
