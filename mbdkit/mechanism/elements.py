"""Bodies, joints, drivers and force elements: frozen values, the same ones for builder, spec and engine.

Every body has its own frame with its origin at the centre of mass; `points` are given in those frames, and the
frame of ``ground`` is the global one. A relative angle is always ``angle_b - angle_a`` for ``bodies: [a, b]``. SI
units, radians.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from mbdkit.errors import SpecError
from mbdkit.mechanism.time_expression import Expression

GROUND = "ground"

Attachment = tuple[str, str, tuple[float, float]]


def _shown(value: Any) -> str:
    """Return what was given, as an error message shows it: not longer than a line."""
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def pair(wanted: str) -> Callable[[Any], Any]:
    """Return a validator that takes a list, tuple or array of two, and says what is `wanted` about anything else."""

    def check(value: Any) -> Any:
        plain = value.tolist() if hasattr(value, "tolist") else value
        if isinstance(plain, list):
            plain = tuple(plain)
        if not isinstance(plain, tuple):
            raise SpecError(f"should be {wanted}, not {_shown(plain)}")
        if len(plain) != 2:
            raise SpecError(f"should be {wanted}, not {len(plain)} item{'s' * (len(plain) != 1)}")
        return plain

    return check


def _length(value: Any) -> Any:
    """Let everything pass but a length of zero, which has a better name."""
    if not isinstance(value, bool) and value == 0:
        raise SpecError("two points at a distance of 0 have no direction between them: use a revolute joint")
    return value


def sequence(value: Any) -> Any:
    """Return a list or array as a tuple, anything else as it is."""
    plain = value.tolist() if hasattr(value, "tolist") else value
    return tuple(plain) if isinstance(plain, list) else plain


def _motion(value: Any) -> Any:
    """Let finite numbers and readable expressions pass, and make tables of mappings."""
    if isinstance(value, str):
        Expression.parse(value)
    elif isinstance(value, Mapping):
        if list(value) != ["table"]:
            raise SpecError(
                f"should be {{table: [[t, ...], [value, ...]]}}, not a mapping with the keys {_shown([*value])}"
            )
        return Table(table=columns_of(value["table"], "table"))
    elif isinstance(value, Table):
        return value
    elif isinstance(value, bool) or not isinstance(value, int | float):
        raise SpecError(
            'should be a number, an expression of t such as "0.5*sin(2*pi*t)", or {table: [[t, ...], [value, ...]]}, '
            f"not {_shown(value)}"
        )
    elif not abs(value) <= sys.float_info.max:
        raise SpecError(f"should be a finite number, not {value!r}")
    return value


def columns_of(value: Any, key: str = "", *, at: str = "times", of: str = "values", shown: str = "t, value") -> Any:
    """Return the two columns of a table as tuples of floats; raise SpecError where no spline goes through them.

    Parameters
    ----------
    value
        What was given.
    key
        Key of the table, for messages.
    at, of
        What stands in the first and in the second column.
    shown
        One of each, as messages show them.
    """
    first, second = shown.split(", ")
    try:
        columns = pair(f"a column of {at} and a column of {of}, [[{first}, ...], [{second}, ...]]")(value)
    except SpecError as error:
        raise error.located(prefix=key) from None
    columns = [sequence(column) for column in columns]
    for number, column in enumerate(columns):
        if not isinstance(column, tuple):
            raise SpecError(f"should be a list of numbers, not {_shown(column)}", key=f"{key}[{number}]")
        for row, x in enumerate(column):
            if isinstance(x, bool) or not isinstance(x, int | float) or not abs(x) <= sys.float_info.max:
                raise SpecError(f"should be a finite number, not {_shown(x)}", key=f"{key}[{number}][{row}]")
    times, values = (tuple(float(x) for x in column) for column in columns)
    if len(times) != len(values):
        raise SpecError(f"a table needs as many {of} as {at}; it has {len(values)} and {len(times)}", key=key)
    if len(times) < 2:
        raise SpecError(f"a table needs two points or more, not {len(times)}", key=key)
    for row in range(1, len(times)):
        if not times[row - 1] < times[row]:
            raise SpecError(
                f"{at} must increase: {times[row]!r} comes after {times[row - 1]!r}", key=f"{key}[0][{row}]"
            )
    return times, values


Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Point = Annotated[tuple[Number, Number], BeforeValidator(pair("two numbers [x, y]"))]
Points = Annotated[tuple[Point, Point], BeforeValidator(pair("two points, one in each body's frame, [[x, y], [x, y]]"))]
BodyPair = Annotated[tuple[str, str], BeforeValidator(pair("two body names [first, second]"))]
Columns = Annotated[tuple[tuple[Number, ...], tuple[Number, ...]], BeforeValidator(columns_of)]


class Element(BaseModel):
    """Base of all elements: strict (no coercion of text or booleans to numbers), frozen, no unknown keys."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", use_attribute_docstrings=True)


