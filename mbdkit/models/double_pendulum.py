"""The double pendulum: two rods in a chain, attached to the ground."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator

from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.values import Number, Point, Positive, pair
from mbdkit.models._chain import chain

SUMMARY = "Two rods in a chain."

_two = BeforeValidator(pair("two numbers [first rod, second rod]"))
PositivePair = Annotated[tuple[Positive, Positive], _two]
NumberPair = Annotated[tuple[Number, Number], _two]


class DoublePendulumOptions(StrictModel):
    """Parameters of `double-pendulum`; each pair starts with the rod at the ground."""

    lengths: PositivePair = (1.0, 1.0)
    """Lengths of the rods [m]."""
    masses: PositivePair = (1.0, 1.0)
    """Masses of the rods [kg]."""
    inertias: PositivePair | None = None
    """Moments of inertia about the midpoints of the rods [kg m^2]; by default, those of uniform rods."""
    angles: NumberPair = (0.0, 0.0)
    """Initial absolute angles of the rods from the +x axis [rad]; -pi/2 is straight down."""
    rates: NumberPair = (0.0, 0.0)
    """Initial absolute angular velocities [rad/s]."""
    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""


def build(options: DoublePendulumOptions) -> Mechanism:
    """Return a mechanism with bodies `rod1` and `rod2` and joints `J1` and `J2`."""
    o = options
    return chain("double-pendulum", o.gravity, o.lengths, o.masses, o.angles, o.rates, o.inertias)
