"""Elementary functions of the machine code, used instead of those of the C library.

Each function is written once, for numbers, lanes and Python, with IEEE 754 operations that every processor rounds
alike: sums, products, quotients, square roots, comparisons and operations on integers, without fused multiplications.
Its results are therefore the same bits everywhere. Special values follow IEEE 754 and Annex F of C99.

In machine code, these functions take the place of those of `math` and NumPy. Code in Python calls
`mbdkit.base.elementary`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mbdkit.engine.kernels.elementary import (
    error_function,
    exponentials,
    gamma,
    hyperbolic,
    inverse_trigonometric,
    lengths,
    logarithms,
    powers,
    trigonometric,
)

#: The functions by the names of those of the C library whose place they take.
FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "acos": inverse_trigonometric.acos,
    "acosh": hyperbolic.acosh,
    "asin": inverse_trigonometric.asin,
    "asinh": hyperbolic.asinh,
    "atan": inverse_trigonometric.atan,
    "atan2": inverse_trigonometric.atan2,
    "atanh": hyperbolic.atanh,
    "cos": trigonometric.cos,
    "cosh": hyperbolic.cosh,
    "erf": error_function.erf,
    "erfc": error_function.erfc,
    "exp": exponentials.exp,
    "expm1": exponentials.expm1,
    "fmod": lengths.fmod,
    "hypot": lengths.hypot,
    "lgamma": gamma.lgamma,
    "log": logarithms.log,
    "log10": logarithms.log10,
    "log1p": logarithms.log1p,
    "log2": logarithms.log2,
    "pow": powers.power,
    "sin": trigonometric.sin,
    "sinh": hyperbolic.sinh,
    "tan": trigonometric.tan,
    "tanh": hyperbolic.tanh,
    "tgamma": gamma.tgamma,
}
