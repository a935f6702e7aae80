"""Force elements: linear springs, elements with any other force law, and applied loads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, NamedTuple, Self, cast

from pydantic import Field, SerializeAsAny

from mbdkit.base.traced_numbers import dist
from mbdkit.mechanism.bodies import GROUND, AtPoint, Body, Element
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.pathways import AnglePathway, LinePathway
from mbdkit.mechanism.state_values import Value, ValuePair, of_state, of_time
from mbdkit.mechanism.values import Motion, NotNegative, Number


class LinearForce(NamedTuple):
    """Parameters of a linear spring and damper on a pathway: tension ``stiffness * (s - free) + damping * ds/dt``."""

    stiffness: float
    damping: float
    free: float


LoadKind = Literal["torque", "point_force", "body_force"]


class AppliedLoad(NamedTuple):
    """A prescribed force or torque on a body.

    Attributes
    ----------
    kind
        Torque, point force in the global frame, or point force in the frame of the body.
    body
        The body that the load acts on.
    reaction_body
        The body that the opposite load acts on; the ground if no other body is given.
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

    @property
    def length_unit(self) -> str:
        """Unit of the coordinate along which the load does work: rad for a torque, m for a force."""
        return "rad" if self.kind == "torque" else "m"


class SpringDamper(LinePathway):
    """A linear spring and damper along the line between two points.

    Tension ``stiffness * (l - free_length) + damping * dl/dt`` pulls the points together, where l is their distance.
    """

    type: Literal["spring-damper"] = "spring-damper"
    stiffness: NotNegative = 0.0
    """Stiffness [N/m]."""
    damping: NotNegative = 0.0
    """Damping [N s/m]."""
    free_length: NotNegative | Literal["start"] = 0.0
    """Length at which the spring exerts no force [m]; or `start`, the length for the given initial positions of the
    bodies (before assembly)."""
    pathway_key: ClassVar[str] = ""

    def placed(self, bodies: Mapping[str, Body], key: str) -> Self:
        """Return the element with its points in the frames of the bodies, and with the free length in metres."""
        placed = super().placed(bodies, key)
        if self.free_length != "start":
            return placed
        a, b = (point if name == GROUND else bodies[name].to_global(point) for _, name, point in placed.attachments())
        return placed.model_copy(update={"free_length": dist(a, b)})

    @property
    def pathway(self) -> SpringDamper:
        """The pathway along which the force acts, which is this object."""
        return self

    @property
    def linear(self) -> LinearForce:
        """The parameters of the linear force law."""
        return LinearForce(self.stiffness, self.damping, cast(float, self.free_length))


class TorsionSpring(AnglePathway):
    """A linear torsion spring and damper on ``angle_b - angle_a``.

    The torque on b is ``-stiffness * (angle_b - angle_a - free_angle) - damping * (rate_b - rate_a)``; the opposite
    torque acts on a.
    """

    type: Literal["torsion-spring"] = "torsion-spring"
    stiffness: NotNegative = 0.0
    """Stiffness [N m/rad]."""
    damping: NotNegative = 0.0
    """Damping [N m s/rad]."""
    free_angle: Number | Literal["start"] = 0.0
    """Relative angle at which the spring exerts no torque [rad]; or `start`, that for the given initial angles of the
    bodies (before assembly)."""
    pathway_key: ClassVar[str] = ""

    def placed(self, bodies: Mapping[str, Body], key: str) -> Self:
        """Return the element with the free angle in radians."""
        if self.free_angle != "start":
            return self
        a, b = (0.0 if name == GROUND else bodies[name].angle for name in self.bodies)
        return self.model_copy(update={"free_angle": b - a})

    @property
    def pathway(self) -> TorsionSpring:
        """The pathway along which the torque acts, which is this object."""
        return self

    @property
    def linear(self) -> LinearForce:
        """The parameters of the linear force law."""
        return LinearForce(self.stiffness, self.damping, cast(float, self.free_angle))


class Torque(Element):
    """A torque on a body, and the opposite torque on `reaction_body` if one is given."""

    type: Literal["torque"] = "torque"
    body: str
    """Name of the body that the torque acts on."""
    value: Value
    """Torque [N m]: number, expression of t or of the state, or table."""
    reaction_body: str | None = None
    """Name of the body that the opposite torque acts on; none by default."""

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        named = [("body", self.body)]
        return named if self.reaction_body is None else [*named, ("reaction_body", self.reaction_body)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key, value) of each prescribed function of time."""
        return of_time([("value", self.value)])

    def expressions(self) -> list[tuple[str, str]]:
        """Return (key, text) of each expression of the state."""
        return of_state([("value", self.value)])

    @property
    def load(self) -> AppliedLoad:
        """The load that the element applies."""
        return AppliedLoad("torque", self.body, self.reaction_body or GROUND, (self.value,))


class PointForce(AtPoint):
    """A force on a point of a body, with components in the global frame or in the body's frame."""

    type: Literal["force"] = "force"
    value: ValuePair
    """Force (x, y) [N]: numbers, expressions of t or of the state, or tables."""
    frame: Literal["global", "body"] = "global"
    """Frame of the components of the force: `global`, or `body`, in which case the force turns with the body."""

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places() if self.frame == "body" else []

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key, value) of each prescribed function of time."""
        return of_time(self._values())

    def expressions(self) -> list[tuple[str, str]]:
        """Return (key, text) of each expression of the state."""
        return of_state(self._values())

    def _values(self) -> list[tuple[str, Motion]]:
        return [(f"value[{i}]", value) for i, value in enumerate(self.value)]

    @property
    def load(self) -> AppliedLoad:
        """The load that the element applies."""
        kind: LoadKind = "body_force" if self.frame == "body" else "point_force"
        return AppliedLoad(kind, self.body, GROUND, self.value, self.held)


# Each law has its own subclass of `Law`, whose fields are the options; SerializeAsAny includes these fields in dumps.
#: A force element; `type` selects its class.
Force = Annotated[SpringDamper | TorsionSpring | Torque | PointForce | SerializeAsAny[Law], Field(discriminator="type")]
