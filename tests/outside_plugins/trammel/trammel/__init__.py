"""A model with a page of the guide: both ends of a rod slide in crossed slots."""

import math
from pathlib import Path

from pydantic import BaseModel, Field

import mbdkit
from mbdkit.plugin import GuidePage, hookimpl


class Options(BaseModel):
    length: float = Field(1.0, gt=0, description="Length of the rod [m].")
    mass: float = Field(2.0, gt=0, description="Mass of the rod [kg].")
    angle: float = Field(0.8, gt=-1.5, lt=1.5, description="Angle of the rod from the horizontal at the start [rad].")


def build(options: Options) -> mbdkit.Mechanism:
    half, m = options.length / 2, mbdkit.Mechanism()
    middle = (half * math.cos(options.angle), half * math.sin(options.angle))
    inertia = options.mass * options.length**2 / 12
    rod = m.body("rod", mass=options.mass, inertia=inertia, position=middle, angle=math.pi - options.angle)
    m.point_on_line("floor", m.ground, rod, points=((0.0, 0.0), (-half, 0.0)), axis=(1.0, 0.0))
    m.point_on_line("wall", m.ground, rod, points=((0.0, 0.0), (half, 0.0)), axis=(0.0, 1.0))
    return m


@mbdkit.hookimpl
def mbdkit_models():
    return [mbdkit.ModelPlugin("trammel", "The trammel of Archimedes.", Options, build)]


@hookimpl
def mbdkit_items():
    return [GuidePage("trammel", "A rod in crossed slots.", file=Path(__file__).parent / "trammel.md")]
