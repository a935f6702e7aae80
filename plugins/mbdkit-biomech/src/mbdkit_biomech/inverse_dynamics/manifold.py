"""The constraint manifold of a mechanism, for many frames at once: matrices, free directions, least-squares
solutions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.frames import Frames, Reactions, evaluate_frames, reactions_in_frames
from mbdkit.runs.assembled_mechanism import AssembledMechanism

SAFE = 1000.0
"""A matrix counts as having full rank if all its pivots are larger than this multiple of the threshold below which
singular values count as zero.
"""

DEPENDENT = 1e-9
"""The position is singular if the smallest pivot of the QR decomposition of the constraint rows is at most this share
of the largest one. The constraint rows then count as linearly dependent.
"""


class Manifold:
    """The constraints and forces of a mechanism, evaluated in frames.

    Parameters
    ----------
    prepared
        The mechanism at its start.

    Attributes
    ----------
    n, m
        Number of coordinates and of independent constraint rows.
    mass : (n,) array
        Mass or moment of inertia of each coordinate; 0 for the angles of point masses.
    length
        Characteristic length of the mechanism [m].
    scale : (n,) array
        Scale of each coordinate: the characteristic length [m], or 1 rad; 0 for the angles of point masses, which have
        no meaning.
    held
        Number of angles of point masses.
    freedoms
        Number of degrees of freedom.
    """

    def __init__(self, prepared: AssembledMechanism):
        equations: EquationsOfMotion = prepared.equations
        self.n, self.m = equations.n, equations.m
        self.mass = np.where(prepared.held, 0.0, equations.mass)
        self.length = prepared.workspace.mechanism.length
        self.scale = np.where(prepared.held, 0.0, np.tile([self.length, self.length, 1.0], self.n // 3))
        self.held = int(np.sum(prepared.held))
        self.freedoms = prepared.freedoms
        self._equations, self._pairs = equations, len(prepared.workspace.mechanism.topology.pairs)

    def frames(self, times: np.ndarray, q: np.ndarray, v: np.ndarray | None = None, *, forces: bool = False) -> Frames:
        """Return the terms of the equations of motion at positions `q` and velocities `v` (T, n); at rest by default.

        Parameters
        ----------
        forces
            Whether the applied forces are evaluated as well.
        """
        out = Frames.zeros(len(times), self.n, self.m)
        v = np.zeros_like(q) if v is None else v
        given = (np.ascontiguousarray(x, dtype=float) for x in (times, q, v))
        evaluate_frames(self._equations.address, *given, forces, out)
        return out

    def reactions(self, times: np.ndarray, q: np.ndarray, v: np.ndarray, lam: np.ndarray) -> Reactions:
        """Return the reactions, residuals and powers for multipliers `lam` (T, m) of the independent rows."""
        out = Reactions.zeros(len(times), self._pairs)
        given = (np.ascontiguousarray(x, dtype=float) for x in (times, q, v, lam))
        reactions_in_frames(self._equations.address, *given, out)
        return out

    def directions(self, jacobian: np.ndarray) -> Directions:
        """Return the constrained and the free directions, given the Jacobian Phi_q (T, m, n) of the constraints."""
        scaled = np.swapaxes(jacobian * self.scale, 1, 2)
        if not self.held:
            q, r = np.linalg.qr(scaled, mode="complete")
            return Directions(self.scale, q[:, :, : self.m], q[:, :, self.m :], r[:, : self.m])
        own = self.scale > 0  # excludes the angles of point masses
        q, r = np.linalg.qr(scaled[:, own], mode="complete")
        whole = np.zeros((len(jacobian), self.n, q.shape[2]))
        whole[:, own] = q
        return Directions(self.scale, whole[:, :, : self.m], whole[:, :, self.m :], r[:, : self.m])


@dataclass(frozen=True)
class Directions:
    """Orthonormal directions of scaled coordinates in T frames, f of which are free.

    Attributes
    ----------
    scale
        (n,) scales of the coordinates, see `Manifold`.
    held, free
        (T, n, m) constrained directions, and (T, n, f) free directions.
    triangle
        (T, m, m) upper triangular matrix R with ``(Phi_q scale)^T = held R``.
    """

    scale: np.ndarray
    held: np.ndarray
    free: np.ndarray
    triangle: np.ndarray

    def rows(self, part: slice | np.ndarray) -> Directions:
        """Return the directions in a selection of frames."""
        return Directions(self.scale, self.held[part], self.free[part], self.triangle[part])

    def singular(self) -> np.ndarray:
        """Return the frames, (T,) bool, in which constraint rows are linearly dependent."""
        if not self.triangle.shape[1]:
            return np.zeros(len(self.triangle), dtype=bool)
        pivots = np.abs(np.diagonal(self.triangle, axis1=1, axis2=2))
        bad: np.ndarray = np.min(pivots, axis=1) <= DEPENDENT * np.max(pivots, axis=1)
        return bad

    def displacement(self, rows: np.ndarray) -> np.ndarray:
        """Return the least scaled displacements (T, n) that change the constraint rows by `rows` (T, m)."""
        if not rows.shape[1]:
            return np.zeros((len(rows), len(self.scale)))
        along = np.linalg.solve(np.swapaxes(self.triangle, 1, 2), rows[..., None])
        return (self.held @ along)[..., 0]

    def multipliers(self, force: np.ndarray) -> np.ndarray:
        """Return lam (T, m) for which ``Phi_q^T lam`` is the part of a generalized force (T, n) in the constrained
        directions.
        """
        if not self.triangle.shape[1]:
            return np.zeros((len(force), 0))
        held = np.swapaxes(self.held, 1, 2) @ (force * self.scale)[..., None]
        found: np.ndarray = np.linalg.solve(self.triangle, held)[..., 0]
        return found

    def least_squares(self, rows: np.ndarray, observed: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return x (T, n) that satisfies ``Phi_q x = rows`` and minimises the norm of ``observed x - values``.

        Parameters
        ----------
        rows
            (T, m) right side of the constraints.
        observed, values
            (T, k, n) and (T, k).

        Returns
        -------
        ndarray
            The solution, with no component along free directions that do not affect ``observed x``.
        """
        x = self.displacement(rows)
        if self.free.shape[2]:
            seen = (observed * self.scale) @ self.free
            rest = values - ((observed * self.scale) @ x[..., None])[..., 0]
            x = x + (self.free @ least_norm(seen, rest, 1e-12)[..., None])[..., 0]
        moved: np.ndarray = x * self.scale
        return moved


def least_norm(matrix: np.ndarray, values: np.ndarray, negligible: float) -> np.ndarray:
    """Return the x (T, f) that minimises the norm of ``matrix x - values``; if there are several, the smallest x.

    If all matrices have full rank, a QR decomposition is used, which is several times as fast as the singular value
    decomposition that is needed otherwise.

    Parameters
    ----------
    matrix, values
        (T, k, f) and (T, k).
    negligible
        Singular values below this share of the largest one count as zero.
    """
    wide = matrix.shape[1] < matrix.shape[2]
    q, r = np.linalg.qr(np.swapaxes(matrix, 1, 2) if wide else matrix)
    pivots = np.abs(np.diagonal(r, axis1=1, axis2=2))
    if not pivots.size or np.any(np.min(pivots, axis=1) <= SAFE * negligible * np.max(pivots, axis=1)):
        return np.asarray((np.linalg.pinv(matrix, rcond=negligible) @ values[..., None])[..., 0])
    if wide:
        return np.asarray((q @ np.linalg.solve(np.swapaxes(r, 1, 2), values[..., None]))[..., 0])
    return np.asarray(np.linalg.solve(r, np.swapaxes(q, 1, 2) @ values[..., None])[..., 0])
