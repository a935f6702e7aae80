"""Numbers in words: lengths and times in the unit that suits them, proportions, counts."""

from __future__ import annotations

import math

_LENGTHS = ((1.0, "m"), (1e-3, "mm"), (1e-6, "um"), (1e-9, "nm"), (1e-12, "pm"))
_TIMES = ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"))
ROUND_OFF = 1e-12
"""Drift, as a share of the mechanism's size, that is owed to double precision rather than to the method."""


def length(value: float) -> str:
    """Return a length [m] such as ``3.1 nm``."""
    return _in_units(value, _LENGTHS)


def duration(value: float) -> str:
    """Return a time [s] such as ``12 ms``."""
    return _in_units(value, _TIMES)


def proportion(value: float) -> str:
    """Return a part of a whole: in percent where that reads well."""
    return f"{100 * value:.2g} %" if 1e-4 <= value < 10 else f"{value:.1g}"


def count(many: int, one: str, more: str = "") -> str:
    """Return ``1 joint``, ``4 joints``, ``12,000 steps``."""
    return f"{many:,} {one if many == 1 else more or one + 's'}"


def _in_units(value: float, units: tuple[tuple[float, str], ...]) -> str:
    if not math.isfinite(value):
        return "not finite"
    for size, unit in units:
        if abs(value) >= 0.9995 * size:
            return f"{value / size:.3g} {unit}".replace("um", "\u00b5m").replace("us", "\u00b5s")
    return f"{value:.2g} {units[0][1]}"
