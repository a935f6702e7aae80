"""Force elements: springs, which are a pathway with the linear law, elements of any other law, and loads."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field, SerializeAsAny

from mbdkit.mechanism.bodies import GROUND, Attachment, Element
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.pathways import AnglePathway, LinePathway
from mbdkit.mechanism.values import Motion, MotionPair, NotNegative, Number, Point


class LinearForce(NamedTuple):
    """A linear spring and damper on a pathway: tension ``stiffness * (s - free) + damping * ds/dt``."""

    stiffness: float
    damping: float
    free: float


LoadKind = Literal["torque", "point_force", "body_force"]


class AppliedLoad(NamedTuple):
    """A prescribed force or torque on a body.

    Attributes
    ----------
    kind
        A torque, or a force on a point, in the global frame or in that of the body.
    body, reaction_body
        The loaded body, and the one that takes the opposite load.
    values
        The torque [N m], or the two components of the force [N].
    point
        Point of application in the frame of the body [m].
    """

    kind: LoadKind
    body: str
    reaction_body: str
    values: tuple[Motion, ...]
    point: tuple[float, float] = (0.0, 0.0)


class SpringDamper(LinePathway):
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
    pathway_key: ClassVar[str] = ""

    @property
    def pathway(self) -> SpringDamper:
        """The pathway of the force, which is the element itself."""
        return self

    @property
    def linear(self) -> LinearForce:
        """The law of the force."""
        return LinearForce(self.stiffness, self.damping, self.free_length)


class TorsionSpring(AnglePathway):
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
    pathway_key: ClassVar[str] = ""

    @property
    def pathway(self) -> TorsionSpring:
        """The pathway of the force, which is the element itself."""
        return self

    @property
    def linear(self) -> LinearForce:
        """The law of the force."""
        return LinearForce(self.stiffness, self.damping, self.free_angle)


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

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses, and which is therefore no point mass."""
        return self.places()

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key, value) of each prescribed function of time."""
        return [("value", self.value)]

    @property
    def load(self) -> AppliedLoad:
        """The load that the element applies."""
        return AppliedLoad("torque", self.body, self.reaction_body or GROUND, (self.value,))


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
        """Return (key, body name, point in its frame) of each body-fixed point of the element."""
        return [("point", self.body, self.point)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses, and which is therefore no point mass."""
        return self.places() if self.frame == "body" else []

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key, value) of each prescribed function of time."""
        return [(f"value[{i}]", value) for i, value in enumerate(self.value)]

    @property
    def load(self) -> AppliedLoad:
        """The load that the element applies."""
        kind: LoadKind = "body_force" if self.frame == "body" else "point_force"
        return AppliedLoad(kind, self.body, GROUND, self.value, self.point)


# The options of a law are fields of a class that its law makes; SerializeAsAny dumps them as well.
Force = Annotated[SpringDamper | TorsionSpring | Torque | PointForce | SerializeAsAny[Law], Field(discriminator="type")]
"""A force element, by its `type`."""
