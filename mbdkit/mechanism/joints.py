"""Joints and drivers: each type is a class with its fields, constraints, row names, misalignment and plot symbol.

A row is one scalar constraint equation. The bodies a and b are the first and the second body of a joint.

To add a joint made of existing constraints, write its class here and add it to `Joint`. A constraint that is a function
of the relative pose of two bodies needs no definition here (`FunctionJoint`). To add another kind of constraint, define
it in ``mbdkit_statics/element_definitions.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.mechanism.angle_function import Center
from mbdkit.mechanism.bodies import At, Attachment, BetweenPoints, Body, FromTo
from mbdkit.mechanism.joint_base import Constraint, FunctionJoint, JointBase, Mark, Pose, Travel
from mbdkit.mechanism.joint_friction import JointFriction, PinFriction, SlideFriction
from mbdkit.mechanism.joint_kinds import OfJointKinds
from mbdkit.mechanism.values import Motion, Number, Point, Points, Positive


class PointJoint(JointBase, BetweenPoints):
    """Base class of joints that constrain a point of one body relative to a point of another."""

    @property
    def flat_points(self) -> tuple[float, float, float, float]:
        """The two points (x_a, y_a, x_b, y_b) [m], each in the frame of its body."""
        return (*self.ends[0], *self.ends[1])


class Revolute(PointJoint, At):
    """A pin: both points coincide, ``p_b - p_a = 0`` in the global frame.

    Here, p_a and p_b are the global positions of the points of the two bodies. With `center`, the first body's point
    moves in that body's frame while the second body turns, as the centre of a knee or of a rolling wheel does:
    ``p_b - p_a - R_a c(angle_b - angle_a) = 0``, with the rotation matrix R_a of the first body. The joint does no
    work: besides its force F, it exerts the torque ``-F . R_a c'`` on the second body. The work of this torque, which
    is recorded as the reaction torque, cancels the work of F along the path of the centre.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*At.ABSENT_BY_DEFAULT, "center", "friction")

    type: Literal["revolute"] = "revolute"
    center: Center | None = None
    """Displacement ``c = {x, y}`` of the first body's point from its position in `points`, in the frame of that body,
    as a function of ``angle_b - angle_a``; by default, the point is fixed."""
    friction: PinFriction | None = None
    """Dry friction of the pin, ``{coefficient: number, radius: length}``; by default, there is none."""
    rows: ClassVar[tuple[str, ...]] = ("x", "y")
    units: ClassVar[tuple[str, ...]] = ("m", "m")

    @model_validator(mode="before")
    @classmethod
    def _no_clearance(cls, data: object) -> object:
        if isinstance(data, Mapping) and "clearance" in data:
            raise SpecError(
                "a pin with clearance is a contact in place of the joint: under `contacts`, a {hole: {center, radius}} "
                "of one body and a {circle: {center, radius}} of the other",
                key="clearance",
            )
        return data

    @property
    def joins_points(self) -> bool:
        """Whether the joint makes its two points coincide."""
        return self.center is None

    @property
    def point_moves_on_first(self) -> bool:
        """Whether b's point can move in a's frame; the reaction on a then acts at b's point."""
        return self.center is not None

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return [] if self.center is None and self.friction is None else self.places()

    def constraints(self, start: Pose) -> list[Constraint]:
        """Return the constraints of the joint."""
        kind = "revolute" if self.center is None else "moving_center"
        return [Constraint(kind, 0, 2, self.flat_points, center=self.center)]

    def placed(self, bodies: Mapping[str, Body], key: str) -> Self:
        """Return the joint with its points in the frames of the bodies.

        With `center`, `at` is the position of the displaced point.
        """
        joint = super().placed(bodies, key)
        if self.at is None or self.center is None:
            return joint
        first, second = (bodies[name].angle if name in bodies else 0.0 for name in self.bodies)
        (x, y), other = joint.ends
        dx, dy = self.center.at(np.array([second - first]))[0].tolist()
        return joint.model_copy(update={"points": ((x - dx, y - dy), other)})

    def gap(self, separation: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Return the misalignment of the joint as a vector, (F, 2) [m]."""
        if self.center is None:
            return separation
        x, y = self.center.at(angles[:, 1] - angles[:, 0]).T
        c, s = elementary.cos(angles[:, 0]), elementary.sin(angles[:, 0])
        return np.asarray(separation - np.stack([c * x - s * y, s * x + c * y], axis=-1))


def _not_zero(value: object) -> object:
    """Reject a length of zero with a hint; everything else is checked by the type of the field."""
    if not isinstance(value, bool) and value == 0:
        raise SpecError("a distance of 0 leaves the direction between the points undefined: use a revolute joint")
    return value


class Distance(PointJoint, FromTo):
    """A massless link: ``|p_b - p_a| - length = 0`` for the global positions p_a and p_b of its points."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*FromTo.ABSENT_BY_DEFAULT, "length")

    type: Literal["distance"] = "distance"
    length: Annotated[Positive, BeforeValidator(_not_zero)] | None = None
    """Distance between the two points [m], required with `points`; by default, the distance from `from` to `to`. Use a
    revolute joint for a distance of zero."""
    rows: ClassVar[tuple[str, ...]] = ("length",)
    units: ClassVar[tuple[str, ...]] = ("m",)
    mark: ClassVar[Mark] = "bar"

    def constraints(self, start: Pose) -> list[Constraint]:
        """Return the constraints of the joint."""
        return [Constraint("distance", 0, 1, self.flat_points, (self._length, 0.0))]

    @model_validator(mode="after")
    def _has_a_length(self) -> Distance:
        if self.length is None and self.points is not None:
            message = "is missing: distance between the two points [m]; it can be omitted only with `from` and `to`"
            raise SpecError(message, key="length")
        return self

    @property
    def _length(self) -> float:
        assert self.length is not None, "the joint is not placed"
        return self.length

    def placed(self, bodies: Mapping[str, Body], key: str) -> Self:
        """Return the joint with its points in the frames of the bodies, and with its length.

        Raises SpecError if `from` and `to` coincide; see also `Element.placed`.
        """
        joint = super().placed(bodies, key)
        if self.length is not None or self.from_ is None or self.to is None:
            return joint
        length = elementary.hypot(self.to[0] - self.from_[0], self.to[1] - self.from_[1])
        with SpecError.locate(f"{key}.to"):
            return joint.model_copy(update={"length": _not_zero(length)})

    def gap(self, separation: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Return the misalignment of the joint as a vector, (F, 2) [m]."""
        apart = elementary.hypot(separation[:, 0], separation[:, 1])[:, None]
        return np.asarray(
            separation * np.divide(apart - self._length, apart, out=np.zeros_like(apart), where=apart > 0)
        )


class SlidingJoint(PointJoint, At):
    """Base class of joints that hold b's point on the line through a's point along `axis`; plots show the line."""

    axis: Point
    """Direction of the line in a's frame; only the direction of this vector is used."""
    mark: ClassVar[Mark] = "slide"
    _point_moves: ClassVar[bool] = True

    @model_validator(mode="after")
    def _axis_has_a_direction(self) -> SlidingJoint:
        if self.axis == (0.0, 0.0):
            raise SpecError("the axis [0, 0] has no direction; use [1, 0] for the x axis of the first body", key="axis")
        return self

    @property
    def direction(self) -> tuple[float, float]:
        """The axis as a unit vector in a's frame."""
        # Scaling by the larger component avoids overflow and underflow of the squares.
        largest = max(abs(self.axis[0]), abs(self.axis[1]))
        x, y = self.axis[0] / largest, self.axis[1] / largest
        length = elementary.hypot(x, y)
        return x / length, y / length

    @property
    def travel(self) -> Travel:
        """The line along which b's point travels from a's point."""
        return (*self.flat_points, *self.direction)

    def on_line(self) -> Constraint:
        """Return the constraint that keeps b's point on the line; it is the first row of the joint."""
        return Constraint("point_on_line", 0, 1, self.flat_points, self.direction)

    def gap(self, separation: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Return the misalignment of the joint as a vector, (F, 2) [m]."""
        x, y = self.direction
        angle = angles[:, 0]
        c, s = elementary.cos(angle), elementary.sin(angle)
        normal = np.stack([-s * x - c * y, c * x - s * y], axis=-1)
        return np.asarray(np.sum(separation * normal, axis=-1, keepdims=True) * normal)


class PointOnLine(SlidingJoint):
    """A pin in a slot, or a roller: b's point stays on the line through a's point along `axis`, and b may turn."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*At.ABSENT_BY_DEFAULT, "friction")

    type: Literal["point-on-line"] = "point-on-line"
    friction: JointFriction | None = None
    """Dry friction along the line, ``{coefficient: number}``; by default, there is none."""
    rows: ClassVar[tuple[str, ...]] = ("normal",)
    units: ClassVar[tuple[str, ...]] = ("m",)

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()[:1]

    def constraints(self, start: Pose) -> list[Constraint]:
        """Return the constraints of the joint."""
        return [self.on_line()]


class Prismatic(SlidingJoint):
    """A slide: b's point stays on the line through a's point along `axis`, and b does not rotate relative to a."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*At.ABSENT_BY_DEFAULT, "friction")

    type: Literal["prismatic"] = "prismatic"
    angle: Number | None = None
    """``angle_b - angle_a`` [rad]; by default, the difference between the given initial angles."""
    friction: SlideFriction | None = None
    """Dry friction of the slide, ``{coefficient: number, length: length}``; by default, there is none."""
    rows: ClassVar[tuple[str, ...]] = ("normal", "angle")
    units: ClassVar[tuple[str, ...]] = ("m", "rad")

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()

    def constraints(self, start: Pose) -> list[Constraint]:
        """Return the constraints of the joint."""
        angle = start.angle if self.angle is None else self.angle
        return [self.on_line(), Constraint("fixed_angle", 1, 1, self.flat_points, (angle, 0.0))]


class Weld(PointJoint, At):
    """A rigid connection: both points coincide, and b does not rotate relative to a."""

    type: Literal["weld"] = "weld"
    angle: Number | None = None
    """``angle_b - angle_a`` [rad]; by default, the difference between the given initial angles."""
    rows: ClassVar[tuple[str, ...]] = ("x", "y", "angle")
    units: ClassVar[tuple[str, ...]] = ("m", "m", "rad")
    mark: ClassVar[Mark] = "weld"
    joins_points: ClassVar[bool] = True

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()

    def constraints(self, start: Pose) -> list[Constraint]:
        """Return the constraints of the joint."""
        angle = start.angle if self.angle is None else self.angle
        return [
            Constraint("revolute", 0, 2, self.flat_points),
            Constraint("fixed_angle", 2, 1, self.flat_points, (angle, 0.0)),
        ]


class Driver(JointBase):
    """A prescribed motion of b relative to a: ``coordinate - motion(t) = 0``.

    `angle` drives ``angle_b - angle_a`` (absolute, not relative to the start). `x` and `y` drive the x or y coordinate
    of b's point in a's frame, measured from a's origin.
    """

    type: Literal["driver"] = "driver"
    coordinate: Literal["angle", "x", "y"]
    """The driven coordinate: `angle` [rad], `x` [m] or `y` [m]."""
    motion: Motion
    """Prescribed value as a function of time [m or rad]: number, expression of t, or table."""
    points: Points | None = None
    """For `x` and `y`: ``[[0, 0], b's point in b's frame]`` [m]; by default, b's origin is driven."""
    mark: ClassVar[Mark] = "none"
    is_driver: ClassVar[bool] = True
    _point_moves: ClassVar[bool] = True

    @model_validator(mode="before")
    @classmethod
    def _no_friction(cls, data: object) -> object:
        if isinstance(data, Mapping) and "friction" in data:
            raise SpecError(
                "a driver has no bearing; give friction to the revolute or prismatic joint that carries the motion",
                key="friction",
            )
        return data

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

    @property
    def travel(self) -> Travel | None:
        """The axis along which `x` or `y` is measured; None for `angle`."""
        if self.coordinate == "angle":
            return None
        return (0.0, 0.0, *self.point, *((1.0, 0.0) if self.coordinate == "x" else (0.0, 1.0)))

    @classmethod
    def unit_along(cls, data: Mapping[str, object]) -> str:
        """Return the unit of the driven coordinate; see `Element.unit_along`."""
        return {"angle": "rad", "x": "m", "y": "m"}.get(str(data.get("coordinate")), "")

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [] if self.coordinate == "angle" else [("points[1]", self.bodies[1], self.point)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places() if self.coordinate == "angle" else self.places()[:1]

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key, value) of each prescribed function of time."""
        return [("motion", self.motion)]

    def constraints(self, start: Pose) -> list[Constraint]:
        """Return the constraints of the joint."""
        if self.travel is None:
            return [Constraint("driver_angle", 0, 1, motion=self.motion)]
        return [Constraint("driver_travel", 0, 1, self.travel[:4], self.travel[4:], self.motion)]


if TYPE_CHECKING:
    Joint = Revolute | Prismatic | PointOnLine | Weld | Distance | Driver | FunctionJoint
else:
    Joint = Annotated[
        Revolute | Prismatic | PointOnLine | Weld | Distance | Driver, Field(discriminator="type"), OfJointKinds()
    ]
    """A joint or driver; `type` selects its class, which a plugin may add (`JointKind`)."""


def force_of_reaction(joints: Mapping[str, Joint]) -> tuple[str, str, str] | None:
    """Return the first force that follows the reaction of its joint: friction, or a side force.

    The result is the name of the joint with the key of the force, the name of the force in messages, and what ends it.
    """
    for name, joint in joints.items():
        if getattr(joint, "friction", None) is not None:
            return f"{quoted(name)}.friction", "friction in joints", "omit it"
        if isinstance(joint, FunctionJoint) and (side := joint.side_force()) is not None:
            return f"{quoted(name)}.{side.key}", side.name, "set it to 0"
    return None
