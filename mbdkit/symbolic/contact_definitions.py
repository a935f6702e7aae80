"""Contacts in SymPy: gap, normal, forces and slip of two shapes, and the functions that evaluate them.

The first body has a line, polygon, circle or hole as its outline; the second body has a circle with center c and radius
r, or a point, for which r = 0. The normal n points from the first body to the second. The normal force N and the
friction force T act at the point ``P = c - n (r + gap/2)``, midway between the two outlines. The velocity of the second
body at P, relative to that of the first body at P, has the component ``gap'`` along n and the slip along t, which is n
turned by -90 degrees. The force on the second body is ``N n + T t``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import sympy as sp
from sympy.printing.numpy import NumPyPrinter

from mbdkit.mechanism.joint_friction import regularised_friction

FIRST = sp.symbols("x1 y1 th1 vx1 vy1 w1", real=True)
SECOND = sp.symbols("x2 y2 th2 vx2 vy2 w2", real=True)
"""Position, angle, velocity and angular velocity of the first and of the second body."""
cx, cy, r = CIRCLE = sp.symbols("cx cy r", real=True)
"""Center of the circle in the frame of the second body, and its radius."""
LAW = sp.symbols("stiffness dissipation release curvature static kinetic transition", positive=True)
"""Parameters of the laws of normal force and friction; see `mbdkit.mechanism.contacts.Contact.law_numbers`."""
LAWS = ("none", "hertz", "linear", "smooth")
"""Laws of the normal force; rigid contacts use ``none``."""

CF, BD, BV = 1e-5, 300.0, 50.0
"""Smoothing constants of Simbody's SmoothSphereHalfSpaceForce, with the default values of OpenSim."""

choose = sp.Function("choose")
"""``choose(x, a, b)`` is a where x > 0, and b elsewhere. SymPy would rearrange nested ``Piecewise`` expressions, which
takes minutes for polygons.
"""

VALUES = ("gap", "normal_force", "friction_force", "slip")
WRENCHES = ("x1", "y1", "torque1", "x2", "y2", "torque2")
"""Force (x, y) and torque about the centre of mass, first those on the first body, then those on the second."""
PLACES = ("point_x", "point_y", "normal_x", "normal_y")
"""Names of the global coordinates of the point P at which the forces act, and of the normal."""


def numbers_of(kind: tuple[str, int]) -> tuple[sp.Symbol, ...]:
    """Return the symbols of the parameters of a kind of geometry, in the order of `ContactPair.numbers`."""
    name, count = kind
    if name == "line":
        return (*CIRCLE, *sp.symbols("px py mx my", real=True))
    if name in ("circles", "hole"):
        return (*CIRCLE, *sp.symbols("px py other", real=True))
    edges = [one for i in range(count) for one in sp.symbols(f"px{i} py{i} mx{i} my{i}", real=True)]
    around = sp.symbols("ax ay bx by ex ey", real=True) if name == "edge" else ()
    return (*CIRCLE, *around, *edges)


