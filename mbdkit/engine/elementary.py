"""Elementary functions for formulas in Python whose values enter results: the same bits on every machine.

They are those of the machine code (`mbdkit.engine.kernels.elementary`). The functions of `math` come from the C
library, and those of NumPy depend on the processor. Unlike those of `math`, they return NaN or infinity and raise no
exception.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbdkit.engine.kernels.elementary_calls import CODES, elementary_value, elementary_values


class ElementaryFunction:
    """An elementary function of numbers or arrays.

    Parameters
    ----------
    name
        Its name in the C library, such as ``atan2``.
    """

    def __init__(self, name: str):
        self.name, self._code = name, CODES[name]

    def __call__(self, x: Any, y: Any = 0.0) -> Any:
        """Return the value as a float for numbers, and element by element for arrays, which are broadcast."""
        if isinstance(x, int | float) and isinstance(y, int | float):
            return elementary_value(self._code, x, y)
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        values = np.empty(x.size)
        elementary_values(self._code, np.ascontiguousarray(x).ravel(), np.ascontiguousarray(y).ravel(), values)
        return values.reshape(x.shape)


acos = ElementaryFunction("acos")
acosh = ElementaryFunction("acosh")
asin = ElementaryFunction("asin")
asinh = ElementaryFunction("asinh")
atan = ElementaryFunction("atan")
atan2 = ElementaryFunction("atan2")
atanh = ElementaryFunction("atanh")
cos = ElementaryFunction("cos")
cosh = ElementaryFunction("cosh")
erf = ElementaryFunction("erf")
erfc = ElementaryFunction("erfc")
exp = ElementaryFunction("exp")
expm1 = ElementaryFunction("expm1")
fmod = ElementaryFunction("fmod")
hypot = ElementaryFunction("hypot")
lgamma = ElementaryFunction("lgamma")
log = ElementaryFunction("log")
log10 = ElementaryFunction("log10")
log1p = ElementaryFunction("log1p")
log2 = ElementaryFunction("log2")
pow = ElementaryFunction("pow")  # noqa: A001
sin = ElementaryFunction("sin")
sinh = ElementaryFunction("sinh")
tan = ElementaryFunction("tan")
tanh = ElementaryFunction("tanh")
tgamma = ElementaryFunction("tgamma")
