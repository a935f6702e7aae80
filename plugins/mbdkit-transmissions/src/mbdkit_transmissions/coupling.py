"""A coupling: any equation between the relative coordinates of two bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from mbdkit.plugin import FunctionJoint, Pose, PoseFunction
from mbdkit.plugin.mechanisms import function_of, value_of_text

VARIABLES = ("x", "y", "angle", "first", "second", "t")


@dataclass(frozen=True)
class Equation:
    """The left side of an equation ``text = 0``, as a function of the pose."""

    text: str

    def __call__(self, pose: Pose, p: Mapping[str, Any]) -> Any:
        """Return its value."""
        own = (pose.x, pose.y, pose.angle, pose.first, pose.first + pose.angle, pose.t)
        return value_of_text(self.text, dict(zip(VARIABLES, own, strict=True)))


class Coupling(FunctionJoint):
    """An equation between the relative coordinates of a pair of bodies, such as ``angle - 2*first`` = 0."""

    type: Literal["coupling"] = "coupling"
    equation: Annotated[str, BeforeValidator(function_of(*VARIABLES))]
    """Expression that is zero, of `x`, `y` [m] and `angle` [rad] of b in a's frame, of the angles `first` of a and
    `second` of b [rad], and of the time `t` [s]. The point of b, and the origin in a's frame, are `points`."""
    unit: Literal["rad", "m"] = "rad"
    """Unit of the expression."""

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
        return [PoseFunction(Equation(self.equation))]