class Table(Element):
    """A function of time by points: the cubic spline through them, with the not-a-knot condition at both ends.

    Three points give a parabola and two a line. First and second derivative are continuous; the third jumps at the
    points, which costs a method of high order its order unless its steps end there. A run must lie within the table.
    """

    table: Columns
    """Times [s], strictly increasing, and the values at them: ``[[t, ...], [value, ...]]``."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s]."""
        return self.table[0][0], self.table[0][-1]


Motion = Annotated[Number | str | Table, BeforeValidator(_motion)]
MotionPair = Annotated[tuple[Motion, Motion], BeforeValidator(pair("two numbers, expressions of t or tables [x, y]"))]


class Body(Element):
    """A rigid body, or a point mass where `inertia` is left out.

    The initial values may be approximate: assembly makes them consistent with the joints.
    """

    mass: Positive
    """Mass [kg]."""
    inertia: Positive | None = None
    """Moment of inertia about the centre of mass [kg m^2]; left out for a point mass."""
    position: Point = (0.0, 0.0)
    """Initial centre of mass (x, y) [m], global frame."""
    angle: Number = 0.0
    """Initial tilt of the body's x axis from the global one [rad]."""
    velocity: Point = (0.0, 0.0)
    """Initial velocity of the centre of mass (x, y) [m/s]."""
    angular_velocity: Number = 0.0
    """Initial angular velocity [rad/s]."""

    @model_validator(mode="after")
    def _point_mass_has_no_angle(self) -> Body:
        if self.inertia is None and (self.angle != 0 or self.angular_velocity != 0):
            key = "angle" if self.angle != 0 else "angular_velocity"
            raise SpecError("a body without inertia is a point mass and does not turn: leave this out", key=key)
        return self

    def to_global(self, point: tuple[float, float]) -> tuple[float, float]:
        """Return where a `point` (x, y) [m] of the body's frame is in the global frame at the initial position."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        x, y = point
        return self.position[0] + c * x - s * y, self.position[1] + s * x + c * y

    def to_local(self, point: tuple[float, float]) -> tuple[float, float]:
        """Return a global `point` (x, y) [m] in the body's frame at the initial position."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        x, y = point[0] - self.position[0], point[1] - self.position[1]
        return c * x + s * y, -s * x + c * y


class Between(Element):
    """An element between two bodies."""

    bodies: BodyPair
    """Names of the two bodies [a, b]; `ground` is the global frame."""

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element names."""
        return [("bodies[0]", self.bodies[0]), ("bodies[1]", self.bodies[1])]


class BetweenPoints(Between):
    """An element between a point of one body and a point of another."""

    points: Points
    """One point in each body's own frame [m]."""

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in its frame) of each point that is held."""
        return [("points[0]", self.bodies[0], self.points[0]), ("points[1]", self.bodies[1], self.points[1])]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return []


class Revolute(BetweenPoints):
    """A pin: both points coincide, ``p_b - p_a = 0`` in the global frame."""

    type: Literal["revolute"] = "revolute"
    rows: ClassVar[tuple[str, ...]] = ("x", "y")
    units: ClassVar[tuple[str, ...]] = ("m", "m")


class Distance(BetweenPoints):
    """A massless link: ``|p_b - p_a| - length = 0``."""

    type: Literal["distance"] = "distance"
    length: Annotated[Positive, BeforeValidator(_length)]
    """Distance of the two points [m]; a length of zero is a revolute joint."""
    rows: ClassVar[tuple[str, ...]] = ("length",)
    units: ClassVar[tuple[str, ...]] = ("m",)


class Prismatic(BetweenPoints):
    """A slide: b's point stays on the line through a's point along `axis`, and b does not turn against a."""

    type: Literal["prismatic"] = "prismatic"
    axis: Point
    """Direction of the line in a's frame; its length does not matter."""
    angle: Number | None = None
    """``angle_b - angle_a`` [rad]; left out, the difference of the initial angles as given."""
    rows: ClassVar[tuple[str, ...]] = ("normal", "angle")
    units: ClassVar[tuple[str, ...]] = ("m", "rad")

    @model_validator(mode="after")
    def _axis_has_a_direction(self) -> Prismatic:
        if self.axis == (0.0, 0.0):
            raise SpecError("the axis [0, 0] has no direction; [1, 0] is a's own x axis", key="axis")
        return self

    @property
    def direction(self) -> tuple[float, float]:
        """The axis as a unit vector in a's frame."""
        largest = max(abs(self.axis[0]), abs(self.axis[1]))
        x, y = self.axis[0] / largest, self.axis[1] / largest
        length = math.hypot(x, y)
        return x / length, y / length

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return self.places()


