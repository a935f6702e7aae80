"""Derivatives of the preparation of a run: of the compiled mechanism and of its consistent start, by parameters.

The preparation turns a spec into arrays: it validates the model, builds and compiles the mechanism, and assembles its
initial state. It is repeated with other values of one parameter. Arrays that depend on it linearly have the slope of a
line through two points, which is exact but for rounding errors. All others are differentiated by differences of order
8, whose error is estimated from that of order 6; the distance of the points is reduced until it is small.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.consistent_start import Starts
from mbdkit.errors import SpecError
from mbdkit.gradients.gradient_parameters import Parameter
from mbdkit.spec import RunSpec
from mbdkit.spec.varied_specs import VariedSpecs

Arrays = Mapping[str, np.ndarray]

WIDEST = 0.05
"""Largest change of a parameter, as a share of its value."""
FACTOR, MOST_ATTEMPTS = 4.0, 4
"""Reduction of the changes while differences are not accurate, and number of attempts."""
ACCURATE = 1e-13
"""Difference of the derivatives of order 8 and 6, relative to the array over its parameter, that counts as accurate."""
LINEAR = 64.0
"""Deviation from a line, in roundings of the array, that counts as round-off."""
CENTRAL, FORWARD = (-4, -3, -2, -1, 1, 2, 3, 4), (1, 2, 3, 4, 5, 6, 7, 8)
"""Places of the points, in units of a quarter of the largest change."""

CHOSEN = ("length", "row_units", "spare_axes")
"""Arrays of the mechanism that are units or choices, on which its motion does not depend."""


@dataclass(frozen=True)
class PreparedDerivatives:
    """Derivatives of the arrays of a prepared run.

    Parameters
    ----------
    seeds
        Derivatives (..., K) of the arrays of the mechanism, and of the initial state ``q`` and ``v``, by K parameters.
    error
        (K,) estimated errors of these derivatives by each parameter, relative to the largest derivative of an array.
    """

    seeds: dict[str, np.ndarray]
    error: np.ndarray


def prepared_derivatives(spec: RunSpec, parameters: Sequence[Parameter]) -> PreparedDerivatives:
    """Return the derivatives of the prepared run by parameters.

    Raises
    ------
    SpecError
        If the structure of the mechanism depends on a parameter, or if the spec is not valid near its value.
    """
    preparation = _Preparation(spec)
    found = [preparation.derivatives(one) for one in parameters]
    base = preparation.base
    seeds = {
        name: np.stack([slopes.get(name, np.zeros(x.shape)) for slopes, _ in found], axis=-1)
        for name, x in base.items()
        if any(name in slopes for slopes, _ in found)
    }
    if "mass" in seeds:  # exact, and zero for ground
        seeds["weight"] = -(base["weight"] ** 2)[..., None] * seeds["mass"]
    return PreparedDerivatives(seeds, np.array([error for _, error in found]))


class _Preparation:
    """Prepares runs of a spec with other values of a parameter."""

    def __init__(self, spec: RunSpec):
        self.spec = spec
        self.specs = VariedSpecs(spec.canonical_json())
        self.starts = Starts()
        self.mechanism, self.base = self._arrays(spec)

    def _arrays(self, spec: RunSpec) -> tuple[CompiledMechanism, dict[str, np.ndarray]]:
        start = self.starts.at_start(spec.mechanism(), spec.time.start, spec.time.final)
        top = start.mechanism.topology
        arrays = {name: x for name, x in top._asdict().items() if x.dtype.kind == "f" and name not in CHOSEN}
        return start.mechanism, {**arrays, "q": start.q0, "v": start.v0}

    def derivatives(self, parameter: Parameter) -> tuple[dict[str, np.ndarray], float]:
        """Return the derivatives by a parameter that are not zero, and their estimated error."""
        try:
            places: tuple[int, ...] = CENTRAL
            return self._with_places(parameter, places)
        except SpecError as error:
            try:
                return self._with_places(parameter, FORWARD)
            except SpecError:
                try:
                    return self._with_places(parameter, tuple(-place for place in FORWARD))
                except SpecError:
                    raise SpecError(
                        f"the run has no derivative by '{parameter.name}', because the spec is not valid for values "
                        f"close to {parameter.value!r}: {error}",
                        key="gradients",
                    ) from None

    def _with_places(self, parameter: Parameter, places: tuple[int, ...]) -> tuple[dict[str, np.ndarray], float]:
        unit = 2.0 ** np.floor(np.log2(WIDEST / 4.0 * self._scale(parameter)))
        ends = (places[0], places[-1]) if places is CENTRAL else (places[3], places[-1])
        middle = (-2, 2) if places is CENTRAL else (places[1],)
        points = {place: self._at(parameter, place * unit) for place in (*ends, *middle)}
        best: tuple[dict[str, np.ndarray], float] | None = None
        for _ in range(MOST_ATTEMPTS):
            if best is None and all(self._is_line(name, points, ends, middle) for name in self.base):
                low, high = points[ends[0]], points[ends[1]]
                span = high[0] - low[0]
                return _without_zeros({name: (high[1][name] - low[1][name]) / span for name in self.base}), 0.0
            for place in places:
                if place not in points:
                    points[place] = self._at(parameter, place * unit)
            found = self._by_differences(parameter, points, places, ends, middle)
            if best is None or found[1] < best[1]:
                best = found
            if best[1] <= ACCURATE:
                break
            unit /= FACTOR
            points = {}
            for place in (*ends, *middle):
                points[place] = self._at(parameter, place * unit)
        assert best is not None
        return _without_zeros(best[0]), best[1]

    def _scale(self, parameter: Parameter) -> float:
        """Return the size of the changes of a parameter."""
        return abs(parameter.value) or min(1.0, self.mechanism.length)

    def _at(self, parameter: Parameter, change: float) -> tuple[float, dict[str, np.ndarray]]:
        """Return the value of a parameter near its own, and the arrays for it."""
        value = parameter.value + change
        mechanism, arrays = self._arrays(self.specs.spec([(parameter.path, value)]))
        for name, x in self.mechanism.topology._asdict().items():
            other = getattr(mechanism.topology, name)
            if x.shape != other.shape or (x.dtype.kind == "i" and not np.array_equal(x, other)):
                raise SpecError(
                    f"the structure of the mechanism depends on '{parameter.name}': it is another one for {value!r}",
                    key="gradients",
                )
        return value - parameter.value, arrays

    def _is_line(
        self,
        name: str,
        points: Mapping[int, tuple[float, Arrays]],
        ends: tuple[int, int],
        middle: tuple[int, ...],
    ) -> bool:
        """Return whether an array is a linear function of the parameter, as far as the points tell."""
        (x0, low), (x1, high) = (points[place] for place in ends)
        slope = (high[name] - low[name]) / (x1 - x0)
        size = np.maximum(np.maximum(np.abs(high[name]), np.abs(low[name])), np.abs(self.base[name]))
        limit = LINEAR * np.finfo(float).eps * size
        deviations = [np.abs(self.base[name] - low[name] + slope * x0)]
        deviations += [np.abs(points[m][1][name] - low[name] - slope * (points[m][0] - x0)) for m in middle]
        return all(bool(np.all(one <= limit)) for one in deviations)

    def _by_differences(
        self,
        parameter: Parameter,
        points: Mapping[int, tuple[float, Arrays]],
        places: tuple[int, ...],
        ends: tuple[int, int],
        middle: tuple[int, ...],
    ) -> tuple[dict[str, np.ndarray], float]:
        """Return derivatives by differences of order 8, exact ones of arrays that are linear, and the largest error."""
        fewer = tuple(place for place in places if abs(place) < max(map(abs, places)))
        unit = points[places[0]][0] / places[0]
        found, worst = {}, 0.0
        for name, base in self.base.items():
            if self._is_line(name, points, ends, middle):
                (x0, low), (x1, high) = (points[place] for place in ends)
                found[name] = (high[name] - low[name]) / (x1 - x0)
                continue
            fine, coarse = (
                sum(w * (points[place][1][name] - base) for place, w in zip(some, weights(some), strict=True)) / unit
                for some in (places, fewer)
            )
            found[name] = np.asarray(fine)
            size = max(float(np.max(np.abs(fine))), float(np.max(np.abs(base))) / self._scale(parameter))
            worst = max(worst, float(np.max(np.abs(fine - coarse))) / size if size > 0.0 else 0.0)
        return found, worst


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


def _without_zeros(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: x for name, x in arrays.items() if np.any(x)}
