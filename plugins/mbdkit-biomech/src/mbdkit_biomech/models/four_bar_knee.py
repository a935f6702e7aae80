r"""The knee as a crossed four-bar linkage: the lower leg of a seated or standing person on two crossed rods.

The thigh is fixed at `thigh_angle`, so its joint points C and D are points of the ground. Two rods, `acl` (B-C) and
`pcl` (D-A), carry the `shank` with the foot. The mechanism has four revolute joints and one degree of freedom. The
straight leg, facing +x::

                   y
              C    |   thigh (fixed)         A  tibial link, posterior     pcl - shank
               \   |                         B  tibial link, anterior      acl - shank
                \  |                         C  femoral link, posterior    ground - acl
                 \ |          ___... D       D  femoral link, anterior     ground - pcl
     A ___...-----\O---------- - - - x
                   \                         O  anatomical knee joint of the straight leg: the origin
                   |\                           of the thigh's, of the shank's and of the global frame
                   | \
                   |  B
                   |   shank and foot

Frames
    The *thigh frame* has its origin at O; y points along the thigh from the knee to the hip, and x points forward. The
    *shank frame* moves with the shank and coincides with the thigh frame when the leg is straight: y points from the
    ankle to the knee, and x points to the side of the toes. Points of springs are given in these two frames. O is the
    origin of the global frame.
Angles
    `thigh_angle` is the absolute angle of the direction from hip to knee, from the +x axis: 0 for a seated person with
    a horizontal thigh, -pi/2 for a standing person. `flexion` is 0 for the straight leg and positive (clockwise) in
    flexion: body `shank` has the angle ``thigh_angle + pi/2 - flexion``.
Linkage
    Lengths and pitches are those of the knee of a lower-limb exoskeleton for a height of 1.78 m; lengths scale with
    `height`. The source places the midpoint of the tibial link on the axis of the shank, 9 mm below O, and states 9 mm
    above O for the femoral link. The closed linkage contradicts the latter (the midpoints differ in height by 24 mm,
    not 18 mm), and the source does not use it. Here the tibial link is mounted as in the source, and closure determines
    the femoral link: its midpoint is 15 mm above O and 8 mm in front of it.
Masses
    Shank and foot form one body, with Winter's fractions of body mass and height and the foot at a right angle to the
    shank. The rods are uniform. Body frames have their origins at the centres of mass. The x axis of each rod points
    from the femoral to the tibial joint; the axes of body `shank` are parallel to those of the shank frame.
"""

from __future__ import annotations

import math
from typing import ClassVar

from pydantic import Field

from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.joint_friction import PinFriction
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import model_builder
from mbdkit.mechanism.values import NotNegative, Number, Point, Points, Positive
from mbdkit_biomech.models._crossed_four_bar import CrossedFourBar
from mbdkit_biomech.models._knee_linkage import MovingFrame, knee_of, xy
from mbdkit_biomech.models._segments import EXOSKELETON, FRACTIONS, GAIT2D, WINTER, BodySegments

REFERENCES = (EXOSKELETON, WINTER, FRACTIONS, GAIT2D)

REFERENCE_HEIGHT = 1.78  # m, body height for which the linkage was designed
LINKS = {"tibial": 0.0445, "femoral": 0.0409, "acl": 0.0516, "pcl": 0.0472}  # m, at that height
DAMPER = "knee-damping"


class KneeLinks(StrictModel):
    """Lengths of the links [m]; the default lengths scale with `height`."""

    tibial: Positive | None = None
    """Tibial link, from joint A to joint B [m]."""
    femoral: Positive | None = None
    """Femoral link, from joint C to joint D [m]."""
    acl: Positive | None = None
    """Anterior cruciate rod, from joint B to joint C [m]."""
    pcl: Positive | None = None
    """Posterior cruciate rod, from joint D to joint A [m]."""


class KneePitches(StrictModel):
    """Angles of the links below the forward horizontal when the leg is straight [rad]."""

    femoral: Number = math.radians(27.5)
    """Femoral link, from joint C to joint D [rad]."""
    tibial: Number = math.radians(19.5)
    """Tibial link, from joint A to joint B [rad]."""


