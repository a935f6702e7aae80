"""The single pendulum: one rod on a pin."""

from __future__ import annotations

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.values import Number, Point, Positive
from mbdkit.models._chain import chain
from mbdkit.strict_model import StrictModel

SUMMARY = "One rod on a pin."


class SinglePendulumOptions(StrictModel):
    """Parameters of `single-pendulum`."""

    length: Positive = 1.0
    """Length of the rod [m]."""
    mass: Positive = 1.0
    """Mass of the rod [kg]."""
    inertia: Positive | None = None
    """Moment of inertia about the rod's middle [kg m^2]; left out, that of a uniform rod."""
    angle: Number = 0.0
    """Initial tilt of the rod from the +x axis [rad]; -pi/2 hangs straight down."""
    rate: Number = 0.0
    """Initial angular velocity [rad/s]."""
    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""


def build(options: SinglePendulumOptions) -> Mechanism:
    """Return body `rod1` on joint `J1`."""
    o = options
    inertias = None if o.inertia is None else [o.inertia]
    return chain("single-pendulum", o.gravity, [o.length], [o.mass], [o.angle], [o.rate], inertias)
