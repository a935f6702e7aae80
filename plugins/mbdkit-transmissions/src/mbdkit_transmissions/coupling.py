"""A coupling: any equation between the relative coordinates of two bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import field_validator

from mbdkit.plugin import FunctionJoint, Pose, PoseFunction
from mbdkit.plugin.mechanisms import Profile

VARIABLES = ("x", "y", "angle", "first", "second", "t")


@dataclass(frozen=True)
class Equation:
    """The left side of an equation ``f = 0``, as a function of the pose; its numbers are parameters."""

    left: Profile

    def __call__(self, pose: Pose, p: Mapping[str, Any]) -> Any:
        """Return its value."""
        return self.left.value(pose.x, pose.y, pose.angle, pose.first, pose.first + pose.angle, pose.t, **p)


class Coupling(FunctionJoint):
    """An equation between the relative coordinates of a pair of bodies, such as ``angle - 2*first`` = 0."""

    type: Literal["coupling"] = "coupling"
    equation: str
    """Expression that is zero, of `x`, `y` [m] and `angle` [rad] of b in a's frame, of the angles `first` of a and
    `second` of b [rad], and of the time `t` [s]. The point of b, and the origin in a's frame, are `points`."""
    unit: Literal["rad", "m"] = "rad"
    """Unit of the expression."""

    @field_validator("equation")
    @classmethod
    def _is_smooth(cls, equation: str) -> str:
        Profile.of(equation, *VARIABLES)
        return equation

    @property
    def rows(self) -> tuple[str, ...]:
        """Name of the constraint row."""
        return ("equation",)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of the constraint row."""
        return (self.unit,)

    def functions(self, start: Pose) -> Sequence[PoseFunction]:
        """Return the constraint of each row; see `FunctionJoint.functions`."""
        left, numbers = Profile.of(self.equation, *VARIABLES).with_numbers("c")
        return [PoseFunction(Equation(left), numbers)]
