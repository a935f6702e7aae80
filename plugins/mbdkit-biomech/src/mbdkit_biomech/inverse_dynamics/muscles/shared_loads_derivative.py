"""Derivatives of the solution of recruitment with respect to parameters of its programmes.

The implicit function theorem is applied to the optimality conditions. Unknowns at their bounds stay there. For the cost
f, the matrix A and the right sides b of the equations, the other unknowns x and the multipliers y of the equations
satisfy

    f'(x) = A^T y,    A x = b.

Their changes are therefore the solution of

    f''(x) dx - A^T dy = dA^T y - df'(x),    A dx = db - dA x,

where ``df'`` is the change of f' with its parameters, the weights. If an unknown is about to leave or to reach a bound,
the result is a one-sided derivative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.linear_systems import products, pseudoinverses
from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import Shared

#: Lower bound of the second derivatives of the cost, relative to the largest one in a frame; smaller ones are raised to
#: this bound.
#:
#: For exponents above 2, the second derivative vanishes at x = 0.
LEAST_CURVATURE = 1e-12
#: Singular values below this share of the largest one belong to equations that contain no free unknown.
NEGLIGIBLE = 1e-13
REFINEMENTS = 2  #: Number of iterative refinements of the solution, which remove rounding errors.


@dataclass(frozen=True)
class ProgrammeChange:
    """Derivatives of programmes with respect to one parameter; the arrays have the shapes of those in `Programme`."""

    matrix: np.ndarray
    right: np.ndarray
    weight: np.ndarray


def change_of_shares(programme: Programme, shared: Shared, exponent: float, change: ProgrammeChange) -> np.ndarray:
    """Return the derivatives (T, N) of the solutions with respect to one parameter.

    Parameters
    ----------
    programme, shared
        The programmes and their solutions.
    exponent
        p > 1, finite.
    change
        Derivatives of the programmes; their bounds are constant.
    """
    x, y, weight = shared.value, shared.multipliers, programme.weight
    is_free = (x > programme.low) & (x < programme.high)
    share = np.abs(x) / weight
    slope = exponent * np.sign(x) * elementary.pow(share, exponent - 1) / weight
    curvature = exponent * (exponent - 1) * elementary.pow(share, exponent - 2) / weight**2
    curvature = np.maximum(curvature, LEAST_CURVATURE * np.max(curvature, axis=1, keepdims=True))
    flexibility = np.where(is_free, 1.0 / curvature, 0.0)
    size = programme.size
    matrix = programme.matrix / size[..., None]
    pulled = products(np.swapaxes(change.matrix, 1, 2), y) + slope * exponent / weight * change.weight
    needed = (change.right - products(change.matrix, x)) / size
    normal = products(matrix * flexibility[:, None], np.swapaxes(matrix, 1, 2))
    inverse = pseudoinverses(normal, NEGLIGIBLE)
    values: np.ndarray = flexibility * pulled
    for _ in range(1 + REFINEMENTS):
        left = needed - products(matrix, values)
        values = values + flexibility * products(np.swapaxes(matrix, 1, 2), products(inverse, left))
    return values
