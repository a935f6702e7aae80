"""Laws written as Python functions of numbers: each is called once, with objects that record its operations as
source.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from mbdkit.base import elementary
from mbdkit.mechanism.force_law import ARGUMENTS, TracedLaw

Term = str | float
"""A name in the generated source, or a constant."""

_TEXTS: Mapping[Any, str] = {
    np.add: "{} + {}", np.subtract: "{} - {}", np.multiply: "{}*{}", np.divide: "{}/{}", np.power: "{}**{}",
    np.negative: "-{}", np.absolute: "abs({})", np.sqrt: "sqrt({})", np.exp: "exp({})", np.log: "log({})",
    np.sin: "sin({})", np.cos: "cos({})", np.tan: "tan({})", np.arcsin: "asin({})", np.arccos: "acos({})",
    np.arctan: "atan({})", np.sinh: "sinh({})", np.cosh: "cosh({})", np.tanh: "tanh({})",
    np.floor: "floor({})", np.arctan2: "atan2({}, {})",
    np.minimum: "({0} if {0} <= {1} else {1})", np.maximum: "({0} if {0} >= {1} else {1})",
    np.less: "{} < {}", np.less_equal: "{} <= {}", np.greater: "{} > {}", np.greater_equal: "{} >= {}",
    np.where: "({1} if {0} else {2})",
}  # fmt: skip
"""Functions that can be traced, with their form in the generated source."""

_OWN = {function: own for own in elementary.FUNCTIONS.values() if (function := own.ufunc) in _TEXTS}
"""Functions of constants, by those of NumPy."""

_SLOPES: Mapping[Any, Callable[..., tuple[Any, ...]]] = {
    np.add: lambda f, x, y: (1.0, 1.0),
    np.subtract: lambda f, x, y: (1.0, -1.0),
    np.multiply: lambda f, x, y: (y, x),
    np.divide: lambda f, x, y: (1.0 / y, -f / y),
    np.power: lambda f, x, y: (y * x ** (y - 1.0), 0.0),  # for constant exponents
    np.negative: lambda f, x: (-1.0,),
    np.sqrt: lambda f, x: (0.5 / f,),
    np.exp: lambda f, x: (f,),
    np.log: lambda f, x: (1.0 / x,),
    np.sinh: lambda f, x: (np.cosh(x),),
    np.cosh: lambda f, x: (np.sinh(x),),
    np.tanh: lambda f, x: (1.0 - f * f,),
    np.sin: lambda f, x: (np.cos(x),),
    np.cos: lambda f, x: (-np.sin(x),),
    **dict.fromkeys((np.less, np.less_equal, np.greater, np.greater_equal), lambda f, x, y: (0.0, 0.0)),
}
"""Derivatives of functions with respect to their operands; f is the value of the function. `Traced`
differentiates ``np.where`` itself. Other functions can be used only for numbers without derivatives.
"""


class Source:
    """Collects the assignments of the source; equal terms occur only once."""

    def __init__(self) -> None:
        self.names: dict[tuple[Any, ...], str] = {}
        self.lines: list[tuple[str, str, tuple[str, ...]]] = []

    def term(self, function: Any, operands: Sequence[Term]) -> Term:
        """Return the variable that holds the value of a function, or the value if all operands are constants."""
        if not any(isinstance(operand, str) for operand in operands):
            return float(_OWN.get(function, function)(*operands))
        same = _without_effect(function, operands)
        if same is not None:
            return same
        key = (function, *operands)
        if key not in self.names:
            name = f"x_{len(self.names)}"
            self.names[key] = name
            written = [
                operand if isinstance(operand, str) else f"({operand!r})" if operand < 0 else repr(operand)
                for operand in operands
            ]
            used = tuple(operand for operand in operands if isinstance(operand, str))
            self.lines.append((name, _TEXTS[function].format(*written), used))
        return self.names[key]

    def needed(self, results: Sequence[Term]) -> list[str]:
        """Return the assignments on which the results depend, in their order."""
        wanted = {result for result in results if isinstance(result, str)}
        kept = []
        for name, text, used in reversed(self.lines):
            if name in wanted:
                kept.append(f"    {name} = {text}")
                wanted.update(used)
        return kept[::-1]


def _without_effect(function: object, operands: Sequence[Term]) -> Term | None:
    """Return the simplified result of a sum with 0, a product or quotient with 0 or 1, a power with exponent 1,
    or a choice between equals.

    None if the operation is none of these.
    """
    first, *others = operands
    second = others[0] if others else None
    if function is np.where:
        return second if second == others[1] else None
    if function is np.multiply:
        if 0.0 in (first, second):
            return 0.0
        return second if first == 1.0 else first if second == 1.0 else None
    if function is np.add:
        return second if first == 0.0 else first if second == 0.0 else None
    if function is np.subtract and second == 0.0:
        return first
    if function is np.divide:
        return 0.0 if first == 0.0 else first if second == 1.0 else None
    return first if function is np.power and second == 1.0 else None


class Traced(NDArrayOperatorsMixin):
    """A number in a law that is traced, with its derivatives with respect to the inputs of the law, if requested.

    The inputs are, for example, length and rate of a pathway.
    """

    def __init__(self, source: Source, term: Term, slopes: tuple[object, ...] = ()):
        self.source, self.term, self.slopes = source, term, slopes

    @property
    def plain(self) -> Traced:
        """The number without derivatives, for calculations that need none, such as the first steps of an iteration."""
        return Traced(self.source, self.term)

    def __array_ufunc__(self, ufunc: object, method: str, *operands: object, **_: object) -> Any:
        return self._applied(ufunc, operands)

    def __array_function__(self, function: Any, types: Any, operands: Any, options: Any) -> Any:
        return self._applied(function, operands)

    def _applied(self, function: Any, operands: Sequence[Any]) -> Any:
        if function is np.arcsinh:  # dual numbers do not support it
            (x,) = operands
            return np.log(x + np.sqrt(x * x + 1.0))
        operands = [
            operand.term if isinstance(operand, Traced) and not isinstance(operand.term, str) else operand
            for operand in operands
        ]
        operands = [operand.item() if isinstance(operand, np.generic) else operand for operand in operands]
        if function is np.power and float(operands[1]).is_integer():
            operands[1] = int(operands[1])
        given = [operand if isinstance(operand, Traced) else Traced(self.source, operand) for operand in operands]
        value = Traced(self.source, self.source.term(function, [value.term for value in given]))
        count = max(len(value.slopes) for value in given)
        if not count:
            return value
        if function is np.where:
            pairs = [[value.slopes[k] if value.slopes else 0.0 for value in given[1:]] for k in range(count)]
            condition = Traced(self.source, given[0].term)
            chosen = (a if a is b else _plain(np.where(condition, a, b)) for a, b in pairs)
            return Traced(self.source, value.term, tuple(chosen))
        plain = [Traced(self.source, value.term) for value in given]
        factors = _SLOPES[function](value, *plain)
        varying = [(factor, one.slopes) for factor, one in zip(factors, given, strict=True) if one.slopes]
        slopes = tuple(
            _plain(sum((factor * own[k] for factor, own in varying if not _is_zero(own[k])), start=0.0))
            for k in range(count)
        )
        return Traced(self.source, value.term, slopes)


def _is_zero(slope: object) -> bool:
    return isinstance(slope, float) and slope == 0.0


def _plain(slope: object) -> Any:
    return slope.term if isinstance(slope, Traced) and not isinstance(slope.term, str) else slope


def traced_source(law: TracedLaw, names: Sequence[str]) -> str:
    """Return the source of ``law(length, rate, time, parameters)``, which returns four numbers.

    They are the force, its derivatives with respect to length and rate, and 0 for the potential. The derivatives are 0
    if the law has none.

    `names`: names of the law's parameters in the order of the array.
    """
    source = Source()
    seeds: tuple[tuple[float, ...], ...] = ((1.0, 0.0), (0.0, 1.0)) if law.has_derivatives else ((), ())
    length, rate = (Traced(source, name, seed) for name, seed in zip(ARGUMENTS, seeds, strict=False))
    parameters = {name: Traced(source, f"parameters[{i}]") for i, name in enumerate(names)}
    value = law.function(length, rate, Traced(source, ARGUMENTS[2]), parameters)
    slopes = value.slopes or (0.0, 0.0)
    results = [value.term, *(slope.term if isinstance(slope, Traced) else float(slope) for slope in slopes), 0.0]
    lines = ["def law(length, rate, time, parameters):", *value.source.needed(results)]
    lines.append(f"    return {', '.join(f'float({result})' for result in results)}")
    return "\n".join(lines) + "\n"
