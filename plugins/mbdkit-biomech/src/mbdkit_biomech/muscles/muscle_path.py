"""Lengths of the paths of muscles and their derivatives with respect to the coordinates of the bodies, in many frames
at once.

Between two points a and b, the path is the shortest curve that passes each circle on the side chosen in the spec. It
consists of tangents and arcs. With centers c_i, signed radii r_i (positive if the path passes the center on the left; 0
for a point) and d = c_j - c_i, a tangent has the direction ``angle(d) - asin((r_i - r_j) / |d|)`` and the length
``sqrt(|d|^2 - (r_i - r_j)^2)``. Circles are cylinders perpendicular to the plane, which can be unrolled: with the
planar length s and the difference h of the offsets of a and b, the path has the length ``sqrt(s^2 + h^2)``.

The length is stationary with respect to the points of contact, so that only the centers contribute to its change:
``ds = sum over tangents of e . (dc_j - dc_i)``, where e are the unit vectors of the tangents. A tension F therefore
acts on each body as the force ``F (e_out - e_in) s / length`` at the center of its circle, or at its point.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import RunError
from mbdkit.base.plain_data import quoted
from mbdkit.mechanism.coordinate_function import CoordinateFunction, names_of, value_and_slopes
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_quantities import GROUND, Point, Quantity
from mbdkit.mechanism.mechanism_seams import element_lines
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.muscles.muscle import Muscle, PathItem
from mbdkit_biomech.muscles.patella import PatellaPath

#: Lower limit of the angle that a path sweeps about the center of a circle, from the point before to the point after.
#:
#: The angle is counted from minus `BEHIND` to 2 pi minus `BEHIND`. It is negative for straight paths that pass the
#: circle at a distance on the side that is not its `side`, and close to 2 pi for paths that turn by almost 2 pi around
#: it.
BEHIND = np.pi / 6

#: If the angle changes by more than this between two frames, it has jumped from one end of its range to the other; see
#: `BEHIND`.
WIDEST = np.pi


@dataclass(frozen=True)
class PathState:
    """A path in T frames.

    Attributes
    ----------
    length
        (T,) length [m].
    gradient
        (T, n) derivatives of the length with respect to the coordinates of the bodies.
    """

    length: np.ndarray
    gradient: np.ndarray

    def rate(self, v: np.ndarray) -> np.ndarray:
        """Return the rate of the length (T,) [m/s] at velocities (T, n)."""
        return np.asarray(np.sum(self.gradient * v, axis=1))


class _PathPlace:
    """A point of a path, or the center of one of its circles, which may move with coordinates."""

    def __init__(self, item: PathItem, names: QuantityNames, key: str):
        self.body = GROUND if item.on == names.mechanism.ground else names.body(item.on, f"{key}.body")
        self.functions: tuple[CoordinateFunction, CoordinateFunction] = item.center
        self.offset = item.offset
        self.radius = 0.0 if item.wrap is None else item.wrap.radius * (1.0 if item.wrap.side == "left" else -1.0)
        self.when = [
            (names.find(name, f"{key}.when.{name}"), low, high) for name, (low, high) in (item.when or {}).items()
        ]
        used = dict.fromkeys(name for part in self.functions for name in names_of(part))
        self.coordinates: dict[str, Quantity] = {name: names.coordinate(name) for name in used}

    def is_there(self, q: np.ndarray) -> np.ndarray:
        """Return the frames in which the path contains the point, (T,) bool."""
        there = np.ones(len(q), dtype=bool)
        for quantity, low, high in self.when:
            value = quantity.value(q)
            there &= (value >= low) & (value <= high)
        return there

    def at(self, q: np.ndarray) -> _Placed:
        """Return the place in T frames."""
        values = {name: quantity.value(q) for name, quantity in self.coordinates.items()}
        (x, dx), (y, dy) = (value_and_slopes(part, values, len(q)) for part in self.functions)
        none = np.zeros(len(q))
        slopes = {name: (dx.get(name, none), dy.get(name, none)) for name in self.coordinates}
        point = Point(self.body, x, y)  # type: ignore[arg-type]
        return _Placed(self, point, np.stack(point.position(q), axis=1), slopes)


class _Placed(NamedTuple):
    """A place of a path in T frames, its position (T, 2) in the global frame, and the derivatives of its coordinates in
    the frame of its body with respect to those of the mechanism.
    """

    place: _PathPlace
    point: Point
    position: np.ndarray
    slopes: dict[str, tuple[np.ndarray, np.ndarray]]

    def add_force(self, q: np.ndarray, force: np.ndarray, out: np.ndarray) -> None:
        """Add the generalized force of a force (T, 2) on the place to `out` (T, n)."""
        self.point.add_force(q, force[:, 0], force[:, 1], out)
        for name, (dx, dy) in self.slopes.items():
            ex, ey = Point(self.place.body, dx, dy).arm(q)  # type: ignore[arg-type]
            own = np.zeros_like(out)
            self.place.coordinates[name].add_gradient(q, own)
            out += (ex * force[:, 0] + ey * force[:, 1])[:, None] * own


class MusclePath:
    """The path of a muscle.

    Parameters
    ----------
    name, muscle
        The muscle.
    names
        Quantities of the mechanism by name.

    Raises
    ------
    SpecError
        If a quantity in a condition, or what the patella needs, does not exist.
    """

    def __init__(self, name: str, muscle: Muscle, names: QuantityNames):
        self.name, key = name, f"model.muscles.{quoted(name)}"
        self._places = [_PathPlace(item, names, f"{key}.path[{index}]") for index, item in enumerate(muscle.path)]
        last, patella = muscle.path[-1].on, muscle.patella
        self.patella = None if patella is None else PatellaPath(patella, last, names, f"{key}.patella")

    def at(self, time: np.ndarray, q: np.ndarray) -> PathState:
        """Return the path at positions q (T, n).

        Raises
        ------
        RunError
            If a point is inside a circle next to it, if circles overlap, if the path would have to pass a circle on the
            wrong side, or if it switches the side between two frames. The error states the time.
        """
        length, gradient = np.empty(len(q)), np.zeros_like(q)
        there = np.array([place.is_there(q) for place in self._places])  # (P, T)
        patterns, group = np.unique(there, axis=1, return_inverse=True)
        for index in range(patterns.shape[1]):
            rows = np.flatnonzero(np.ravel(group) == index)
            places = [place for place, has in zip(self._places, patterns[:, index], strict=True) if has]
            length[rows], gradient[rows] = self._of_pattern(time[rows], q[rows], places)
        if self.patella is not None:
            self.patella.add(q, length, gradient)
        return PathState(length, gradient)

    def _of_pattern(
        self, time: np.ndarray, q: np.ndarray, places: Sequence[_PathPlace]
    ) -> tuple[np.ndarray, np.ndarray]:
        length, gradient = np.zeros(len(q)), np.zeros_like(q)
        placed = [place.at(q) for place in places]
        ends = [index for index, place in enumerate(places) if place.radius == 0]
        for first, last in pairwise(ends):
            span = placed[first : last + 1]
            height = places[last].offset - places[first].offset
            planar, forces = self._taut(time, span)
            own = elementary.hypot(planar, height)
            share = planar / np.where(own > 0, own, 1.0)
            length += own
            for one, force in zip(span, forces, strict=True):
                one.add_force(q, force * share[:, None], gradient)
        return length, gradient

    def _taut(self, time: np.ndarray, span: Sequence[_Placed]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the planar length (T,) between two points, and its derivatives (T, 2) with respect to the position of
        each place.

        The circles that the path touches are found by trying all selections of circles, those with few circles first.
        """
        centers = [placed.position for placed in span]
        radii = [placed.place.radius for placed in span]
        circles = range(1, len(span) - 1)
        for index in circles:
            self._require_outside(time, centers, radii, index)
            self._require_no_turn(time, centers, index, radii[index])
        length = np.empty(len(time))
        forces = [np.zeros((len(time), 2)) for _ in span]
        left = np.ones(len(time), dtype=bool)
        for touched in _patterns(circles):
            own, its_forces, fits = _string(centers, radii, (0, *touched, len(span) - 1))
            rows = left & fits
            length[rows] = own[rows]
            for total, force in zip(forces, its_forces, strict=True):
                total[rows] = force[rows]
            left &= ~rows
            if not left.any():
                return length, forces
        raise RunError(
            f"muscle '{self.name}' cannot pass its circles on their sides at t = {time[np.argmax(left)]:.6g} s: it is "
            "on the other side; correct `side`, or the path"
        )

    def _require_outside(
        self, time: np.ndarray, centers: Sequence[np.ndarray], radii: Sequence[float], index: int
    ) -> None:
        """Raise RunError for the first frame in which a point or circle next to a circle is too close to it.

        A point is too close inside the circle, a circle with the same side if one contains the other, and a circle with
        the other side if both overlap.
        """
        for other in (index - 1, index + 1):
            apart = elementary.hypot(*(centers[other] - centers[index]).T)
            inside = apart < abs(radii[index] - radii[other])
            if inside.any():
                what = "a point of its path" if radii[other] == 0 else "another of its circles"
                frame = int(np.argmax(inside))
                raise RunError(
                    f"muscle '{self.name}' has {what} inside its circle of radius {abs(radii[index]):g} m at "
                    f"t = {time[frame]:.6g} s, {apart[frame]:.6g} m from the center"
                )

    def _require_no_turn(self, time: np.ndarray, centers: Sequence[np.ndarray], index: int, radius: float) -> None:
        sweep = _sweep(centers[index - 1], centers[index], centers[index + 1], radius)
        if (jumps := np.flatnonzero(np.abs(np.diff(sweep)) > WIDEST)).size:
            raise RunError(
                f"muscle '{self.name}' switches the side of its circle between t = {time[jumps[0]]:.6g} s and "
                f"{time[jumps[0] + 1]:.6g} s, where its length would jump"
            )


