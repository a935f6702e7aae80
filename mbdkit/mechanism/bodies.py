"""Bodies, and the base classes of the elements that act on them.

Each body has its own frame, whose origin is the centre of mass. `points` are given in these frames; `at`, `from` and
`to` are given in the global frame, with the bodies at their initial positions before assembly. The frame of ``ground``
is the global frame. A relative angle is always ``angle_b - angle_a`` for ``bodies: [a, b]``. Units are SI; angles are
in radians.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import ClassVar, Self

from pydantic import ConfigDict, Field, model_validator

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.values import BodyPair, Motion, Number, Point, Points, Positive

GROUND = "ground"

#: A global point counts as the position of a point mass if their distance, relative to the largest of their
#: coordinates (at least 1 mm), does not exceed this.
ON_POINT_MASS = 1e-9

#: Key in the spec, body name, and point in the body's frame [m].
Attachment = tuple[str, str, tuple[float, float]]


class Body(StrictModel):
    """A rigid body, or a point mass if `inertia` is omitted.

    The initial values may be approximate: assembly adjusts them until they satisfy the joints.
    """

    mass: Positive
    """Mass [kg]."""
    inertia: Positive | None = None
    """Moment of inertia about the centre of mass [kg m^2]; omitted for a point mass."""
    position: Point = (0.0, 0.0)
    """Initial position of the centre of mass (x, y) [m], in the global frame."""
    angle: Number = 0.0
    """Initial angle from the global x axis to the body's x axis [rad]."""
    velocity: Point = (0.0, 0.0)
    """Initial velocity of the centre of mass (x, y) [m/s]."""
    angular_velocity: Number = 0.0
    """Initial angular velocity [rad/s]."""

    @model_validator(mode="after")
    def _has_reciprocals(self) -> Body:
        for key, value, unit in (("mass", self.mass, "kg"), ("inertia", self.inertia, "kg m^2")):
            if value is not None and value < sys.float_info.min:
                least = f"{sys.float_info.min:.1e} {unit}, the smallest number with all digits in double precision"
                raise SpecError(f"should be at least {least}, not {value:g}", key=key)
        return self

    @model_validator(mode="after")
    def _point_mass_has_no_angle(self) -> Body:
        if self.inertia is None and (self.angle != 0 or self.angular_velocity != 0):
            key = "angle" if self.angle != 0 else "angular_velocity"
            raise SpecError("a body without inertia is a point mass and has no orientation: omit this key", key=key)
        return self

    def to_global(self, point: tuple[float, float]) -> tuple[float, float]:
        """Return the global coordinates of a `point` (x, y) [m] given in the body's frame, at the initial position."""
        c, s = elementary.cos(self.angle), elementary.sin(self.angle)
        x, y = point
        return self.position[0] + c * x - s * y, self.position[1] + s * x + c * y

    def to_local(self, point: tuple[float, float]) -> tuple[float, float]:
        """Return the coordinates of a global `point` (x, y) [m] in the body's frame, at the initial position."""
        c, s = elementary.cos(self.angle), elementary.sin(self.angle)
        x, y = point[0] - self.position[0], point[1] - self.position[1]
        return c * x + s * y, -s * x + c * y


class Element(StrictModel):
    """Base class of joints, forces, pathways, markers, and elements of the kinds that plugins add.

    Its methods list the bodies, points, angles, motions and expressions that an element uses.
    """

    KEYS_WITHOUT_LAST: ClassVar[tuple[str, ...]] = ()
    """Keys with bodies for which ``BEAM.last`` is not accepted."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the first-order states of an element of a plugin's kind in a run."""
        return ()

    def lengths_to_check(self) -> list[tuple[str, float]]:
        """Return (key, value [m]) of each length that is improbable if it is far above the size of the mechanism."""
        return []

    @property
    def friction_coefficients(self) -> tuple[float, ...]:
        """Coefficients of dry friction; empty without friction."""
        return getattr(getattr(self, "friction", None), "coefficients", ())

    def extent_points(self) -> list[tuple[str, tuple[float, float]]]:
        """Return (body name, point in the body's frame [m]) of each point that the extent of the mechanism includes."""
        return [(name, point) for _, name, point in self.attachments()]

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        return []

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return []

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return []

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key, value) of each prescribed function of time."""
        return []

    def expressions(self) -> list[tuple[str, str]]:
        """Return (key, text) of each expression of the state."""
        return []

    @classmethod
    def unit_along(cls, data: Mapping[str, object]) -> str:
        """Return the unit of the length or coordinate of an element, m or rad.

        It selects one of the two units in the description of a key, as in ``[N/m or N m/rad]``.

        `data`: keys of an element of this class, which need not be valid. Returns the unit; empty if the keys do not
        determine it.
        """
        return ""

    def placed(self, bodies: Mapping[str, Body], key: str) -> Self:
        """Return the element with its points in the frames of the bodies; `bodies` are at their positions before
        assembly.

        Raises SpecError if the element is attached to a point mass at a point other than the position of the mass. The
        key path of the error begins with `key`.
        """
        return self


class AtPoint(Element):
    """An element at a point of one body.

    The point is given either in the frame of the body or in the global frame. In the latter case, `point` is None until
    `placed` converts the point.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("at",)

    body: str
    """Name of the body."""
    point: Point | None = (0.0, 0.0)
    """The point (x, y) in the body's frame [m]; the centre of mass by default."""
    at: Point | None = None
    """The point (x, y) [m] in the global frame, for the given initial position of the body (before assembly); an
    alternative to `point`."""

    @model_validator(mode="before")
    @classmethod
    def _no_default_beside_at(cls, data: object) -> object:
        if isinstance(data, Mapping) and data.get("at") is not None and "point" not in data:
            return {**data, "point": None}
        return data

    @model_validator(mode="after")
    def _point_once(self) -> Self:
        if self.at is not None and self.point is not None:
            raise SpecError(
                "give the position either as `point` (in the frame of the body) or as `at` (in the global frame), not "
                "both",
                key="at",
            )
        if self.at is None and self.point is None:
            raise SpecError("should be a point [x, y]; leave it out for the centre of mass", key="point")
        return self

    @property
    def held(self) -> tuple[float, float]:
        """The point in the frame of the body [m], of an element that was placed."""
        assert self.point is not None, "the element is not placed"
        return self.point

    def placed(self, bodies: Mapping[str, Body], key: str) -> Self:
        """Return the element with its point in the frame of the body; see `Element.placed`."""
        if self.at is None:
            return self
        point = local_point(bodies, self.body, self.at, f"{key}.at")
        return self.model_copy(update={"point": point, "at": None})

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        return [("body", self.body)]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [("point", self.body, self.held)]


