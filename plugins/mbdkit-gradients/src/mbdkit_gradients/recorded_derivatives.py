"""Exact derivatives of the arrays of a mechanism, from the operations that were recorded while it was built.

`mbdkit.runs.varied_numbers` records how the entries of the compiled arrays follow from numbers of a spec. The recorded
operations are repeated here with numbers that carry their derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mbdkit.base.traced_numbers import Formulas, UntraceableError, recorded_functions
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.consistent_start import MechanismAtStart
from mbdkit.engine.least_change import LeastChange
from mbdkit.expressions.operations import OPERATIONS
from mbdkit_gradients.parameter_differences import CENTRAL, LEFT_OUT, RANK, weights


class _Number:
    """A value with its derivatives (K,)."""

    __slots__ = ("slope", "value")

    def __init__(self, value: float, slope: np.ndarray):
        self.value, self.slope = value, slope

    def __abs__(self) -> _Number:
        sign = math.copysign(1.0, self.value) if self.value else np.where(self.slope == 0.0, 0.0, math.nan)
        return _Number(abs(self.value), sign * self.slope)

    def __neg__(self) -> _Number:
        return _Number(-self.value, -self.slope)

    def is_integer(self) -> bool:
        return self.value.is_integer()


def _parts(x: Any) -> tuple[float, Any]:
    return (x.value, x.slope) if isinstance(x, _Number) else (float(x), 0.0)


def _by_rule(name: str) -> Callable[..., Any]:
    """Return an operation of expressions for numbers with derivatives."""
    rule = OPERATIONS[name].rule

    def compute(*operands: Any) -> Any:
        if len(operands) == 1:
            value, slope, _ = rule(operands[0].value)
            return _Number(float(value), slope * operands[0].slope)
        (a, da), (b, db) = map(_parts, operands)
        if name == "pow" and not isinstance(operands[1], _Number):
            return _Number(a**b, b * a ** (b - 1.0) * da if b else 0.0 * da)
        value, slope, _ = rule(a, da, 0.0, b, db, 0.0)
        return _Number(float(value), np.asarray(slope))

    return compute


def _operator(name: str) -> tuple[Callable[..., Any], Callable[..., Any]]:
    compute = _by_rule(name)
    return compute, lambda self, other: compute(other, self)


def _comparison(name: str) -> Callable[[Any, Any], bool]:
    compare: Callable[[Any, Any], bool] = getattr(float, name)
    return lambda self, other: compare(self.value, _parts(other)[0])


for _symbol, _name in {"add": "add", "sub": "sub", "mul": "mul", "truediv": "div", "pow": "pow"}.items():
    _forward, _backward = _operator(_name)
    setattr(_Number, f"__{_symbol}__", _forward)
    setattr(_Number, f"__r{_symbol}__", _backward)
for _name in ("__lt__", "__le__", "__gt__", "__ge__", "__eq__", "__ne__"):
    setattr(_Number, _name, _comparison(_name))


def _length(*components: Any) -> Any:
    value = math.hypot(*(_parts(x)[0] for x in components))
    slope = sum(x * dx for x, dx in map(_parts, components))
    return _Number(value, slope / value if value > 0.0 else math.nan * slope)


def _chosen(choose: Callable[..., float]) -> Callable[..., Any]:
    def compute(*operands: Any) -> Any:
        values = operands if len(operands) > 1 else operands[0]
        best = choose([_parts(x)[0] for x in values])
        fits = [x for x in values if _parts(x)[0] == best]
        if len(fits) == 1 or not any(isinstance(x, _Number) for x in fits):
            return fits[0]
        return _Number(best, math.nan * sum(_parts(x)[1] for x in fits))  # different derivatives on both sides

    return compute


def _spline(arguments: Sequence[Any], values: Sequence[Any]) -> list[Any]:
    pieces = recorded_functions()["_cubic_pieces"]
    if any(isinstance(x, _Number) for x in arguments):
        raise UntraceableError("the arguments of a table are parameters")
    count = next(len(x.slope) for x in values if isinstance(x, _Number))
    slopes = np.array([np.broadcast_to(_parts(x)[1], count) for x in values])
    return list(map(_Number, pieces(arguments, [_parts(x)[0] for x in values]), pieces(arguments, slopes)))


def _functions() -> dict[str, Callable[..., Any]]:
    """Return the functions that recorded operations call, for numbers with derivatives."""
    own: dict[str, Callable[..., Any]] = {
        name: _by_rule(name) for name in OPERATIONS if OPERATIONS[name].is_function and name not in ("min", "max")
    }
    own |= {
        "_hypot": _length, "hypot": _length, "_dist": lambda a, b: _length(*(x - y for x, y in zip(a, b, strict=True))),
        "_sqrt": own["sqrt"], "_max": _chosen(max), "_min": _chosen(min),
        "_power": _by_rule("pow"), "pow": _by_rule("pow"),
        "_second": _chosen(lambda values: sorted(values)[-2]), "_cubic_pieces": _spline,
    }  # fmt: skip
    return {name: _for_both(function, own.get(name)) for name, function in recorded_functions().items()}


def _for_both(function: Callable[..., Any], own: Callable[..., Any] | None) -> Callable[..., Any]:
    def compute(*operands: Any) -> Any:
        parts = [x for operand in operands for x in (operand if isinstance(operand, tuple | list) else [operand])]
        if not any(isinstance(x, _Number) for x in parts):
            return function(*operands)
        if own is None:
            raise UntraceableError(f"the derivative of {function} is not known")
        return own(*operands)

    return compute


def derivatives_of(formulas: Formulas, values: Sequence[float]) -> np.ndarray:
    """Return the derivatives (R, K) of recorded results with respect to the K inputs at their recorded values.

    They are nan where the derivatives on both sides differ.

    Raises
    ------
    UntraceableError
        If the derivative of a recorded operation is not known.
    """
    inputs = map(_Number, map(float, values), np.eye(len(values)))
    try:
        with np.errstate(invalid="ignore"):
            results = formulas.compiled(_functions())(*inputs)
    except (ArithmeticError, ValueError, TypeError, AttributeError) as error:
        raise UntraceableError(str(error)) from error
    if results is None:
        raise UntraceableError("a condition does not hold")
    slopes = np.zeros((len(results), len(values)))
    for row, result in zip(slopes, results, strict=True):
        row[:] = _parts(result)[1]
    return slopes


def inside(formulas: Formulas, values: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Return (K,) whether all recorded conditions hold if a value increases or decreases by its change."""
    function = formulas.compiled(recorded_functions())

    def hold(inputs: np.ndarray) -> bool:
        try:
            return function(*inputs.tolist()) is not None
        except (ArithmeticError, ValueError):
            return False

    if hold(values + changes) and hold(values - changes):
        return np.ones(len(values), dtype=bool)
    return np.array([hold(values + change) and hold(values - change) for change in np.diag(changes)])


