"""A joint: a pin of b slides on the parabola y = curvature x^2 of a."""

from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from mbdkit.plugin import Example, FunctionJoint, JointKind, Number, PoseFunction, Target, hookimpl


def beside(pose, p):
    """Return about the distance from the curve [m]."""
    c = p["curvature"]
    return (pose.y - c * pose.x**2) / np.sqrt(1 + (2 * c * pose.x) ** 2)


class PinOnParabola(FunctionJoint):
    """A pin of b on a parabola of a."""

    type: Literal["parabola-pin"] = "parabola-pin"
    curvature: Number = 1.0
    """Half of the curvature of the parabola at its vertex, which is a's point [1/m]."""
    rows: ClassVar[tuple[str, ...]] = ("normal",)
    units: ClassVar[tuple[str, ...]] = ("m",)

    def angles(self):
        return self.places()[:1]

    def functions(self, start):
        return [PoseFunction(beside, (("curvature", self.curvature),))]

    def lines(self, start):
        (x, y), wide = self.points[0], 1.2 * abs(start.x) + 0.1
        return [[(0, (x + s, y + self.curvature * s * s)) for s in np.linspace(-wide, wide, 41).tolist()]]


@hookimpl
def mbdkit_items():
    kind = JointKind(
        name="parabola-pin",
        summary="a pin on a parabola",
        model=Target("parabola_pin:PinOnParabola"),
        example="parabola-pin",
    )
    return [kind, *Example.folder(Path(__file__).parent)]
