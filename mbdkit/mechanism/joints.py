"""Joints and drivers: each type is one class with its fields, constraints, row names, gap and mark in pictures.

To add a joint made of known constraints, write its class here and name it in `Joint`. A new kind of constraint is one
definition in ``mbdkit/symbolic/definitions.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from mbdkit.errors import SpecError
from mbdkit.mechanism.bodies import Attachment, Between, BetweenPoints
from mbdkit.mechanism.values import Motion, Number, Point, Points, Positive

if TYPE_CHECKING:
    import numpy as np

Mark = Literal["pin", "slide", "weld", "bar", "none"]
"""How pictures show a joint: at its point, with a guide along its axis, as a line between its points, or not at all."""


@dataclass(frozen=True)
class Constraint:
    """One kinematic constraint of a joint, of one or two rows of the same unit.

    Attributes
    ----------
    kind
        Name of its definition, such as ``revolute`` or ``fixed_angle``.
    first_row
        Place of its first row among the rows of the joint.
    rows
        Number of its rows.
    points
        Point in the frame of the first body and in that of the second, (x_a, y_a, x_b, y_b) [m].
    constants
        The two further parameters of the kind; zero where it has fewer.
    motion
        The function of time that drives it; None if there is none.
    """

    kind: str
    first_row: int
    rows: int
    points: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    constants: tuple[float, float] = (0.0, 0.0)
    motion: Motion | None = None


class JointBase(Between):
    """Base of joints: the knowledge that the engine, the checks and the pictures need of a joint type."""

    mark: ClassVar[Mark] = "pin"
    is_driver: ClassVar[bool] = False
    """Whether the joint prescribes a motion."""
    joins_points: ClassVar[bool] = False
    """Whether the joint makes its two points coincide."""
    point_moves_on_first: ClassVar[bool] = False
    """Whether the point of the second body moves in the frame of the first, and exerts the reaction there."""

    def constraints(self, initial_angle: float) -> list[Constraint]:
        """Return the constraints of the joint.

        Parameters
        ----------
        initial_angle
            ``angle_b - angle_a`` [rad] of the initial positions as given, for joints that keep it.
        """
        raise NotImplementedError

    def gap(self, separation: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the vector by which the joint is open, (F, 2) [m].

        Parameters
        ----------
        separation
            (F, 2) vector from the point of the first body to the point of the second, in the global frame [m].
        angle
            (F,) angle of the first body [rad].
        """
        return separation


class PointJoint(JointBase, BetweenPoints):
    """Base of joints that hold a point of one body against a point of another."""

    @property
    def flat_points(self) -> tuple[float, float, float, float]:
        """The two points (x_a, y_a, x_b, y_b) [m], each in the frame of its body."""
        return (*self.points[0], *self.points[1])


class Revolute(PointJoint):
    """A pin: both points coincide, ``p_b - p_a = 0`` in the global frame."""

    type: Literal["revolute"] = "revolute"
    rows: ClassVar[tuple[str, ...]] = ("x", "y")
    units: ClassVar[tuple[str, ...]] = ("m", "m")
    joins_points: ClassVar[bool] = True

    def constraints(self, initial_angle: float) -> list[Constraint]:
        """Return the constraints of the joint."""
        return [Constraint("revolute", 0, 2, self.flat_points)]


def _not_zero(value: Any) -> Any:
    """Refuse a length of zero with a hint; all other checks come later."""
    if not isinstance(value, bool) and value == 0:
        raise SpecError("two points at a distance of 0 have no direction between them: use a revolute joint")
    return value


