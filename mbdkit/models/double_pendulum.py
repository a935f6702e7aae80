"""The double pendulum: a rod on a pin, and another rod on its end."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.values import Number, Point, Positive, pair
from mbdkit.models._chain import chain
from mbdkit.strict_model import StrictModel

SUMMARY = "Two rods in a chain."

_two = BeforeValidator(pair("two numbers [first rod, second rod]"))
PositivePair = Annotated[tuple[Positive, Positive], _two]
NumberPair = Annotated[tuple[Number, Number], _two]


class DoublePendulumOptions(StrictModel):
    """Parameters of `double-pendulum`, two of each, from the ground outwards."""

    lengths: PositivePair = (1.0, 1.0)
    """Lengths of the rods [m]."""
    masses: PositivePair = (1.0, 1.0)
    """Masses of the rods [kg]."""
    inertias: PositivePair | None = None
    """Moments of inertia about the rods' middles [kg m^2]; left out, those of uniform rods."""
    angles: NumberPair = (0.0, 0.0)
    """Initial tilts of the rods from the +x axis, both absolute [rad]; -pi/2 hangs straight down."""
    rates: NumberPair = (0.0, 0.0)
    """Initial angular velocities, both absolute [rad/s]."""
    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""


def build(options: DoublePendulumOptions) -> Mechanism:
    """Return bodies `rod1`, `rod2` on joints `J1`, `J2`."""
    o = options
    return chain("double-pendulum", o.gravity, o.lengths, o.masses, o.angles, o.rates, o.inertias)
