"""Constraint rows of rigid contacts: gap and slip, their gradients, and the velocity-dependent terms of their second
time derivatives.

The first body has a line, circle or hole as its outline; the second body has a circle with center c and radius r, or a
point, for which r = 0. The normal n points from the first body to the second. The velocity of the second body at the
point ``c - n r``, relative to that of the first body there, has the component ``gap'`` along n and the slip along t,
which is n turned by -90 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

FIRST = sp.symbols("x1 y1 th1 vx1 vy1 w1", real=True)
#: Position, angle, velocity and angular velocity of the first and of the second body.
SECOND = sp.symbols("x2 y2 th2 vx2 vy2 w2", real=True)
#: Center of the circle in the frame of the second body, and its radius.
cx, cy, r = CIRCLE = sp.symbols("cx cy r", real=True)

choose = sp.Function("choose")  #: ``choose(x, a, b)`` is a where x > 0, and b elsewhere.

TURNED = sp.symbols("cos1 sin1 cos2 sin2", real=True)  #: Cosine and sine of the angles of both bodies.

_ANGLES = (FIRST[2], SECOND[2])
_BY_TURN = dict(zip((f(angle) for angle in _ANGLES for f in (sp.cos, sp.sin)), TURNED, strict=True))
#: Symbols in the formulas: for each body x, y, cosine and sine of its angle, and its velocities. The parameters of the
#: geometry follow.
ARGUMENTS = (*FIRST[:2], *TURNED[:2], *FIRST[3:], *SECOND[:2], *TURNED[2:], *SECOND[3:])


def numbers_of(kind: str) -> tuple[sp.Symbol, ...]:
    """Return the symbols of the parameters of a kind of geometry, in the order of `ContactPair.numbers`."""
    return (*CIRCLE, *sp.symbols("px py mx my" if kind == "line" else "px py other", real=True))


@dataclass(frozen=True)
class Definition:
    """Formulas for the quantities of a contact row.

    Attributes
    ----------
    steps
        Symbols of intermediate quantities with their expressions in `ARGUMENTS`, the parameters of the geometry and
        earlier intermediate quantities.
    quantities
        Expressions for `QUANTITIES`, in this order.
    """

    steps: tuple[tuple[sp.Symbol, sp.Expr], ...]
    quantities: tuple[sp.Expr, ...]


class NamedSteps:
    """Assigns symbols to intermediate quantities in the order of their computation, so that formulas stay small, and
    differentiates them with respect to time.
    """

    def __init__(self) -> None:
        self.named: list[tuple[sp.Symbol, sp.Expr]] = []
        (x1, y1, _, *rates1), (x2, y2, _, *rates2) = FIRST, SECOND
        (c1, s1, c2, s2), w1, w2 = TURNED, rates1[2], rates2[2]
        #: Rates of the symbols that change with time; all others, including the velocities, are taken as constant.
        self.rates: dict[sp.Basic, sp.Expr] = {
            x1: rates1[0], y1: rates1[1], c1: -s1 * w1, s1: c1 * w1,
            x2: rates2[0], y2: rates2[1], c2: -s2 * w2, s2: c2 * w2,
        }  # fmt: skip

    def __call__(self, expression: sp.Expr) -> sp.Expr:
        """Return a symbol that stands for an expression; numbers and symbols are returned unchanged."""
        expression = expression.xreplace(_BY_TURN)
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

    def rate(self, quantity: sp.Expr) -> sp.Expr:
        """Return the rate of a quantity for constant velocities."""
        known = dict(self.named)
        if quantity in known and quantity not in self.rates:
            self.rates[quantity] = self(self._derivative(known[quantity]))
        return self.rates.get(quantity, sp.Integer(0)) if quantity.is_Atom else self._derivative(quantity)

    def _derivative(self, expression: sp.Expr) -> sp.Expr:
        if expression.func == choose:
            condition, first, second = expression.args
            return choose(condition, self.rate(first), self.rate(second))
        choices = {part: sp.Dummy(real=True) for part in expression.atoms(choose)}
        plain = expression.xreplace(choices)
        back = {dummy: part for part, dummy in choices.items()}
        parts = ((part, plain.diff(part)) for part in sorted(plain.free_symbols, key=str))
        return sp.Add(*(slope.xreplace(back) * self.rate(back.get(part, part)) for part, slope in parts if slope != 0))


def _geometry(kind: str, step: NamedSteps) -> tuple[sp.Expr, sp.Expr, sp.Expr]:
    """Return the gap and the normal (x, y) in the global frame of a kind of geometry: ``line``, ``circles`` or
    ``hole``.
    """
    (x1, y1, th1), (x2, y2, th2) = FIRST[:3], SECOND[:3]
    px, py = step.rotated(th2, cx, cy)
    # vector from the first body's centre of mass to the center of the circle
    gx, gy = step(x2 + px - x1), step(y2 + py - y1)
    numbers = numbers_of(kind)[3:]
    if kind == "line":
        ux, uy = step.rotated(-th1, gx, gy)  # the center of the circle in the frame of the first body
        px, py, mx, my = numbers
        return (ux - px) * mx + (uy - py) * my - r, *step.rotated(th1, mx, my)
    ox, oy = step.rotated(th1, *numbers[:2])
    distance, nx, ny = step.direction(gx - ox, gy - oy)
    if kind == "hole":  # the wall pushes the circle towards the center
        return numbers[2] - r - distance, -nx, -ny
    return distance - r - numbers[2], nx, ny


#: Quantities of a contact row: gap and slip, the rows n and t (6 components each) with ``gap' = n . v`` and
#: ``slip = t . v``, and the right-hand sides of ``n . a = -n' . v`` and ``t . a = -t' . v``. Accelerations that satisfy
#: these equations leave gap' and slip constant.
QUANTITIES = ("gap", "slip", "normal", "tangent", "normal_right", "tangent_right")


def row_definition(kind: str) -> Definition:
    """Return the formulas for the `QUANTITIES` of a kind of geometry."""
    step = NamedSteps()
    gap, *normal = _geometry(kind, step)
    nx, ny = map(step, normal)
    (x1, y1), (x2, y2, th2) = FIRST[:2], SECOND[:3]
    px, py = (step(p - r * n) for p, n in zip(step.rotated(th2, cx, cy), (nx, ny), strict=True))
    ox, oy = step(x2 + px - x1), step(y2 + py - y1)
    (*_, vx1, vy1, w1), (*_, vx2, vy2, w2) = FIRST, SECOND
    vx, vy = step(vx2 - w2 * py - vx1 + w1 * oy), step(vy2 + w2 * px - vy1 - w1 * ox)
    slip, rate = step(vx * ny - vy * nx), step(vx * nx + vy * ny)
    along = [-nx, -ny, oy * nx - ox * ny, nx, ny, px * ny - py * nx]
    across = [-ny, nx, oy * ny + ox * nx, ny, -nx, -py * ny - px * nx]
    quantities = [gap, slip, *along, *across, -step.rate(rate), -step.rate(slip)]
    return Definition(tuple(step.named), tuple(quantity.xreplace(_BY_TURN) for quantity in quantities))
