"""The constraint manifold of a mechanism, for many frames at once: matrices, free directions, least-squares
solutions; and quantities that are evaluated together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.frames import Frames, Reactions, evaluate_frames, reactions_in_frames
from mbdkit.engine.linear_systems import complete_qr, least_norms, products, solve_triangles
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_quantities import Quantity
from mbdkit.runs.assembled_mechanism import AssembledMechanism

#: The position is singular if the smallest pivot of the QR decomposition of the constraint rows is at most this share
#: of the largest one. The constraint rows then count as linearly dependent.
DEPENDENT = 1e-9

#: Remainders of columns of the matrix of a fit below this share of the largest column count as zero.
NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class GivenMechanism:
    """A mechanism without a spec; errors about it stay as they are."""

    whole: Mechanism

    def mechanism(self) -> Mechanism:
        """Return the mechanism."""
        return self.whole

    def placed(self, error: SpecError) -> SpecError:
        """Return the error."""
        return error


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

    def directions_at(self, times: np.ndarray, q: np.ndarray) -> Directions:
        """Return the constrained and the free directions at positions `q` (T, n)."""
        return self.directions(self.frames(times, q).jacobian)

    def directions(self, jacobian: np.ndarray) -> Directions:
        """Return the constrained and the free directions, given the Jacobian Phi_q (T, m, n) of the constraints."""
        scaled = np.swapaxes(jacobian * self.scale, 1, 2)
        if not self.held:
            q, r = complete_qr(scaled)
            return Directions(self.scale, q[:, :, : self.m], q[:, :, self.m :], r[:, : self.m])
        own = self.scale > 0  # excludes the angles of point masses
        q, r = complete_qr(scaled[:, own])
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
        return np.asarray(np.min(pivots, axis=1) <= DEPENDENT * np.max(pivots, axis=1))

    def displacement(self, rows: np.ndarray) -> np.ndarray:
        """Return the least scaled displacements (T, n) that change the constraint rows by `rows` (T, m)."""
        if not rows.shape[1]:
            return np.zeros((len(rows), len(self.scale)))
        return products(self.held, solve_triangles(self.triangle, rows, transposed=True))

    def multipliers(self, force: np.ndarray) -> np.ndarray:
        """Return lam (T, m) for which ``Phi_q^T lam`` is the part of a generalized force (T, n) in the constrained
        directions.
        """
        if not self.triangle.shape[1]:
            return np.zeros((len(force), 0))
        return solve_triangles(self.triangle, products(np.swapaxes(self.held, 1, 2), force * self.scale))

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
            scaled = observed * self.scale
            seen, rest = products(scaled, self.free), values - products(scaled, x)
            x = x + products(self.free, least_norms(seen, rest, NEGLIGIBLE))
        return np.asarray(x * self.scale)


class Quantities:
    """Several quantities, evaluated together.

    Parameters
    ----------
    quantities
        The K quantities.
    """

    def __init__(self, quantities: Sequence[Quantity]):
        self.quantities = tuple(quantities)
        self.is_angle = np.array([quantity.unit == "rad" for quantity in self.quantities], dtype=bool)
        self.scale = np.array([quantity.scale for quantity in self.quantities])

    def __len__(self) -> int:
        return len(self.quantities)

    def only(self, places: Sequence[int]) -> Quantities:
        """Return the quantities with the given indices."""
        return Quantities([self.quantities[place] for place in places])

    def sizes(self, length: float) -> np.ndarray:
        """Return the values (K,) that count as 1: 1 rad for angles, and `length` for lengths."""
        return np.asarray(np.where(self.is_angle, 1.0, length) * self.scale)

    def values(self, q: np.ndarray) -> np.ndarray:
        """Return the values (T, K)."""
        out = np.empty((len(q), len(self)))
        for index, quantity in enumerate(self.quantities):
            out[:, index] = quantity.value(q)
        return out

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return the Jacobian (T, K, n)."""
        out = np.zeros((len(q), len(self), q.shape[1]))
        for index, quantity in enumerate(self.quantities):
            quantity.add_gradient(q, out[:, index])
        return out

    def curvature(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the second time derivatives (T, K) that the quantities have if the accelerations of the coordinates
        are zero.
        """
        out = np.empty((len(q), len(self)))
        for index, quantity in enumerate(self.quantities):
            out[:, index] = quantity.curvature(q, v)
        return out
