"""The N-four-bar mechanism: a row of four-bar windows with two singular positions per turn of the cranks."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

from pydantic import Field

from mbdkit.base import elementary
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import model_builder
from mbdkit.mechanism.values import Number, Point, Positive
from mbdkit.models._memory import check_memory

REFERENCES = tuple(Path(__file__).with_suffix(".bib").read_text(encoding="utf-8").strip().split("\n\n"))

#: Memory needed to compile one window of the mechanism (two rods and three joints) [bytes].
BYTES_PER_WINDOW = 40_000


class NFourBarOptions(StrictModel):
    """Parameters of `n-four-bar`."""

    n: Annotated[int, Field(ge=1)] = 2
    """Number of windows."""
    length: Positive = 1.0
    """Length of every rod [m]."""
    mass: Positive = 1.0
    """Mass of every rod [kg]."""
    inertia: Positive | None = None
    """Moment of inertia of every rod about its midpoint [kg m^2]; by default, that of a uniform rod."""
    angle: Number = math.pi / 2
    """Initial angle of the cranks from the +x axis [rad]; upright by default."""
    speed: Number = 1.0
    """Initial speed of the moving ends of the cranks [m/s], clockwise: to the right if the cranks are upright."""
    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""


@model_builder
def build(options: NFourBarOptions) -> Mechanism:
    """Return a mechanism of N + 1 cranks on the ground at A_i = (i L, 0), with N couplers between their ends B_i.

    ::

        B0 --coupler1-- B1 --coupler2-- B2          A0 .. AN: ground and cranks
        |               |               |           B0 .. BN: crank i and the coupler to its left (B0: to its right)
        crank0        crank1          crank2        C1 .. CN-1: crank i and the coupler to its right, pinned like Bi
        A0              A1              A2

    All rods are equal and the cranks start parallel, so they stay parallel, with one degree of freedom. At crank angles
    0 and pi, where all rods are collinear, each window can fold in either direction: these positions are singular, with
    N + 1 instantaneous degrees of freedom.

    Problem A02 of the IFToMM benchmark library (Gonzalez, Dopico, Lugris and Cuadrado, A benchmarking system for MBS
    simulation software, Multibody System Dynamics 16 (2006) 179-190, http://lim.ii.udc.es/mbsbenchmark). The default
    parameters are those of the benchmark, which extends the two windows of Bayo and Avello (1994).

    Raises
    ------
    SpecError
        If the available memory is not sufficient for this many windows.
    """
    o = options
    check_memory(o.n, "windows", BYTES_PER_WINDOW)
    length, half = o.length, 0.5 * o.length
    inertia = o.mass * (length * length) / 12 if o.inertia is None else o.inertia
    rate = -o.speed / length
    x, y = length * elementary.cos(o.angle), length * elementary.sin(o.angle)
    mechanism = Mechanism(o.gravity, name="n-four-bar")
    cranks = []
    for i in range(o.n + 1):
        crank = mechanism.body(
            f"crank{i}",
            mass=o.mass,
            inertia=inertia,
            position=(i * length + 0.5 * x, 0.5 * y),
            angle=o.angle,
            velocity=(-0.5 * rate * y, 0.5 * rate * x),
            angular_velocity=rate,
        )
        mechanism.revolute(f"A{i}", mechanism.ground, crank, points=((i * length, 0.0), (-half, 0.0)))
        cranks.append(crank)
    for i in range(1, o.n + 1):
        coupler = mechanism.body(
            f"coupler{i}",
            mass=o.mass,
            inertia=inertia,
            position=((i - 1) * length + x + half, y),
            velocity=(-rate * y, rate * x),
        )
        left = "B0" if i == 1 else f"C{i - 1}"
        mechanism.revolute(left, cranks[i - 1], coupler, points=((half, 0.0), (-half, 0.0)))
        mechanism.revolute(f"B{i}", cranks[i], coupler, points=((half, 0.0), (half, 0.0)))
    largest = max(o.n * length, abs(o.speed))
    mechanism.hold(tolerance=max(1e-12, 8 * sys.float_info.epsilon * largest))
    return mechanism
