"""Numbers as the sentences of a verdict say them."""

from __future__ import annotations

import math
from collections.abc import Iterable


def least_most(values: Iterable[float]) -> str:
    """Return the least and the largest of some values, to two digits; those that are not finite are left out."""
    known = [value for value in values if math.isfinite(value)]
    return f"{min(known):.2g} to {max(known):.2g}" if known else "an unknown number of"


def two_digits(number: float) -> str:
    """Return a count to two digits, its thousands apart."""
    return f"{float(f'{number:.2g}'):,.0f}" if math.isfinite(number) else "an unknown number of"
