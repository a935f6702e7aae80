"""Values as text: lengths and times with a suitable unit, proportions, counts, ranges."""

from __future__ import annotations

import math

_LENGTHS = ((1.0, "m"), (1e-3, "mm"), (1e-6, "um"), (1e-9, "nm"), (1e-12, "pm"))
_TIMES = ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"))


def length(value: float) -> str:
    """Return a length [m] such as ``3.1 nm``."""
    return _in_units(value, _LENGTHS)


def duration(value: float) -> str:
    """Return a time [s] such as ``12 ms``."""
    return _in_units(value, _TIMES)


def proportion(value: float) -> str:
    """Return a proportion, in percent unless it is very small or large."""
    return f"{100 * value:.2g} %" if 1e-4 <= value < 10 else f"{value:.1g}"


def count(many: int, one: str, more: str = "") -> str:
    """Return a count with its noun, such as ``1 joint`` or ``12,000 steps``."""
    return f"{many:,} {one if many == 1 else more or one + 's'}"


def _in_units(value: float, units: tuple[tuple[float, str], ...]) -> str:
    if not math.isfinite(value):
        return "not finite"
    for size, unit in units:
        if abs(value) >= 0.9995 * size:
            return f"{value / size:.3g} {unit}".replace("um", "\u00b5m").replace("us", "\u00b5s")
    return f"{value:.2g} {units[0][1]}"


def with_unit(value: float, unit: str, digits: int = 6) -> str:
    """Return a number with its unit as text."""
    return f"{value:.{digits}g} {unit}".rstrip()


def heading(name: str, unit: str) -> str:
    """Return a name with its unit as the heading of a column of text."""
    return f"{name} [{unit}]" if unit else name
