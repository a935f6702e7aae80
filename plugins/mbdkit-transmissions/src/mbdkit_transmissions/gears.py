"""Pairs that roll on each other without slip: gears, belts, racks and rolling wheels.

With psi the angle of the line of centres in the frame of the first body and beta the relative angle, pitch circles of
radii ra and rb roll on each other if ``rb beta - (rb + ra) psi`` is constant; for a ring, or an open belt, with -ra.
The line of centres is all that has to be known of the carrier.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from mbdkit.plugin import FunctionJoint, Number, Point, Pose, PoseFunction, Positive, SideForce, SpecError
from mbdkit.plugin.equations import elementary
from mbdkit.plugin.mechanisms import pair

TURN = 2 * math.pi
#: Largest deviation of the distance of the centres at the start from that of the pitch circles, as a fraction of it.
PITCH = 1e-3

Radii = Annotated[tuple[Positive, Positive], BeforeValidator(pair("two radii, [of a, of b]"))]
Teeth = Annotated[tuple[int, int], BeforeValidator(pair("two numbers of teeth, [of a, of b]"))]


def has_direction(vector: tuple[float, float]) -> tuple[float, float]:
    """Return a vector; raise SpecError if it is zero."""
    if vector == (0.0, 0.0):
        raise SpecError("the vector [0, 0] has no direction")
    return vector


Direction = Annotated[Point, AfterValidator(has_direction)]  #: A vector of which only the direction is used.
Lines = Sequence[Sequence[tuple[int, tuple[float, float]]]]  #: Lines through points of the first or second body.


def rolling_circles(pose: Pose, p: Mapping[str, Any]) -> Any:
    """Return how far two circles have slipped on each other [m].

    The angle of the line of centres gets the whole turns with which it is closest to the one that follows from the
    relative angle, so that it never jumps. Since the constraint is linear in angles, it does not drift in motions in
    which all angles change evenly.
    """
    wanted = (p["radius"] * pose.angle - p["offset"]) / p["distance"]
    off = wanted - np.arctan2(pose.y, pose.x)
    return p["distance"] * (off - TURN * np.floor(off.plain / TURN + 0.5))


def equal_turns(pose: Pose, p: Mapping[str, Any]) -> Any:
    """Return how far a belt over pulleys of equal radii has slipped [m]."""
    return p["radius"] * (pose.angle - p["start"])


def _rolling(start: Pose, first: float, second: float) -> PoseFunction:
    """Return the constraint of circles of radii `first` (negative for a ring or an open belt) and `second`."""
    distance = second + first
    if distance == 0.0:
        return PoseFunction(equal_turns, (("radius", second), ("start", start.angle)))
    offset = second * start.angle - distance * elementary.atan2(start.y, start.x)
    return PoseFunction(rolling_circles, (("distance", distance), ("offset", offset), ("radius", second)))


def _check_distance(start: Pose, wanted: float, key: str, text: str) -> None:
    apart = elementary.hypot(start.x, start.y)
    if abs(apart - abs(wanted)) > PITCH * abs(wanted):
        raise SpecError(
            f"{text} need centres that are {abs(wanted):.6g} m apart, but these are {apart:.6g} m apart at the start; "
            "`points` are the centres in the frames of the bodies",
            key=key,
        )


def circle(body: int, center: tuple[float, float], radius: float) -> list[tuple[int, tuple[float, float]]]:
    """Return the outline of a circle of a body."""
    x, y = center
    angles = [2 * math.pi * i / 48 for i in range(49)]
    return [(body, (x + radius * math.cos(angle), y + radius * math.sin(angle))) for angle in angles]


class Gear(FunctionJoint):
    """Two gears, whose pitch circles roll on each other. Other joints hold their centres at a constant distance."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("points", "radii", "teeth", "module")

    type: Literal["gear"] = "gear"
    radii: Radii | None = None
    """Pitch radii of the gears on a and b [m]."""
    teeth: Teeth | None = None
    """Numbers of teeth of the gears on a and b; with `module`, an alternative to `radii`."""
    module: Positive | None = None
    """Module of the teeth, the pitch diameter divided by the number of teeth [m]."""
    internal: bool = False
    """Whether the larger gear is a ring, with teeth inside."""
    pressure_angle: Annotated[Number, Field(ge=0, lt=1.2)] = math.radians(20.0)
    """Pressure angle of the teeth [rad]: the force on a tooth has a radial part, the tangent of this angle times the
    tangential one, which pushes the teeth apart. It changes the forces in the bearings, and not the motion."""
    rows: ClassVar[tuple[str, ...]] = ("mesh",)
    units: ClassVar[tuple[str, ...]] = ("m",)

    @model_validator(mode="after")
    def _has_radii(self) -> Gear:
        if (self.radii is None) == (self.teeth is None):
            raise SpecError("give either `radii`, or `teeth` and `module`", key="radii")
        if (self.teeth is None) != (self.module is None):
            raise SpecError("`teeth` and `module` belong together", key="module" if self.module is None else "teeth")
        if self.teeth is not None and min(self.teeth) < 1:
            raise SpecError(f"should be positive numbers, not {list(self.teeth)}", key="teeth")
        if self.internal and self.pitch_radii[0] == self.pitch_radii[1]:
            raise SpecError("a ring is larger than the gear inside it, but both radii are equal", key="internal")
        return self

    @property
    def pitch_radii(self) -> tuple[float, float]:
        """Pitch radii of the gears on a and b [m]."""
        if self.radii is not None:
            return self.radii
        assert self.teeth is not None
        assert self.module is not None
        return self.teeth[0] * self.module / 2, self.teeth[1] * self.module / 2

    @property
    def ratio(self) -> float:
        """Angle by which b turns if a turns by 1 rad and the line of centres is held."""
        first, second = self.pitch_radii
        return first / second if self.internal else -first / second

    @property
    def wanted(self) -> float:
        """Distance of the centres [m]; negative if the ring is on a."""
        first, second = self.pitch_radii
        return second - first if self.internal else second + first

    def functions(self, start: Pose) -> Sequence[PoseFunction]:
        """Return the constraint of each row; see `FunctionJoint.functions`."""
        first, second = self.pitch_radii
        text = f"pitch radii of {first:.6g} m and {second:.6g} m{' of a ring and a gear' if self.internal else ''}"
        _check_distance(start, self.wanted, "radii" if self.teeth is None else "teeth", text)
        return [_rolling(start, -first if self.internal else first, second)]

    def side_force(self) -> SideForce | None:
        """Return the radial part of the force on the teeth, which pushes the centres apart, or together in a ring."""
        if self.pressure_angle == 0.0:
            return None
        ratio = math.tan(self.pressure_angle) * (1.0 if self.internal else -1.0)
        return SideForce(0, ratio, "the radial force of the teeth", "pressure_angle")

    def lines(self, start: Pose) -> Lines:
        """Return the pitch circles, each with a radius that shows how it turns."""
        lines = []
        for body, (center, radius) in enumerate(zip(self.points, self.pitch_radii, strict=True)):
            lines.append([(body, center), *circle(body, center, radius)])
        return lines


