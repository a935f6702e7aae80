"""Friction in joints, and side forces of joints, as force elements: their pathways, and their laws, which depend on the
multipliers of the joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.mechanism.force_law import TracedLaw
from mbdkit.mechanism.joint_base import FunctionJoint, SideForce
from mbdkit.mechanism.joint_friction import JointFriction, PinFriction, SlideFriction, regularised_friction
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import Segment

if TYPE_CHECKING:
    from mbdkit.expressions.recorded import Recorded

#: Names of the law parameters for the multipliers of the first rows of the joint; kernels update their values.
REACTIONS = ("reaction_0", "reaction_1")
#: Names of additional parameters, 1 or -1, of the laws of friction in runs with derivatives
#: (`mbdkit_gradients.law_corners`): whether the slip velocity is above the transition speed, whether it is below its
#: negative, and, for slides, the signs of the normal forces at both ends.
SIDES = tuple(f"mbdkit_side_{i}" for i in range(4))


@dataclass(frozen=True)
class FrictionForce:
    """Friction in a joint as a force element along the coordinate of the joint. This object is also the pathway.

    `name`, `joint`: name of the joint, and the joint. `number`: index of the joint.
    """

    name: str
    joint: Joint
    number: int
    friction: JointFriction
    law_id: ClassVar[str] = "joint-friction"

    @property
    def pathway(self) -> FrictionForce:
        """The pathway along which the force acts, which is this object."""
        return self

    @property
    def length_unit(self) -> str:
        """Unit of the coordinate of the joint."""
        return self.joint.coordinate_unit

    def segments(self, joints: Mapping[str, Joint]) -> tuple[Segment, ...]:
        """Return the segments of the pathway: the relative angle of the bodies, or the travel of the joint."""
        if self.joint.travel is None:
            return (Segment("relative_angle", self.joint.bodies),)
        ax, ay, bx, by, ux, uy = self.joint.travel
        return (Segment("travel", self.joint.bodies, (ax, ay, bx, by), (ux, uy)),)

    @cached_property
    def force_law(self) -> TracedLaw:
        """The law of the force."""
        return PIN if isinstance(self.friction, PinFriction) else SLIDE

    @property
    def reactions(self) -> tuple[tuple[int, str], ...]:
        """Row and name of each parameter of the law that is a multiplier."""
        return tuple(enumerate(REACTIONS[: len(self.joint.rows)]))

    @property
    def numbers(self) -> dict[str, float]:
        """Values of the parameters of the law by name; those of multipliers are 0."""
        static, kinetic = self.friction.coefficients
        arm = 0.0
        if isinstance(self.friction, PinFriction):
            arm = self.friction.radius
        elif isinstance(self.friction, SlideFriction) and self.friction.length is not None:
            arm = 1.0 / self.friction.length
        given = {"static": static, "kinetic": kinetic, "transition": self.friction.transition_speed, "arm": arm}
        return {**dict.fromkeys(REACTIONS, 0.0), **given}


TINY = 1e-300  #: Square of a reaction that counts as none [N^2].


def _side_force(length: Recorded, rate: Recorded, time: Recorded, p: Mapping[str, Recorded]) -> Recorded:
    square = p[REACTIONS[0]] * p[REACTIONS[0]]
    return p["ratio"] * square / np.sqrt(square + TINY)


@dataclass(frozen=True)
class FollowingForce:
    """The side force of a joint as a force element along the line between its points, which is also the pathway.

    Attributes
    ----------
    name, joint
        Name of the joint, and the joint.
    number
        Index of the joint.
    side
        The side force.
    """

    name: str
    joint: FunctionJoint
    number: int
    side: SideForce
    law_id: ClassVar[str] = "side-force"
    length_unit: ClassVar[str] = "m"
    force_law: ClassVar[TracedLaw] = TracedLaw(_side_force, lambda one: one.numbers)

    @property
    def pathway(self) -> FollowingForce:
        """The pathway along which the force acts, which is this object."""
        return self

    def segments(self, joints: Mapping[str, Joint]) -> tuple[Segment, ...]:
        """Return the segment of the pathway."""
        return (Segment("two_points", self.joint.bodies, self.joint.flat_points),)

    @property
    def reactions(self) -> tuple[tuple[int, str], ...]:
        """Row and name of each parameter of the law that is a multiplier."""
        return ((self.side.row, REACTIONS[0]),)

    @property
    def numbers(self) -> dict[str, float]:
        """Values of the parameters of the law by name; that of the multiplier is 0."""
        return {REACTIONS[0]: 0.0, "ratio": self.side.ratio}


def _pin(rate: Recorded, p: Mapping[str, Recorded]) -> Recorded:
    """Return the friction torque of a pin of radius `arm` at an angular rate; the multipliers are its reaction."""
    square = p["reaction_0"] * p["reaction_0"] + p["reaction_1"] * p["reaction_1"]
    force = square / np.sqrt(square + TINY)  # unlike the root, 0 has derivatives with respect to parameters: zeros
    return p["arm"] * _against(force, p["arm"] * rate, p)


def _slide(rate: Recorded, p: Mapping[str, Recorded]) -> Recorded:
    """Return the friction force of a slide of length ``1 / arm`` at a rate of its travel.

    The multipliers are the normal force and the moment, which are equivalent to one normal force at each end.
    """
    half, couple = 0.5 * p["reaction_0"], p["arm"] * p["reaction_1"]
    first, second = half + couple, half - couple
    if SIDES[2] in p:
        return _against(p[SIDES[2]] * first + p[SIDES[3]] * second, rate, p)
    return _against(np.absolute(first) + np.absolute(second), rate, p)


def _against(normal: Recorded, slip: Recorded, p: Mapping[str, Recorded]) -> Recorded:
    numbers, share = (p["static"], p["kinetic"], p["transition"]), None
    if SIDES[0] in p:
        forwards, backwards = p[SIDES[0]] > 0.0, p[SIDES[1]] > 0.0
        # steps that are repeated from the corner on go beyond it: without bounds, the joint could lock itself there
        inside = slip / p["transition"]
        inside = np.where(inside > 1.25, 1.25, np.where(inside < -1.25, -1.25, inside))
        share = np.where(forwards, 1.0, np.where(backwards, -1.0, inside))
    return -regularised_friction(normal, slip, numbers, lambda x, a, b: np.where(x > 0.0, a, b), share)


PIN = TracedLaw(lambda length, rate, time, p: _pin(rate, p), lambda one: one.numbers, passive=True)
#: Laws of the friction of pins and of slides.
SLIDE = TracedLaw(lambda length, rate, time, p: _slide(rate, p), lambda one: one.numbers, passive=True)


def friction_forces(mechanism: Mechanism) -> list[FrictionForce]:
    """Return the friction of all joints that have friction, as force elements."""
    forces = []
    for number, (name, joint) in enumerate(mechanism.joints.items()):
        if (friction := getattr(joint, "friction", None)) is not None:
            forces.append(FrictionForce(name, joint, number, friction))
    return forces


def following_forces(mechanism: Mechanism) -> list[FollowingForce]:
    """Return the side forces of all joints that have one, as force elements."""
    return [
        FollowingForce(name, joint, number, side)
        for number, (name, joint) in enumerate(mechanism.joints.items())
        if isinstance(joint, FunctionJoint) and (side := joint.side_force()) is not None
    ]
