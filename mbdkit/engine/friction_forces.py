"""Friction in joints as force elements: their pathways, and their laws, which depend on the multipliers of the
joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np

from mbdkit.mechanism.force_law import TracedLaw
from mbdkit.mechanism.joint_friction import JointFriction, PinFriction, SlideFriction, regularised_friction
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import Segment

REACTIONS = ("reaction_0", "reaction_1")
"""Names of the law parameters for the multipliers of the first rows of the joint; kernels update their values."""


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
        return friction_law(_pin if isinstance(self.friction, PinFriction) else _slide)

    @property
    def reactions(self) -> tuple[str, ...]:
        """Names of the parameters that are multipliers, in the order of the rows of the joint."""
        return REACTIONS[: len(self.joint.rows)]

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


Law = Callable[[Any, Mapping[str, Any]], Any]


def _pin(rate: Any, p: Mapping[str, Any]) -> Any:
    """Return the friction torque of a pin of radius `arm` at an angular rate; the multipliers are its reaction."""
    force = np.sqrt(p["reaction_0"] * p["reaction_0"] + p["reaction_1"] * p["reaction_1"])
    return p["arm"] * _against(force, p["arm"] * rate, p)


def _slide(rate: Any, p: Mapping[str, Any]) -> Any:
    """Return the friction force of a slide of length ``1 / arm`` at a rate of its travel.

    The multipliers are the normal force and the moment, which are equivalent to one normal force at each end.
    """
    half, couple = 0.5 * p["reaction_0"], p["arm"] * p["reaction_1"]
    return _against(np.absolute(half + couple) + np.absolute(half - couple), rate, p)


def _against(normal: object, slip: object, p: Mapping[str, object]) -> Any:
    numbers = p["static"], p["kinetic"], p["transition"]
    return -regularised_friction(normal, slip, numbers, lambda x, a, b: np.where(x > 0.0, a, b))


@lru_cache(maxsize=2)
def friction_law(force: Law) -> TracedLaw:
    """Return the law of one kind of friction; `force` is `_pin` or `_slide`."""
    return TracedLaw(lambda length, rate, time, p: force(rate, p), lambda one: one.numbers, passive=True)


def friction_forces(mechanism: Mechanism) -> list[FrictionForce]:
    """Return the friction of all joints that have friction, as force elements."""
    forces = []
    for number, (name, joint) in enumerate(mechanism.joints.items()):
        if (friction := getattr(joint, "friction", None)) is not None:
            forces.append(FrictionForce(name, joint, number, friction))
    return forces
