"""The linear spring and damper, for any pathway."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.force_law import ExpressionLaw
from mbdkit.mechanism.values import NotNegative, Number

if TYPE_CHECKING:
    import sympy


class LinearOptions(StrictModel):
    """Options of `linear`: the force is ``stiffness * (length - free_length) + damping * rate``."""

    stiffness: NotNegative = 0.0
    """Stiffness [N/m or N m/rad]."""
    damping: NotNegative = 0.0
    """Damping [N s/m or N m s/rad]."""
    free_length: Number = 0.0
    """Length, angle or coordinate at which the spring exerts no force [m or rad]."""


def force() -> sympy.Expr:
    """Return the force ``k (s - s_0) + c s'`` for length s, stiffness k, free length s_0 and damping c."""
    from sympy import symbols

    length, rate, stiffness, damping, free_length = symbols("length rate stiffness damping free_length", real=True)
    return stiffness * (length - free_length) + damping * rate


def potential() -> sympy.Expr:
    """Return the potential ``k (s - s_0)^2 / 2``; for the symbols, see `force`."""
    from sympy import symbols

    length, stiffness, free_length = symbols("length stiffness free_length", real=True)
    return stiffness * (length - free_length) ** 2 / 2


LAW = ExpressionLaw(force, potential, passive=True)
