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

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, model_validator

from mbdkit.plugin import GROUND, Body, Element, NotNegative, Number, Point, Positive, SpecError, StrictModel
from mbdkit.plugin.equations import elementary
from mbdkit.plugin.mechanisms import Attachment, BodyPair

#: Components of displacements and forces, in the order of archives.
DIRECTIONS = ("normal", "tangential", "rotation")


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


class CuffSlip(StrictModel):
    """Dry friction between a cuff and the skin, by the model of Dahl.

    The displacement z of the skin, by which the tissue is sheared, follows the tangential displacement x of the device:
    z' = x' - abs(x') f(z) / (friction (preload + n)), where f is the law of the tissue and n the absolute value of the
    normal force without damping. P. R. Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14 (1976)
    1675-1682, https://doi.org/10.2514/3.61511.
    """

    friction: Positive
    """Coefficient of friction between cuff and skin."""
    preload: Positive
    """Normal force with which the straps press the cuff on the limb, on all sides [N]."""


class CuffLimits(StrictModel):
    """Forces beyond which a cuff is judged."""

    normal_force: Positive = 230.0
    """Largest normal force [N]. Through a rigid cuff on the thigh, persons felt discomfort from 40 N to more than 230
    N: J. Bessler-Etten et al., Applied Ergonomics 115 (2024) 104055, https://doi.org/10.1016/j.apergo.2023.104055."""
    shear_force: Positive = 250.0
    """Largest shear force [N]. Along thigh and shank, persons accepted at least 250 N, and 700 N to 870 N on average:
    M. B. Yandell et al., PLoS ONE 15 (2020) e0228536, https://doi.org/10.1371/journal.pone.0228536."""
    pressure: Positive = 17.3e3
    """Largest mean pressure on `area` [Pa]. On 20 cm^2 of the thigh, women felt pain from 34.6 N on average, men from
    89.3 N: Z. Kozinc et al., Applied Ergonomics 93 (2021) 103379, https://doi.org/10.1016/j.apergo.2021.103379."""
    slip: Positive = 0.01
    """Largest distance over which the cuff slides on the skin [m]."""


def _unit_vector(axis: tuple[float, float]) -> tuple[float, float]:
    if (size := elementary.hypot(*axis)) == 0.0:
        raise SpecError("should not be [0, 0]: it is the direction in which the cuff pushes on the limb")
    return axis[0] / size, axis[1] / size


class Tissue(StrictModel):
    """Properties of a cuff, without its place."""

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
    slip: CuffSlip | None = None
    """Friction between cuff and skin, {friction, preload}; by default, the cuff does not slide."""
    area: Positive | None = None
    """Area of the cuff on each side of the limb, on which its normal force is distributed [m^2]."""
    limits: CuffLimits = CuffLimits()
    """Forces beyond which the verdict is doubtful: `normal_force`, `shear_force`, `pressure`, `slip`."""

    @model_validator(mode="after")
    def _slip_has_stiffness(self) -> Self:
        if self.slip is not None and not self.stiffness.tangential:
            raise SpecError("should be greater than 0 for a cuff that slips", key="stiffness.tangential")
        if self.slip is not None and self.damping.tangential:
            raise SpecError("is not possible with `slip`, which limits the shear force", key="damping.tangential")
        return self


class Cuff(Tissue, Element):
    """A soft attachment of a link of a device to a limb."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("on", "angle", "slip", "area", "limits")

    bodies: BodyPair
    """Names of limb and device; the limb may be `ground`."""
    at: Point
    """Point of the limb [m], in its frame: where the device's point is while the tissue is at rest."""
    on: Point | None = None
    """The device's point [m], in its frame, at which the forces act; by default, the point that coincides with `at` for
    the given initial positions (before assembly)."""
    angle: Number | None = None
    """Angle of the device relative to the limb while the tissue is at rest [rad]; by default, the one of the given
    initial positions (before assembly)."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the first-order states: the displacement of the skin, if the cuff slips."""
        return () if self.slip is None else ("tangential.skin",)

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
            update={"on": on if self.on is None else self.on, "angle": b - a if self.angle is None else self.angle}
        )
