"""Cuffs that act in a run: each is three force elements, one for each component of its displacement."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, ClassVar

from mbdkit import ExpressionLaw
from mbdkit.plugin import GROUND, ActingForce, Joint, Lowering, Mechanism, Segment, SpecError, quoted
from mbdkit.plugin.equations import elementary
from mbdkit.plugin.seams import element_forces, element_lines, expression_lowering, lowering, start_values
from mbdkit_wearable.cuff import DIRECTIONS, Cuff

if TYPE_CHECKING:
    import numpy as np
    import sympy


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
            **({"skin": 0.0} if self.direction == 1 and self.cuff.slip is not None else {}),
            **of_tissue,
        }

    @property
    def _has_clearance(self) -> bool:
        return self.direction == 0 and self.cuff.clearance > 0.0

    @property
    def force_law(self) -> ExpressionLaw:
        """The force as a function of the displacement and its rate, or of the displacement of the skin."""
        is_exponential = not isinstance(self.cuff.law, str)
        if self.direction == 1 and self.cuff.slip is not None:
            return skin_law(is_exponential)
        return tissue_law(is_exponential, self._has_clearance)

    def force_at(self, displacement: float) -> float:
        """Return the force of tissue without clearance at a displacement [m or rad]."""
        numbers = self.numbers
        if (scale := numbers.get("scale")) is None:
            return numbers["stiffness"] * displacement
        size = elementary.exp(abs(displacement) / scale) - 1.0
        return numbers["stiffness"] * scale * math.copysign(size, displacement)

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
        force = _exponential(x, size, stiffness, scale)
        potential = stiffness * scale * (scale * (sp.exp(size / scale) - 1) - size)
    else:
        force = sp.Piecewise((stiffness * size, x >= 0), (-stiffness * size, True)) if has_clearance else stiffness * x
        potential = stiffness * size**2 / 2 if has_clearance else stiffness * x**2 / 2
    # behind a clearance, damping grows with the depth, because a force that jumps at contact stops Newton's method
    drag = damping * rate * (sp.Min(size / clearance, 1) if has_clearance else 1)
    return ExpressionLaw(force + drag, potential, passive=True, parameters=lambda force: force.numbers)


@cache
def skin_law(is_exponential: bool) -> ExpressionLaw:
    """Return the law of the shear force of a cuff that slips: a function of the displacement of the skin, a state."""
    import sympy as sp

    stiffness, scale, skin = sp.symbols("stiffness scale skin", real=True)
    force = _exponential(skin, sp.Abs(skin), stiffness, scale) if is_exponential else stiffness * skin
    rates = {"skin": (sp.Integer(0), "m")}  # `lower_slip` replaces the rate
    return ExpressionLaw(force, passive=True, rates=rates, parameters=lambda force: force.numbers)


def _exponential(x: sympy.Expr, size: sympy.Expr, stiffness: sympy.Expr, scale: sympy.Expr) -> sympy.Expr:
    import sympy as sp

    magnitude = stiffness * scale * (sp.exp(size / scale) - 1)
    return sp.Piecewise((magnitude, x >= 0), (-magnitude, True))


@dataclass(frozen=True)
class ActingCuff:
    """A cuff that acts in a run.

    Attributes
    ----------
    name, cuff
        Its name, and the cuff.
    forces
        Indices of its three force elements among all of them.
    skin
        Index of the displacement of the skin among the first-order states; -1 for a cuff that does not slip.
    """

    name: str
    cuff: Cuff
    forces: tuple[int, int, int]
    skin: int = -1

    @property
    def zeros(self) -> list[float]:
        """Lengths of the pathways at which the displacements are zero."""
        return [CuffForce(self.cuff, i).zero for i in range(3)]


def forces_of(cuffs: Mapping[str, Cuff]) -> dict[str, CuffForce]:
    """Return the three components of each cuff as force elements by name, such as ``thigh.normal``."""
    return {f"{name}.{DIRECTIONS[i]}": CuffForce(cuff, i) for name, cuff in cuffs.items() for i in range(3)}


element_forces(forces_of)


@lowering
def lower(cuffs: Mapping[str, Cuff], lowering: Lowering, acting: tuple[ActingForce, ...]) -> tuple[ActingCuff, ...]:
    """Return the cuffs of a mechanism that is compiled, whose forces have been added."""
    found = []
    for number, (name, cuff) in enumerate(cuffs.items()):
        normal, tangential, rotation = acting[3 * number : 3 * number + 3]
        if cuff.slip is not None and not lowering.mechanism.is_of_run:
            raise SpecError(
                "the shear force of a cuff that slips depends on the motion before, which only a run has; leave this "
                "out here",
                key=f"model.cuffs.{quoted(name)}.slip",
            )
        skin = -1 if cuff.slip is None else tangential.state
        found.append(ActingCuff(name, cuff, (normal.place, tangential.place, rotation.place), skin))
    return tuple(found)


@expression_lowering
def lower_slip(cuffs: tuple[ActingCuff, ...], lowering: Lowering) -> tuple[ActingCuff, ...]:
    """Set the rates of the displacements of the skin below cuffs that slip; see `mbdkit_wearable.cuff.CuffSlip`."""
    for acting in cuffs:
        if (slip := acting.cuff.slip) is not None:
            own = f"cuffs[{json.dumps(acting.name)}]"
            share = f"{own}.shear_force/({slip.friction!r}*({slip.preload!r} + abs({own}.normal_force)))"
            rate = f"{own}.tangential_rate - abs({own}.tangential_rate)*{share}"
            key = f"model.cuffs.{quoted(acting.name)}.slip"
            lowering.set_rate(acting.skin, lowering.expression(key, acting.name, rate))
    return cuffs


@start_values
def skin_at_start(cuffs: tuple[ActingCuff, ...], mechanism: Mechanism, _t0: float, q: np.ndarray) -> dict[int, float]:
    """Return displacements of the skin by index of the state: those of the device, as far as friction holds them."""
    place = dict(zip(mechanism.bodies, q.tolist(), strict=False)) | {GROUND: [0.0, 0.0, 0.0]}
    found = {}
    for acting in cuffs:
        if (slip := acting.cuff.slip) is not None:
            normal, tangential, _ = displacement_at(acting.cuff, *(place[body] for body in acting.cuff.bodies))
            push = CuffForce(acting.cuff, 0).force_at(max(abs(normal) - acting.cuff.clearance, 0.0))
            force, limit = CuffForce(acting.cuff, 1), slip.friction * (slip.preload + push)
            while abs(force.force_at(tangential)) > limit:  # stiffness does not decrease, so that the end is reached
                tangential *= limit / abs(force.force_at(tangential))
            found[acting.skin] = tangential
    return found


def displacement_at(cuff: Cuff, limb: Sequence[float], device: Sequence[float]) -> tuple[float, float, float]:
    """Return the displacement of a cuff for poses (x, y, angle) of limb and device."""
    (px, py), (x, y, angle) = cuff.ends[1], device
    c, s = elementary.cos(angle), elementary.sin(angle)
    dx, dy = x + c * px - s * py - limb[0], y + s * px + c * py - limb[1]
    c, s = elementary.cos(limb[2]), elementary.sin(limb[2])
    across = c * dx + s * dy - cuff.at[0], c * dy - s * dx - cuff.at[1]
    normal, tangential = (sum(a * b for a, b in zip(CuffForce(cuff, i).along, across, strict=True)) for i in (0, 1))
    assert cuff.angle is not None
    return normal, tangential, angle - limb[2] - cuff.angle


@element_lines
def cuff_lines(cuff: Cuff, _mechanism: Mechanism) -> Sequence[Sequence[tuple[str, tuple[float, float]]]]:
    """Return the line between the points of limb and device."""
    return [list(zip(cuff.bodies, cuff.ends, strict=True))]
