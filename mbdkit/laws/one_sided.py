"""The one-sided spring and damper: a rope that only pulls, or a stop that only pushes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from mbdkit.mechanism.force_law import ExpressionLaw
from mbdkit.mechanism.values import NotNegative, Number
from mbdkit.strict_model import StrictModel

if TYPE_CHECKING:
    import sympy

SUMMARY = "A spring and damper that only pulls (a rope) or only pushes (a stop)."


class OneSidedOptions(StrictModel):
    """Options of `one-sided`: a linear spring and damper that acts on one side of its free length only.

    With ``acts: tension`` there is no force below the free length, and the element never pushes. With
    ``acts: compression`` there is no force above the free length, and the element never pulls. This includes the
    damper: if the sum of spring and damper force has the wrong sign, the force is zero.
    """

    stiffness: NotNegative
    """Stiffness [N/m or N m/rad]."""
    damping: NotNegative = 0.0
    """Damping while in contact [N s/m or N m s/rad]; it makes the force jump at the beginning of contact."""
    free_length: Number = 0.0
    """Length, angle or coordinate at which contact begins [m or rad]."""
    acts: Literal["tension", "compression"]
    """`tension` pulls when longer than the free length, `compression` pushes when shorter."""


def force() -> sympy.Expr:
    """Return ``side * (k x + c x')`` with ``x = side * (s - s_0)``; zero if x or the bracket is not positive."""
    from sympy import And, Piecewise, symbols

    length, rate, stiffness, damping, free_length, side = symbols(
        "length rate stiffness damping free_length side", real=True
    )
    stretch = side * (length - free_length)
    push = stiffness * stretch + damping * side * rate
    return Piecewise((side * push, And(stretch > 0, push > 0)), (0, True))


def potential() -> sympy.Expr:
    """Return the potential ``k x^2 / 2`` for ``x = side * (s - s_0) > 0``, otherwise zero."""
    from sympy import Piecewise, symbols

    length, stiffness, free_length, side = symbols("length stiffness free_length side", real=True)
    stretch = side * (length - free_length)
    return Piecewise((stiffness * stretch**2 / 2, stretch > 0), (0, True))


def parameters(options: OneSidedOptions) -> dict[str, float]:
    """Return the options as numbers: `side` is 1 for tension and -1 for compression."""
    return {
        "stiffness": options.stiffness,
        "damping": options.damping,
        "free_length": options.free_length,
        "side": 1.0 if options.acts == "tension" else -1.0,
    }


LAW = ExpressionLaw(force, potential, passive=True, parameters=parameters)
