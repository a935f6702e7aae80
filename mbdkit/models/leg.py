r"""A human leg in the sagittal plane: thigh, shank and foot, with a pinned knee or with a four-bar knee.

The person faces +x; with all angles zero, the leg is straight and the foot flat::

            | y
      hip   o ------ x       Frames: each segment has its origin at the joint above it, y points to that joint
            |                and x forward. All frames are parallel to the global frame when the person stands
      thigh |                upright, so that the angle of each body is 0 then.
            |
      knee  o                hip flexion             turns the thigh forward (counter-clockwise)
            |                knee flexion            turns the shank backward (clockwise)
      shank |                ankle dorsiflexion      turns the toes up (counter-clockwise)
            |
      ankle o___             hip.angle = flexion, knee.angle = -flexion (negative, since joint angles are
      heel /____\ toe        counter-clockwise), ankle.angle = dorsiflexion

Root
    With ``root: hip``, the hip is pinned to the ground. With ``root: trunk``, a body `trunk` with head and arms carries
    the hip and is free in the plane. The mechanism has one leg. In motions that are the same on both sides, this leg
    carries half of the trunk (``trunk_share: 0.5``); otherwise, the force of the other leg must be given as a load.
Segments
    Masses, lengths, centres of mass and radii of gyration are fractions of body mass and height by `table`: Winter's,
    or those of de Leva for women and men. De Leva's shank ends at the lateral malleolus, which counts as the ankle
    here. The tables say nothing on the heel and on the height of the ankle: for all of them these are 0.06/1.8 and
    0.039 of body height, and the trunk has the centre of mass and the radius of gyration that gait2d computes with
    Winter's fractions.
Coordinates
    `hip_flexion`, `knee_flexion` and `ankle_dorsiflexion`, with these signs, and with ``root: trunk`` also `hip_x`,
    `hip_y` [m] and `trunk_tilt` (counter-clockwise, that is backward): measured motions and actuators may have these
    names.
Knee of `leg-four-bar`
    That of the model `four-bar-knee` on a thigh that moves: rods `acl` and `pcl`, joints A and B on the shank, C and D
    on the thigh. Knee flexion is the angle between thigh and shank.

Further joints, forces (springs, torques, laws), markers and muscles are added by name, as in the model `mechanism`,
with points in the frames of the bodies, whose origins are the centres of mass, or by `at`, `from` and `to` in global
coordinates at the start.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.text import listed
from mbdkit.mechanism.bodies import GROUND, Body, Marker
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.joints import Joint, Revolute
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_data import MechanismData, NamedCoordinate
from mbdkit.mechanism.muscles import Muscle
from mbdkit.mechanism.values import Number, Point, Positive
from mbdkit.models._knee_linkage import Frame, knee_of, xy
from mbdkit.models._segments import DE_LEVA, FRACTIONS, GAIT2D, WINTER, Person
from mbdkit.models.four_bar_knee import EXOSKELETON, KneeLinks, KneePitches, linkage

SUMMARY = "A leg of thigh, shank and foot, scaled by body mass and height, on a fixed hip or on a free trunk."
FOUR_BAR_SUMMARY = "The same leg with a knee that is a crossed four-bar linkage."
REFERENCES = (WINTER, DE_LEVA, FRACTIONS, GAIT2D)
FOUR_BAR_REFERENCES = (EXOSKELETON, *REFERENCES)


class LegOptions(StrictModel):
    """Parameters of `leg`."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("muscles",)

    height: Positive = 1.8
    """Body height [m]; scales the segments."""
    body_mass: Positive = 75.0
    """Body mass [kg]."""
    table: Literal["winter", "de-leva-female", "de-leva-male"] = "winter"
    """Table of the proportions of the segments."""
    root: Literal["hip", "trunk"] = "hip"
    """`hip`: the hip is pinned to the ground; `trunk`: a free body carries it."""
    trunk_share: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Share of the mass of head, arms and trunk that the body `trunk` has: 0.5 if both legs carry it alike."""
    hip_position: Point = (0.0, 0.0)
    """Initial position of the hip (x, y) [m], in the global frame."""
    hip_velocity: Point = (0.0, 0.0)
    """Initial velocity of the hip (x, y) [m/s]; only with ``root: trunk``."""
    trunk_angle: Number = 0.0
    """Initial angle of the trunk from upright, counter-clockwise [rad]; hip flexion is counted from here."""
    trunk_rate: Number = 0.0
    """Initial angular velocity of the trunk [rad/s]; only with ``root: trunk``."""
    hip_flexion: Number = 0.0
    """Initial angle from trunk to thigh, forward [rad]."""
    knee_flexion: Number = 0.0
    """Initial angle from thigh to shank, backward [rad]."""
    ankle_dorsiflexion: Number = 0.0
    """Initial angle from shank to foot, toes up [rad]."""
    hip_flexion_rate: Number = 0.0
    """Initial rate of hip flexion [rad/s]."""
    knee_flexion_rate: Number = 0.0
    """Initial rate of knee flexion [rad/s]."""
    ankle_dorsiflexion_rate: Number = 0.0
    """Initial rate of ankle dorsiflexion [rad/s]."""
    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""
    joints: dict[str, Joint] = Field(default_factory=dict)
    """Further joints and drivers by name."""
    forces: dict[str, Force] = Field(default_factory=dict)
    """Force elements by name."""
    markers: dict[str, Marker] = Field(default_factory=dict)
    """Further points of bodies whose positions and velocities are recorded, by name."""
    muscles: dict[str, Muscle] = Field(default_factory=dict)
    """Muscles by name. In runs they exert forces; in inverse dynamics with `recruitment`, they share moments."""


class LegFourBarOptions(LegOptions):
    """Parameters of `leg-four-bar`."""

    links: KneeLinks = KneeLinks()
    """Lengths of the links of the knee [m]; the default lengths scale with `height`."""
    pitches: KneePitches = KneePitches()
    """Pitches of the links of the knee when the leg is straight [rad]."""
    rod_mass: Positive = 0.05
    """Mass of each of the two rods of the knee [kg]."""


def build(options: LegOptions) -> Mechanism:
    """Return the leg: bodies `thigh`, `shank`, `foot` and joints `hip`, `knee`, `ankle`, perhaps a body `trunk`.

    Raises
    ------
    SpecError
        If the trunk has a motion but ``root: hip``, or if a further joint, force or marker has the name of one of the
        leg or refers to a body that is not there.
    """
    return _Leg(options).mechanism("leg")


def build_four_bar(options: LegFourBarOptions) -> Mechanism:
    """Return the leg with bodies `acl` and `pcl`, and joints `A`, `B`, `C` and `D` in place of `knee`.

    Raises
    ------
    SpecError
        As for `build`; also if the linkage cannot be assembled at the flexion of the knee.
    """
    leg = _Leg(options)
    person, thigh = leg.person, leg.frames["thigh"]
    top = Frame(
        thigh.to_global(-1j * person.thigh_length),
        thigh.turn,
        thigh.angle,
        thigh.velocity_of(-1j * person.thigh_length),
        thigh.rate,
    )
    four_bar = linkage(options.height, options.links, options.pitches)
    flexion = options.knee_flexion, options.knee_flexion_rate
    try:
        knee = knee_of(four_bar, options.height, top, flexion, options.rod_mass)
    except SpecError as error:
        raise SpecError(error.message, key="knee_flexion") from None
    leg.place_below_knee(knee.shank)
    acl, pcl = knee.ends["acl"], knee.ends["pcl"]
    on_shank = {name: xy(point - person.shank.centre) for name, point in knee.tibial.items()}
    down = person.thigh.centre + 1j * person.thigh_length
    on_thigh = {name: xy(point - down) for name, point in knee.femoral.items()}
    leg.bodies |= knee.rods
    del leg.joints["knee"]
    flexion_of_bodies = NamedCoordinate(of="shank.angle", relative_to="thigh", scale=-1.0)
    leg.coordinates |= {"knee_flexion": flexion_of_bodies}
    leg.joints |= {
        "A": Revolute(bodies=("pcl", "shank"), points=((pcl, 0.0), on_shank["A"])),
        "B": Revolute(bodies=("acl", "shank"), points=((acl, 0.0), on_shank["B"])),
        "C": Revolute(bodies=("thigh", "acl"), points=(on_thigh["C"], (-acl, 0.0))),
        "D": Revolute(bodies=("thigh", "pcl"), points=(on_thigh["D"], (-pcl, 0.0))),
    }
    return leg.mechanism("leg-four-bar")


class _Leg:
    """Bodies, joints and markers of a leg with a pinned knee."""

    def __init__(self, options: LegOptions):
        o = self.options = options
        person = self.person = Person(o.body_mass, o.height, o.table)
        self.segments = {"thigh": person.thigh, "shank": person.shank, "foot": person.foot}
        trunk = Frame.at(complex(*o.hip_position), o.trunk_angle, complex(*o.hip_velocity), o.trunk_rate)
        thigh = Frame.at(trunk.origin, trunk.angle + o.hip_flexion, trunk.velocity, trunk.rate + o.hip_flexion_rate)
        self.frames = {"thigh": thigh}
        self.joints: dict[str, Joint] = {}
        hip = (GROUND, o.hip_position)
        if o.root == "trunk":
            self.frames["trunk"], self.segments["trunk"] = trunk, o.trunk_share * person.trunk
            hip = ("trunk", xy(-person.trunk.centre))
        else:
            for key in ("hip_velocity", "trunk_rate"):
                if getattr(o, key) not in (0.0, (0.0, 0.0)):
                    raise SpecError(
                        "with `root: hip` the trunk is at rest: leave this out, or use `root: trunk`", key=key
                    )
        knee, ankle = -1j * person.thigh_length, -1j * person.shank_length
        for name, (upper, point), lower in (
            ("hip", hip, "thigh"),
            ("knee", ("thigh", xy(knee - person.thigh.centre)), "shank"),
            ("ankle", ("shank", xy(ankle - person.shank.centre)), "foot"),
        ):
            points = (point, xy(-self.segments[lower].centre))
            self.joints[name] = Revolute(bodies=(upper, lower), points=points)
        self.coordinates = {
            "hip_flexion": NamedCoordinate(of="hip.angle"),
            "knee_flexion": NamedCoordinate(of="knee.angle", scale=-1.0),
            "ankle_dorsiflexion": NamedCoordinate(of="ankle.angle"),
        }
        if o.root == "trunk":
            root = {"hip_x": "hip.x", "hip_y": "hip.y", "trunk_tilt": "trunk.angle"}
            self.coordinates |= {name: NamedCoordinate(of=of) for name, of in root.items()}
        self.bodies: dict[str, Body] = {}
        self.place_below_knee(
            Frame.at(
                thigh.to_global(knee),
                thigh.angle - o.knee_flexion,
                thigh.velocity_of(knee),
                thigh.rate - o.knee_flexion_rate,
            )
        )

    def place_below_knee(self, shank: Frame) -> None:
        """Add shank and foot, given the frame of the shank."""
        o, ankle = self.options, -1j * self.person.shank_length
        foot = Frame.at(
            shank.to_global(ankle),
            shank.angle + o.ankle_dorsiflexion,
            shank.velocity_of(ankle),
            shank.rate + o.ankle_dorsiflexion_rate,
        )
        self.frames |= {"shank": shank, "foot": foot}
        order = [name for name in ("trunk", "thigh", "shank", "foot") if name in self.frames]
        self.bodies = {name: self.frames[name].carry(self.segments[name]) for name in order}

    def mechanism(self, name: str) -> Mechanism:
        """Return the mechanism with the further elements of the options."""
        person, o = self.person, self.options
        places = {
            "hip": ("trunk", 0j) if "trunk" in self.frames else ("thigh", 0j),
            "knee": ("shank", 0j),
            "ankle": ("foot", 0j),
            "heel": ("foot", person.heel),
            "toe": ("foot", person.toe),
        }
        markers = {
            key: Marker(body=body, point=xy(point - self.segments[body].centre))
            for key, (body, point) in places.items()
        }
        for kind, own, more in (("joints", self.joints, o.joints), ("markers", markers, o.markers)):
            for key in own.keys() & more.keys():
                raise SpecError(
                    f"the leg itself has an element of this name (it has {listed(sorted(own))})",
                    key=f"{kind}.{quoted(key)}",
                )
        data = MechanismData(
            gravity=o.gravity,
            bodies=self.bodies,
            joints=self.joints | o.joints,
            forces=o.forces,
            markers=markers | o.markers,
            muscles=o.muscles,
            coordinates=self.coordinates,
        )
        return Mechanism.from_data(data, name=name)
