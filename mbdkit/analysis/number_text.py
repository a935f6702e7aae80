"""Formatting of numbers in the sentences of a verdict."""

from __future__ import annotations

import math
from collections.abc import Iterable


def least_most(values: Iterable[float]) -> str:
    """Return the smallest and the largest finite value as text with two significant digits."""
    known = [value for value in values if math.isfinite(value)]
    return f"{min(known):.2g} to {max(known):.2g}" if known else "an unknown number of"


def two_digits(number: float) -> str:
    """Return a count as text with two significant digits and thousands separators."""
    return f"{float(f'{number:.2g}'):,.0f}" if math.isfinite(number) else "an unknown number of"
