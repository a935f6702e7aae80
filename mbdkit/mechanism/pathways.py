"""Pathways: the distances, angles and coordinates along which force laws act."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, NamedTuple, Protocol

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from mbdkit.base.errors import SpecError
from mbdkit.mechanism.bodies import Attachment, Between, Element, FromTo
from mbdkit.mechanism.force_law import ForceLaw
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.values import Number, Points


class Segment(NamedTuple):
    """A segment of a pathway between two bodies; the length of the pathway is the sum of the lengths of its segments.

    Attributes
    ----------
    kind
        Name of the symbolic definition of the length of the segment.
    bodies
        Names of the first and the second body.
    points
        (x_a, y_a, x_b, y_b) [m], each point in the frame of its body.
    constants
        Further parameters of the definition.
    """

    kind: str
    bodies: tuple[str, str]
    points: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    constants: tuple[float, float] = (0.0, 0.0)


class AnyPathway(Protocol):
    """What force elements are asked about their pathways."""

    @property
    def length_unit(self) -> str:
        """Unit of the length, m or rad."""

    def segments(self, joints: Mapping[str, Joint], /) -> tuple[Segment, ...]:
        """Return the segments of the pathway in a mechanism with these joints."""


class LawForce(Protocol):
    """A force element with a law along a pathway, as `element_forces` returns it.

    The law reads its options from the attributes of this object.
    """

    @property
    def law_id(self) -> str:
        """Name of the law in messages."""

    @property
    def force_law(self) -> ForceLaw:
        """The law; it has a state for each first-order state of the element."""

    @property
    def pathway(self) -> AnyPathway:
        """The pathway."""


class LinePathway(FromTo):
    """Base class of pathways whose length is the distance between two points [m]."""

    is_line: ClassVar[bool] = True
    """Whether the pathway is the line between two points; its direction is undefined if they coincide."""
    length_unit: ClassVar[str] = "m"

    def segments(self, joints: Mapping[str, Joint]) -> tuple[Segment, ...]:
        """Return the segments of the pathway in a mechanism with these joints."""
        return (Segment("two_points", self.bodies, (*self.ends[0], *self.ends[1])),)


class LineForce(LinePathway):
    """Base class of elements of plugins that are forces along the line between two points; see `LawForce`."""

    force_law: ClassVar[ForceLaw]
    """The force law, which gets the element as its options. Kinds with `ElementForces.forces` need none."""

    @property
    def law_id(self) -> str:
        """Name of the law in messages."""
        return type(self).__name__

    @property
    def pathway(self) -> LinePathway:
        """The pathway, which is the element."""
        return self

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the first-order states of the law."""
        law = getattr(type(self), "force_law", None)
        return () if law is None else tuple(state.name for state in law.states)


class AnglePathway(Between):
    """Base class of pathways whose length is ``angle_b - angle_a`` [rad]."""

    is_line: ClassVar[bool] = False
    length_unit: ClassVar[str] = "rad"

    def segments(self, joints: Mapping[str, Joint]) -> tuple[Segment, ...]:
        """Return the segments of the pathway in a mechanism with these joints."""
        return (Segment("relative_angle", self.bodies),)

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
    """The coordinate, which is used as the length of the pathway."""
    points: Points | None = None
    """``[[0, 0], b's point in b's frame]`` [m]; by default, b's origin."""
    is_line: ClassVar[bool] = False
    length_unit: ClassVar[str] = "m"

    @model_validator(mode="before")
    @classmethod
    def _no_angle(cls, data: object) -> object:
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
    def point(self) -> tuple[float, float]:
        """The point of the second body, in its frame (x, y) [m]."""
        return (0.0, 0.0) if self.points is None else self.points[1]

    def segments(self, joints: Mapping[str, Joint]) -> tuple[Segment, ...]:
        """Return the segments of the pathway in a mechanism with these joints."""
        return (
            Segment(
                "travel", self.bodies, (0.0, 0.0, *self.point), (1.0, 0.0) if self.coordinate == "x" else (0.0, 1.0)
            ),
        )

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [("points[1]", self.bodies[1], self.point)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()[:1]


def _not_empty(radii: dict[str, float]) -> dict[str, float]:
    if not radii:
        raise SpecError("needs at least one joint and the radius of its pulley [m], such as {knee: 0.04}")
    return radii


class JointAngles(Element):
    """The length ``length - sum(radius * angle of the joint)`` [m] of a cable over pulleys at several joints.

    An exotendon (A. J. van den Bogert, BioMedical Engineering OnLine 2:17, 2003) is such a cable with the law
    `one-sided`. A tension F turns the second body of each joint against the first by the torque ``radius * F``: a
    positive radius increases the angle, a negative one decreases it. The length is exact as long as the cable stays on
    the pulleys. Forces of the pulleys on their axles are not part of the reactions of the joints.
    """

    # `angles` is a method of every element, so the attribute has another name.
    model_config = ConfigDict(serialize_by_alias=True)

    type: Literal["joint-angles"]
    radii: Annotated[dict[str, Number], AfterValidator(_not_empty)] = Field(alias="angles")
    """Radius of the pulley at each joint, by the name of the joint [m]: ``{hip: 0.03, knee: -0.02}``."""
    length: Number = 0.0
    """Length where all angles are zero [m]; only its difference from the free length of the law matters."""
    is_line: ClassVar[bool] = False
    length_unit: ClassVar[str] = "m"

    def segments(self, joints: Mapping[str, Joint]) -> tuple[Segment, ...]:
        """Return the segments of the pathway in a mechanism with these joints, one for each joint."""
        return tuple(
            Segment("pulley", joints[name].bodies, constants=(radius, 0.0 if index else self.length))
            for index, (name, radius) in enumerate(self.radii.items())
        )


def path_ends(segments: tuple[Segment, ...]) -> tuple[str, str]:
    """Return the bodies at the two ends of a pathway: the first body of the first segment, and the second body of the
    last segment.
    """
    return segments[0].bodies[0], segments[-1].bodies[1]


#: A pathway of an element of type ``law``; `type` selects its class.
Pathway = Annotated[TwoPoints | RelativeAngle | Coordinate | JointAngles, Field(discriminator="type")]
