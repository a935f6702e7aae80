"""Elementary functions for formulas in Python whose values enter results: the same bits on every machine.

They are those of the machine code (`mbdkit.engine.kernels.elementary`). The functions of `math` come from the C
library, and those of NumPy depend on the processor; so does ``**``, except for squares of arrays. Unlike those of
`math`, these functions return NaN or infinity where there is no finite value.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, overload

from mbdkit.base import higher_layers


class ElementaryFunction:
    """An elementary function of numbers or arrays.

    `name`: its name in the C library, such as ``atan2``. `numpy_name`: its name in NumPy, if it is another one.
    """

    def __init__(self, name: str, numpy_name: str = ""):
        self.name = self.__name__ = name
        self._numpy_name = numpy_name or name

    @cached_property
    def ufunc(self) -> Any:
        """The function of NumPy, or None if there is none."""
        import numpy as np

        return getattr(np, self._numpy_name, None)

    @cached_property
    def _of_numbers(self) -> Any:
        return higher_layers.elementary_functions()[self.name]

    @overload
    def __call__(self, *operands: float) -> float: ...

    @overload
    def __call__(self, *operands: Any) -> Any: ...

    def __call__(self, *operands: Any) -> Any:
        """Return the value as a float for numbers, and element by element for arrays, which are broadcast.

        Operands with a method ``__elementary__`` get this function, others with an own method ``__array_ufunc__`` that
        of NumPy.
        """
        kinds = {type(operand) for operand in operands}
        if kinds <= _NUMBERS:
            return self._of_numbers(*map(float, operands))
        import numpy as np

        if own := [x for x in operands if hasattr(x, "__array_ufunc__") and not isinstance(x, np.ndarray | np.generic)]:
            return own[0].__elementary__(self, operands) if hasattr(own[0], "__elementary__") else self.ufunc(*operands)
        arrays = [np.asarray(operand) for operand in operands]
        if len(arrays) != 1 + (self.name in _OF_TWO) or any(x.dtype.kind == "c" for x in arrays):
            raise TypeError(f"{self.name} takes {1 + (self.name in _OF_TWO)} real operands, not {operands}")
        if any(x.dtype == object and x.ndim for x in arrays):
            return np.frompyfunc(self, len(arrays), 1)(*arrays)
        arrays = [x.astype(np.float64, copy=False) for x in arrays]
        if all(x.ndim == 0 for x in arrays):
            return np.float64(self._of_numbers(*map(float, arrays)))
        return higher_layers.elementary_values(self.name, *arrays)


_NUMBERS = {float, int}
_OF_TWO = {"atan2", "fmod", "hypot", "pow"}

acos = ElementaryFunction("acos", "arccos")
acosh = ElementaryFunction("acosh", "arccosh")
asin = ElementaryFunction("asin", "arcsin")
asinh = ElementaryFunction("asinh", "arcsinh")
atan = ElementaryFunction("atan", "arctan")
atan2 = ElementaryFunction("atan2", "arctan2")
atanh = ElementaryFunction("atanh", "arctanh")
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
pow = ElementaryFunction("pow", "power")  # noqa: A001
sin = ElementaryFunction("sin")
sinh = ElementaryFunction("sinh")
tan = ElementaryFunction("tan")
tanh = ElementaryFunction("tanh")
tgamma = ElementaryFunction("tgamma")


def unit_vector(angle: float) -> complex:
    """Return the complex number of length 1 with an angle [rad]."""
    return complex(cos(angle), sin(angle))


FUNCTIONS = {one.name: one for one in tuple(globals().values()) if isinstance(one, ElementaryFunction)}
