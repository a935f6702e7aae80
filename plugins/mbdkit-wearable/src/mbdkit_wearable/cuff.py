"""Cuffs: soft attachments of a link of a device to a limb.

A cuff has a point of the limb, where the soft tissue is at rest, and a point of the device. The displacement of the
device's point is measured in the frame of the limb, along the axis of the cuff and at right angles to it::

        tangential
            ^        device's point
            |    ..o
            |..''          displacement = (normal, tangential, rotation)
    limb ---+--------> axis (normal)

Normal and tangential displacement are pathways of the type ``travel``, and the rotation is the relative angle of both
bodies, so that each force is conjugate to its displacement: both forces act at the device's point, on the device and,
reversed, on the limb, and the sums of forces and of moments are zero to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field

from mbdkit.plugin import (
    GROUND,
    Element,
    ExpressionLaw,
    NotNegative,
    Number,
    Point,
    Positive,
    Segment,
    SpecError,
    StrictModel,
)
from mbdkit.plugin.equations import elementary
from mbdkit.plugin.mechanisms import Attachment, BodyPair
from mbdkit.plugin.seams import element_forces, element_lines, lowering

if TYPE_CHECKING:
    import sympy

    from mbdkit.plugin import ActingForce, Body, Joint, Lowering, Mechanism

DIRECTIONS = ("normal", "tangential", "rotation")
"""Components of displacements and forces, in the order of archives."""


class CuffStiffness(StrictModel):
    """Stiffness of the soft tissue under a cuff, for small displacements."""

    normal: NotNegative = 0.0
    """Along the axis [N/m]."""
    tangential: NotNegative = 0.0
    """At right angles to the axis [N/m]."""
    rotation: NotNegative = 0.0
    """Against rotation of the device relative to the limb [N m/rad]."""


class CuffDamping(StrictModel):
    """Damping of the soft tissue under a cuff."""

    normal: NotNegative = 0.0
    """Along the axis [N s/m]."""
    tangential: NotNegative = 0.0
    """At right angles to the axis [N s/m]."""
    rotation: NotNegative = 0.0
    """Against rotation of the device relative to the limb [N m s/rad]."""


class ExponentialTissue(StrictModel):
    """Tissue whose stiffness increases exponentially.

    With the stiffness k for small displacements, the force at a displacement x is k L (exp(abs(x)/L) - 1), so that the
    stiffness increases linearly with the force: the law of Y. C. Fung, Elasticity of soft tissues in simple elongation,
    American Journal of Physiology 213 (1967) 1532-1544, https://doi.org/10.1152/ajplegacy.1967.213.6.1532.
    """

    name: Literal["exponential"]
    length: Positive
    """Displacement L over which the stiffness increases by the factor e [m]."""
    angle: Positive
    """Rotation over which the stiffness against rotation increases by the factor e [rad]."""


def _unit_vector(axis: tuple[float, float]) -> tuple[float, float]:
    if (size := elementary.hypot(*axis)) == 0.0:
        raise SpecError("should not be [0, 0]: it is the direction in which the cuff pushes on the limb")
    return axis[0] / size, axis[1] / size


class Cuff(Element):
    """A soft attachment of a link of a device to a limb."""

    bodies: BodyPair
    """Names of limb and device; the limb may be `ground`."""
    at: Point
    """Point of the limb [m], in its frame: where the device's point is while the tissue is at rest."""
    on: Point | None = None
    """The device's point [m], in its frame, at which the forces act; by default, the point that coincides with `at` for
    the given initial positions (before assembly)."""
    angle: Number | None = None
    """Angle of the device relative to the limb [rad] while the tissue is at rest; by default, the one of the given initial
    positions (before assembly)."""
    axis: Annotated[Point, AfterValidator(_unit_vector)] = (1.0, 0.0)
    """Direction of the normal force, in the frame of the limb; its length does not matter."""
    stiffness: CuffStiffness
    """Stiffness of the tissue: `normal`, `tangential`, `rotation`."""
    damping: CuffDamping = CuffDamping()
    """Damping of the tissue: `normal`, `tangential`, `rotation`."""
    law: Literal["linear"] | ExponentialTissue = "linear"
    """Force as a function of displacement: `linear`, or {name: exponential, length, angle}."""
    clearance: NotNegative = 0.0
    """Normal displacement up to which the cuff does not touch the limb, in both directions [m]."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("on", "angle")

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        return [("bodies[0]", self.bodies[0]), ("bodies[1]", self.bodies[1])]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [("at", self.bodies[0], self.at), ("on", self.bodies[1], self.ends[1])]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()

    @property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The points of limb and device [m], each in the frame of its body."""
        assert self.on is not None, "the element is not placed"
        return self.at, self.on

    def placed(self, bodies: Mapping[str, Body], key: str) -> Self:
        """Return the element with the device's point and the angle at rest; see `mbdkit.plugin.Element.placed`."""
        limb, device = self.bodies
        held = self.at if limb == GROUND else bodies[limb].to_global(self.at)
        on = held if device == GROUND else bodies[device].to_local(held)
        a, b = (0.0 if body == GROUND else bodies[body].angle for body in (limb, device))
        return self.model_copy(
            update={
                "on": on if self.on is None else self.on,
                "angle": b - a if self.angle is None else self.angle,
            }
        )


