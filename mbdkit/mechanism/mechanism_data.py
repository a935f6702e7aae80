"""The free-form model ``mechanism`` as a spec holds it: gravity, bodies, joints, forces and assembly."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.values import Point, Positive, sequence
from mbdkit.strict_model import StrictModel


class Assembly(StrictModel):
    """How the initial state is made consistent with the joints."""

    fix: Annotated[tuple[str, ...], BeforeValidator(sequence)] = ()
    """Bodies that are held where they are while the others move."""
    tolerance: Positive = 1.0e-12
    """Largest residual of a start that counts as consistent [m, rad, m/s, rad/s]; such a start is left untouched."""


class MechanismData(StrictModel):
    """The `mechanism` model as it stands in a spec: everything about a mechanism, by name."""

    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""
    bodies: dict[str, Body]
    """The bodies by name; `ground` exists without being listed."""
    joints: dict[str, Joint] = Field(default_factory=dict)
    """Joints and drivers by name."""
    forces: dict[str, Force] = Field(default_factory=dict)
    """Force elements by name."""
    assembly: Assembly = Assembly()
    """How the start is made consistent."""
