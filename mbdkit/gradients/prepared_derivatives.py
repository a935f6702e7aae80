"""Derivatives of the preparation of a run: of the compiled mechanism and of its consistent start, by parameters.

The preparation turns a spec into arrays: it validates the model, builds and compiles the mechanism, and assembles its
initial state. It is repeated with other values of one parameter. Arrays that depend on it linearly have the slope of a
line through two points, which is exact but for rounding errors. All others are differentiated by differences of order
8, whose error is estimated from that of order 6; the distance of the points is reduced until it is small. The numbers
in expressions of measures and events, which may depend on named parameters, are treated in the same way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.consistent_start import Starts
from mbdkit.engine.kernels.system import Topology
from mbdkit.errors import SpecError
from mbdkit.gradients.differentiated_expressions import NO_MEASURES, Definitions, numbers_of
from mbdkit.gradients.gradient_parameters import Parameter
from mbdkit.run_corners import knots_of
from mbdkit.spec import RunSpec
from mbdkit.spec.varied_specs import VariedSpecs

Arrays = Mapping[str, np.ndarray]

WIDEST = 0.05
"""Largest change of a parameter, as a share of its size."""
SMALLEST_SIZE = 0.1
"""Least size of a parameter, in SI units and with lengths in units of the mechanism's length if that is below 1 m.

