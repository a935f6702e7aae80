"""Options and functions of the models `urdf`, `mjcf` and `pylinkage`, and the force law `dry-friction`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, Field

import mbdkit
from mbdkit.plugin import regularised_friction
from mbdkit.plugin.seams import model_builder
from mbdkit_robots.linkages import read_linkage
from mbdkit_robots.mjcf import read_mjcf
from mbdkit_robots.planar import PlanarMechanism, Plane, SpatialModel
from mbdkit_robots.trees import leaving_bodies
from mbdkit_robots.urdf import read_urdf

if TYPE_CHECKING:
    import sympy

_HERE = Path(__file__).parent
_STRICT = ConfigDict(strict=True, frozen=True, extra="forbid", use_attribute_docstrings=True)


class MjcfOptions(BaseModel):
    """Path of the file, plane of motion, and initial values and speeds."""

    model_config = _STRICT

    file: str = Field(examples=[str(_HERE / "four_bar.xml")])
    """Path of the MJCF file; relative to the current folder."""
    plane: Plane = "xz"
    """The plane of motion. Its two axes become x and y."""
    initial: dict[str, float] = Field(default_factory=dict)
    """Initial values of joints by name [rad or m], with the sign convention of the file; 0 by default."""
    speeds: dict[str, float] = Field(default_factory=dict)
    """Initial speeds of joints by name [rad/s or m/s], with the sign convention of the file; 0 by default."""
    transition_speed: float = Field(default=0.01, gt=0, allow_inf_nan=False)
    """Speed [rad/s or m/s] at which the regularised dry friction of a joint reaches its magnitude."""


class UrdfOptions(MjcfOptions):
    """Path of the file, plane of motion, whether the root link is free, and initial values and speeds."""

    file: str = Field(examples=[str(_HERE / "arm.urdf")])
    """Path of the URDF file; relative to the current folder."""
    floating: bool = False
    """Whether the root link moves freely; by default, it is fixed to the ground."""


class LinkageOptions(BaseModel):
    """Path of the file, and the time step and mass, which linkages of pylinkage do not have."""

    model_config = _STRICT

    file: str = Field(examples=[str(_HERE / "linkage.json")])
    """Path of the JSON file that `pylinkage.mechanism.mechanism_to_json` wrote; relative to the current folder."""
    steps_per_second: float = Field(default=100.0, gt=0)
    """Number of pylinkage steps per second [1/s]. The angular velocities of pylinkage are given in radians per step."""
    mass_per_length: float = Field(default=1.0, gt=0)
    """Mass of a link per unit of its length [kg/m]; links are thin rods between their joints."""


class DryFrictionOptions(BaseModel):
    """Options of `dry-friction`: a force of constant magnitude against the motion, which does not depend on the load.

    Below the transition speed, the force is proportional to the speed.
    """

    model_config = _STRICT

    loss: float = Field(ge=0, allow_inf_nan=False)
    """Magnitude of the force [N or N m], as `frictionloss` in MJCF and `friction` in URDF."""
    transition_speed: float = Field(default=0.01, gt=0, allow_inf_nan=False)
    """Speed [m/s or rad/s] at which the regularised force reaches its magnitude."""


def _dry_friction() -> sympy.Expr:
    """Return the force ``loss * rate / transition_speed``; its magnitude is at most `loss`."""
    from sympy import Piecewise, symbols

    rate, loss, transition = symbols("rate loss transition_speed", real=True)
    return -regularised_friction(loss, rate, (1, 1, transition), lambda x, a, b: Piecewise((a, x > 0), (b, True)))


def _no_potential() -> sympy.Expr:
    from sympy import Integer

    return Integer(0)


@model_builder
def of_urdf(options: UrdfOptions) -> mbdkit.Mechanism:
    """Return the planar mechanism of the file."""
    return _projected(read_urdf(options.file, floating=options.floating), options)


@model_builder
def of_mjcf(options: MjcfOptions) -> mbdkit.Mechanism:
    """Return the planar mechanism of the file."""
    return _projected(read_mjcf(options.file), options)


def _projected(model: SpatialModel, options: MjcfOptions) -> mbdkit.Mechanism:
    planar = PlanarMechanism(model, options.plane, options.transition_speed)
    for name in leaving_bodies(model, planar.normal):
        model.leave_out("motions of free bodies out of the plane", name, acts=True)
    return planar.mechanism(options.initial, options.speeds)


@model_builder
def of_linkage(options: LinkageOptions) -> mbdkit.Mechanism:
    """Return the planar mechanism of the file."""
    rate, mass = options.steps_per_second, options.mass_per_length
    return read_linkage(options.file, steps_per_second=rate, mass_per_length=mass)


LAW = mbdkit.ExpressionLaw(_dry_friction, _no_potential, passive=True)