class Between(Element):
    """An element between two bodies."""

    bodies: BodyPair
    """Names of the two bodies [a, b]; `ground` is the fixed global frame."""

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        return [("bodies[0]", self.bodies[0]), ("bodies[1]", self.bodies[1])]


#: Fields with points in the global frame, by their keys in specs.
_FIELDS = {"at": "at", "from": "from_", "to": "to"}


class BetweenPoints(Between):
    """An element between a point of one body and a point of another.

    The points are given either in the frames of the bodies or in the global frame. In the latter case, `points` is None
    until `placed` converts them.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("points", "at", "from_", "to")
    GLOBAL: ClassVar[tuple[str, ...]] = ()
    """Keys of the points in the global frame: one for a common point, or one for each body."""

    points: Points | None = None
    """One point of each body, [[x, y], [x, y]], in the frame of that body [m]."""

    @model_validator(mode="after")
    def _points_once(self) -> Self:
        keys = [key for key in self.GLOBAL if getattr(self, _FIELDS[key]) is not None]
        names = " and ".join(f"`{key}`" for key in self.GLOBAL)
        if self.points is None and not keys:
            raise SpecError(
                f"is missing: one point in each body's own frame [m]; or give {names} in the global frame at the "
                "initial positions",
                key="points",
            )
        if self.points is not None and keys:
            raise SpecError(
                f"give the position either as `points` (in the frames of the bodies) or as {names} (in the global "
                "frame), not both",
                key=keys[0],
            )
        if keys and len(keys) < len(self.GLOBAL):
            lacking = next(key for key in self.GLOBAL if key not in keys)
            raise SpecError(f"is missing: {names} go together", key=lacking)
        return self

    @property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The two points [m], each in the frame of its body."""
        assert self.points is not None, "the element is not placed"
        return self.points

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        (a, b), (on_a, on_b) = self.bodies, self.ends
        return [("points[0]", a, on_a), ("points[1]", b, on_b)]

    def placed(self, bodies: Mapping[str, Body], key: str) -> Self:
        """Return the element with its points in the frames of the bodies; see `Element.placed`."""
        if self.points is not None:
            return self
        held = tuple(
            local_point(bodies, name, getattr(self, _FIELDS[given]), f"{key}.{given}")
            for name, given in zip(self.bodies, (self.GLOBAL[0], self.GLOBAL[-1]), strict=True)
        )
        return self.model_copy(update={"points": held, **dict.fromkeys(_FIELDS[key] for key in self.GLOBAL)})


class At(BetweenPoints):
    """An element whose two points coincide at the start."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [{"required": ["points"]}, {"required": ["at"]}]})
    GLOBAL: ClassVar[tuple[str, ...]] = ("at",)

    at: Point | None = None
    """Common position (x, y) [m] of both points in the global frame, for the given initial positions of the bodies
    (before assembly); an alternative to `points`."""


class FromTo(BetweenPoints):
    """An element whose two points are apart."""

    # `from` is a keyword of Python, so the keyword argument is called `from_`.
    model_config = ConfigDict(
        populate_by_name=True,
        serialize_by_alias=True,
        json_schema_extra={"anyOf": [{"required": ["points"]}, {"required": ["from", "to"]}]},
    )
    GLOBAL: ClassVar[tuple[str, ...]] = ("from", "to")

    from_: Point | None = Field(default=None, alias="from")
    """Point (x, y) [m] of the first body in the global frame, for the given initial positions of the bodies (before
    assembly); `from` and `to` are an alternative to `points`."""
    to: Point | None = None
    """Point (x, y) [m] of the second body in the global frame, for the given initial positions of the bodies."""


def local_point(bodies: Mapping[str, Body], name: str, point: tuple[float, float], key: str) -> tuple[float, float]:
    """Return a global point in the frame of a body at its initial position; (0, 0) for a point mass.

    Raises SpecError if the body is a point mass at another position. The error has the key path `key`.
    """
    if name == GROUND:
        return point
    body = bodies[name]
    local = body.to_local(point)
    if body.inertia is not None:
        return local
    if elementary.hypot(*local) <= ON_POINT_MASS * max(1e-3, *map(abs, (*point, *body.position))):
        return 0.0, 0.0
    raise SpecError(
        f"'{name}' is a point mass (it has no inertia), so its only point is its position "
        f"[{body.position[0]:.6g}, {body.position[1]:.6g}]",
        key=key,
    )


class Marker(AtPoint):
    """A point of a body whose position and velocity are recorded; a marker does not affect the motion."""
