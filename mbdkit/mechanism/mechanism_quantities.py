"""Quantities h(q) of a mechanism as functions of its coordinates q: values, gradients and second derivatives.

Observed quantities, independent coordinates and actuators are such quantities. Arrays of coordinates q and velocities v
at T times are (T, n), with the n = 3 B coordinates x, y, angle of the B bodies, without ground.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.frozen import dataclass

GROUND = -1  #: Value that stands for the ground where the index of a body is expected.

AXES = ("x", "y", "angle")


@dataclass(frozen=True)
class Point:
    """A point of a body, in the frame of the body [m]."""

    body: int
    x: float
    y: float

    def arm(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the vector (x, y) from the body's origin to the point in the global frame, each (T,)."""
        if self.body == GROUND:
            return np.full(len(q), self.x), np.full(len(q), self.y)
        c, s = elementary.cos(q[:, 3 * self.body + 2]), elementary.sin(q[:, 3 * self.body + 2])
        return c * self.x - s * self.y, s * self.x + c * self.y

    def position(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the position (x, y) in the global frame, each (T,)."""
        x, y = self.arm(q)
        return (x, y) if self.body == GROUND else (x + q[:, 3 * self.body], y + q[:, 3 * self.body + 1])

    def add_force(self, q: np.ndarray, fx: np.ndarray, fy: np.ndarray, out: np.ndarray) -> None:
        """Add the generalized force of a force (T,) at this point to `out` (T, n)."""
        if self.body == GROUND:
            return
        x, y = self.arm(q)
        first = 3 * self.body
        out[:, first] += fx
        out[:, first + 1] += fy
        out[:, first + 2] += x * fy - y * fx

    def curvature(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the acceleration (x, y) that the point has if the accelerations of the coordinates are zero, each
        (T,).
        """
        x, y = self.arm(q)
        square = 0.0 if self.body == GROUND else v[:, 3 * self.body + 2] ** 2
        return -square * x, -square * y


class Quantity(ABC):
    """A quantity h(q) of a mechanism."""

    unit: Literal["m", "rad"]

    @property
    def scale(self) -> float:
        """Magnitude of the change of the quantity per change of the angle or length on which it is based."""
        return 1.0

    @property
    def unscaled(self) -> Quantity:
        """The angle or length on which the quantity is based."""
        return self

    @property
    def place(self) -> tuple[int, int] | None:
        """Index of the body, and axis as of `Coordinate`, if this is a coordinate of the body or of a point of it."""
        return None

    @property
    def marker(self) -> tuple[Point, int] | None:
        """Point of a body, and axis as of `Coordinate`, if this is a coordinate of the point."""
        return None

    @abstractmethod
    def value(self, q: np.ndarray) -> np.ndarray:
        """Return h (T,) [m or rad]."""

    @abstractmethod
    def add_gradient(self, q: np.ndarray, out: np.ndarray) -> None:
        """Add the gradient of h to `out` (T, n)."""

    def curvature(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the second time derivative (T,) that h has if the accelerations of the coordinates are zero.

        The default, zero, is correct for quantities that are linear in the coordinates.
        """
        return np.zeros(len(q))


@dataclass(frozen=True)
class Coordinate(Quantity):
    """A coordinate of a body: 0 for x, 1 for y, 2 for the angle."""

    body: int
    axis: int

    @property
    def unit(self) -> Literal["m", "rad"]:  # type: ignore[override]
        """Unit of the coordinate."""
        return "rad" if self.axis == 2 else "m"

    @property
    def place(self) -> tuple[int, int]:
        """Index of the body, and axis."""
        return self.body, self.axis

    def value(self, q: np.ndarray) -> np.ndarray:
        """Return the coordinate."""
        return q[:, 3 * self.body + self.axis]

    def add_gradient(self, q: np.ndarray, out: np.ndarray) -> None:
        """Add 1 in the column of the coordinate."""
        out[:, 3 * self.body + self.axis] += 1.0


@dataclass(frozen=True)
class RelativeAngle(Quantity):
    """The angle of the second body relative to the first, ``angle_b - angle_a``."""

    a: int
    b: int
    unit = "rad"

    def value(self, q: np.ndarray) -> np.ndarray:
        """Return the angle."""
        return np.asarray(_angle(q, self.b) - _angle(q, self.a))

    def add_gradient(self, q: np.ndarray, out: np.ndarray) -> None:
        """Add 1 for the second body and -1 for the first."""
        for body, sign in ((self.a, -1.0), (self.b, 1.0)):
            if body != GROUND:
                out[:, 3 * body + 2] += sign


@dataclass(frozen=True)
class MarkerCoordinate(Quantity):
    """A coordinate of a point of a body in the global frame: 0 for x, 1 for y."""

    point: Point
    axis: int
    unit = "m"

    @property
    def place(self) -> tuple[int, int]:
        """Index of the body, and axis."""
        return self.point.body, self.axis

    @property
    def marker(self) -> tuple[Point, int]:
        """Point of a body, and axis."""
        return self.point, self.axis

    def value(self, q: np.ndarray) -> np.ndarray:
        """Return the coordinate."""
        return self.point.position(q)[self.axis]

    def add_gradient(self, q: np.ndarray, out: np.ndarray) -> None:
        """Add the gradient, which is the generalized force of a unit force at the point along the axis."""
        one = np.ones(len(q))
        self.point.add_force(q, one * (self.axis == 0), one * (self.axis == 1), out)

    def curvature(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the centripetal acceleration along the axis, (T,)."""
        return self.point.curvature(q, v)[self.axis]


@dataclass(frozen=True)
class Travel(Quantity):
    """Distance of the second body's point from the first body's point along a direction fixed to the first body."""

    first: Point
    second: Point
    direction: tuple[float, float]
    unit = "m"

    def _along(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return Point(self.first.body, *self.direction).arm(q)

    def _between(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (ax, ay), (bx, by) = self.first.position(q), self.second.position(q)
        return bx - ax, by - ay

    def value(self, q: np.ndarray) -> np.ndarray:
        """Return the travel."""
        (ex, ey), (ux, uy) = self._along(q), self._between(q)
        return np.asarray(ex * ux + ey * uy)

    def add_gradient(self, q: np.ndarray, out: np.ndarray) -> None:
        """Add the gradient: the effects of unit forces at the two points, and of the rotation of the direction."""
        (ex, ey), (ux, uy) = self._along(q), self._between(q)
        self.second.add_force(q, ex, ey, out)
        self.first.add_force(q, -ex, -ey, out)
        if self.first.body != GROUND:
            out[:, 3 * self.first.body + 2] += ex * uy - ey * ux

    def curvature(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the second time derivative of the travel if the accelerations of the coordinates are zero, (T,)."""
        (ex, ey), (ux, uy) = self._along(q), self._between(q)
        spin = np.zeros(len(q)) if self.first.body == GROUND else v[:, 3 * self.first.body + 2]
        (ax, ay), (bx, by) = (_point_velocity(point, q, v) for point in (self.first, self.second))
        (cx, cy), (dx, dy) = self.first.curvature(q, v), self.second.curvature(q, v)
        turning = 2 * spin * (ex * (by - ay) - ey * (bx - ax))
        return np.asarray(ex * (dx - cx) + ey * (dy - cy) + turning - spin**2 * (ex * ux + ey * uy))


@dataclass(frozen=True)
class Affine(Quantity):
    """A quantity with a different sign, scale and zero: ``factor * of + offset``."""

    of: Quantity
    factor: float
    offset: float

    @property
    def unit(self) -> Literal["m", "rad"]:  # type: ignore[override]
        """Unit of the quantity."""
        return self.of.unit

    @property
    def scale(self) -> float:
        """Magnitude of the factor."""
        return abs(self.factor)

    @property
    def unscaled(self) -> Quantity:
        """The quantity with factor 1 and offset 0."""
        return self.of

    def value(self, q: np.ndarray) -> np.ndarray:
        """Return the value."""
        return np.asarray(self.factor * self.of.value(q) + self.offset)

    def add_gradient(self, q: np.ndarray, out: np.ndarray) -> None:
        """Add the gradient."""
        own = np.zeros_like(out)
        self.of.add_gradient(q, own)
        out += self.factor * own

    def curvature(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the second time derivative if the accelerations of the coordinates are zero, (T,)."""
        return self.factor * self.of.curvature(q, v)


def _angle(q: np.ndarray, body: int) -> np.ndarray:
    return np.zeros(len(q)) if body == GROUND else q[:, 3 * body + 2]


def _point_velocity(point: Point, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if point.body == GROUND:
        return np.zeros(len(q)), np.zeros(len(q))
    x, y = point.arm(q)
    first = 3 * point.body
    return v[:, first] - v[:, first + 2] * y, v[:, first + 1] + v[:, first + 2] * x
