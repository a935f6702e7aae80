"""Stress-free shapes of beams: points of a curve at given arc lengths, and the shape functions of elements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.quadrature import gauss_legendre

#: Number of Gauss points for computing the arc length of a curve between two neighbouring given points.
QUADRATURE = 16

#: Number of Newton steps for the position of a node on a curve; the initial guess is close to the solution.
NEWTON_STEPS = 8


class Place(NamedTuple):
    """A point of a curve: position (x, y) [m] and angle of the tangent from the +x axis [rad], not wrapped."""

    x: float
    y: float
    angle: float


class IntegrationPoint(NamedTuple):
    """An integration point of an element.

    `shape`: values of the shape functions of the nodes at this point. `slope`: their derivatives with respect to a
    coordinate that goes from 0 to 1 along the element. `weight`: weight of the point; the weights of an element add up
    to 1.
    """

    shape: tuple[float, ...]
    slope: tuple[float, ...]
    weight: float


def _quadratic(x: float) -> IntegrationPoint:
    """Return the integration point at `x` of a quadratic element, along which `x` goes from -1 to 1."""
    return IntegrationPoint(
        (x * (x - 1.0) / 2.0, 1.0 - x * x, x * (x + 1.0) / 2.0), (2.0 * x - 1.0, -4.0 * x, 2.0 * x + 1.0), 0.5
    )


#: Integration points of elements by their number of nodes.
#:
#: There is one point fewer than needed for exact integration of the shear energy, which prevents slender elements from
#: being too stiff in bending (shear locking).
INTEGRATION = {
    2: (IntegrationPoint((0.5, 0.5), (-1.0, 1.0), 1.0),),
    3: (_quadratic(-1.0 / math.sqrt(3.0)), _quadratic(1.0 / math.sqrt(3.0))),
}

#: Shares of the mass and load of an element that are assigned to its nodes, by the number of nodes.
#:
#: Elements with two nodes follow the trapezoidal rule, elements with three nodes Simpson's rule.
NODE_SHARES = {2: (0.5, 0.5), 3: (1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0)}

#: Corrections of the trapezoidal rule at the first three nodes, and in reverse order at the last three nodes.
#:
#: They are given as shares of the length of an element. The corrected rule is Gregory's rule with second differences,
#: which integrates cubic functions exactly. For two elements it equals Simpson's rule, and for three the 3/8 rule.
END_CORRECTIONS = (-1.0 / 8.0, 1.0 / 6.0, -1.0 / 24.0)


def straight(a: Sequence[float], b: Sequence[float], count: int) -> list[Place]:
    """Return `count` equidistant points of the line from `a` to `b`, both (x, y) [m]."""
    angle = elementary.atan2(b[1] - a[1], b[0] - a[0])
    parts = [i / (count - 1) for i in range(count)]
    return [Place((1.0 - t) * a[0] + t * b[0], (1.0 - t) * a[1] + t * b[1], angle) for t in parts]


def curved(points: Sequence[Sequence[float]], count: int) -> tuple[list[Place], float]:
    """Return `count` points at equal arc lengths on the curve through given points, and the length of the curve [m].

    The curve is a cubic spline, with "not-a-knot" end conditions, whose parameter is the length along the polygon
    through the points. Through three points, it is a parabola.

    `points`: three or more points (x, y) [m]; neighbours must differ.
    """
    from scipy.interpolate import CubicSpline

    corners = np.array(points, dtype=float)
    knots = np.concatenate([[0.0], np.cumsum(elementary.hypot(*np.diff(corners, axis=0).T))])
    curve = CubicSpline(knots, corners)
    rate = curve.derivative()
    nodes, weights = gauss_legendre(QUADRATURE)

    def lengths(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Return the arc lengths between parameters of the curve within one piece."""
        half = 0.5 * (end - begin)
        at = (begin + half)[:, None] + half[:, None] * nodes
        return np.asarray(np.sum(elementary.hypot(*np.moveaxis(rate(at), -1, 0)) * weights, axis=-1) * half)

    whole = np.concatenate([[0.0], np.cumsum(lengths(knots[:-1], knots[1:]))])
    wanted = np.linspace(0.0, whole[-1], count)
    piece = np.clip(np.searchsorted(whole, wanted, side="right") - 1, 0, len(knots) - 2)
    at = np.interp(wanted, whole, knots)
    for _ in range(NEWTON_STEPS):
        at -= (whole[piece] + lengths(knots[piece], at) - wanted) / elementary.hypot(*rate(at).T)
    dx, dy = rate(at).T
    angles = np.unwrap(elementary.atan2(dy, dx))
    return [Place(*point) for point in np.column_stack([curve(at), angles]).tolist()], float(whole[-1])


