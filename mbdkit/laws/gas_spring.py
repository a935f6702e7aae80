"""The gas spring: a cylinder of compressed gas that pushes its ends apart."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from mbdkit.base import elementary
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.force_law import ExpressionLaw
from mbdkit.mechanism.values import NotNegative, Positive

if TYPE_CHECKING:
    import sympy


class GasSpringOptions(StrictModel):
    """Options of `gas-spring`: the push ``preload / (1 - x/stroke * (1 - progression**(-1/exponent)))**exponent``.

    x is the compression, ``extended_length - length``. The gas in the cylinder follows the polytropic law ``p
    V^exponent = constant``, and its volume decreases linearly with x, so that the push at full stroke is ``progression
    * preload``. Manufacturers call preload F1, the force at full stroke F2, and F2/F1 progression. The end stops of the
    cylinder are not part of the law: it holds from full stroke to the extended length, and a run that leaves this range
    is doubtful. Beyond the extended length the push decreases further by the same formula, and beyond the stroke it
    increases linearly.
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
    """Damping by the oil and the seals [N s/m or N m s/rad]."""


def force() -> sympy.Expr:
    """Return the force ``c s' - F_1 v^-n`` for the length s, with the relative volume ``v = 1 - q (s_1 - s)``.

    c is the damping, F_1 the preload, n the exponent, q the shrinkage (see `parameters`), and s_1 the extended length.
    Beyond full stroke, the force is continued linearly.
    """
    from sympy import symbols

    rate, damping, slope = symbols("rate damping slope", real=True)
    push, _, beyond = _gas()
    return damping * rate - push + slope * beyond


def potential() -> sympy.Expr:
    """Return the potential: the work done on the gas from the extended length to the current length."""
    from sympy import log, symbols

    preload, shrinkage, exponent, isothermal, divisor, slope = symbols(
        "preload shrinkage exponent isothermal divisor slope", real=True
    )
    push, volume, beyond = _gas()
    polytropic = (volume ** (1 - exponent) - 1) / divisor
    stored = preload / shrinkage * (isothermal * -log(volume) + (1 - isothermal) * polytropic)
    return stored - push * beyond + slope * beyond**2 / 2


def _gas() -> tuple[sympy.Expr, sympy.Expr, sympy.Expr]:
    """Return the push and the relative volume of the gas, both constant beyond full stroke, and the length minus that
    at full stroke, which is zero up to full stroke and negative beyond it.
    """
    from sympy import Piecewise, symbols

    length, preload, shrinkage, extended, exponent, shortest = symbols(
        "length preload shrinkage extended exponent shortest", real=True
    )
    inside = Piecewise((length, length > shortest), (shortest, True))
    volume = 1 - shrinkage * (extended - inside)
    return preload * volume ** (-exponent), volume, length - inside


def parameters(options: GasSpringOptions) -> dict[str, float]:
    """Return the parameters of the law.

    `shrinkage` is the decrease of the volume per compression, relative to the volume at the extended length. `shortest`
    is the length at full stroke, and `slope` the stiffness there. The potential of an isothermal gas is a logarithm.
    The formula for other gases is evaluated as well, with a `divisor` that is not zero.
    """
    isothermal = options.exponent == 1.0
    volume = elementary.pow(options.progression, -1.0 / options.exponent)
    shrinkage = (1.0 - volume) / options.stroke
    return {
        "preload": options.preload,
        "shrinkage": shrinkage,
        "extended": options.extended_length,
        "shortest": options.extended_length - options.stroke,
        "slope": options.preload * options.exponent * shrinkage * options.progression / volume,
        "exponent": options.exponent,
        "isothermal": float(isothermal),
        "divisor": 1.0 if isothermal else options.exponent - 1.0,
        "damping": options.damping,
    }


def valid_range(options: GasSpringOptions) -> dict[str, tuple[float, float]]:
    """Return the range of lengths between the end stops."""
    return {"length": (options.extended_length - options.stroke, options.extended_length)}


LAW = ExpressionLaw(force, potential, passive=True, parameters=parameters, valid_range=valid_range)