class Steps:
    """Assigns symbols to intermediate quantities in the order of their computation, so that formulas stay small."""

    def __init__(self) -> None:
        self.named: list[tuple[sp.Symbol, sp.Expr]] = []

    def __call__(self, expression: sp.Expr) -> sp.Expr:
        """Return a symbol that stands for an expression; numbers and symbols are returned unchanged."""
        if expression.is_Atom:
            return expression
        symbol = sp.Symbol(f"s{len(self.named)}", real=True)
        self.named.append((symbol, expression))
        return symbol

    def rotated(self, angle: sp.Expr, x: sp.Expr, y: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """Return a vector rotated by an angle."""
        c, s = self(sp.cos(angle)), self(sp.sin(angle))
        return self(c * x - s * y), self(s * x + c * y)

    def direction(self, dx: sp.Expr, dy: sp.Expr) -> tuple[sp.Expr, sp.Expr, sp.Expr]:
        """Return the length of a vector and its direction, which is (0, 0) where the length is 0."""
        square = self(dx**2 + dy**2)
        divisor = self(sp.sqrt(choose(square, square, 1)))
        return self(choose(square, divisor, 0)), self(dx / divisor), self(dy / divisor)


Outline = tuple[sp.Expr, sp.Expr, sp.Expr, sp.Expr]
"""Gap, normal (x, y), and a number that is positive where this geometry may exert a force."""


def geometry(kind: tuple[str, int], step: Steps) -> Outline:
    """Return gap, normal in the global frame, and the condition for a force (see `Outline`) of a kind of geometry."""
    (x1, y1, th1), (x2, y2, th2) = FIRST[:3], SECOND[:3]
    px, py = step.rotated(th2, cx, cy)
    # vector from the first body's centre of mass to the center of the circle
    gx, gy = step(x2 + px - x1), step(y2 + py - y1)
    numbers = numbers_of(kind)[3:]
    if kind[0] in ("circles", "hole"):
        ox, oy = step.rotated(th1, *numbers[:2])
        distance, nx, ny = step.direction(gx - ox, gy - oy)
        if kind[0] == "hole":  # the wall pushes the circle towards the center
            return numbers[2] - r - distance, -nx, -ny, sp.Integer(1)
        return distance - r - numbers[2], nx, ny, sp.Integer(1)
    ux, uy = step.rotated(-th1, gx, gy)  # the center of the circle in the frame of the first body
    of_kind = {"line": _of_line, "inside": _of_corner, "edge": _of_edge}[kind[0]]
    gap, mx, my, active = of_kind(ux, uy, numbers, step)
    return gap, *step.rotated(th1, mx, my), active


def _of_line(ux: sp.Expr, uy: sp.Expr, numbers: Sequence[sp.Symbol], step: Steps) -> Outline:
    px, py, mx, my = numbers
    return (ux - px) * mx + (uy - py) * my - r, mx, my, sp.Integer(1)


def _of_corner(ux: sp.Expr, uy: sp.Expr, edges: Sequence[sp.Symbol], step: Steps) -> Outline:
    """Return the outline for a corner (circle of radius r) against a polygon.

    A corner inside is pushed out through the nearest edge. Outside, the gap is the largest distance from the lines
    through the edges. `edges` has a point and a normal of each edge.
    """
    rows = [edges[i : i + 4] for i in range(0, len(edges), 4)]
    (height, mx, my), *others = [(step((ux - px) * mx + (uy - py) * my), mx, my) for px, py, mx, my in rows]
    for other, ox, oy in others:
        more = step(other - height)
        height, mx, my = step(choose(more, other, height)), step(choose(more, ox, mx)), step(choose(more, oy, my))
    return height - r, mx, my, sp.Integer(1)


def _of_edge(ux: sp.Expr, uy: sp.Expr, numbers: Sequence[sp.Symbol], step: Steps) -> Outline:
    """Return the outline for an edge of a polygon, from b to e, and its corner b, at which the preceding edge from a
    ends.

    This geometry exerts a force if its edge or its corner b is the part of the polygon nearest to the circle; elsewhere
    its gap is the distance from the edge.
    """
    ax, ay, bx, by, ex, ey = numbers[:6]
    deepest = step(_of_corner(ux, uy, numbers[6:], step)[0] + r)
    size, tx, ty = step.direction(ex - bx, ey - by)
    along, height = step((ux - bx) * tx + (uy - by) * ty), step((ux - bx) * ty - (uy - by) * tx)
    before, fx, fy = step.direction(bx - ax, by - ay)
    past = step((ux - ax) * fx + (uy - ay) * fy - before)
    to_corner, dx, dy = step.direction(ux - bx, uy - by)
    to_end, _, _ = step.direction(ux - ex, uy - ey)

    def where_it_is(at_corner: sp.Expr, at_end: sp.Expr, at_edge: sp.Expr, inside: sp.Expr) -> sp.Expr:
        outside = choose(-along, at_corner, choose(along - size, at_end, at_edge))
        return step(choose(deepest, outside, inside))

    # positive also behind the edge, so that a circle outside another edge does not overlap with this one
    far = choose(height, height, -height)
    distance = where_it_is(to_corner, to_end, far, choose(deepest - height, -height, height))
    mx, my = where_it_is(dx, tx, ty, ty), where_it_is(dy, ty, -tx, -tx)
    active = where_it_is(choose(past, 1, 0), sp.Integer(0), choose(height, 1, 0), choose(deepest - height, 0, 1))
    return distance - r, mx, my, active


def normal_force(law: str, depth: sp.Expr, rate: sp.Expr) -> sp.Expr:
    """Return the normal force of a law for an indentation and its rate."""
    k, c, release, curvature = LAW[:4]
    if law == "none":
        return sp.Integer(0)
    if law == "smooth":
        modulus = k ** sp.Rational(2, 3) / 2
        hertz = sp.Rational(4, 3) * modulus * sp.sqrt(curvature * modulus)
        hertz *= sp.sqrt(depth**2 + CF) ** sp.Rational(3, 2) * (1 + sp.tanh(BD * depth)) / 2
        return hertz * (1 + sp.Rational(3, 2) * c * rate) * (1 + sp.tanh(BV * (rate + release))) / 2
    if law == "linear":
        pushed = k * depth + c * rate
    else:
        pushed = k * depth ** sp.Rational(3, 2) * (1 + sp.Rational(3, 2) * c * rate)
    return choose(depth, choose(pushed, pushed, 0), 0)


def friction_force(law: str, normal: sp.Expr, slip: sp.Expr) -> sp.Expr:
    """Return Coulomb's friction force; see `mbdkit.mechanism.joint_friction.regularised_friction`.

    The law ``smooth`` replaces the magnitude of the slip by ``sqrt(slip^2 + CF)``, as SmoothSphereHalfSpaceForce does.
    """
    if law != "smooth":
        return regularised_friction(normal, slip, LAW[4:], choose)
    static, kinetic, transition = LAW[4:]
    square = slip**2 + CF
    ratio = square / transition**2
    size = kinetic + 2 * (static - kinetic) / (1 + ratio)
    share = slip / sp.sqrt(square) * choose(1 - ratio, sp.sqrt(ratio), 1)
    return -normal * size * share


@dataclass(frozen=True)
class Definition:
    """Formulas for the quantities of a contact.

    Attributes
    ----------
    steps
        Symbols of intermediate quantities with their expressions in `FIRST`, `SECOND`, the parameters of the geometry,
        `LAW` and earlier intermediate quantities.
    quantities
        Expressions for `VALUES`, `WRENCHES` and `PLACES`, in this order.
    """

    steps: tuple[tuple[sp.Symbol, sp.Expr], ...]
    quantities: tuple[sp.Expr, ...]


def sliding(
    second: tuple[sp.Expr, sp.Expr], first: tuple[sp.Expr, sp.Expr], normal: tuple[sp.Expr, sp.Expr], step: Steps
) -> tuple[sp.Expr, sp.Expr]:
    """Return the slip and the rate of the gap at a point. `second` and `first` are the vectors to the point from the
    centres of mass of the second and of the first body.
    """
    (*_, vx1, vy1, w1), (*_, vx2, vy2, w2) = FIRST, SECOND
    (px, py), (ox, oy), (nx, ny) = second, first, normal
    vx, vy = step(vx2 - w2 * py - vx1 + w1 * oy), step(vy2 + w2 * px - vy1 - w1 * ox)
    return step(vx * ny - vy * nx), step(vx * nx + vy * ny)


@lru_cache(maxsize=64)
def definition(kind: tuple[str, int], law: str, has_friction: bool) -> Definition:
    """Return the formulas of a contact.

    Parameters
    ----------
    kind
        Kind of geometry, which is ``line``, ``circles``, ``hole``, ``inside`` or ``edge``, and the number of edges of
        the polygon.
    law
        One of `LAWS`.
    has_friction
        Whether there is friction.
    """
    step = Steps()
    gap, nx, ny, active = (step(one) for one in geometry(kind, step))
    (x1, y1), (x2, y2, th2) = FIRST[:2], SECOND[:3]
    px, py = step.rotated(th2, cx, cy)
    # vector to P from the second body's centre of mass
    px, py = (step(p - (r + gap / 2) * n) for p, n in ((px, nx), (py, ny)))
    ox, oy = step(x2 + px - x1), step(y2 + py - y1)
    slip, rate = sliding((px, py), (ox, oy), (nx, ny), step)
    normal = step(choose(active, normal_force(law, -gap, -rate), 0) if active != 1 else normal_force(law, -gap, -rate))
    friction = step(friction_force(law, normal, slip)) if has_friction else sp.Integer(0)
    fx, fy = step(normal * nx + friction * ny), step(normal * ny - friction * nx)
    wrenches = (-fx, -fy, oy * fx - ox * fy, fx, fy, px * fy - py * fx)
    places = (x2 + px, y2 + py, nx, ny)
    return Definition(tuple(step.named), (gap, normal, friction, slip, *wrenches, *places))


class _Printer(NumPyPrinter):
    """Writes powers as products and roots, whose rounding does not depend on the length of arrays."""

    def _print_Pow(self, expr: Any, rational: bool = False) -> str:
        if expr.exp == sp.Rational(3, 2):
            base = self._print(expr.base)
            return f"(({base})*sqrt({base}))"
        if expr.exp == sp.Rational(3, 4):
            base = self._print(expr.base)
            return f"(sqrt({base})*sqrt(sqrt({base})))"
        written: str = super()._print_Pow(expr, rational=rational)
        return written


@lru_cache(maxsize=64)
def contact_function(kind: tuple[str, int], law: str, has_friction: bool) -> Callable[..., list[Any]]:
    """Return a function that evaluates the `definition` for numbers, arrays, or traced operands."""
    arguments = (*FIRST, *SECOND, *numbers_of(kind), *LAW)
    functions = {"choose": _choose, **{name: _of_each(name) for name in ("cos", "sin", "tanh")}}
    defined = definition(kind, law, has_friction)
    found: Callable[..., list[Any]] = sp.lambdify(
        arguments,
        list(defined.quantities),
        modules=[functions, "numpy"],
        printer=_Printer({"fully_qualified_modules": False, "inline": True, "allow_unknown_functions": True}),
        cse=lambda quantities: (defined.steps, quantities),
    )
    return found


def _choose(condition: Any, first: Any, second: Any) -> Any:
    return np.where(condition > 0.0, first, second)


def _of_each(name: str) -> Callable[[Any], Any]:
    """Return a function that evaluates the items of arrays one by one. NumPy's own functions round differently for
    arrays of different lengths.
    """
    of_any, of_number = getattr(np, name), getattr(math, name)

    def function(x: Any) -> Any:
        if isinstance(x, np.ndarray):
            return np.array([of_number(item) for item in x.ravel().tolist()]).reshape(x.shape)
        return of_any(x)

    return function
