"""The exponential spring: no force below its free length, and a stiffness that grows with the force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.force_law import SwitchingLaw
from mbdkit.mechanism.values import NotNegative, Number, Positive

if TYPE_CHECKING:
    import sympy


class ExponentialOptions(StrictModel):
    """Options of `exponential`: the force ``scale * (exp(growth * x) - 1)`` of the stretch x.

    The stiffness is ``growth * (force + scale)``: it grows linearly with the force, as that of soft tissue does (Y. C.
    Fung, American Journal of Physiology 213:1532, 1967). With ``acts: tension``, there is no force below the free
    length; with ``acts: compression``, there is no force above it. The damper never reverses the force.
    """

    scale: NotNegative
    """Scale of the force [N or N m]; the stiffness at the free length is ``growth * scale``."""
    growth: Positive
    """Growth of the force with the stretch [1/m or 1/rad]."""
    damping: NotNegative = 0.0
    """Damping while stretched [N s/m or N m s/rad]."""
    free_length: Number = 0.0
    """Length, angle or coordinate at which the force begins [m or rad]."""
    acts: Literal["tension", "compression"]
    """`tension` pulls if the pathway is longer than the free length, `compression` pushes if it is shorter."""


def force() -> sympy.Expr:
    """Return the force ``side (a (exp(b x) - 1) + c x')``; zero if x or the outer bracket is not positive.

    The stretch is ``x = side (s - s_0)``, with the length s, free length s_0, scale a, growth b and damping c;
    `side` is 1 for tension and -1 for compression.
    """
    from sympy import And, Piecewise, exp, symbols

    length, rate, scale, growth, damping, free_length, side = symbols(
        "length rate scale growth damping free_length side", real=True
    )
    stretch = side * (length - free_length)
    push = scale * (exp(growth * stretch) - 1) + damping * side * rate
    return Piecewise((side * push, And(stretch > 0, push > 0)), (0, True))


def potential() -> sympy.Expr:
    """Return the potential ``a ((exp(b x) - 1) / b - x)`` if the stretch x is positive, otherwise zero; see `force`."""
    from sympy import Piecewise, exp, symbols

    length, scale, growth, free_length, side = symbols("length scale growth free_length side", real=True)
    stretch = side * (length - free_length)
    return Piecewise((scale * ((exp(growth * stretch) - 1) / growth - stretch), stretch > 0), (0, True))


def parameters(options: ExponentialOptions) -> dict[str, float]:
    """Return the options as numbers: `side` is 1 for tension and -1 for compression."""
    return {
        "scale": options.scale,
        "growth": options.growth,
        "damping": options.damping,
        "free_length": options.free_length,
        "side": 1.0 if options.acts == "tension" else -1.0,
    }


def switch(length: Any, rate: Any, p: Mapping[str, Any]) -> Any:
    """Return a function that is positive where there is a force; see `force`."""
    stretch = p["side"] * (length - p["free_length"])
    return np.minimum(
        (p["scale"] * p["growth"] + p["damping"]) * stretch,
        p["scale"] * np.exp(p["growth"] * stretch) - p["scale"] + p["damping"] * p["side"] * rate,
    )


LAW = SwitchingLaw(force, potential, passive=True, parameters=parameters, switch=switch)
