"""Functions of one coordinate in `.osim` files, and their conversion to moving centers of joints.

OpenSim's `SimmSpline` is the spline of Forsythe, Malcolm and Moler (Computer Methods for Mathematical Computations,
1977): its third derivatives at the ends are those of the cubics through the first four and the last four points.
OpenSim extrapolates it by straight lines. `NaturalCubicSpline` is an earlier name of this class.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
from numpy.polynomial.polynomial import polyadd, polyder, polyval
from scipy.interpolate import PPoly

from mbdkit_opensim.osim_document import label_of, number_of, numbers_of, refused

#: The center of a revolute joint in `Mechanism.revolute`: a number, an expression in `angle`, or a table.
Center = float | str | dict[str, object]


@dataclass(frozen=True)
class Function:
    """A function of a coordinate: a polynomial, or a cubic spline with two continuous derivatives.

    Attributes
    ----------
    polynomial
        Coefficients in ascending powers; empty for a spline.
    spline
        None for a polynomial.
    """

    polynomial: tuple[float, ...]
    spline: PPoly | None = None

    def __call__(self, at: float) -> float:
        """Return the value of the function at a value of the coordinate."""
        return float(polyval(at, self.polynomial) if self.spline is None else self.spline(at))

    def slope(self, at: float) -> float:
        """Return the derivative of the function at a value of the coordinate."""
        return float(polyval(at, polyder(self.polynomial)) if self.spline is None else self.spline(at, 1))

    @property
    def degree(self) -> int:
        """Degree of the polynomial; 3 for a spline."""
        return 3 if self.spline is not None else int(max(np.flatnonzero(self.polynomial), default=0))

    def times(self, factor: float) -> Function:
        """Return the function times a number."""
        spline = None if self.spline is None else PPoly(factor * self.spline.c, self.spline.x)
        return Function(tuple(factor * c for c in self.polynomial), spline)


def constant(value: float) -> Function:
    """Return a constant function."""
    return Function((float(value),))


def function_in(holder: Element, owner: str) -> Function:
    """Return the function that an element contains. If planar mechanisms have no counterpart of it, SpecError is
    raised, with the name `owner`.
    """
    result = holder.find("*[@name='function']")
    if result is None or result.tag in ("coordinates", "axis"):
        return function_named(holder, "function", owner)
    return _function(result, owner)


def function_named(holder: Element, name: str, owner: str) -> Function:
    """Return the function in the property `name` of an element. If the property is no function, SpecError is raised,
    with the name `owner`.
    """
    wrapper = holder.find(name)
    result = None if wrapper is None else next(iter(wrapper), None)
    if result is None:
        raise refused(f"{owner} has no function")
    return _function(result, owner)


def _function(element: Element, owner: str) -> Function:
    match element.tag:
        case "Constant":
            return constant(number_of(element, "value", "0"))
        case "LinearFunction":
            slope, intercept = numbers_of(element, "coefficients", 2, "1 0")
            return Function((float(intercept), float(slope)))
        case "PolynomialFunction":
            coefficients = numbers_of(element, "coefficients", None)
            if not len(coefficients):
                raise refused(f"{owner}: a PolynomialFunction has no coefficients")
            return Function(tuple(coefficients[::-1].tolist()))
        case "MultiplierFunction":
            return function_in(element, owner).times(number_of(element, "scale", "1"))
        case "SimmSpline" | "NaturalCubicSpline" | "PiecewiseLinearFunction":
            return _through_points(element, owner)
    raise refused(f"{owner} has a {element.tag}, which cannot be used here")


def _through_points(element: Element, owner: str) -> Function:
    x, y = (numbers_of(element, tag, None) for tag in "xy")
    if len(x) != len(y) or len(x) < 2 or np.any(np.diff(x) <= 0):
        raise refused(f"{owner}: {label_of(element)} needs two points or more with increasing x, and as many y")
    if len(x) == 2:
        slope = (y[1] - y[0]) / (x[1] - x[0])
        return Function((float(y[0] - slope * x[0]), float(slope)))
    if element.tag in ("SimmSpline", "NaturalCubicSpline"):
        return Function((), simm_spline(x, y))
    raise refused(f"{owner} has a PiecewiseLinearFunction, whose slope jumps; use a SimmSpline")


def simm_spline(x: np.ndarray, y: np.ndarray) -> PPoly:
    """Return the spline through points (n,), n > 2, as OpenSim's `SimmSpline` computes it between the first and last
    point.
    """
    n, h = len(x), np.diff(x)
    slopes = np.diff(y) / h
    matrix, right = np.zeros((n, n)), np.zeros(n)
    for i in range(1, n - 1):
        matrix[i, i - 1 : i + 2] = h[i - 1], 2 * (h[i - 1] + h[i]), h[i]
        right[i] = slopes[i] - slopes[i - 1]
    matrix[0, :2], matrix[-1, -2:] = (-h[0], h[0]), (h[-1], -h[-1])
    if n > 3:  # third divided differences of the outer four points
        second = (slopes[1:] - slopes[:-1]) / (x[2:] - x[:-2])
        third = (second[1:] - second[:-1]) / (x[3:] - x[:-3])
        right[0], right[-1] = h[0] ** 2 * third[0], -(h[-1] ** 2) * third[-1]
    sigma = np.linalg.solve(matrix, right)  # a sixth of the second derivatives
    coefficients = [np.diff(sigma) / h, 3 * sigma[:-1], slopes - h * (sigma[1:] + 2 * sigma[:-1]), y[:-1]]
    return PPoly(np.array(coefficients), x)


def center_of(parts: list[tuple[float, Function]], slope: float, offset: float, owner: str) -> Center:
    """Return a sum of functions of a coordinate as a function of the angle of a joint, for `Mechanism.revolute`.

    Parameters
    ----------
    parts
        Factor and function of each term.
    slope, offset
        The relation between angle and coordinate: the angle [rad] is ``slope * coordinate + offset``.
    owner
        Name of the component for error messages.

    Returns
    -------
    Center
        A number, an expression or a table. The cubic spline of a table equals the sum, up to rounding errors.
    """
    parts = [(factor, function) for factor, function in parts if factor != 0.0]
    splines = [function.spline for _, function in parts if function.spline is not None]
    if not splines:
        total: np.ndarray = np.zeros(1)
        for factor, function in parts:
            total = polyadd(total, factor * np.array(function.polynomial))
        if not np.any(total[1:]):
            return float(total[0])
        text = repr(float(total[-1]))
        for c in total[-2::-1].tolist():
            text = f"({text})*((angle - ({offset!r}))/({slope!r})) + ({c!r})"
        return text
    if any(function.degree > 3 for _, function in parts):
        raise refused(f"{owner} adds a spline to a polynomial of a degree above 3 in one direction")
    knots = np.unique(np.concatenate([spline.x for spline in splines]))
    first, last = (max(s.x[0] for s in splines), min(s.x[-1] for s in splines))
    knots = knots[(knots >= first) & (knots <= last)]
    if len(knots) < 2:
        raise refused(f"{owner} adds splines whose points do not overlap")
    # With a point inside each outer interval, the spline through the table satisfies the condition `not-a-knot`.
    inner = [(2 * knots[0] + knots[1]) / 3, (knots[-2] + 2 * knots[-1]) / 3]
    at = np.unique(np.concatenate([knots, inner]))
    values = [sum(factor * function(q) for factor, function in parts) for q in at.tolist()]
    angles = slope * at + offset
    if slope < 0:
        angles, values = angles[::-1], values[::-1]
    return {"table": [angles.tolist(), [float(value) for value in values]]}
