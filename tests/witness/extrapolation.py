"""Richardson's extrapolation: what values on finer and finer meshes tend to."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np


def limit(values: Sequence[np.ndarray], order: int) -> np.ndarray:
    """Return the limit of values on meshes of 1, 2, 4, ... times as many elements.

    Their errors are a series of powers of the length of an element: `order`, order + 2, order + 4, ...
    """
    while len(values) > 1:
        values = [fine + (fine - coarse) / (2**order - 1) for coarse, fine in pairwise(values)]
        order += 2
    return values[0]
