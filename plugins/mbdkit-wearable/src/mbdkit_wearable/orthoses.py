r"""Devices for legs as models of their own: orthoses of the knee, an exoskeleton of hip and knee, and a strut.

Each device is in its neutral posture, in which the leg is straight and the person faces +x::

         | y
      [ upper ]    cuff of the thigh: `upper_arm` above the knee
         |
         o ------ x    knee, the origin; that of `hip-knee-exoskeleton` is the hip
         |
      [ lower ]    cuff of the shank: `lower_arm` below the knee

The frame of each link is parallel to the global frame and has its origin at the cuff, where the centre of mass lies,
too. An angle of the joint `hinge` is that of the lower link relative to the upper one, negative in flexion as in the
model `leg`. Lengths scale with the height of the person, thighs by D. A. Winter, Biomechanics and Motor Control of
Human Movement, 4th edition, Wiley 2009.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar

from mbdkit.plugin import Mechanism, NotNegative, Number, Positive, StrictModel
from mbdkit.plugin.mechanisms import Motion
from mbdkit.plugin.seams import model_builder

WINTER, STIENEN, GROUP3 = Path(__file__).with_name("references.bib").read_text("utf-8").strip().split("\n\n")
REFERENCES, FOUR_BAR, SELF_ALIGNING = (WINTER,), (WINTER, GROUP3), (WINTER, STIENEN)

ARM, THIGH = 0.09, 0.245  #: Distance of a cuff from the knee, and length of the thigh, relative to body height.
FOUR_BAR_HEIGHT = 1.78
#: Pins of the four-bar linkage at this body height [m], in the straight leg: A and B of the lower link, C and D of the
#: upper one, so that its links have the lengths and pitches of the model `four-bar-knee`, rounded to 0.1 mm.
PINS = {"A": (-0.0210, -0.0016), "B": (0.0210, -0.0164), "C": (-0.0101, 0.0244), "D": (0.0261, 0.0056)}


class DeviceOptions(StrictModel):
    """Parameters that all devices of the knee have."""

    height: Positive = 1.75
    """Height of the person [m]; scales the device."""
    upper_arm: Positive | None = None
    """Distance of the cuff of the thigh from the knee [m]; by default, 0.09 of `height`."""
    lower_arm: Positive | None = None
    """Distance of the cuff of the shank from the knee [m]; by default, 0.09 of `height`."""
    upper_mass: Positive = 0.5
    """Mass of the upper link [kg]."""
    lower_mass: Positive = 0.5
    """Mass of the lower link [kg]."""

    @property
    def arms(self) -> tuple[float, float]:
        """Distances of both cuffs from the knee [m]."""
        return self.upper_arm or ARM * self.height, self.lower_arm or ARM * self.height


class OrthosisOptions(DeviceOptions):
    """Parameters of orthoses with a joint, a spring and a motor at the knee."""

    stiffness: NotNegative = 0.0
    """Stiffness of the spring at the joint [N m/rad]."""
    damping: NotNegative = 0.0
    """Damping at the joint [N m s/rad]."""
    free_angle: Number = 0.0
    """Angle of the lower link relative to the upper one at which the spring is at rest [rad], negative in flexion."""
    motor: Motion = 0.0
    """Torque of the motor on the lower link [N m], positive where it extends the knee: a number, or a function of
    time."""


class FourBarOrthosisOptions(OrthosisOptions):
    """Parameters of `four-bar-orthosis`."""

    rod_mass: Positive = 0.05
    """Mass of each of the two rods [kg]."""


class GearedOrthosisOptions(OrthosisOptions):
    """Parameters of `geared-orthosis`."""

    pitch: Positive = 0.015
    """Pitch radius of both toothed sectors [m]."""
    plate_mass: Positive = 0.1
    """Mass of the plate with the two pivots [kg]."""


class SelfAligningOrthosisOptions(OrthosisOptions):
    """Parameters of `self-aligning-orthosis`."""

    slide_mass: Positive = 0.1
    """Mass of each of the two parts that slide [kg]."""


class ExoskeletonOptions(OrthosisOptions):
    """Parameters of `hip-knee-exoskeleton`; `upper_arm` counts from the knee, and the spring is at the knee."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("thigh_length",)

    thigh_length: Positive | None = None
    """Distance from hip to knee [m]; by default, 0.245 of `height`."""
    pelvis_arm: Positive = 0.1
    """Distance of the link on the trunk above the hip [m]."""
    pelvis_mass: Positive = 2.0
    """Mass of the link on the trunk [kg]."""
    hip_stiffness: NotNegative = 0.0
    """Stiffness of the spring at the hip [N m/rad]."""
    hip_motor: Motion = 0.0
    """Torque of the motor at the hip on the upper link [N m], positive where it flexes the hip."""


class StrutOptions(DeviceOptions):
    """Parameters of `passive-strut`."""

    depth: Number = 0.06
    """Distance of the strut behind the knee [m]."""
    stiffness: NotNegative = 3000.0
    """Stiffness of the strut [N/m]."""
    damping: NotNegative = 0.0
    """Damping of the strut [N s/m]."""
    free_length: Positive | None = None
    """Length of the strut without force [m]; by default, that in the straight leg."""


