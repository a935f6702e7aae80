"""The gas spring: a cylinder of compressed gas that pushes its ends apart."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from mbdkit.mechanism.force_law import ExpressionLaw
from mbdkit.mechanism.values import NotNegative, Positive
from mbdkit.strict_model import StrictModel

if TYPE_CHECKING:
    import sympy

SUMMARY = "A gas spring: pushes with a preload that grows with compression, by the polytropic law of its gas."


class GasSpringOptions(StrictModel):
    """Options of `gas-spring`: the push ``preload / (1 - x/stroke * (1 - progression**(-1/exponent)))**exponent``.

    x is the compression, ``extended_length - length``. The gas in the cylinder follows the polytropic law
    ``p V^exponent = constant``, and its volume decreases linearly with x, so that the push at full stroke is
    ``progression * preload``. Manufacturers call preload F1, the force at full stroke F2, and F2/F1 progression. The
    end stops of the cylinder are not part of the law: beyond the extended length the push continues to decrease, and
    beyond the stroke to increase.
    """

    preload: NotNegative
    """Push at the extended length [N or N m]."""
    progression: Annotated[float, Field(gt=1, allow_inf_nan=False)]
    """Push at full stroke, relative to the preload; 1.2 to 1.6 for common cylinders."""
    extended_length: Positive
    """Length between the ends when extended [m or rad]."""
    stroke: Positive
    """Compression at full stroke [m or rad]."""
    exponent: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 1.0
    """Polytropic exponent: 1 for slow motion at constant temperature, up to 1.4 for fast motion of nitrogen."""
    damping: NotNegative = 0.0
    """Damping of its oil and seals [N s/m or N m s/rad]."""


def force() -> sympy.Expr:
    """Return ``c s' - F_1 (1 - q (s_1 - s))^-n`` of length s, extended length s_1, exponent n and shrinkage q."""
    from sympy import symbols

    length, rate, preload, shrinkage, extended, exponent, damping = symbols(
        "length rate preload shrinkage extended exponent damping", real=True
    )
    return damping * rate - preload * (1 - shrinkage * (extended - length)) ** (-exponent)


def potential() -> sympy.Expr:
    """Return the work that compresses the gas from the extended length."""
    from sympy import log, symbols

    length, preload, shrinkage, extended, exponent, isothermal, divisor = symbols(
        "length preload shrinkage extended exponent isothermal divisor", real=True
    )
    volume = 1 - shrinkage * (extended - length)
    polytropic = (volume ** (1 - exponent) - 1) / divisor
    return preload / shrinkage * (isothermal * -log(volume) + (1 - isothermal) * polytropic)


def parameters(options: GasSpringOptions) -> dict[str, float]:
    """Return the parameters; `shrinkage` is the decrease of the volume per compression, relative to the volume.

    The potential of an isothermal gas is a logarithm; `divisor` avoids a division by zero in the other formula.
    """
    isothermal = options.exponent == 1.0
    return {
        "preload": options.preload,
        "shrinkage": (1.0 - options.progression ** (-1.0 / options.exponent)) / options.stroke,
        "extended": options.extended_length,
        "exponent": options.exponent,
        "isothermal": float(isothermal),
        "divisor": 1.0 if isothermal else options.exponent - 1.0,
        "damping": options.damping,
    }


LAW = ExpressionLaw(force, potential, passive=True, parameters=parameters)