class Weld(BetweenPoints):
    """A rigid connection: both points coincide, and b does not turn against a."""

    type: Literal["weld"] = "weld"
    angle: Number | None = None
    """``angle_b - angle_a`` [rad]; left out, the difference of the initial angles as given."""
    rows: ClassVar[tuple[str, ...]] = ("x", "y", "angle")
    units: ClassVar[tuple[str, ...]] = ("m", "m", "rad")

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return self.places()


class Driver(Between):
    """A prescribed motion of b relative to a: ``coordinate - motion(t) = 0``.

    `angle` drives ``angle_b - angle_a`` (absolute, not relative to the start); `x` and `y` drive that coordinate of b's
    point in a's frame, measured from a's origin.
    """

    type: Literal["driver"] = "driver"
    coordinate: Literal["angle", "x", "y"]
    """What is driven: `angle` [rad], `x` [m] or `y` [m]."""
    motion: Motion
    """Number, expression of t, or table."""
    points: Points | None = None
    """For x and y: ``[[0, 0], b's point]``; left out, b's origin is driven."""

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
        """Return (key, body name, point in its frame) of each point that is held."""
        return [] if self.coordinate == "angle" else [("points[1]", self.bodies[1], self.point)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return self.places() if self.coordinate == "angle" else self.places()[:1]


class SpringDamper(BetweenPoints):
    """A linear spring and damper along the line between two points.

    Tension ``stiffness * (l - free_length) + damping * dl/dt`` pulls the points together, l being their distance.
    """

    type: Literal["spring-damper"] = "spring-damper"
    stiffness: NotNegative = 0.0
    """Stiffness [N/m]."""
    damping: NotNegative = 0.0
    """Damping [N s/m]."""
    free_length: NotNegative = 0.0
    """Length without force [m]."""


class TorsionSpring(Between):
    """A linear torsion spring and damper on ``angle_b - angle_a``.

    The torque on b is ``-stiffness * (angle_b - angle_a - free_angle) - damping * (rate_b - rate_a)``, and its opposite
    acts on a.
    """

    type: Literal["torsion-spring"] = "torsion-spring"
    stiffness: NotNegative = 0.0
    """Stiffness [N m/rad]."""
    damping: NotNegative = 0.0
    """Damping [N m s/rad]."""
    free_angle: Number = 0.0
    """Relative angle without torque [rad]."""

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in its frame) of each point that is held."""
        return []

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return self.places()


class Torque(Element):
    """A torque on a body, with its opposite on `reaction_body` if one is named."""

    type: Literal["torque"] = "torque"
    body: str
    """The body that the torque turns."""
    value: Motion
    """Torque [N m]: number, expression of t, or table."""
    reaction_body: str | None = None
    """The body that takes the opposite torque; none by default."""

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element names."""
        named = [("body", self.body)]
        return named if self.reaction_body is None else [*named, ("reaction_body", self.reaction_body)]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in its frame) of each point that is held."""
        return []

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return self.places()


class PointForce(Element):
    """A force on a point of a body, given in the global frame or in the body's own, with which it turns."""

    type: Literal["force"] = "force"
    body: str
    """The body that the force acts on."""
    point: Point = (0.0, 0.0)
    """Where it acts, in the body's frame [m]."""
    value: MotionPair
    """Force (x, y) [N]: numbers, expressions of t, or tables."""
    frame: Literal["global", "body"] = "global"
    """The frame that x and y of the force belong to: `global`, or that of the `body`."""

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element names."""
        return [("body", self.body)]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in its frame) of each point that is held."""
        return [("point", self.body, self.point)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return self.places() if self.frame == "body" else []