class Distance(PointJoint):
    """A massless link: ``|p_b - p_a| - length = 0``."""

    type: Literal["distance"] = "distance"
    length: Annotated[Positive, BeforeValidator(_not_zero)]
    """Distance of the two points [m]; use a revolute joint for a distance of zero."""
    rows: ClassVar[tuple[str, ...]] = ("length",)
    units: ClassVar[tuple[str, ...]] = ("m",)
    mark: ClassVar[Mark] = "bar"

    def constraints(self, initial_angle: float) -> list[Constraint]:
        """Return the constraints of the joint."""
        return [Constraint("distance", 0, 1, self.flat_points, (self.length, 0.0))]

    def gap(self, separation: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the vector by which the joint is open, (F, 2) [m]."""
        import numpy as np

        apart = np.hypot(separation[:, 0], separation[:, 1])[:, None]
        gap: np.ndarray = separation * np.divide(apart - self.length, apart, out=np.zeros_like(apart), where=apart > 0)
        return gap


class SlidingJoint(PointJoint):
    """Base of joints that hold b's point on the line through a's point along `axis`; pictures show the line."""

    axis: Point
    """Direction of the line in a's frame; its length does not matter."""
    mark: ClassVar[Mark] = "slide"
    point_moves_on_first: ClassVar[bool] = True

    @model_validator(mode="after")
    def _axis_has_a_direction(self) -> SlidingJoint:
        if self.axis == (0.0, 0.0):
            raise SpecError("the axis [0, 0] has no direction; [1, 0] is a's own x axis", key="axis")
        return self

    @property
    def direction(self) -> tuple[float, float]:
        """The axis as a unit vector in a's frame."""
        # Scaling by the larger component keeps the squares from overflow and underflow.
        largest = max(abs(self.axis[0]), abs(self.axis[1]))
        x, y = self.axis[0] / largest, self.axis[1] / largest
        length = math.hypot(x, y)
        return x / length, y / length

    def on_line(self) -> Constraint:
        """Return the constraint of the point, which is the first row of the joint."""
        return Constraint("point_on_line", 0, 1, self.flat_points, self.direction)

    def gap(self, separation: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the vector by which the joint is open, (F, 2) [m]."""
        import numpy as np

        x, y = self.direction
        normal = np.stack([-np.sin(angle) * x - np.cos(angle) * y, np.cos(angle) * x - np.sin(angle) * y], axis=-1)
        gap: np.ndarray = np.sum(separation * normal, axis=-1, keepdims=True) * normal
        return gap


class Prismatic(SlidingJoint):
    """A slide: b's point stays on the line through a's point along `axis`, and b does not turn against a."""

    type: Literal["prismatic"] = "prismatic"
    angle: Number | None = None
    """``angle_b - angle_a`` [rad]; left out, the difference of the initial angles as given."""
    rows: ClassVar[tuple[str, ...]] = ("normal", "angle")
    units: ClassVar[tuple[str, ...]] = ("m", "rad")

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses, and which is therefore no point mass."""
        return self.places()

    def constraints(self, initial_angle: float) -> list[Constraint]:
        """Return the constraints of the joint."""
        angle = initial_angle if self.angle is None else self.angle
        return [self.on_line(), Constraint("fixed_angle", 1, 1, self.flat_points, (angle, 0.0))]


class Weld(PointJoint):
    """A rigid connection: both points coincide, and b does not turn against a."""

    type: Literal["weld"] = "weld"
    angle: Number | None = None
    """``angle_b - angle_a`` [rad]; left out, the difference of the initial angles as given."""
    rows: ClassVar[tuple[str, ...]] = ("x", "y", "angle")
    units: ClassVar[tuple[str, ...]] = ("m", "m", "rad")
    mark: ClassVar[Mark] = "weld"
    joins_points: ClassVar[bool] = True

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses, and which is therefore no point mass."""
        return self.places()

    def constraints(self, initial_angle: float) -> list[Constraint]:
        """Return the constraints of the joint."""
        angle = initial_angle if self.angle is None else self.angle
        return [
            Constraint("revolute", 0, 2, self.flat_points),
            Constraint("fixed_angle", 2, 1, self.flat_points, (angle, 0.0)),
        ]


class Driver(JointBase):
    """A prescribed motion of b relative to a: ``coordinate - motion(t) = 0``.

    `angle` drives ``angle_b - angle_a`` (absolute, not relative to the start); `x` and `y` drive that coordinate of b's
    point in a's frame, measured from a's origin.
    """

    type: Literal["driver"] = "driver"
    coordinate: Literal["angle", "x", "y"]
    """The driven coordinate: `angle` [rad], `x` [m] or `y` [m]."""
    motion: Motion
    """Number, expression of t, or table."""
    points: Points | None = None
    """For x and y: ``[[0, 0], b's point]``; left out, b's origin is driven."""
    mark: ClassVar[Mark] = "none"
    is_driver: ClassVar[bool] = True
    point_moves_on_first: ClassVar[bool] = True

    @model_validator(mode="after")
    def _points_fit_the_coordinate(self) -> Driver:
        if self.points is not None and self.coordinate == "angle":
            raise SpecError("a driver of the angle takes no points", key="points")
        if self.points is not None and self.points[0] != (0.0, 0.0):
            raise SpecError(
                "should be [0, 0]: a driver of x or y measures from the origin of the first body", key="points[0]"
            )
        return self

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the constraint rows."""
        return (self.coordinate,)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the constraint rows."""
        return ("rad",) if self.coordinate == "angle" else ("m",)

    @property
    def point(self) -> tuple[float, float]:
        """The driven point in b's frame [m]."""
        return (0.0, 0.0) if self.points is None else self.points[1]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in its frame) of each body-fixed point of the element."""
        return [] if self.coordinate == "angle" else [("points[1]", self.bodies[1], self.point)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses, and which is therefore no point mass."""
        return self.places() if self.coordinate == "angle" else self.places()[:1]

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key, value) of each prescribed function of time."""
        return [("motion", self.motion)]

    def constraints(self, initial_angle: float) -> list[Constraint]:
        """Return the constraints of the joint."""
        return [Constraint(f"driver_{self.coordinate}", 0, 1, (0.0, 0.0, *self.point), motion=self.motion)]


Joint = Annotated[Revolute | Prismatic | Weld | Distance | Driver, Field(discriminator="type")]
"""A joint or driver, by its `type`."""
