"""Derivatives, with respect to parameters, of the arrays that a spec is compiled to, such as the mechanism and its
initial state.

The preparation, which turns a spec into arrays, is repeated with other values of one parameter. If an array depends on
the parameter linearly, its derivative is the slope of a line through two points, which is exact up to rounding errors.
All other arrays are differentiated by differences of order 8, whose error is estimated from differences of order 6. The
distance of the points is reduced until this error is small.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from math import prod

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.table_rows import LAW_ROW
from mbdkit.integrators.duals.dual_run import Seeds
from mbdkit.laws.tabulated import LAW as TABLE
from mbdkit_gradients.gradient_parameters import Parameter, refused
from mbdkit_gradients.table_derivatives import TableValues

Arrays = Mapping[str, np.ndarray]

#: Largest change of a parameter on both sides, relative to its size; a change on only one side is up to twice this.
WIDEST = 0.05
#: Smallest size that is assumed for a parameter, such as an angle of 1e-9 rad.
#:
#: The effect of smaller changes would be lost in rounding errors. The size is in SI units; if the length of the
#: mechanism is below 1 m, the size is multiplied by this length.
SMALLEST_SIZE = 0.1
#: Factor by which changes are reduced as long as differences are not accurate, and largest number of attempts.
FACTOR, MOST_ATTEMPTS = 4.0, 4
#: Largest difference between the derivatives of order 8 and 6 for which they count as accurate.
#:
#: It is relative to the largest derivative, or to the largest value of the array divided by the size of the parameter,
#: whichever is larger.
ACCURATE = 1e-13
LINEAR = 64.0  #: Largest deviation from a line that counts as rounding, in units of round-off of the array.
#: Smallest change of parameters, relative to their sizes, at which arrays show whether they are linear in all of them.
#:
#: Derivatives of arrays that are not, but seem to be, have relative errors of ``LINEAR`` units of round-off over this.
APART = 1e-3
MANY = 3  #: Smallest number of values of a table that are differentiated together.
RANK = 1e-9  #: Smallest singular value, relative to the largest, of matrices that count as regular.
CENTRAL, FORWARD = (-4, -3, -2, -1, 1, 2, 3, 4), (1, 2, 3, 4, 5, 6, 7, 8)
#: Positions of the points, in a unit that is at most a quarter of `WIDEST` times the size of the parameter.
BACKWARD = tuple(-place for place in FORWARD)
SIDES = {0: CENTRAL, 1: FORWARD, -1: BACKWARD}  #: Positions by the side on which they are.
#: Positions of the points that are used, with 0, to test for linear dependence.
FEW = {CENTRAL: (-4, 3), FORWARD: (4, 8), BACKWARD: (-8, -4)}


#: Arrays that are not differentiated.
#:
#: The motion does not depend on the first three, which are units and choices. The derivatives of the last one, the
#: inverse masses, follow from those of the masses.
LEFT_OUT = ("length", "row_units", "spare_axes", "weight")


@dataclass(frozen=True)
class PreparedDerivatives:
    """Derivatives of the arrays of a prepared run.

    Parameters
    ----------
    seeds
        Derivatives with respect to K parameters of the arrays of the mechanism, of the initial state ``q`` and ``v``,
        and of the numbers of measures and events (`numbers_of`).
    error
        (K,) estimated errors of these derivatives with respect to each parameter, relative to the largest derivative of
        an array.
    side
        (K,) 0 if the spec is valid for changes of both signs, otherwise the sign for which it is valid, such as 1 for a
        damping of zero.
    """

    seeds: Seeds
    error: np.ndarray
    side: np.ndarray

    def with_columns(self, where: np.ndarray, others: PreparedDerivatives) -> PreparedDerivatives:
        """Return these derivatives with others in place of those with respect to some parameters, (K,) `where`."""
        arrays, error, side = dict(self.seeds.arrays), self.error.copy(), self.side.copy()
        for name, x in others.seeds.arrays.items():
            own = arrays.get(name)
            arrays[name] = np.zeros((*x.shape[:-1], len(where))) if own is None else own.copy()
            arrays[name][..., where] = x
        error[where], side[where] = others.error, others.side
        return PreparedDerivatives(Seeds(arrays, self.seeds.scale), error, side)


@dataclass(frozen=True)
class KnownDerivatives:
    """Derivatives of the arrays of a preparation at some values (K,) of its parameters."""

    values: np.ndarray
    mechanism: CompiledMechanism
    base: Arrays
    derivatives: PreparedDerivatives


class Preparation(ABC):
    """Prepares a spec with other values of a parameter.

    Attributes
    ----------
    mechanism
        The compiled mechanism of the spec.
    base
        Arrays of the preparation of the spec itself, by name.
    """

    mechanism: CompiledMechanism
    base: Arrays
    ROUNDED: tuple[str, ...] = ()
    """Names of arrays that have rounding errors of lengths and angles, even if their values are small."""

    @cached_property
    def sides(self) -> dict[tuple[Path, float], int]:
        """Sides on which the spec is valid near a value of a parameter, by its key path and this value, if known."""
        return {}

    @cached_property
    def _signed(self) -> dict[Parameter, bool]:
        """Whether small parameters may have the other sign, if known."""
        return {}

    @abstractmethod
    def at(self, parameter: Parameter, value: float) -> Arrays:
        """Return the arrays for another value of a parameter.

        Raises
        ------
        SpecError
            If the spec is not valid with this value, or if the structure of the arrays depends on the parameter.
        """

    def derivatives(self, parameters: Sequence[Parameter]) -> PreparedDerivatives:
        """Return the derivatives of the arrays with respect to parameters.

        Raises
        ------
        SpecError
            If the structure of the arrays depends on a parameter, or if the spec is not valid near its value.
        """
        exact: dict[int, _ArrayDerivatives] = {}
        for table in self.tables(parameters):
            slopes = np.zeros((len(self.base["law_parameters"]), len(table.columns)))
            slopes[table.rows] = table.slopes()
            exact |= {
                k: _ArrayDerivatives({"law_parameters": x}, 0.0, 0)
                for k, x in zip(table.columns.tolist(), slopes.T, strict=True)
            }
        found = [exact[k] if k in exact else self._by(one) for k, one in enumerate(parameters)]
        return self._joined(found, parameters)

    def tables(self, parameters: Sequence[Parameter]) -> list[TableValues]:
        """Return the parameters that are values in tables of force laws; these change nothing but numbers of the law.

        One point with another value of one of them confirms that.
        """
        tables: dict[str, dict[int, int]] = {}
        for k, one in enumerate(parameters):
            match [*map(str, one.path)]:
                case ["model", "forces", force, "table", "1", place]:
                    tables.setdefault(force, {})[k] = int(place)
        found = []
        for places in tables.values():
            if len(places) < MANY:
                continue
            middle = len(places) // 2
            try:
                change, arrays = self._point(parameters[[*places][middle]], self._unit(parameters[[*places][middle]]))
            except SpecError:
                continue
            table = self._table(arrays["law_parameters"] != self.base["law_parameters"], places)
            if table is None:
                continue
            before, after = (x["law_parameters"].copy() for x in (self.base, arrays))
            pieces = after[table.rows] - before[table.rows]
            miss = pieces - change * table.slopes(slice(middle, middle + 1))[:, 0]
            # the third derivatives of the spline amplify the rounding errors of its values
            size = np.max(np.abs(pieces)) + np.max(np.abs(after[table.rows][::5])) / np.min(np.diff(table.lengths)) ** 3
            after[table.rows] = before[table.rows]
            same = {**arrays, "law_parameters": after}
            if np.all(np.abs(miss) <= LINEAR * np.finfo(float).eps * size) and all(
                np.array_equal(same[name], x) for name, x in self.base.items()
            ):
                found.append(table)
        return found

    def _table(self, moved: np.ndarray, places: Mapping[int, int]) -> TableValues | None:
        """Return the table whose values some numbers of laws, (P,) `moved`, depend on; None if they are no table's.

        `places`: indices of values of the table by those of the parameters.
        """
        top = self.mechanism.topology
        for (_, law), begin in zip(self.mechanism.laws, top.laws[:, LAW_ROW.parameters].tolist(), strict=True):
            if law.law is TABLE and np.any(moved[begin + 1 : begin + 1 + int(top.law_parameters[begin])]):
                first = begin + 4 + int(top.law_parameters[begin + 2])
                lengths = top.law_parameters[begin + 3 : first].copy()
                return TableValues(first, lengths, np.array([*places]), np.array([*places.values()]))
        return None

    def lines(self, parameters: Sequence[Parameter]) -> PreparedDerivatives:
        """Return what the derivatives are if all arrays are linear in the parameters, from one point for each.

        Raises
        ------
        SpecError
            See `derivatives`.
        """
        sides = [self.sides.get((one.path, one.value), 0) for one in parameters]
        places = (FEW[SIDES[side]][0] for side in sides)
        points = [self._point(one, place * self._unit(one)) for one, place in zip(parameters, places, strict=True)]
        slopes = [{name: (arrays[name] - x) / change for name, x in self.base.items()} for change, arrays in points]
        nonzero = [{name: x for name, x in own.items() if np.any(x)} for own in slopes]
        found = [_ArrayDerivatives(own, 0.0, side) for own, side in zip(nonzero, sides, strict=True)]
        return self._joined(found, parameters)

    def _joined(self, found: Sequence[_ArrayDerivatives], parameters: Sequence[Parameter]) -> PreparedDerivatives:
        seeds = {
            name: np.stack([one.slopes.get(name, np.zeros(x.shape)) for one in found], axis=-1)
            for name, x in self.base.items()
            if any(name in one.slopes for one in found)
        }
        error, side = np.array([one.error for one in found]), np.array([one.side for one in found])
        return self._completed(seeds, parameters, error, side)

    def _completed(self, slopes: Arrays, parameters: Sequence[Parameter], *rest: np.ndarray) -> PreparedDerivatives:
        """Add sizes of the parameters, and derivatives of inverse masses, which are exact, and zero for ground."""
        if "mass" in slopes:
            slopes = {**slopes, "weight": -(self.mechanism.topology.weight**2)[..., None] * slopes["mass"]}
        return PreparedDerivatives(Seeds(slopes, np.array([self._scale(parameter) for parameter in parameters])), *rest)

    def repeated(self, known: KnownDerivatives, parameters: Sequence[Parameter]) -> PreparedDerivatives | None:
        """Return derivatives that are known at other values, if all arrays are linear in the parameters together, from
        these values to the present ones; otherwise None.

        Products of parameters are told apart from linear arrays only if all parameters differ.
        """
        slopes, error, side = known.derivatives.seeds, known.derivatives.error, known.derivatives.side
        changes = np.array([one.value for one in parameters]) - known.values
        if np.any(error) or np.any(side) or np.any(np.abs(changes) < APART * slopes.scale):
            return None
        topologies = zip(self.mechanism.topology, known.mechanism.topology, strict=True)
        if any(x.dtype.kind == "i" and not np.array_equal(x, y) for x, y in topologies):
            return None
        for name, x in self.base.items():
            y, slope = known.base[name], slopes.get(name)
            if x.shape != y.shape:
                return None
            steps = np.zeros((*x.shape, 1)) if slope is None else slope * changes
            limit = LINEAR * np.finfo(float).eps * (np.abs(x) + np.abs(y) + np.sum(np.abs(steps), axis=-1))
            if np.any(np.abs(x - y - np.sum(steps, axis=-1)) > limit):
                return None
        return self._completed(slopes.arrays, parameters, error, side)

    def mechanism_arrays(self, mechanism: CompiledMechanism) -> dict[str, np.ndarray]:
        """Return the arrays of a mechanism that may depend on parameters."""
        fields = mechanism.topology._asdict()
        return {name: x for name, x in fields.items() if x.dtype.kind == "f" and name not in LEFT_OUT}

    def require_same_structure(self, mechanism: CompiledMechanism, parameter: Parameter, value: float) -> None:
        """Raise SpecError if a mechanism differs from that of the spec in more than its numbers, or in the times at
        which controllers take samples.
        """
        for name, x in self.mechanism.topology._asdict().items():
            other = getattr(mechanism.topology, name)
            if x.shape != other.shape or (x.dtype.kind == "i" and not np.array_equal(x, other)):
                raise refused(f"the structure of the mechanism depends on '{parameter.name}': it changes for {value!r}")
        for one, other in zip(self.mechanism.controllers, mechanism.controllers, strict=True):
            if (one.period, one.delay) != (other.period, other.delay):
                raise refused(
                    f"the times of the samples of the controller '{one.name}' depend on '{parameter.name}'; there are "
                    "no derivatives with respect to such a parameter"
                )

    def require_same_form(self, arrays: Arrays, parameter: Parameter) -> None:
        """Raise SpecError if expressions do not have as many instructions as those of the spec.

        `arrays` has the numbers in the instructions; see `numbers_of`.
        """
        if any(x.shape != self.base[name].shape for name, x in arrays.items()):
            raise refused(
                f"the form of an expression depends on '{parameter.name}', for example because it is an exponent; "
                f"derivatives with respect to such a parameter are not available"
            )

    def _scale(self, parameter: Parameter) -> float:
        """Return the size of a parameter, relative to which its changes are measured.

        A small number that cannot have the other sign, such as an inertia, is its own size: larger changes would pass
        zero.
        """
        size, assumed = abs(parameter.value), SMALLEST_SIZE * min(1.0, self.mechanism.length)
        if 0.0 < size < WIDEST * assumed:
            if parameter not in self._signed:
                try:
                    self.at(parameter, -parameter.value)
                    self._signed[parameter] = True
                except SpecError:
                    self._signed[parameter] = False
            if not self._signed[parameter]:
                return size
        return max(size, assumed)

    def _unit(self, parameter: Parameter) -> float:
        return float(2.0 ** np.floor(elementary.log2(WIDEST / 4.0 * self._scale(parameter))))

    def _by(self, parameter: Parameter) -> _ArrayDerivatives:
        key, failure = (parameter.path, parameter.value), None
        for side in sorted(SIDES, key=lambda side: side != self.sides.get(key, 0)):
            try:
                found = _ArrayDerivatives(*self._with_places(parameter, SIDES[side]), side)
            except SpecError as error:
                failure = failure or error
                continue
            if side:
                self.sides[key] = side
            return found
        assert failure is not None
        if failure.key == "gradients":
            raise failure
        raise refused(
            f"there is no derivative with respect to '{parameter.name}', because the spec is not valid for values "
            f"close to {parameter.value!r}: {failure}"
        )

    def _with_places(self, parameter: Parameter, places: tuple[int, ...]) -> tuple[dict[str, np.ndarray], float]:
        """Return non-zero derivatives with respect to a parameter and their error, from points at these positions."""
        unit = self._unit(parameter)
        points = {place: self._point(parameter, place * unit) for place in FEW[places]}
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
            points |= {place: self._point(parameter, place * unit) for place in places if place not in points}
            for name in waiting:
                slope, error = self._difference(parameter, name, points, places)
                if error < errors.get(name, np.inf):
                    slopes[name], errors[name] = slope, error
            waiting = [name for name in waiting if errors[name] > ACCURATE]
            unit, points = unit / FACTOR, {}
        return {name: x for name, x in slopes.items() if np.any(x)}, max(errors.values())

    def _point(self, parameter: Parameter, change: float) -> tuple[float, Arrays]:
        """Return the actual change of a parameter after rounding, and the arrays for the changed parameter."""
        value = parameter.value + change
        return value - parameter.value, self.at(parameter, value)

    def _difference(
        self, parameter: Parameter, name: str, points: Mapping[int, tuple[float, Arrays]], places: tuple[int, ...]
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
        scale = self._scale(parameter)
        size = max(float(np.max(np.abs(fine))), float(np.max(np.abs(base))) / scale)
        if name in self.ROUNDED:
            size = max(size, self.mechanism.length / scale)
        return fine, (float(np.max(np.abs(fine - coarse))) / size if size > 0.0 else 0.0)


@dataclass(frozen=True)
class _ArrayDerivatives:
    """The derivatives of arrays, except zeros, with respect to one parameter; see `PreparedDerivatives`."""

    slopes: dict[str, np.ndarray]
    error: float
    side: int


def _slope_of_line(base: np.ndarray, points: Mapping[int, tuple[float, np.ndarray]]) -> np.ndarray | None:
    """Return the slope of the line through the first and last point; None if other points are not on it."""
    (x0, low), (x1, high) = points[min(points)], points[max(points)]
    slope = (high - low) / (x1 - x0)
    limit = LINEAR * np.finfo(float).eps * np.maximum(np.maximum(np.abs(high), np.abs(low)), np.abs(base))
    others = [(0.0, base), *points.values()]
    is_line = all(bool(np.all(np.abs(y - low - slope * (x - x0)) <= limit)) for x, y in others)
    return np.asarray(slope) if is_line else None


@cache
def weights(places: tuple[int, ...]) -> tuple[float, ...]:
    """Return the weights of ``f(x) - f(0)`` in the derivative at 0 of the polynomial through 0 and all positions."""

    def weight(place: int) -> Fraction:
        return prod((Fraction(-other, place - other) for other in places if other != place), start=Fraction(1, place))

    return tuple(float(weight(place)) for place in places)
