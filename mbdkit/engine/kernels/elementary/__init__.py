"""Elementary functions of the machine code, used instead of those of the C library.

Each function is written once, for numbers, lanes and Python, with IEEE 754 operations that every processor rounds
alike: sums, products, quotients, square roots, comparisons and operations on integers, without fused multiplications.
Its results are therefore the same bits everywhere. Special values follow IEEE 754 and Annex F of C99.

In machine code, these functions take the place of those of `math` and NumPy. Code in Python calls
`mbdkit.engine.elementary`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mbdkit.engine.kernels.elementary import inverse_trigonometric, lengths, trigonometric

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "acos": inverse_trigonometric.acos,
    "asin": inverse_trigonometric.asin,
    "atan": inverse_trigonometric.atan,
    "atan2": inverse_trigonometric.atan2,
    "cos": trigonometric.cos,
    "fmod": lengths.fmod,
    "hypot": lengths.hypot,
    "sin": trigonometric.sin,
    "tan": trigonometric.tan,
}
"""The functions by the names of those of the C library whose place they take."""
