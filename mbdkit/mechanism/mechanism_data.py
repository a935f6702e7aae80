"""A mechanism as plain data, as it stands in a spec: every element by name, told apart by its type."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, SerializeAsAny

from mbdkit.mechanism.elements import (
    Body,
    Distance,
    Driver,
    Element,
    Point,
    PointForce,
    Positive,
    Prismatic,
    Revolute,
    SpringDamper,
    Torque,
    TorsionSpring,
    Weld,
    sequence,
)
from mbdkit.mechanism.law_element import Law

Joint = Annotated[Revolute | Prismatic | Weld | Distance | Driver, Field(discriminator="type")]
Force = Annotated[SpringDamper | TorsionSpring | Torque | PointForce | SerializeAsAny[Law], Field(discriminator="type")]
"""A law's options are fields of the class that its law makes, and are dumped as well."""


class Assembly(Element):
    """How the initial state is made consistent with the joints."""

    fix: Annotated[tuple[str, ...], BeforeValidator(sequence)] = ()
    """Bodies that are held where they are while the others move."""
    tolerance: Positive = 1.0e-12
    """Largest residual of a start that counts as consistent [m, rad, m/s, rad/s]; such a start is left untouched."""


class MechanismData(Element):
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