Changes as a share of a smaller value, such as an angle of 1e-9 rad, would be lost in rounding errors.
"""
FACTOR, MOST_ATTEMPTS = 4.0, 4
"""Reduction of the changes while differences are not accurate, and number of attempts."""
ACCURATE = 1e-13
"""Difference of the derivatives of order 8 and 6, relative to the array over its parameter, that counts as accurate."""
LINEAR = 64.0
"""Deviation from a line, in roundings of the array, that counts as round-off."""
CENTRAL, FORWARD = (-4, -3, -2, -1, 1, 2, 3, 4), (1, 2, 3, 4, 5, 6, 7, 8)
BACKWARD = tuple(-place for place in FORWARD)
"""Places of the points, in units of a quarter of the largest change."""
FEW = {CENTRAL: (-4, 1, 4), FORWARD: (2, 4, 8), BACKWARD: (-8, -4, -2)}
"""Places by which linear dependence is recognised."""

LEFT_OUT = ("length", "row_units", "spare_axes", "weight")
"""Arrays of the mechanism that are units or choices, on which its motion does not depend, and the inverse masses."""


@dataclass(frozen=True)
class PreparedDerivatives:
    """Derivatives of the arrays of a prepared run.

    Parameters
    ----------
    seeds
        Derivatives (..., K) of the arrays of the mechanism, of the initial state ``q`` and ``v``, and of the numbers of
        measures and events (`numbers_of`), by K parameters.
    error
        (K,) estimated errors of these derivatives by each parameter, relative to the largest derivative of an array.
    scale
        (K,) size of each parameter, by which its changes are measured.
    side
        (K,) 0, or the sign of the changes by which the spec stays valid, such as 1 for a damping of zero.
    """

    seeds: dict[str, np.ndarray]
    error: np.ndarray
    scale: np.ndarray
    side: np.ndarray


def prepared_derivatives(
    spec: RunSpec, parameters: Sequence[Parameter], definitions: Definitions = NO_MEASURES
) -> PreparedDerivatives:
    """Return the derivatives of the prepared run by parameters.

    Parameters
    ----------
    definitions
        The measures, whose numbers may depend on the parameters.

    Raises
    ------
    SpecError
        If the structure of the mechanism depends on a parameter, or if the spec is not valid near its value.
    """
    preparation = _Preparation(spec, definitions)
    found = [preparation.derivatives(one) for one in parameters]
    base = preparation.base
    seeds = {
        name: np.stack([one.slopes.get(name, np.zeros(x.shape)) for one in found], axis=-1)
        for name, x in base.items()
        if any(name in one.slopes for one in found)
    }
    if "mass" in seeds:  # exact, and zero for ground
        weight = preparation.mechanism.topology.weight
        seeds["weight"] = -(weight**2)[..., None] * seeds["mass"]
    return PreparedDerivatives(
        seeds,
        np.array([one.error for one in found]),
        np.array([preparation.scale(one) for one in parameters]),
        np.array([one.side for one in found]),
    )


@dataclass(frozen=True)
class _Derivatives:
    """The derivatives of all arrays by one parameter that are not zero; see `PreparedDerivatives`."""

    slopes: dict[str, np.ndarray]
    error: float
    side: int


class _Preparation:
    """Prepares runs of a spec with other values of a parameter."""

    def __init__(self, spec: RunSpec, definitions: Definitions):
        self.spec, self.definitions = spec, definitions
        self.specs = VariedSpecs(spec.canonical_json())
        self.starts = Starts()
        self.mechanism, self.base = self._arrays(spec)
        self.knots = knots_of(spec)

    def _arrays(self, spec: RunSpec) -> tuple[CompiledMechanism, dict[str, np.ndarray]]:
        start = self.starts.at_start(spec.mechanism(), spec.time.start, spec.time.final)
        top = start.mechanism.topology
        arrays = {name: x for name, x in top._asdict().items() if x.dtype.kind == "f" and name not in LEFT_OUT}
        numbers = numbers_of(spec, self.definitions) if spec.parameters else {}
        return start.mechanism, {**arrays, "q": start.q0, "v": start.v0, **numbers}

    def scale(self, parameter: Parameter) -> float:
        """Return the size of a parameter, by which its changes are measured."""
        return max(abs(parameter.value), SMALLEST_SIZE * min(1.0, self.mechanism.length))

    def derivatives(self, parameter: Parameter) -> _Derivatives:
        """Return the derivatives by a parameter."""
        try:
            return _Derivatives(*self._with_places(parameter, CENTRAL), 0)
        except SpecError as error:
            for side, places in ((1, FORWARD), (-1, BACKWARD)):
                with suppress(SpecError):
                    return _Derivatives(*self._with_places(parameter, places), side)
            if error.key == "gradients":
                raise
            raise SpecError(
                f"the run has no derivative by '{parameter.name}', because the spec is not valid for values close to "
                f"{parameter.value!r}: {error}",
                key="gradients",
            ) from None

    def _with_places(self, parameter: Parameter, places: tuple[int, ...]) -> tuple[dict[str, np.ndarray], float]:
        """Return the derivatives by a parameter that are not zero, and their error, by points at these places."""
        unit = 2.0 ** np.floor(np.log2(WIDEST / 4.0 * self.scale(parameter)))
        points = {place: self._at(parameter, place * unit) for place in FEW[places]}
        slopes: dict[str, np.ndarray] = {}
        errors: dict[str, float] = {}
        for name, base in self.base.items():
            slope = _slope_of_line(base, {place: (x, arrays[name]) for place, (x, arrays) in points.items()})
            if slope is not None:
                slopes[name], errors[name] = slope, 0.0
        waiting = [name for name in self.base if name not in slopes]
        for _ in range(MOST_ATTEMPTS):
            if not waiting:
                break
            points |= {place: self._at(parameter, place * unit) for place in places if place not in points}
            for name in waiting:
                slope, error = self._difference(parameter, name, points, places)
                if error < errors.get(name, np.inf):
                    slopes[name], errors[name] = slope, error
            waiting = [name for name in waiting if errors[name] > ACCURATE]
            unit, points = unit / FACTOR, {}
        return {name: x for name, x in slopes.items() if np.any(x)}, max(errors.values())

    def _at(self, parameter: Parameter, change: float) -> tuple[float, dict[str, np.ndarray]]:
        """Return the value of a parameter near its own, and the arrays for it."""
        value = parameter.value + change
        spec = self.specs.spec([(parameter.path, value)])
        if knots_of(spec) != self.knots:
            raise SpecError(
                f"a knot or corner of a motion moves with '{parameter.name}'; by such parameters a run has no "
                "derivatives",
                key="gradients",
            )
        mechanism, arrays = self._arrays(spec)
        if any(x.shape != arrays[name].shape for name, x in self.base.items() if name not in Topology._fields):
            raise SpecError(
                f"the form of an expression depends on '{parameter.name}', such as that of an exponent; by such "
                "parameters a run has no derivatives",
                key="gradients",
            )
        for name, x in self.mechanism.topology._asdict().items():
            other = getattr(mechanism.topology, name)
            if x.shape != other.shape or (x.dtype.kind == "i" and not np.array_equal(x, other)):
                raise SpecError(
                    f"the structure of the mechanism depends on '{parameter.name}': it is another one for {value!r}",
                    key="gradients",
                )
        return value - parameter.value, arrays

    def _difference(
        self,
        parameter: Parameter,
        name: str,
        points: Mapping[int, tuple[float, Arrays]],
        places: tuple[int, ...],
    ) -> tuple[np.ndarray, float]:
        """Return the derivative of an array by differences of order 8, and its relative error by those of order 6."""
        base, unit = self.base[name], points[places[0]][0] / places[0]
        fewer = tuple(place for place in places if abs(place) < max(map(abs, places)))
        fine, coarse = (
            np.asarray(
                sum(w * (points[place][1][name] - base) for place, w in zip(some, weights(some), strict=True)) / unit
            )
            for some in (places, fewer)
        )
        scale = self.scale(parameter)
        size = max(float(np.max(np.abs(fine))), float(np.max(np.abs(base))) / scale)
        if name in ("q", "v"):  # which assembly changes by rounding errors of lengths and angles
            size = max(size, self.mechanism.length / scale)
        error = float(np.max(np.abs(fine - coarse))) / size if size > 0.0 else 0.0
        return fine, error


def _slope_of_line(base: np.ndarray, points: Mapping[int, tuple[float, np.ndarray]]) -> np.ndarray | None:
    """Return the slope of the line through the first and the last point; None if others are not on it."""
    (x0, low), (x1, high) = points[min(points)], points[max(points)]
    slope = (high - low) / (x1 - x0)
    limit = LINEAR * np.finfo(float).eps * np.maximum(np.maximum(np.abs(high), np.abs(low)), np.abs(base))
    others = [(0.0, base), *points.values()]
    is_line = all(bool(np.all(np.abs(y - low - slope * (x - x0)) <= limit)) for x, y in others)
    return np.asarray(slope) if is_line else None


@cache
def weights(places: tuple[int, ...]) -> tuple[float, ...]:
    """Return the weights of ``f(x) - f(0)`` in the derivative at 0 of the polynomial through 0 and all places."""
    found = []
    for one in places:
        weight = Fraction(1, one)
        for other in places:
            if other != one:
                weight *= Fraction(-other, one - other)
        found.append(float(weight))
    return tuple(found)