@dataclass(frozen=True)
class CuffForce:
    """One component of the force of a cuff, as a force element that is its own pathway.

    Attributes
    ----------
    cuff
        The cuff, placed.
    direction
        Component: 0 normal, 1 tangential, 2 rotation.
    """

    cuff: Cuff
    direction: int
    law_id: ClassVar[str] = "cuff"

    @property
    def length_unit(self) -> str:
        """Unit of the displacement."""
        return "rad" if self.direction == 2 else "m"

    @property
    def pathway(self) -> CuffForce:
        """The pathway along which the force acts, which is this object."""
        return self

    @property
    def along(self) -> tuple[float, float]:
        """Unit vector of the displacement in the frame of the limb."""
        x, y = self.cuff.axis
        return (x, y) if self.direction == 0 else (-y, x)

    @property
    def zero(self) -> float:
        """Length of the pathway at which the displacement is zero [m or rad]."""
        if self.direction == 2:
            assert self.cuff.angle is not None
            return self.cuff.angle
        return self.along[0] * self.cuff.at[0] + self.along[1] * self.cuff.at[1]

    @property
    def numbers(self) -> dict[str, float]:
        """Parameters of the law by name."""
        name, tissue = DIRECTIONS[self.direction], self.cuff.law
        of_tissue = {} if isinstance(tissue, str) else {"scale": tissue.angle if self.direction == 2 else tissue.length}
        return {
            "stiffness": getattr(self.cuff.stiffness, name),
            "damping": getattr(self.cuff.damping, name),
            "zero": self.zero,
            **({"clearance": self.cuff.clearance} if self._has_clearance else {}),
            **of_tissue,
        }

    @property
    def _has_clearance(self) -> bool:
        return self.direction == 0 and self.cuff.clearance > 0.0

    @property
    def force_law(self) -> ExpressionLaw:
        """The force as a function of the displacement and its rate."""
        return tissue_law(not isinstance(self.cuff.law, str), self._has_clearance)

    def segments(self, joints: Mapping[str, Joint]) -> tuple[Segment, ...]:
        """Return the only segment of the pathway."""
        if self.direction == 2:
            return (Segment("relative_angle", self.cuff.bodies),)
        (ax, ay), (bx, by) = self.cuff.ends
        return (Segment("travel", self.cuff.bodies, (ax, ay, bx, by), self.along),)


@cache
def tissue_law(is_exponential: bool, has_clearance: bool) -> ExpressionLaw:
    """Return the law of the force of tissue, with its potential."""
    import sympy as sp

    length, rate, stiffness, damping, zero, clearance, scale = sp.symbols(
        "length rate stiffness damping zero clearance scale", real=True
    )
    x: sympy.Expr = length - zero
    size: sympy.Expr = sp.Max(sp.Abs(x) - clearance, 0) if has_clearance else sp.Abs(x)
    if is_exponential:
        magnitude = stiffness * scale * (sp.exp(size / scale) - 1)
        force = sp.Piecewise((magnitude, x >= 0), (-magnitude, True))
        potential = stiffness * scale * (scale * (sp.exp(size / scale) - 1) - size)
    else:
        force = sp.Piecewise((stiffness * size, x >= 0), (-stiffness * size, True)) if has_clearance else stiffness * x
        potential = stiffness * size**2 / 2 if has_clearance else stiffness * x**2 / 2
    drag = sp.Piecewise((damping * rate, sp.Abs(x) > clearance), (0, True)) if has_clearance else damping * rate
    return ExpressionLaw(force + drag, potential, passive=True, parameters=lambda force: force.numbers)


@dataclass(frozen=True)
class ActingCuff:
    """A cuff that acts in a run: its name, and the indices of its three force elements among all of them."""

    name: str
    cuff: Cuff
    forces: tuple[int, int, int]

    @property
    def zeros(self) -> list[float]:
        """Lengths of the pathways at which the displacements are zero."""
        return [CuffForce(self.cuff, i).zero for i in range(3)]


def forces_of(cuffs: Mapping[str, Cuff]) -> dict[str, CuffForce]:
    """Return the three components of each cuff as force elements by name, such as ``thigh.normal``."""
    return {f"{name}.{DIRECTIONS[i]}": CuffForce(cuff, i) for name, cuff in cuffs.items() for i in range(3)}


element_forces(forces_of)


@lowering
def lower(cuffs: Mapping[str, Cuff], _lowering: Lowering, acting: tuple[ActingForce, ...]) -> tuple[ActingCuff, ...]:
    """Return the cuffs of a mechanism that is compiled, whose forces have been added."""
    place = {force.name: force.place for force in acting}
    return tuple(
        ActingCuff(name, cuff, (place[f"{name}.normal"], place[f"{name}.tangential"], place[f"{name}.rotation"]))
        for name, cuff in cuffs.items()
    )


@element_lines
def cuff_lines(cuff: Cuff, _mechanism: Mechanism) -> Sequence[Sequence[tuple[str, tuple[float, float]]]]:
    """Return the line between the points of limb and device."""
    return [list(zip(cuff.bodies, cuff.ends, strict=True))]