#: Largest residual of a consistent start, relative to its largest term, that counts as round-off.
CONSISTENT = 1e-13


class StartDerivatives:
    """Derivatives of a start that satisfies the constraints without any change by assembly.

    If the given values leave the constraints, assembly changes them as little as possible in the mass metric, so that
    the derivatives are those of the given values, projected to the linearized constraints.
    """

    def __init__(self, start: MechanismAtStart, t0: float, fixed: np.ndarray):
        mechanism, top = start.mechanism, start.mechanism.topology
        self.q, self.v = start.q0[:-3], start.v0[:-3]
        own = top._replace(pair_parameters=top.pair_parameters.copy())
        self._search = LeastChange(replace(mechanism, topology=own), t0, fixed)
        self._points, self._numbers = own.pair_parameters, self._search.scratch.law_values
        self._light = np.where(fixed, 0.0, np.sqrt(top.weight[:-1].ravel()))
        _, entries, _ = self._search.evaluate(self.q)
        self._jacobian = np.zeros((len(self._search.rows), len(self.q)))
        np.add.at(self._jacobian, entries[:2], entries[2])

    def _residuals(self, q: np.ndarray) -> np.ndarray:
        """Return the residuals of positions and velocities (2, m)."""
        phi, jacobian, phi_t = self._search.evaluate(q)
        return np.array([phi, self._search.rates(jacobian, self.v, phi_t)])

    def _along(self, evaluate: Callable[[float], np.ndarray], unit: float) -> np.ndarray:
        now = evaluate(0.0)
        terms = (w * (evaluate(place * unit) - now) for place, w in zip(CENTRAL, weights(CENTRAL), strict=True))
        return np.asarray(sum(terms)) / unit

    def by_numbers(self, points: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Return the derivatives (2, m, K) of the residuals, given those of the parameters of the joints (P, 6, K), and
        of the numbers of laws (L, K) that are in functions of the pose.
        """
        total = np.zeros((2, len(self._search.rows), numbers.shape[-1]))
        for column in np.flatnonzero(np.any(points, axis=(0, 2))).tolist():
            total += self._by(self._points[:, column])[..., None] * points[self._search.rows[:, 0], column]
        for place in np.flatnonzero(np.any(numbers, axis=1)).tolist():
            total += self._by(self._numbers[place : place + 1])[..., None] * numbers[place]
        return total

    def _by(self, numbers: np.ndarray) -> np.ndarray:
        """Return the derivatives (2, m) of the residuals, if some numbers of the mechanism change equally."""
        given = numbers.copy()
        unit = 2.0 ** np.floor(np.log2(0.0125 * max(0.1, float(np.max(np.abs(given))))))

        def moved(change: float) -> np.ndarray:
            numbers[:] = given + change
            return self._residuals(self.q)

        found = self._along(moved, unit)
        numbers[:] = given
        return found

    def _projected(self, given: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Return derivatives (n, K) near the given ones for which the residual ``J x + r`` (m, K) vanishes."""
        miss = self._jacobian @ given + residual
        size = np.abs(self._jacobian) @ np.abs(given) + np.abs(residual)
        if not np.any(np.abs(miss) > CONSISTENT * np.max(size, axis=0, initial=0.0)):
            return given
        light = self._light
        return np.asarray(given - light[:, None] * np.linalg.lstsq(self._jacobian * light, miss, RANK)[0])

    def of(self, q: np.ndarray, v: np.ndarray, points: np.ndarray, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """Return the derivatives of the start ``q`` and ``v`` (3 (B + 1), K) from those of the given values, ground
        last; for `points` and `numbers`, see `by_numbers`.
        """
        residuals, rate = self.by_numbers(points, numbers)
        dq = self._projected(q[:-3], residuals)
        for k in np.flatnonzero(np.any(dq, axis=0)) if np.any(self.v) else ():
            way = 0.001 / float(np.max(np.abs(dq[:, k]))) * dq[:, k]

            def moved(share: float, way: np.ndarray = way) -> np.ndarray:
                return self._residuals(self.q + share * way)

            rate[:, k] += self._along(moved, 1.0)[1] * float(np.max(np.abs(dq[:, k]))) / 0.001
        dv = self._projected(v[:-3], rate)
        return {name: np.apply_along_axis(with_ground, 0, x) for name, x in (("q", dq), ("v", dv)) if np.any(x)}


def arrays_from(
    places: Mapping[str, tuple[np.ndarray, np.ndarray]], base: Mapping[str, np.ndarray], slopes: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the derivatives (..., K) of the arrays that recorded results are entries of, without those left out."""
    arrays = {}
    for name, (entries, columns) in places.items():
        if name not in (*LEFT_OUT, "tolerance", "longest", "size"):
            full = np.zeros((base[name].size, slopes.shape[1]))
            full[entries] = slopes[columns]
            arrays[name] = full.reshape(*base[name].shape, -1)
    return arrays
