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
    """Options of `one-sided`: a linear spring and damper that acts on one side of its free length alone.

    With ``acts: tension`` it is slack while shorter than its free length and never pushes; with ``acts: compression``
    it is out of touch while longer and never pulls. Neither does its damper: where spring and damper together would act
    the other way, there is no force.
    """

    stiffness: NotNegative
    """Stiffness [N/m or N m/rad]."""
    damping: NotNegative = 0.0
    """Damping while in touch [N s/m or N m s/rad]; the force jumps with it where the spring comes into touch."""
    free_length: Number = 0.0
    """Length, angle or coordinate at which the spring comes into touch [m or rad]."""
    acts: Literal["tension", "compression"]
    """`tension` pulls when longer than the free length, `compression` pushes when shorter."""


def force() -> sympy.Expr:
    """Return k x + c x' where the spring is in touch, x > 0, and this is positive; with the sign of the side."""
    from sympy import And, Piecewise, symbols

    length, rate, stiffness, damping, free_length, side = symbols(
        "length rate stiffness damping free_length side", real=True
    )
    stretch = side * (length - free_length)
    push = stiffness * stretch + damping * side * rate
    return Piecewise((side * push, And(stretch > 0, push > 0)), (0, True))


def potential() -> sympy.Expr:
    """Return k x^2 / 2 where the spring is in touch, x > 0."""
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
