"""Data of the free-form model ``mechanism`` in a spec: gravity, bodies, beams, joints, forces, markers, assembly."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import BeforeValidator, Field, model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.beams import Beam
from mbdkit.mechanism.bodies import Body, Marker
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.named_coordinates import AnyNamedCoordinate
from mbdkit.mechanism.values import Point, Positive, sequence

NO_BODY = "a mechanism needs at least one body or beam"


class Assembly(StrictModel):
    """Settings for making the initial state consistent with the joints."""

    fix: Annotated[tuple[str, ...], BeforeValidator(sequence)] = ()
    """Names of the bodies that assembly does not move."""
    tolerance: Positive = 1.0e-12
    """Largest constraint residual of a consistent initial state [m, rad, m/s, rad/s]; assembly keeps such a state."""


class MechanismData(StrictModel):
    """Data of the model `mechanism`: gravity, named bodies, beams, joints, forces and markers, and assembly."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("beams", "markers", "coordinates")

    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""
    bodies: dict[str, Body] = Field(default_factory=dict)
    """Bodies by name; `ground` is predefined."""
    beams: dict[str, Beam] = Field(default_factory=dict)
    """Flexible beams by name; the nodes of a beam `link` are the bodies `link.0`, `link.1`, ..."""
    joints: dict[str, Joint] = Field(default_factory=dict)
    """Joints and drivers by name."""
    forces: dict[str, Force] = Field(default_factory=dict)
    """Force elements by name."""
    markers: dict[str, Marker] = Field(default_factory=dict)
    """Points of bodies whose positions and velocities are recorded, by name."""
    coordinates: dict[str, AnyNamedCoordinate] = Field(default_factory=dict)
    """Names of quantities, such as ``knee_angle: knee.angle`` or ``knee_angle: {of: knee.angle, scale: -1}``."""
    assembly: Assembly = Assembly()
    """Settings for making the initial state consistent."""

    @model_validator(mode="after")
    def _has_bodies(self) -> MechanismData:
        if not self.bodies and not self.beams:
            raise SpecError(NO_BODY, key="bodies")
        return self
