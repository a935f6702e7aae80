"""Bodies, and the base classes of the elements that act on them.

Each body has its own frame with its origin at the centre of mass; `points` are given in these frames. The frame of
``ground`` is the global frame. A relative angle is always ``angle_b - angle_a`` for ``bodies: [a, b]``. Units are SI;
angles are in radians.
"""

from __future__ import annotations

import math

from pydantic import model_validator

from mbdkit.errors import SpecError
from mbdkit.mechanism.values import BodyPair, Motion, Number, Point, Points, Positive
from mbdkit.strict_model import StrictModel

GROUND = "ground"

Attachment = tuple[str, str, tuple[float, float]]
"""Key in the spec, body name, and point in the body's frame [m]."""


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
    def _point_mass_has_no_angle(self) -> Body:
        if self.inertia is None and (self.angle != 0 or self.angular_velocity != 0):
            key = "angle" if self.angle != 0 else "angular_velocity"
            raise SpecError("a body without inertia is a point mass and has no orientation: omit this key", key=key)
        return self

    def to_global(self, point: tuple[float, float]) -> tuple[float, float]:
        """Return the global coordinates of a `point` (x, y) [m] given in the body's frame, at the initial position."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        x, y = point
        return self.position[0] + c * x - s * y, self.position[1] + s * x + c * y

    def to_local(self, point: tuple[float, float]) -> tuple[float, float]:
        """Return the coordinates of a global `point` (x, y) [m] in the body's frame, at the initial position."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        x, y = point[0] - self.position[0], point[1] - self.position[1]
        return c * x + s * y, -s * x + c * y


class Element(StrictModel):
    """Base class of joints, pathways and force elements: lists the bodies, points, angles and motions that they use."""

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


class Between(Element):
    """An element between two bodies."""

    bodies: BodyPair
    """Names of the two bodies [a, b]; `ground` is the fixed global frame."""

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        return [("bodies[0]", self.bodies[0]), ("bodies[1]", self.bodies[1])]


class BetweenPoints(Between):
    """An element between a point of one body and a point of another."""

    points: Points
    """One point in each body's own frame [m]."""

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [("points[0]", self.bodies[0], self.points[0]), ("points[1]", self.bodies[1], self.points[1])]
