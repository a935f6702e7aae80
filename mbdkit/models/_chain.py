"""A chain of rods attached to the ground, whose initial positions satisfy the joints to round-off."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

from mbdkit.mechanism.mechanism import Mechanism


def chain(
    name: str,
    gravity: tuple[float, float],
    lengths: Sequence[float],
    masses: Sequence[float],
    angles: Sequence[float],
    rates: Sequence[float],
    inertias: Sequence[float] | None,
) -> Mechanism:
    """Return a chain of rods `rod1` to `rodn` with revolute joints `J1` to `Jn`, numbered from the ground outwards.

    Joint `J1` is at the origin. The frame of each rod has its origin at the midpoint of the rod, and its x axis points
    along the rod, away from the ground.

    Parameters
    ----------
    lengths, masses, angles, rates
        One value for each rod: length [m], mass [kg], absolute angle from the +x axis [rad], absolute angular velocity
        [rad/s].
    inertias
        Moment of inertia of each rod about its midpoint [kg m^2]; None for uniform rods, m L^2 / 12.

    Returns
    -------
    Mechanism
        Positions and velocities are compensated sums along the chain (Neumaier), so the joints are satisfied to
        round-off. If round-off exceeds 1e-12, the assembly tolerance grows with the length and speed of the chain.
    """
    mechanism = Mechanism(gravity, name=name)
    x, y, u, v = (_Sum() for _ in range(4))
    before, end = mechanism.ground, (0.0, 0.0)
    fastest = 0.0
    for index, (length, mass, angle, rate) in enumerate(zip(lengths, masses, angles, rates, strict=True)):
        half_x, half_y = 0.5 * length * math.cos(angle), 0.5 * length * math.sin(angle)
        centre = (x.add(half_x), y.add(half_y))
        velocity = (u.add(-rate * half_y), v.add(rate * half_x))
        rod = mechanism.body(
            f"rod{index + 1}",
            mass=mass,
            inertia=mass * length**2 / 12 if inertias is None else inertias[index],
            position=centre,
            angle=angle,
            velocity=velocity,
            angular_velocity=rate,
        )
        mechanism.revolute(f"J{index + 1}", before, rod, points=(end, (-0.5 * length, 0.0)))
        x.add(half_x), y.add(half_y), u.add(-rate * half_y), v.add(rate * half_x)
        before, end = rod, (0.5 * length, 0.0)
        fastest = max(fastest, abs(u.value), abs(v.value))
    mechanism.hold(tolerance=max(1e-12, 8 * sys.float_info.epsilon * max(sum(lengths), fastest)))
    return mechanism


class _Sum:
    """A compensated running sum (Neumaier 1974)."""

    def __init__(self) -> None:
        self.value = 0.0
        self._lost = 0.0

    def add(self, term: float) -> float:
        total = self.value + term
        self._lost += (self.value - total) + term if abs(self.value) >= abs(term) else (term - total) + self.value
        self.value = total
        return total + self._lost
