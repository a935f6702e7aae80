"""The single pendulum: one rod attached to the ground by a revolute joint."""

from __future__ import annotations

from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.values import Number, Point, Positive
from mbdkit.models._chain import chain

SUMMARY = "One rod attached to the ground by a revolute joint."


class SinglePendulumOptions(StrictModel):
    """Parameters of `single-pendulum`."""

    length: Positive = 1.0
    """Length of the rod [m]."""
    mass: Positive = 1.0
    """Mass of the rod [kg]."""
    inertia: Positive | None = None
    """Moment of inertia about the midpoint of the rod [kg m^2]; by default, that of a uniform rod."""
    angle: Number = 0.0
    """Initial angle of the rod from the +x axis [rad]; -pi/2 is straight down."""
    rate: Number = 0.0
    """Initial angular velocity [rad/s]."""
    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""


def build(options: SinglePendulumOptions) -> Mechanism:
    """Return a mechanism with body `rod1` and joint `J1`."""
    o = options
    inertias = None if o.inertia is None else [o.inertia]
    return chain("single-pendulum", o.gravity, [o.length], [o.mass], [o.angle], [o.rate], inertias)
