"""The n-pendulum: a chain of n rods."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.memory import available_memory, in_bytes
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.values import Number, Point, Positive, sequence
from mbdkit.models._chain import chain

SUMMARY = "A chain of n rods, with equal or individual parameters."

BYTES_PER_ROD = 10_000
"""Memory needed per rod to compile the mechanism [bytes]; measured: 9,200 with 40,000 rods, more with fewer rods."""

_QUANTITIES = {"length": "lengths", "mass": "masses", "inertia": "inertias", "angle": "angles", "rate": "rates"}


_list = BeforeValidator(sequence)
PositiveList = Annotated[tuple[Positive, ...], _list, Field(min_length=1)]
NumberList = Annotated[tuple[Number, ...], _list, Field(min_length=1)]


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
        for one, many in _QUANTITIES.items():
            values = getattr(self, many)
            if values is None:
                continue
            if getattr(self, one) is not None:
                raise SpecError(f"give either '{one}' for all rods or the list '{many}', not both", key=many)
            if count is not None and len(values) != count:
                raise SpecError(f"has {len(values)} numbers, but '{source}' says {count} rods", key=many)
            count, source = len(values), many
        if count is None:
            raise SpecError("'n', the number of rods, is missing (or a list such as 'lengths')", key="n")
        return self

    def each(self, one: str, default: float) -> tuple[float, ...]:
        """Return the quantity with the singular name `one` for each rod."""
        values = getattr(self, _QUANTITIES[one])
        if values is not None:
            return tuple(values)
        value = getattr(self, one)
        return (default if value is None else value,) * self.count

    @property
    def count(self) -> int:
        """The number of rods."""
        if self.n is not None:
            return self.n
        return next(len(values) for many in _QUANTITIES.values() if (values := getattr(self, many)) is not None)


def build(options: NPendulumOptions) -> Mechanism:
    """Return a mechanism with bodies `rod1` to `rodn` and joints `J1` to `Jn`.

    Raises
    ------
    SpecError
        If the available memory is not sufficient for this many rods.
    """
    o = options
    needed, available = o.count * BYTES_PER_ROD, available_memory()
    if available is not None and needed > available:
        raise SpecError(
            f"{o.count:,} rods need about {in_bytes(needed)} of memory, but only {in_bytes(available)} are available: "
            f"use at most {available // BYTES_PER_ROD:,}",
            key="n",
        )
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
