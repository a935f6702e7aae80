"""Natural sizes of quantities, computed from length, mass and time of a mechanism.

They distinguish rounding errors from results: numbers that differ from zero by rounding errors only, such as the height
of a rod that lies still, have no digits to compare.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from mbdkit.base import elementary
from mbdkit.base.units import Unit


def natural_scales(length: float, mass: float, gravity: Sequence[float], duration: float) -> tuple[float, float, float]:
    """Return length [m], mass [kg] and time [s] of a mechanism.

    The time is about that of a free fall by the length, or the duration of the run [s] if that is shorter; 1 s if there
    is no gravity and no duration.
    """
    pull = elementary.hypot(*gravity)
    fall = math.sqrt(length / pull) if pull > 0.0 else math.inf
    time = min(fall, duration) if duration > 0.0 else fall
    return length, mass, time if math.isfinite(time) else 1.0


def natural_size(unit: Unit, length: float, mass: float, time: float) -> float:
    """Return the natural size of quantities with a unit, in this unit."""
    powers = [float(elementary.pow(x, power)) for x, power in zip((length, mass, time), unit.exponents, strict=True)]
    return math.prod(powers) / unit.factor