class KneeSpring(StrictModel):
    """A linear spring and damper between a point of the thigh and a point of the shank."""

    points: Points
    """Points in the thigh frame and in the shank frame, ``[[x, y], [x, y]]`` [m]: origin at the knee joint, x forward,
    y up along the thigh and along the shank."""
    stiffness: NotNegative = 0.0
    """Stiffness [N/m]."""
    damping: NotNegative = 0.0
    """Damping [N s/m]."""
    free_length: NotNegative = 0.0
    """Length at which the spring exerts no force [m]."""


class FourBarKneeOptions(StrictModel):
    """Parameters of `four-bar-knee`."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("pin_friction",)

    height: Positive = 1.78
    """Body height [m]; scales the linkage and the segments."""
    body_mass: Positive = 75.0
    """Body mass [kg]."""
    thigh_angle: Number = 0.0
    """Angle of the direction from hip to knee, from the +x axis [rad]: 0 is seated, -pi/2 is standing."""
    flexion: Number = 0.0
    """Initial flexion of the knee [rad]; 0 for the straight leg."""
    flexion_rate: Number = 0.0
    """Initial flexion rate [rad/s]."""
    links: KneeLinks = KneeLinks()
    """Lengths of the links [m]."""
    pitches: KneePitches = KneePitches()
    """Pitches of the links when the leg is straight [rad]."""
    rod_mass: Positive = 0.05
    """Mass of each of the two rods [kg]."""
    damping: NotNegative = 0.0
    """Rotational damping between thigh and shank [N m s/rad]."""
    pin_friction: PinFriction | None = None
    """Dry friction in each pin of the linkage, ``{coefficient: number, radius: length}``; by default, there is none."""
    springs: dict[str, KneeSpring] = Field(default_factory=dict)
    """Springs and dampers between thigh and shank, by name."""
    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""


def linkage(height: float, links: KneeLinks, pitches: KneePitches) -> CrossedFourBar:
    """Return the four-bar linkage of a person with this body height [m]; lengths in `links` replace scaled ones."""
    scale = height / REFERENCE_HEIGHT
    given = {name: length for name, length in links if length is not None}
    lengths = {name: given.get(name, scale * length) for name, length in LINKS.items()}
    return CrossedFourBar(**lengths, tibial_pitch=pitches.tibial, femoral_pitch=pitches.femoral)


@model_builder
def build(options: FourBarKneeOptions) -> Mechanism:
    """Return a mechanism with bodies `acl`, `pcl`, `shank` and joints `A`, `B`, `C`, `D`, at the given flexion.

    Raises
    ------
    SpecError
        If the linkage cannot be assembled at this flexion, or if the name of a spring is not valid.
    """
    person = BodySegments(options.body_mass, options.height)
    thigh = MovingFrame.at(0j, options.thigh_angle + 0.5 * math.pi)
    four_bar = linkage(options.height, options.links, options.pitches)
    knee = knee_of(four_bar, options.height, thigh, (options.flexion, options.flexion_rate), options.rod_mass)
    leg = person.shank + person.foot_on_shank

    mechanism = Mechanism(options.gravity, name="four-bar-knee")
    mechanism.bodies = {**knee.rods, "shank": knee.shank.carry(leg)}
    mechanism.joints = knee.pins(mechanism.ground, thigh.to_global, leg.centre, options.pin_friction)
    if options.damping > 0:
        mechanism.torsion_spring(DAMPER, mechanism.ground, "shank", damping=options.damping)
    for name, spring in options.springs.items():
        on_thigh, on_shank = (complex(*point) for point in spring.points)
        points = xy(thigh.to_global(on_thigh)), xy(on_shank - leg.centre)
        # not by `model_dump`, which takes numbers with recorded formulas for wrong types
        numbers = {name: value for name, value in spring if name != "points"}
        try:
            mechanism.spring_damper(name, mechanism.ground, "shank", points=points, **numbers)
        except SpecError as error:
            raise SpecError(error.message, key=f"springs.{name}") from None
    return mechanism