def _links(o: DeviceOptions, knee: float = 0.0) -> Mechanism:
    """Return a mechanism with the upper and the lower link; `knee` is the height of the knee [m]."""
    m = Mechanism()
    upper, lower = o.arms
    for name, mass, arm in (("upper", o.upper_mass, upper), ("lower", o.lower_mass, -lower)):
        m.body(name, mass=mass, inertia=mass * arm**2 / 12.0, position=(0.0, knee + arm))
    return m


def _orthosis(o: OrthosisOptions, knee: float = 0.0) -> Mechanism:
    """Return a mechanism with both links and what acts between them, but without a joint."""
    m = _links(o, knee)
    m.torsion_spring("spring", "upper", "lower", stiffness=o.stiffness, damping=o.damping, free_angle=o.free_angle)
    m.torque("motor", "lower", value=o.motor, reaction_body="upper")
    return m


def _part(m: Mechanism, name: str, mass: float, position: tuple[float, float], size: float) -> None:
    m.body(name, mass=mass, inertia=mass * size**2 / 12.0, position=position)


@model_builder
def hinge(options: OrthosisOptions) -> Mechanism:
    """Return an orthosis with one hinge: bodies `upper` and `lower`, joint `hinge`."""
    m = _orthosis(options)
    m.revolute("hinge", "upper", "lower", at=(0.0, 0.0))
    return m


@model_builder
def four_bar(options: FourBarOrthosisOptions) -> Mechanism:
    """Return an orthosis with a crossed four-bar linkage: bodies `upper`, `lower`, `acl`, `pcl`, joints `A` to `D`."""
    m, scale = _orthosis(options), options.height / FOUR_BAR_HEIGHT
    pins = {name: (scale * x, scale * y) for name, (x, y) in PINS.items()}
    for rod, ends in {"acl": "CB", "pcl": "DA"}.items():
        (ax, ay), (bx, by) = (pins[end] for end in ends)
        _part(m, rod, options.rod_mass, ((ax + bx) / 2.0, (ay + by) / 2.0), math.hypot(bx - ax, by - ay))
    pairs = {"A": ("lower", "pcl"), "B": ("lower", "acl"), "C": ("upper", "acl"), "D": ("upper", "pcl")}
    for pin, pair in pairs.items():
        m.revolute(pin, *pair, at=pins[pin])
    return m


@model_builder
def geared(options: GearedOrthosisOptions) -> Mechanism:
    """Return an orthosis with two pivots in a plate, and toothed sectors that mesh between them.

    Bodies `upper`, `lower`, `plate`; joints `upper_pivot`, `lower_pivot`, `sectors`.
    """
    m, pitch = _orthosis(options), options.pitch
    _part(m, "plate", options.plate_mass, (0.0, 0.0), 4.0 * pitch)
    pivots = (0.0, pitch), (0.0, -pitch)
    for name, pivot in zip(("upper", "lower"), pivots, strict=True):
        m.revolute(f"{name}_pivot", name, "plate", at=pivot)
    points = [m.to_local(name, pivot) for name, pivot in zip(("upper", "lower"), pivots, strict=True)]
    m.gear("sectors", "upper", "lower", points=points, radii=(pitch, pitch))
    return m


@model_builder
def self_aligning(options: SelfAligningOrthosisOptions) -> Mechanism:
    """Return an orthosis whose hinge can move on the upper link along two slides, which still transmit torques.

    Bodies `upper`, `along`, `across`, `lower`; joints `along`, `across` (slides) and `hinge`.
    """
    m = _orthosis(options)
    for name in ("along", "across"):
        _part(m, name, options.slide_mass, (0.0, 0.0), 0.05)
    m.prismatic("along", "upper", "along", at=(0.0, 0.0), axis=(0.0, 1.0))
    m.prismatic("across", "along", "across", at=(0.0, 0.0), axis=(1.0, 0.0))
    m.revolute("hinge", "across", "lower", at=(0.0, 0.0))
    return m


@model_builder
def hip_knee(options: ExoskeletonOptions) -> Mechanism:
    """Return an exoskeleton with hinges at hip and knee, without a foot; its origin is the hip.

    Bodies `pelvis`, `upper`, `lower`; joints `hip` and `hinge`.
    """
    knee = -(options.thigh_length or THIGH * options.height)
    m = _orthosis(options, knee)
    _part(m, "pelvis", options.pelvis_mass, (0.0, options.pelvis_arm), 0.2)
    m.revolute("hip", "pelvis", "upper", at=(0.0, 0.0))
    m.revolute("hinge", "upper", "lower", at=(0.0, knee))
    m.torsion_spring("hip_spring", "pelvis", "upper", stiffness=options.hip_stiffness)
    m.torque("hip_motor", "upper", value=options.hip_motor, reaction_body="pelvis")
    return m


@model_builder
def strut(options: StrutOptions) -> Mechanism:
    """Return two shells, and a spring behind the knee: bodies `upper` and `lower`, force `strut`."""
    m, end = _links(options), (-options.depth, 0.0)
    free = sum(options.arms) if options.free_length is None else options.free_length
    numbers: dict[str, Any] = {"stiffness": options.stiffness, "damping": options.damping, "free_length": free}
    m.spring_damper("strut", "upper", "lower", points=(end, end), **numbers)
    return m