class Belt(FunctionJoint):
    """A belt, chain or cable over two pulleys, which does not slip or stretch; other joints hold their axes."""

    type: Literal["belt"] = "belt"
    radii: Radii
    """Radii of the pulleys on a and b [m]."""
    crossed: bool = False
    """Whether the belt is crossed, so that the pulleys turn in opposite directions."""
    rows: ClassVar[tuple[str, ...]] = ("belt",)
    units: ClassVar[tuple[str, ...]] = ("m",)

    @property
    def ratio(self) -> float:
        """Angle by which b turns if a turns by 1 rad and the line of centres is held."""
        first, second = self.radii
        return -first / second if self.crossed else first / second

    def functions(self, start: Pose) -> Sequence[PoseFunction]:
        """Return the constraint of each row; see `FunctionJoint.functions`."""
        first, second = self.radii
        apart, least = elementary.hypot(start.x, start.y), first + second
        if apart <= least:
            kind = "a crossed" if self.crossed else "an open"
            raise SpecError(
                f"{kind} belt over radii of {first:.6g} m and {second:.6g} m needs axes more than {least:.6g} m apart, "
                f"but these are {apart:.6g} m apart at the start",
                key="radii",
            )
        return [_rolling(start, first if self.crossed else -first, second)]

    def lines(self, start: Pose) -> Lines:
        """Return the pulleys, each with a radius that shows how it turns."""
        pairs = zip(self.points, self.radii, strict=True)
        return [[(body, center), *circle(body, center, radius)] for body, (center, radius) in enumerate(pairs)]