def with_ends(forces: np.ndarray, angles: np.ndarray, length: float) -> np.ndarray:
    """Return internal forces in the middle of the elements of a beam, and at both of its ends.

    The force at an end is extrapolated in the global frame, in which it varies little where a beam is bent: by the
    parabola through the values of the three nearest elements, linearly from two elements, or as a constant from a
    single element. The moment at an end follows by equilibrium from the moment in the middle of the outermost element:
    m' = -r' x n, where m is the moment, n the force, and r' the derivative of the position with respect to the arc
    length. With any number of two-node elements, or with at least two elements of three nodes, the moment at the clamp
    of a cantilever under its own weight then agrees with beam theory.

    Parameters
    ----------
    forces
        (..., E, 3) axial force, shear force [N] and moment [N m], in the order of the elements. Those of an element
        with three nodes are the means of the values at its two Gauss points, each in the directions of its section.
    angles
        (..., E + 1) or (..., 2 E + 1) angles of the nodes [rad].
    length
        Length of an element [m].

    Returns
    -------
    np.ndarray
        (..., E + 2, 3) values at end a, in the middle of the elements, and at end b.
    """
    elements = forces.shape[-2]
    has_middle = angles.shape[-1] > elements + 1
    step = 2 if has_middle else 1
    first, last = angles[..., :-1:step], angles[..., step::step]
    mean, center, spread = (first + last) / 2, (first + last) / 2, np.zeros_like(first)
    if has_middle:
        center = angles[..., 1::2]
        mean, spread = (first + last) / 6 + 2 / 3 * center, (last - first) / math.sqrt(12)
    force = _turned(forces[..., :2], mean) / elementary.cos(spread)[..., None]
    ends = []
    for sign, places, own, other in ((1.0, (0, 1, 2), first, last), (-1.0, (-1, -2, -3), last, first)):
        one, two, three = (places[min(k, elements - 1)] for k in range(3))
        change = force[..., one, :] - force[..., two, :]
        at_end = force[..., one, :] + 0.5 * change
        if elements > 2:
            at_end += 0.375 * (change - (force[..., two, :] - force[..., three, :]))
        here, there, middle = own[..., one], other[..., one], center[..., one]
        # An element with two nodes is straight, and its force is constant, because its loads act on the nodes. With
        # three nodes, the mean shear force between the middle and the end is nearly that at a quarter of the length.
        shear = _turned(force[..., one, :], -middle)[..., 1]
        if has_middle:
            quarter = 0.375 * here + 0.75 * middle - 0.125 * there
            shear = _turned(force[..., one, :] + 0.25 * change, -quarter)[..., 1]
            # The mean of the moment at the Gauss points differs from the moment in the middle by its second derivative
            # times h^2 / 24, where h is the length of the element.
            along = _turned(force[..., one, :], -middle)[..., 0]
            shear -= (_turned(change, -middle)[..., 1] - (here - there) * along) / 12
        moment = forces[..., one, 2] + sign * 0.5 * length * shear
        ends.append(np.concatenate([_turned(at_end, -here), moment[..., None]], axis=-1)[..., None, :])
    return np.concatenate([ends[0], forces, ends[1]], axis=-2)


def _turned(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return vectors (..., 2) turned by angles (...) [rad]."""
    cosine, sine = elementary.cos(angle), elementary.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def places_with_ends(length: float, elements: int) -> np.ndarray:
    """Return the arc lengths (E + 2,) [m] at which `with_ends` gives internal forces, for a beam of equal elements."""
    return length / elements * np.array([0.0, *(np.arange(elements) + 0.5), elements])
