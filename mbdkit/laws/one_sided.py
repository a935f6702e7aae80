"""The one-sided spring and damper: a rope that only pulls, or a stop that only pushes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from pydantic import model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.force_law import SwitchingLaw
from mbdkit.mechanism.values import NotNegative, Number

if TYPE_CHECKING:
    import sympy


class OneSidedOptions(StrictModel):
    """Options of `one-sided`: a linear spring and damper that acts on one side of its free length only.

    With ``acts: tension`` there is no force below the free length, and the element never pushes. With
    ``acts: compression`` there is no force above the free length, and the element never pulls. If the sum of spring
    force and damper force has the wrong sign, the force is zero.

    With `engages_at`, the element exerts no force until its length passes this value, which lies beyond the free
    length. The force of the spring then jumps from zero to ``stiffness * (engages_at - free_length)``, like that of a
    preloaded spring.
    """

    stiffness: NotNegative
    """Stiffness [N/m or N m/rad]."""
    damping: NotNegative = 0.0
    """Damping while in contact [N s/m or N m s/rad]; it makes the force discontinuous at the beginning of contact."""
    free_length: Number = 0.0
    """Length, angle or coordinate at which the spring exerts no force [m or rad]; contact begins there by default."""
    engages_at: Number | None = None
    """Length, angle or coordinate at which contact begins [m or rad]; the free length by default."""
    acts: Literal["tension", "compression"]
    """`tension` pulls if the pathway is longer than the free length, `compression` pushes if it is shorter."""

    @model_validator(mode="after")
    def _engages_beyond_free_length(self) -> Self:
        if self.engages_at is not None and _side(self) * (self.engages_at - self.free_length) < 0:
            where = "above" if self.acts == "tension" else "below"
            raise SpecError(
                f"should be {where} the free length {self.free_length:g} or equal to it: with `acts: {self.acts}`, the "
                "spring has no force on the other side",
                key="engages_at",
            )
        return self


def _side(options: OneSidedOptions) -> float:
    return 1.0 if options.acts == "tension" else -1.0


def force() -> sympy.Expr:
    """Return the force ``side * (k x + c x')``; zero if x <= x_1, or if the bracket is not positive.

    The stretch is ``x = side * (s - s_0)``, with the length s, free length s_0, stiffness k and damping c;
    `side` is 1 for tension and -1 for compression. Contact begins at the stretch x_1.
    """
    from sympy import And, Piecewise, symbols

    length, rate, stiffness, damping, free_length, begin, side = symbols(
        "length rate stiffness damping free_length begin side", real=True
    )
    stretch = side * (length - free_length)
    push = stiffness * stretch + damping * side * rate
    return Piecewise((side * push, And(stretch > begin, push > 0)), (0, True))


def potential() -> sympy.Expr:
    """Return the potential ``k (x^2 - x_1^2) / 2`` if x > x_1, otherwise zero; for the symbols, see `force`."""
    from sympy import Piecewise, symbols

    length, stiffness, free_length, begin, side = symbols("length stiffness free_length begin side", real=True)
    stretch = side * (length - free_length)
    return Piecewise((stiffness * (stretch**2 - begin**2) / 2, stretch > begin), (0, True))


def parameters(options: OneSidedOptions) -> dict[str, float]:
    """Return the options as numbers: `side` is 1 for tension and -1 for compression; `begin` is the stretch x_1."""
    side = _side(options)
    return {
        "stiffness": options.stiffness,
        "damping": options.damping,
        "free_length": options.free_length,
        "begin": 0.0 if options.engages_at is None else side * (options.engages_at - options.free_length),
        "side": side,
    }


def switch(length: Any, rate: Any, p: Mapping[str, Any]) -> Any:
    """Return a function that is positive in contact; see `force`."""
    stretch = p["side"] * (length - p["free_length"])
    return np.minimum(
        (p["stiffness"] + p["damping"]) * (stretch - p["begin"]),
        p["stiffness"] * stretch + p["damping"] * p["side"] * rate,
    )


LAW = SwitchingLaw(force, potential, passive=True, parameters=parameters, switch=switch)
