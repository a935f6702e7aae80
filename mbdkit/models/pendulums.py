"""Pendulums: one rod, two or n in a chain that is attached to the ground.

The initial positions of a chain satisfy the joints to round-off.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.traced_numbers import largest
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import model_builder
from mbdkit.mechanism.values import Number, Point, Positive, pair, sequence
from mbdkit.models._memory import check_memory

#: Memory needed per rod to compile the mechanism [bytes]; measured: 9,200 with 40,000 rods, more with fewer rods.
BYTES_PER_ROD = 10_000

_QUANTITIES = {"length": "lengths", "mass": "masses", "inertia": "inertias", "angle": "angles", "rate": "rates"}

_two = BeforeValidator(pair("two numbers [first rod, second rod]"))
PositivePair = Annotated[tuple[Positive, Positive], _two]
NumberPair = Annotated[tuple[Number, Number], _two]
_list = BeforeValidator(sequence)
PositiveList = Annotated[tuple[Positive, ...], _list, Field(min_length=1)]
NumberList = Annotated[tuple[Number, ...], _list, Field(min_length=1)]


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


@model_builder
def build_single(options: SinglePendulumOptions) -> Mechanism:
    """Return a mechanism with body `rod1` and joint `J1`."""
    o = options
    inertias = None if o.inertia is None else [o.inertia]
    return chain("single-pendulum", o.gravity, [o.length], [o.mass], [o.angle], [o.rate], inertias)


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


@model_builder
def build_double(options: DoublePendulumOptions) -> Mechanism:
    """Return a mechanism with bodies `rod1` and `rod2` and joints `J1` and `J2`."""
    o = options
    return chain("double-pendulum", o.gravity, o.lengths, o.masses, o.angles, o.rates, o.inertias)


class NPendulumOptions(StrictModel):
    """Parameters of `n-pendulum`.

    Each quantity is either one number for all rods or, under its plural name, a list with one number for each rod,
    starting at the ground. `n` can be omitted if there is a list.
    """

    n: Annotated[int, Field(ge=1)] | None = None
    """Number of rods."""
    length: Positive | None = None
    """Length of every rod [m]; 1 by default."""
    mass: Positive | None = None
    """Mass of every rod [kg]; 1 by default."""
    inertia: Positive | None = None
    """Moment of inertia of every rod about its midpoint [kg m^2]; by default, that of a uniform rod."""
    angle: Number | None = None
    """Initial angle of every rod from the +x axis [rad]; 0 by default, -pi/2 is straight down."""
    rate: Number | None = None
    """Initial absolute angular velocity of every rod [rad/s]; 0 by default."""
    lengths: PositiveList | None = None
    """Lengths of the rods [m]."""
    masses: PositiveList | None = None
    """Masses of the rods [kg]."""
    inertias: PositiveList | None = None
    """Moments of inertia about the midpoints of the rods [kg m^2]."""
    angles: NumberList | None = None
    """Initial absolute angles of the rods from the +x axis [rad]."""
    rates: NumberList | None = None
    """Initial absolute angular velocities of the rods [rad/s]."""
    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""

    @model_validator(mode="after")
    def _lists_agree(self) -> NPendulumOptions:
        count, source = self.n, "n"
        for quantity, many in _QUANTITIES.items():
            if (values := getattr(self, many)) is None:
                continue
            if getattr(self, quantity) is not None:
                raise SpecError(f"give either '{quantity}' for all rods or the list '{many}', not both", key=many)
            if count is not None and len(values) != count:
                raise SpecError(f"has {len(values)} numbers, but '{source}' says {count} rods", key=many)
            count, source = len(values), many
        if count is None:
            raise SpecError("'n', the number of rods, is missing (or a list such as 'lengths')", key="n")
        return self

    def each(self, one: str, default: float) -> tuple[float, ...]:
        """Return the quantity with the singular name `one` for each rod."""
        if (values := getattr(self, _QUANTITIES[one])) is not None:
            return tuple(values)
        value = getattr(self, one)
        return (default if value is None else value,) * self.count

    @property
    def count(self) -> int:
        """The number of rods."""
        if self.n is not None:
            return self.n
        return next(len(values) for many in _QUANTITIES.values() if (values := getattr(self, many)) is not None)


@model_builder
def build_n(options: NPendulumOptions) -> Mechanism:
    """Return a mechanism with bodies `rod1` to `rodn` and joints `J1` to `Jn`.

    Raises
    ------
    SpecError
        If the available memory does not suffice for this many rods.
    """
    o = options
    check_memory(o.count, "rods", BYTES_PER_ROD)
    uniform = o.inertia is None and o.inertias is None
    return chain(
        "n-pendulum",
        o.gravity,
        o.each("length", 1.0),
        o.each("mass", 1.0),
        o.each("angle", 0.0),
        o.each("rate", 0.0),
        None if uniform else o.each("inertia", 0.0),
    )


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
        half_x, half_y = 0.5 * length * elementary.cos(angle), 0.5 * length * elementary.sin(angle)
        centre = (x.add(half_x), y.add(half_y))
        velocity = (u.add(-rate * half_y), v.add(rate * half_x))
        rod = mechanism.body(
            f"rod{index + 1}",
            mass=mass,
            inertia=mass * (length * length) / 12 if inertias is None else inertias[index],
            position=centre,
            angle=angle,
            velocity=velocity,
            angular_velocity=rate,
        )
        mechanism.revolute(f"J{index + 1}", before, rod, points=(end, (-0.5 * length, 0.0)))
        x.add(half_x), y.add(half_y), u.add(-rate * half_y), v.add(rate * half_x)
        before, end = rod, (0.5 * length, 0.0)
        fastest = largest(fastest, abs(u.value), abs(v.value))
    mechanism.hold(tolerance=largest(1e-12, 8 * sys.float_info.epsilon * largest(sum(lengths), fastest)))
    return mechanism


class _Sum:
    """A compensated running sum (Neumaier 1974); the errors of additions are computed without branches (Knuth)."""

    def __init__(self) -> None:
        self.value = 0.0
        self._lost = 0.0

    def add(self, term: float) -> float:
        total = self.value + term
        other = total - self.value
        self._lost += (self.value - (total - other)) + (term - other)
        self.value = total
        return total + self._lost