def _direction(axis: tuple[float, float]) -> tuple[float, float]:
    length = elementary.hypot(*axis)
    return axis[0] / length, axis[1] / length


def rack_travel(pose: Pose, p: Mapping[str, Any]) -> Any:
    """Return how far a wheel has slipped on a rack of the second body [m]."""
    c, s = np.cos(pose.angle), np.sin(pose.angle)
    along = -(p["axis_x"] * (c * pose.x + s * pose.y) + p["axis_y"] * (c * pose.y - s * pose.x))
    return along - p["along"] - p["radius"] * (pose.angle - p["start"])


class Rack(FunctionJoint):
    """A gear and a rack: the pitch circle of a rolls on the pitch line of b. Other joints keep their distance."""

    type: Literal["rack"] = "rack"
    radius: Positive
    """Pitch radius of the gear on a [m]; `points` are its centre, and a point on the pitch line of the rack."""
    axis: Direction = (1.0, 0.0)
    """Direction of the pitch line in b's frame; only the direction of this vector is used."""
    rows: ClassVar[tuple[str, ...]] = ("mesh",)
    units: ClassVar[tuple[str, ...]] = ("m",)

    def functions(self, start: Pose) -> Sequence[PoseFunction]:
        """Return the constraint of each row; see `FunctionJoint.functions`."""
        ex, ey = _direction(self.axis)
        c, s = elementary.cos(start.angle), elementary.sin(start.angle)
        x, y = -(c * start.x + s * start.y), s * start.x - c * start.y  # the centre in b's frame
        height = ex * y - ey * x
        if abs(abs(height) - self.radius) > PITCH * self.radius:
            raise SpecError(
                f"the pitch line is {abs(height):.6g} m from the centre of the gear at the start, which has a pitch "
                f"radius of {self.radius:.6g} m; `points` are this centre and a point on the line",
                key="radius",
            )
        numbers = {
            "along": ex * x + ey * y, "axis_x": ex, "axis_y": ey, "radius": math.copysign(self.radius, height),
            "start": start.angle,
        }  # fmt: skip
        return [PoseFunction(rack_travel, tuple(numbers.items()))]

    def lines(self, start: Pose) -> Lines:
        """Return the pitch circle and a part of the pitch line."""
        (ex, ey), (x, y), half = _direction(self.axis), self.points[1], 4 * self.radius
        line = [(1, (x - half * ex, y - half * ey)), (1, (x + half * ex, y + half * ey))]
        return [[(0, self.points[0]), *circle(0, self.points[0], self.radius)], line]


def height_over_line(pose: Pose, p: Mapping[str, Any]) -> Any:
    """Return the distance of a wheel from a line of the first body [m], less its radius."""
    return p["axis_x"] * pose.y - p["axis_y"] * pose.x - p["height"]


