"""Constraint rows of rigid contacts: gap and slip, their gradients, and the velocity-dependent terms of their second
time derivatives.
"""

from __future__ import annotations

import sympy as sp

from mbdkit.symbolic.contact_definitions import CIRCLE, FIRST, SECOND, Definition, Steps, choose, geometry, sliding

TURNED = sp.symbols("cos1 sin1 cos2 sin2", real=True)
"""Cosine and sine of the angles of both bodies."""

_ANGLES = (FIRST[2], SECOND[2])
_BY_TURN = dict(zip((f(angle) for angle in _ANGLES for f in (sp.cos, sp.sin)), TURNED, strict=True))
ARGUMENTS = (*FIRST[:2], *TURNED[:2], *FIRST[3:], *SECOND[:2], *TURNED[2:], *SECOND[3:])
"""Symbols in the formulas: for each body x, y, cosine and sine of its angle, and its velocities. The parameters of the
geometry follow.
"""


class _Moving(Steps):
    """Assigns symbols to intermediate quantities, and differentiates them with respect to time."""

    def __init__(self) -> None:
        super().__init__()
        (x1, y1, _, *rates1), (x2, y2, _, *rates2) = FIRST, SECOND
        (c1, s1, c2, s2), w1, w2 = TURNED, rates1[2], rates2[2]
        #: Rates of the symbols that change with time; all others, including the velocities, are taken as constant.
        self.rates: dict[sp.Basic, sp.Expr] = {
            x1: rates1[0], y1: rates1[1], c1: -s1 * w1, s1: c1 * w1,
            x2: rates2[0], y2: rates2[1], c2: -s2 * w2, s2: c2 * w2,
        }  # fmt: skip

    def __call__(self, expression: sp.Expr) -> sp.Expr:
        """Return a symbol that stands for an expression."""
        return super().__call__(expression.xreplace(_BY_TURN))

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
        choices = {one: sp.Dummy(real=True) for one in expression.atoms(choose)}
        plain = expression.xreplace(choices)
        back = {dummy: one for one, dummy in choices.items()}
        parts = ((one, plain.diff(one)) for one in sorted(plain.free_symbols, key=str))
        return sp.Add(*(slope.xreplace(back) * self.rate(back.get(one, one)) for one, slope in parts if slope != 0))


QUANTITIES = ("gap", "slip", "normal", "tangent", "normal_right", "tangent_right")
"""Quantities of a contact row: gap and slip, the rows n and t (6 components each) with ``gap' = n . v`` and
``slip = t . v``, and the right-hand sides of ``n . a = -n' . v`` and ``t . a = -t' . v``. Accelerations that satisfy
these equations leave gap' and slip constant.
"""


def row_definition(kind: tuple[str, int]) -> Definition:
    """Return the formulas for the `QUANTITIES` of a kind of geometry."""
    step = _Moving()
    gap, *normal, _ = geometry(kind, step)
    nx, ny = map(step, normal)
    (x1, y1), (x2, y2, th2), (cx, cy, r) = FIRST[:2], SECOND[:3], CIRCLE
    px, py = (step(p - r * n) for p, n in zip(step.rotated(th2, cx, cy), (nx, ny), strict=True))
    ox, oy = step(x2 + px - x1), step(y2 + py - y1)
    slip, rate = sliding((px, py), (ox, oy), (nx, ny), step)
    along = [-nx, -ny, oy * nx - ox * ny, nx, ny, px * ny - py * nx]
    across = [-ny, nx, oy * ny + ox * nx, ny, -nx, -py * ny - px * nx]
    found = [gap, slip, *along, *across, -step.rate(rate), -step.rate(slip)]
    return Definition(tuple(step.named), tuple(quantity.xreplace(_BY_TURN) for quantity in found))
