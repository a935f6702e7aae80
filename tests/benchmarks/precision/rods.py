"""Equal rods in a row in their absolute angles alone, written down twice: by joint forces, and by Lagrange.

theta are the rods' angles from the +x axis, e = (cos theta, sin theta) and e' = (-sin theta, cos theta) of each rod.
The force F_i at the inner end of rod i moves it together with -F_(i+1) at the outer end,

    m a_i = F_i - F_(i+1) + m g          J theta_i'' = -L/2 e'_i . (F_i + F_(i+1)),

and that the ends of neighbours stay together is a block tridiagonal, positive definite system for the forces: n rods
cost O(n). Lagrange's equations of the second kind are dense instead, with M_ij = K_ij cos(theta_i - theta_j),

    sum_j K_ij (cos(theta_i - theta_j) theta_j'' + sin(theta_i - theta_j) theta_j'^2) = -g k_i cos theta_i.

Nothing of mbdkit is used here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpbsv

Array = NDArray[np.floating[Any]]
RightSide = Callable[[float, Array], Any]

GRAVITY = 9.81


@dataclass(frozen=True)
class Rods:
    """`count` uniform rods, the first one hung from the origin; states are (theta, theta'), shape (2 n,).

    Parameters
    ----------
    count
        Number of rods n.
    length, mass
        Of each [m], [kg].
    """

    count: int
    length: float = 1.0
    mass: float = 1.0

    def centres(self, angles: Array) -> Array:
        """Return the rods' centres (n, 2) [m]."""
        along = self.length * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return np.cumsum(along, axis=0) - along / 2

    def right_side(self) -> RightSide:
        """Return the derivative of the state as a user in a hurry for speed writes it: scalars for two rods."""
        return self._two() if self.count == 2 else self._many()

    def _two(self) -> RightSide:
        """Return theta'' of two rods by Cramer's rule in Python's floats, which NumPy is slower than at this size."""
        cos, sin = math.cos, math.sin
        gravity = GRAVITY / self.length

        def rates(time: float, state: Array) -> list[float]:
            a, b, u, v = state.tolist()
            cosine, sine = 0.5 * cos(a - b), 0.5 * sin(a - b)
            p = -1.5 * gravity * cos(a) - sine * v * v
            q = -0.5 * gravity * cos(b) + sine * u * u
            determinant = 4 / 9 - cosine * cosine
            return [u, v, (p / 3 - cosine * q) / determinant, (4 / 3 * q - cosine * p) / determinant]

        return rates

    def _many(self) -> RightSide:
        """Return theta'' by the banded system, in whole vectors and one call of LAPACK."""
        n, length, mass = self.count, self.length, self.mass
        k, half = 3.0 / mass, 0.5 * length  # k = (L/2)^2 / J
        turn = -half / (mass * length * length / 12)
        band = np.zeros((4, 2 * n), order="F")
        right = np.empty((n, 2))
        forces = np.zeros((n + 1, 2))
        unit, across, whirl, square = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 3))

        def rates(time: float, state: Array) -> Array:
            angles, speeds = state[:n], state[n:]
            np.cos(angles, out=unit[:, 0])
            np.sin(angles, out=unit[:, 1])
            across[:, 0], across[:, 1] = -unit[:, 1], unit[:, 0]
            square[:, 0::2] = across * across
            square[:, 1] = across[:, 0] * across[:, 1]
            np.multiply(square, k, out=square)
            band[0, 0::2], band[0, 1::2], band[1, 0::2] = square[:, 0], square[:, 2], square[:, 1]
            band[0, 2:] += band[0, :-2].copy()
            band[1, 2::2] += square[:-1, 1]
            band[0] += 2 / mass
            band[0, :2] -= 1 / mass
            band[1, 1::2] = square[:, 1]
            band[2, 0::2], band[2, 1::2] = square[:, 0], square[:, 2]
            band[2] -= 1 / mass
            band[3, 0::2] = square[:, 1]
            np.multiply((half * speeds * speeds)[:, None], unit, out=whirl)
            np.negative(whirl, out=right)
            right[1:] -= whirl[:-1]
            right[0, 1] += GRAVITY
            forces[:n] = dpbsv(band, right.reshape(-1), lower=1)[1].reshape(n, 2)
            out = np.empty(2 * n)  # solvers keep what they are given
            out[:n] = speeds
            np.multiply(turn, np.einsum("ij,ij->i", across, forces[:-1] + forces[1:]), out=out[n:])
            return out

        return rates

    def by_joint_forces(self, time: Any, state: Array) -> Array:
        """Return the derivative of a state of any float type: the banded solution, refined in that type."""
        kind = state.dtype.type
        n, mass, length = self.count, kind(self.mass), kind(self.length)
        half, k = length / 2, kind(3) / mass
        angles, speeds = state[:n], state[n:]
        unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        across = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
        whirl = half * (speeds * speeds)[:, None] * unit
        right = -whirl
        right[1:] -= whirl[:-1]
        right[0, 1] += kind(GRAVITY)
        band = self._band(np.asarray(across, dtype=float))
        forces = np.zeros((n + 1, 2), dtype=state.dtype)
        for _ in range(4):
            projected = k * np.einsum("ij,ij->i", across, forces[:-1] + forces[1:])[:, None] * across
            drawn = (forces[:-1] - forces[1:]) / mass
            rest = right - drawn - projected
            rest[1:] += drawn[:-1] - projected[:-1]
            forces[:n] += dpbsv(band, np.asarray(rest, dtype=float).reshape(-1), lower=1)[1].reshape(n, 2)
        turn = -half / (mass * length * length / 12)
        return np.concatenate([speeds, turn * np.einsum("ij,ij->i", across, forces[:-1] + forces[1:])])

    def _band(self, across: Array) -> Array:
        """Return the lower band (4, 2 n) of the forces' matrix."""
        square = 3.0 / self.mass * np.einsum("ni,nj->nij", across, across)
        one = np.eye(2) / self.mass
        diagonal = one + square
        diagonal[1:] += one + square[:-1]
        beside = square - one
        band = np.zeros((4, 2 * self.count), order="F")
        band[0, 0::2], band[0, 1::2] = diagonal[:, 0, 0], diagonal[:, 1, 1]
        band[1, 0::2], band[1, 1::2] = diagonal[:, 1, 0], beside[:, 0, 1]
        band[2, 0::2], band[2, 1::2] = beside[:, 0, 0], beside[:, 1, 1]
        band[3, 0::2] = beside[:, 1, 0]
        return band

    @cached_property
    def lagrange_constants(self) -> tuple[Array, Array]:
        """Return K (n, n) and k (n,) of Lagrange's equations over m L^2 and m L, exact in double precision times 6."""
        outer = self.count - 1.0 - np.arange(self.count)
        constants = 6 * np.minimum.outer(outer, outer) + 3
        constants[np.diag_indices(self.count)] -= 1
        return constants, 6 * outer + 3

    def by_lagrange(self, time: Any, state: Array) -> Array:
        """Return the derivative of a state of any float type: the dense solution, refined in that type."""
        kind = state.dtype.type
        n = self.count
        K, weight = (constants.astype(state.dtype) for constants in self.lagrange_constants)
        angles, speeds = state[:n], state[n:]
        cosine, sine = np.cos(angles), np.sin(angles)
        squares = speeds * speeds
        right = cosine * (K @ (sine * squares)) - sine * (K @ (cosine * squares))
        right -= kind(GRAVITY) / kind(self.length) * weight * cosine
        c, s, double = np.asarray(cosine, dtype=float), np.asarray(sine, dtype=float), self.lagrange_constants[0]
        factor = cho_factor(double * (np.outer(c, c) + np.outer(s, s)))
        turn = np.zeros(n, dtype=state.dtype)
        for _ in range(4):
            rest = right - cosine * (K @ (cosine * turn)) - sine * (K @ (sine * turn))
            turn += cho_solve(factor, np.asarray(rest, dtype=float))
        return np.concatenate([speeds, turn])
