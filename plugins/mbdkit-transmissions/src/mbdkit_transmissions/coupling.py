"""A coupling: any equation between the relative coordinates of two bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BeforeValidator

from mbdkit.plugin import FunctionJoint, Pose, PoseFunction
from mbdkit.plugin.mechanisms import function_of, value_of_program, with_numbers

VARIABLES = ("x", "y", "angle", "first", "second", "t")
NUMBER = "c"
"""Prefix of the names of parameters, which are the numbers in the equation."""


@dataclass(frozen=True)
class Equation:
    """The left side of an equation ``f = 0``, as a function of the pose; its numbers are parameters."""

    program: tuple[tuple[str, float], ...]

    def __call__(self, pose: Pose, p: Mapping[str, object]) -> object:
        """Return its value."""
        own = (pose.x, pose.y, pose.angle, pose.first, pose.first + pose.angle, pose.t)
        numbers = {name.removeprefix(NUMBER): number for name, number in p.items()}
        return value_of_program(self.program, numbers | dict(zip(VARIABLES, own, strict=True)))


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
        program, numbers = with_numbers(self.equation, VARIABLES)
        return [PoseFunction(Equation(program), tuple((f"{NUMBER}{i}", x) for i, x in enumerate(numbers)))]
