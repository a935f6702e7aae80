"""Pathways: the distances, angles and coordinates along which force laws act."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from mbdkit.errors import SpecError
from mbdkit.mechanism.bodies import Attachment, Between, FromTo
from mbdkit.mechanism.values import Points


class LinePathway(FromTo):
    """Base class of pathways whose length is the distance between two points [m]."""

    is_line: ClassVar[bool] = True
    """Whether the pathway is the line between two points; its direction is undefined if they coincide."""
    length_unit: ClassVar[str] = "m"

    @property
    def kind(self) -> str:
        """Name of the symbolic definition of the pathway."""
        return "two_points"

    @property
    def flat_points(self) -> tuple[float, float, float, float]:
        """The two points (x_a, y_a, x_b, y_b) [m], each in the frame of its body."""
        return (*self.ends[0], *self.ends[1])


class AnglePathway(Between):
    """Base class of pathways whose length is ``angle_b - angle_a`` [rad]."""

    is_line: ClassVar[bool] = False
    length_unit: ClassVar[str] = "rad"
    flat_points: ClassVar[tuple[float, float, float, float]] = (0.0, 0.0, 0.0, 0.0)

    @property
    def kind(self) -> str:
        """Name of the symbolic definition of the pathway."""
        return "relative_angle"

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()


class TwoPoints(LinePathway):
    """The distance between two points [m]; a positive force pulls them together."""

    type: Literal["two-points"]


class RelativeAngle(AnglePathway):
    """The relative angle ``angle_b - angle_a`` [rad]; a positive torque acts to decrease it."""

    type: Literal["relative-angle"]


class Coordinate(Between):
    """Coordinate ``x`` or ``y`` of b's point in a's frame [m]; a positive force acts to decrease it."""

    type: Literal["coordinate"]
    coordinate: Literal["x", "y"]
    """The coordinate that is the length of the pathway."""
    points: Points | None = None
    """``[[0, 0], b's point in b's frame]`` [m]; by default, b's origin."""
    is_line: ClassVar[bool] = False
    length_unit: ClassVar[str] = "m"

    @model_validator(mode="before")
    @classmethod
    def _no_angle(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and data.get("coordinate") == "angle":
            raise SpecError("for an angle, use the pathway {type: relative-angle, ...}", key="coordinate")
        return data

    @model_validator(mode="after")
    def _points_fit(self) -> Coordinate:
        if self.points is not None and self.points[0] != (0.0, 0.0):
            raise SpecError(
                "should be [0, 0]: a coordinate is measured from the origin of the first body", key="points[0]"
            )
        return self

    @property
    def kind(self) -> str:
        """Name of the symbolic definition of the pathway."""
        return f"coordinate_{self.coordinate}"

    @property
    def point(self) -> tuple[float, float]:
        """The point of the second body, in its frame (x, y) [m]."""
        return (0.0, 0.0) if self.points is None else self.points[1]

    @property
    def flat_points(self) -> tuple[float, float, float, float]:
        """The origin of a's frame and b's point in b's frame (x_a, y_a, x_b, y_b) [m]."""
        return (0.0, 0.0, *self.point)

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [("points[1]", self.bodies[1], self.point)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()[:1]


Pathway = Annotated[TwoPoints | RelativeAngle | Coordinate, Field(discriminator="type")]
"""A pathway of an element of type ``law``; `type` selects its class."""
