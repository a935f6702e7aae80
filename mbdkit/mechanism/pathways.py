"""Pathways: the generalised lengths along which force laws act."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from mbdkit.errors import SpecError
from mbdkit.mechanism.bodies import Attachment, Between, BetweenPoints
from mbdkit.mechanism.values import Points


class LinePathway(BetweenPoints):
    """Base of pathways whose length is the distance of two points [m]."""

    is_line: ClassVar[bool] = True
    """Whether the pathway is a line between two points, which has no direction where they coincide."""
    length_unit: ClassVar[str] = "m"

    @property
    def kind(self) -> str:
        """Name of the pathway's definition."""
        return "two_points"

    @property
    def flat_points(self) -> tuple[float, float, float, float]:
        """The two points (x_a, y_a, x_b, y_b) [m], each in the frame of its body."""
        return (*self.points[0], *self.points[1])


class AnglePathway(Between):
    """Base of pathways whose length is ``angle_b - angle_a`` [rad]."""

    is_line: ClassVar[bool] = False
    length_unit: ClassVar[str] = "rad"
    flat_points: ClassVar[tuple[float, float, float, float]] = (0.0, 0.0, 0.0, 0.0)

    @property
    def kind(self) -> str:
        """Name of the pathway's definition."""
        return "relative_angle"

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses, and which is therefore no point mass."""
        return self.places()


class TwoPoints(LinePathway):
    """The distance of two points [m]; a positive force pulls them together."""

    type: Literal["two-points"]


class RelativeAngle(AnglePathway):
    """``angle_b - angle_a`` [rad]; a positive torque turns b back towards a."""

    type: Literal["relative-angle"]


class Coordinate(Between):
    """``x`` or ``y`` of b's point in a's frame, from a's origin [m]; a positive force makes it smaller."""

    type: Literal["coordinate"]
    coordinate: Literal["x", "y"]
    """Which coordinate is the length."""
    points: Points | None = None
    """``[[0, 0], b's point]``; left out, b's origin."""
    is_line: ClassVar[bool] = False
    length_unit: ClassVar[str] = "m"

    @model_validator(mode="before")
    @classmethod
    def _no_angle(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and data.get("coordinate") == "angle":
            raise SpecError("the pathway along an angle is written {type: relative-angle, ...}", key="coordinate")
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
        """Name of the pathway's definition."""
        return f"coordinate_{self.coordinate}"

    @property
    def point(self) -> tuple[float, float]:
        """B's point in b's frame [m]."""
        return (0.0, 0.0) if self.points is None else self.points[1]

    @property
    def flat_points(self) -> tuple[float, float, float, float]:
        """The origin of a's frame and b's point (x_a, y_a, x_b, y_b) [m]."""
        return (0.0, 0.0, *self.point)

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in its frame) of each body-fixed point of the element."""
        return [("points[1]", self.bodies[1], self.point)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses, and which is therefore no point mass."""
        return self.places()[:1]


Pathway = Annotated[TwoPoints | RelativeAngle | Coordinate, Field(discriminator="type")]
"""A pathway of an element of type ``law``, by its `type`."""
