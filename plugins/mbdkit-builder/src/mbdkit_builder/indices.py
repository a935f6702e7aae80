"""Make indices of arrays in compiled code count from the beginning only; negative indices are not supported.

Numba compares each signed index with 0, and adds the size of the axis to a negative one. In kernels, whose indices are
mostly read from arrays, this takes a tenth of the time. This module replaces `fix_integer_index`, an internal of Numba.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.np import arrayobj


def count_from_zero() -> None:
    """Compile indices without a comparison with 0."""
    arrayobj.fix_integer_index = _index


def _index(context: Any, builder: Any, kind: Any, value: Any, size: Any) -> Any:
    return context.cast(builder, value, kind, types.intp if kind.signed else types.uintp)