def _patterns(circles: range) -> Iterator[tuple[int, ...]]:
    """Return all selections of circles, in the order of the path; those with few circles come first."""
    for count in range(len(circles) + 1):
        yield from combinations(circles, count)


def _string(
    centers: Sequence[np.ndarray], radii: Sequence[float], touched: tuple[int, ...]
) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Return length (T,) and derivatives (T, 2) by all centers of a taut string, and whether it touches all circles."""
    length = np.zeros(len(centers[0]))
    forces = [np.zeros((len(length), 2)) for _ in centers]
    fits = np.ones(len(length), dtype=bool)
    for one, other in pairwise(touched):
        straight, unit = _tangent(centers[one], centers[other], radii[one] - radii[other])
        length += straight
        forces[one] -= unit
        forces[other] += unit
        for passed in range(one + 1, other):
            fits &= _passes(centers, radii, one, passed, other)
    for before, index, after in zip(touched, touched[1:], touched[2:], strict=False):
        turn = _turn(centers, radii, before, index, after)
        length += abs(radii[index]) * turn
        fits &= turn >= 0
    return length, forces, fits


def _tangent(a: np.ndarray, b: np.ndarray, difference: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the length (T,) of a tangent of two circles, and its unit vector (T, 2); `difference` is r_a - r_b."""
    apart = elementary.hypot(*(b - a).T)
    safe = np.where(apart > 0, apart, 1.0)
    sine = np.clip(difference / safe, -1.0, 1.0)
    cosine = np.sqrt(1.0 - sine * sine)
    along = (b - a) / safe[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return apart * cosine, cosine[:, None] * along - sine[:, None] * across


def _sweep(before: np.ndarray, center: np.ndarray, after: np.ndarray, radius: float) -> np.ndarray:
    """Return the angle (T,) about a center, from the place before to the place after, on the side of the circle."""
    a, b = before - center, after - center
    clockwise = -elementary.atan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.sum(a * b, axis=1))
    return np.asarray(np.mod(np.copysign(1.0, radius) * clockwise + BEHIND, 2 * np.pi) - BEHIND)


