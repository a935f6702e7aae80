"""Rows of rigid contacts: gap and slip, their gradients, and what velocities add to their second derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import sympy as sp

from mbdkit.symbolic.contact_definitions import CIRCLE, FIRST, SECOND, Steps, geometry, numbers_of, sliding

NEGLIGIBLE = 1e-40
"""Square of a distance [m^2] that is added to others, so that a circle in the middle of a hole can be evaluated."""


class _Whole(Steps):
    """Writes definitions without intermediate results, so that they can be differentiated."""

    def __call__(self, expression: sp.Expr) -> sp.Expr:
        return expression

    def direction(self, dx: sp.Expr, dy: sp.Expr) -> tuple[sp.Expr, sp.Expr, sp.Expr]:
        """Return the length of a vector and its direction, which is (0, 0) where the length is 0."""
        distance = sp.sqrt(dx**2 + dy**2 + NEGLIGIBLE)
        return distance, dx / distance, dy / distance


@lru_cache(maxsize=16)
def row_function(kind: tuple[str, int]) -> Callable[..., list[Any]]:
    """Return a function of `FIRST`, `SECOND` and the numbers of a kind of geometry.

    It returns gap, slip, the rows n and t (6 each) with ``gap' = n . v`` and ``slip = t . v``, and the right-hand sides
    of ``n . a = -n' . v`` and ``t . a = -t' . v``, with which gap' and slip do not change.
    """
    positions, velocities = (*FIRST[:3], *SECOND[:3]), (*FIRST[3:], *SECOND[3:])
    whole = _Whole()
    gap, nx, ny, _ = geometry(kind, whole)
    (x1, y1), (x2, y2, th2), (cx, cy, r) = FIRST[:2], SECOND[:3], CIRCLE
    px, py = (p - r * n for p, n in zip(whole.rotated(th2, cx, cy), (nx, ny), strict=True))
    slip, _ = sliding((px, py), (x2 + px - x1, y2 + py - y1), (nx, ny), whole)
    normal = [gap.diff(x) for x in positions]
    tangent = [sp.expand(slip).diff(x) for x in velocities]

    def bent(row: list[sp.Expr]) -> sp.Expr:
        rate = sum(x * u for x, u in zip(row, velocities, strict=True))
        return -sum(rate.diff(x) * u for x, u in zip(positions, velocities, strict=True))

    arguments = (*FIRST, *SECOND, *numbers_of(kind))
    values = [gap, slip, *normal, *tangent, bent(normal), bent(tangent)]
    found: Callable[..., list[Any]] = sp.lambdify(arguments, values, modules="math", cse=True)
    return found