def slip_on_line(pose: Pose, p: Mapping[str, Any]) -> Any:
    """Return how far a wheel has slipped on a line of the first body [m]."""
    return p["axis_x"] * pose.x + p["axis_y"] * pose.y - p["along"] + p["height"] * (pose.angle - p["start"])


def distance_of_circles(pose: Pose, p: Mapping[str, Any]) -> Any:
    """Return the distance of the centres of two circles that touch [m], less what it should be."""
    return np.sqrt(pose.x * pose.x + pose.y * pose.y) - p["apart"]


class Rolling(FunctionJoint):
    """A wheel of b that rolls without slip on a line or a circle of a, and does not lift off."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("points", "axis", "on_radius", "available_friction")

    type: Literal["rolling"] = "rolling"
    radius: Positive
    """Radius of the wheel [m]; `points` are a point of the line, or the centre of the circle, and that of the wheel."""
    axis: Direction | None = None
    """Direction of the line in a's frame; by default, [1, 0], unless `on_radius` is given."""
    on_radius: Number | None = None
    """Radius of the circle on which the wheel rolls [m]; negative if it rolls inside."""
    available_friction: Positive | None = None
    """Coefficient of friction that is available. A run that needs a larger one to roll is doubtful; by default, the
    summary only says how large it must be."""
    rows: ClassVar[tuple[str, ...]] = ("normal", "tangential")
    units: ClassVar[tuple[str, ...]] = ("m", "m")

    @model_validator(mode="after")
    def _is_possible(self) -> Rolling:
        if self.on_radius is not None and self.axis is not None:
            raise SpecError("give either `axis`, for a line, or `on_radius`, for a circle", key="axis")
        if self.on_radius is not None and -self.radius <= self.on_radius <= 0.0:
            raise SpecError("a circle in which a wheel rolls is larger than the wheel", key="on_radius")
        return self

    def push(self, start: Pose) -> float:
        """Return 1 if a negative multiplier of the first row pushes the wheel away from what it rolls on, else -1."""
        if self.on_radius is not None:
            return math.copysign(1.0, self.on_radius)
        ex, ey = self.axis or (1.0, 0.0)
        return math.copysign(1.0, ex * start.y - ey * start.x)

    def functions(self, start: Pose) -> Sequence[PoseFunction]:
        """Return the constraint of each row; see `FunctionJoint.functions`."""
        if self.on_radius is not None:
            apart = abs(self.radius + self.on_radius)
            text = f"a wheel of radius {self.radius:.6g} m on a circle of radius {abs(self.on_radius):.6g} m"
            _check_distance(start, apart, "radius", text)
            touching = PoseFunction(distance_of_circles, (("apart", apart),))
            return [touching, _rolling(start, self.on_radius, self.radius)]
        ex, ey = _direction(self.axis or (1.0, 0.0))
        height = ex * start.y - ey * start.x
        if abs(abs(height) - self.radius) > PITCH * self.radius:
            raise SpecError(
                f"the line is {abs(height):.6g} m from the centre of the wheel at the start, whose radius is "
                f"{self.radius:.6g} m; `points` are a point of the line and this centre",
                key="radius",
            )
        numbers = {"axis_x": ex, "axis_y": ey, "height": math.copysign(self.radius, height)}
        slip = numbers | {"along": ex * start.x + ey * start.y, "start": start.angle}
        return [PoseFunction(height_over_line, tuple(numbers.items())), PoseFunction(slip_on_line, tuple(slip.items()))]

    def lines(self, start: Pose) -> Lines:
        """Return the wheel, and the circle or a part of the line."""
        wheel = [(1, self.points[1]), *circle(1, self.points[1], self.radius)]
        if self.on_radius is not None:
            return [wheel, circle(0, self.points[0], abs(self.on_radius))]
        (ex, ey), (x, y), half = _direction(self.axis or (1.0, 0.0)), self.points[0], 6 * self.radius
        return [wheel, [(0, (x - half * ex, y - half * ey)), (0, (x + half * ex, y + half * ey))]]