def _turn(centers: Sequence[np.ndarray], radii: Sequence[float], before: int, index: int, after: int) -> np.ndarray:
    """Return the angle (T,) by which the string would turn around a circle; negative if it is straight."""
    own, side = radii[index], np.copysign(1.0, radii[index])
    turn = _sweep(centers[before], centers[index], centers[after], own) - np.pi
    for other in (before, after):
        apart = elementary.hypot(*(centers[other] - centers[index]).T)
        turn = turn + side * elementary.asin(np.clip((own - radii[other]) / apart, -1.0, 1.0))
    return turn


def _passes(centers: Sequence[np.ndarray], radii: Sequence[float], before: int, index: int, after: int) -> np.ndarray:
    """Return whether the tangent between two places passes a circle between them on its side, or at a distance."""
    free = _turn(centers, radii, before, index, after) <= 0
    other_side = [-radius if place == index else radius for place, radius in enumerate(radii)]
    beyond = _sweep(centers[before], centers[index], centers[after], radii[index]) < 0
    return free & ~(beyond & (_turn(centers, other_side, before, index, after) > 0))


Place = tuple[str, tuple[float, float]]  #: Body, and point in its frame [m].


@element_lines
def muscle_lines(muscle: Muscle, mechanism: Mechanism) -> list[list[Place]]:
    """Return the line of a muscle, from its origin to its insertion.

    Moving points are drawn at their initial positions; conditional points are left out. On a circle, the point farthest
    to the side of the path is used.
    """
    items = [item for item in muscle.path if item.when is None]
    places: list[Place] = []
    for item in items:  # a point, or the center of a circle, in the frame of its body at the start
        x, y = (_value(mechanism, part) for part in item.center)
        places.append((item.on, (x, y)))
    results = places.copy()
    for index, item in enumerate(items):
        if item.wrap is not None:
            (ax, ay), (bx, by) = (mechanism.to_global(*places[other]) for other in (index - 1, index + 1))
            size = math.hypot(bx - ax, by - ay) or 1.0
            reach = item.wrap.radius * (1.0 if item.wrap.side == "left" else -1.0) / size
            x, y = mechanism.to_global(*places[index])
            point = mechanism.to_local(item.on, (x - reach * (by - ay), y + reach * (bx - ax)))
            results[index] = (item.on, point)
    return [results]


def _value(mechanism: Mechanism, part: CoordinateFunction) -> float:
    if isinstance(part, int | float):
        return float(part)
    names = QuantityNames(mechanism)
    q = np.array([[x for body in mechanism.bodies.values() for x in (*body.position, body.angle)]])
    values = {name: names.coordinate(name).value(q) for name in names_of(part)}
    return float(value_and_slopes(part, values, 1)[0][0])
