"""Stress-free shapes of beams: points of a curve at given arc lengths, and the shape functions of elements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

QUADRATURE = 16
"""Number of Gauss points for computing the arc length of a curve between two neighbouring given points."""

NEWTON_STEPS = 8
"""Number of Newton steps for the position of a node on a curve; the initial guess is close to the solution."""


class Place(NamedTuple):
    """A point of a curve: position (x, y) [m] and angle of the tangent from the +x axis [rad], not wrapped."""

    x: float
    y: float
    angle: float


class IntegrationPoint(NamedTuple):
    """An integration point of an element.

    Attributes
    ----------
    shape
        Values of the shape functions of the nodes at this point.
    slope
        Their derivatives with respect to a coordinate that goes from 0 to 1 along the element.
    weight
        Weight of the point; the weights of an element add up to 1.
    """

    shape: tuple[float, ...]
    slope: tuple[float, ...]
    weight: float


def _quadratic(x: float) -> IntegrationPoint:
    """Return the integration point at `x` of a quadratic element, along which `x` goes from -1 to 1."""
    return IntegrationPoint(
        (x * (x - 1.0) / 2.0, 1.0 - x * x, x * (x + 1.0) / 2.0), (2.0 * x - 1.0, -4.0 * x, 2.0 * x + 1.0), 0.5
    )


INTEGRATION = {
    2: (IntegrationPoint((0.5, 0.5), (-1.0, 1.0), 1.0),),
    3: (_quadratic(-1.0 / math.sqrt(3.0)), _quadratic(1.0 / math.sqrt(3.0))),
}
"""Integration points of elements by their number of nodes.

There is one point fewer than needed for exact integration of the shear energy, which prevents slender elements from
being too stiff in bending (shear locking).
"""

NODE_SHARES = {2: (0.5, 0.5), 3: (1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0)}
"""Shares of the mass and load of an element that are assigned to its nodes, by the number of nodes.

Elements with two nodes follow the trapezoidal rule, elements with three nodes Simpson's rule.
"""

END_CORRECTIONS = (-1.0 / 8.0, 1.0 / 6.0, -1.0 / 24.0)
"""Corrections of the trapezoidal rule at the first three nodes, and in reverse order at the last three nodes.

They are given as shares of the length of an element. The corrected rule is Gregory's rule with second differences,
which integrates cubic functions exactly. For two elements it equals Simpson's rule, and for three the 3/8 rule.
"""


def straight(a: Sequence[float], b: Sequence[float], count: int) -> list[Place]:
    """Return `count` equidistant points of the line from `a` to `b`, both (x, y) [m]."""
    angle = math.atan2(b[1] - a[1], b[0] - a[0])
    parts = [i / (count - 1) for i in range(count)]
    return [Place((1.0 - t) * a[0] + t * b[0], (1.0 - t) * a[1] + t * b[1], angle) for t in parts]


def curved(points: Sequence[Sequence[float]], count: int) -> tuple[list[Place], float]:
    """Return `count` points at equal arc lengths on the curve through given points, and the length of the curve [m].

    The curve is a cubic spline, with "not-a-knot" end conditions, whose parameter is the length along the polygon
    through the points. Through three points, it is a parabola.

    Parameters
    ----------
    points
        Three or more points (x, y) [m]; neighbours must differ.
    """
    from scipy.interpolate import CubicSpline

    corners = np.array(points, dtype=float)
    knots = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    curve = CubicSpline(knots, corners)
    rate = curve.derivative()
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE)

    def lengths(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Return the arc lengths between parameters of the curve within one piece."""
        half = 0.5 * (end - begin)
        at = (begin + half)[:, None] + half[:, None] * nodes
        return np.asarray(np.hypot(*np.moveaxis(rate(at), -1, 0)) @ weights * half)

    whole = np.concatenate([[0.0], np.cumsum(lengths(knots[:-1], knots[1:]))])
    wanted = np.linspace(0.0, whole[-1], count)
    piece = np.clip(np.searchsorted(whole, wanted, side="right") - 1, 0, len(knots) - 2)
    at = np.interp(wanted, whole, knots)
    for _ in range(NEWTON_STEPS):
        at -= (whole[piece] + lengths(knots[piece], at) - wanted) / np.hypot(*rate(at).T)
    dx, dy = rate(at).T
    angles = np.unwrap(np.arctan2(dy, dx))
    return [Place(*place) for place in np.column_stack([curve(at), angles]).tolist()], float(whole[-1])


def with_ends(forces: np.ndarray, length: float, nodes: int) -> np.ndarray:
    """Return internal forces in the middle of the elements of a beam, and at both of its ends.

    Axial and shear forces at an end are extrapolated by the parabola through the values of the three nearest elements,
    linearly from two elements, or as a constant from a single element. The moment at an end follows by equilibrium from
    the moment in the middle of the outermost element: m' = -r' x n, where m is the moment, n the force, and r' the
    derivative of the position with respect to the arc length. With any number of elements, the moment at the clamp of a
    cantilever under its own weight then agrees with beam theory.

    Parameters
    ----------
    forces
        (..., E, 3) axial force, shear force [N] and moment [N m], in the order of the elements.
    length
        Length of an element [m].
    nodes
        Number of nodes of an element, 2 or 3.

    Returns
    -------
    np.ndarray
        (..., E + 2, 3) values at end a, in the middle of the elements, and at end b.
    """
    ends = []
    for sign, first, second in ((1.0, 0, min(1, forces.shape[-2] - 1)), (-1.0, -1, max(-2, -forces.shape[-2]))):
        middle, change = forces[..., first, :], forces[..., first, :] - forces[..., second, :]
        end = middle + 0.5 * change
        if forces.shape[-2] > 2:
            third = forces[..., second + (second - first), :]
            end += 0.375 * (change - (forces[..., second, :] - third))
        # The moment of an element with three nodes is the mean of its values at two Gauss points. Under a distributed
        # load w, this mean differs from the moment in the middle by w h^2 / 24, where h is the length of the element.
        # The mean shear force between the middle and the end is the shear force at a quarter of the length.
        shear = middle[..., 1] + ((1 / 4 - 1 / 12) * change[..., 1] if nodes == 3 else 0.0)
        end[..., 2] = middle[..., 2] + sign * 0.5 * length * shear
        ends.append(end[..., None, :])
    return np.concatenate([ends[0], forces, ends[1]], axis=-2)


def places_with_ends(length: float, elements: int) -> np.ndarray:
    """Return the arc lengths (E + 2,) [m] at which `with_ends` gives internal forces, for a beam of equal elements."""
    return length / elements * np.array([0.0, *(np.arange(elements) + 0.5), elements])
