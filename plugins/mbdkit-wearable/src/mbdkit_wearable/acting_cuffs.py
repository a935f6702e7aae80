"""Cuffs that act in a run: each is three force elements, one for each component of its displacement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, ClassVar

from mbdkit.plugin import ExpressionLaw, Segment
from mbdkit.plugin.seams import element_forces, element_lines, lowering
from mbdkit_wearable.cuff import DIRECTIONS, Cuff

if TYPE_CHECKING:
    import sympy

    from mbdkit.plugin import ActingForce, Joint, Lowering, Mechanism


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
