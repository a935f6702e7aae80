r"""Human legs in the sagittal plane: thigh, shank and foot, with a pinned knee or with a four-bar knee.

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
    the hip and is free in the plane.
Legs
    By default, the mechanism has one leg. In motions that are the same on both sides, this leg carries half of the
    trunk (``trunk_share: 0.5``); otherwise, the force of the other leg must be given as a load. With ``legs: 2``, a
    second leg hangs at the same hip: its bodies, joints, coordinates and markers have the same names with `_left`, such
    as `shank_left`, `knee_left`, `knee_flexion_left` and `toe_left`, and `left` has its pose at the start. With
    ``symmetric_muscles: true``, each muscle that is attached to the first leg is also on the second, as `NAME_left`.
Segments
    Masses, lengths, centres of mass and radii of gyration are fractions of body mass and height by `table`: Winter's,
    or those of de Leva for women and men. De Leva's shank ends at the lateral malleolus, which counts as the ankle
    here. The tables do not give the position of the heel and the height of the ankle: with all tables, the heel is
    0.06/1.8 of body height behind the ankle, and the ankle at 0.039 of body height. The trunk has the centre of mass
    and the radius of gyration that gait2d computes with Winter's fractions.
Coordinates
    `hip_flexion`, `knee_flexion` and `ankle_dorsiflexion`, with these signs, and with ``root: trunk`` also `hip_x`,
    `hip_y` [m] and `trunk_tilt` (counter-clockwise, that is backward): measured motions and actuators may have these
    names.
Knee of `leg-four-bar`
    That of the model `four-bar-knee` on a thigh that moves: rods `acl` and `pcl`, joints A and B on the shank, C and D
    on the thigh. Knee flexion is the angle between thigh and shank.

Further joints, forces (springs, torques, laws), markers, inputs, muscles and contacts are added by name, as in the
model `mechanism`, with points in the frames of the bodies, whose origins are the centres of mass, or by `at`, `from`
and `to` in global coordinates at the start.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.bodies import GROUND, Body, Marker
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.joint_friction import PinFriction
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_data import MechanismData, NamedCoordinate
from mbdkit.mechanism.mechanism_seams import model_builder
from mbdkit.mechanism.state_values import Input
from mbdkit.mechanism.values import NotNegative, Number, Point, Positive
from mbdkit.spec.loading import read_source
from mbdkit_biomech.models._knee_linkage import MovingFrame, xy
from mbdkit_biomech.models._one_leg import (
    SUFFIX,
    Hip,
    LegParts,
    LegPose,
    four_bar_leg,
    muscles_of_both,
    pinned_leg,
    second_leg,
)
from mbdkit_biomech.models._segments import DE_LEVA, EXOSKELETON, FRACTIONS, GAIT2D, WINTER, BodySegments
from mbdkit_biomech.models.four_bar_knee import KneeLinks, KneePitches, linkage
from mbdkit_biomech.muscles.muscle import Muscle
from mbdkit_contact.contact import Contact

REFERENCES = (WINTER, DE_LEVA, FRACTIONS, GAIT2D)
FOUR_BAR_REFERENCES = (EXOSKELETON, *REFERENCES)


MUSCLE_SETS = ("walking-muscles", "walking-two-legs")  #: Packaged examples whose muscles other legs may have.


def _packaged(value: object) -> object:
    """Return the muscles of a packaged example for its name."""
    if not isinstance(value, str):
        return value
    if value not in MUSCLE_SETS:
        raise SpecError(f"is no set of muscles{did_you_mean(value, MUSCLE_SETS) or f'; sets: {listed(MUSCLE_SETS)}'}")
    return read_source(value).data["model"]["muscles"]


class LegOptions(LegPose):
    """Parameters of `leg`."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        *("legs", "left", "inputs", "muscles", "symmetric_muscles", "contacts"),
        *("thigh_length", "shank_length", "added_mass"),
    )

    height: Positive = 1.8
    """Body height [m]; scales the segments."""
    body_mass: Positive = 75.0
    """Body mass [kg]."""
    table: Literal["winter", "de-leva", "de-leva-female", "de-leva-male"] = "winter"
    """Table of the proportions of the segments; `de-leva` is the mean of those for women and men."""
    thigh_length: Positive | None = None
    """Distance from hip to knee [m]; by default, by `table` and `height`."""
    shank_length: Positive | None = None
    """Distance from knee to ankle [m]; by default, by `table` and `height`."""
    added_mass: dict[Literal["trunk", "thigh", "shank", "foot"], NotNegative] = Field(default_factory=dict)
    """Masses [kg] that the person carries at the centre of mass of the trunk, and of a segment of each leg."""
    root: Literal["hip", "trunk"] = "hip"
    """`hip`: the hip is pinned to the ground; `trunk`: a free body carries it."""
    trunk_share: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Share of the mass of head, arms and trunk that the body `trunk` has; with one leg, use 0.5 for motions that are
    the same on both sides."""
    hip_position: Point = (0.0, 0.0)
    """Initial position of the hip (x, y) [m], in the global frame."""
    hip_velocity: Point = (0.0, 0.0)
    """Initial velocity of the hip (x, y) [m/s]; only with ``root: trunk``."""
    trunk_angle: Number = 0.0
    """Initial angle of the trunk from upright, counter-clockwise [rad]; hip flexion is measured from the trunk."""
    trunk_rate: Number = 0.0
    """Initial angular velocity of the trunk [rad/s]; only with ``root: trunk``."""
    legs: Literal[1, 2] = 1
    """Number of legs; names of the second leg end in `_left`."""
    left: LegPose = LegPose()
    """Pose of the second leg at the start; only with ``legs: 2``."""
    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""
    joints: dict[str, Joint] = Field(default_factory=dict)
    """Further joints and drivers by name."""
    forces: dict[str, Force] = Field(default_factory=dict)
    """Force elements by name."""
    markers: dict[str, Marker] = Field(default_factory=dict)
    """Further points on bodies, by name; the positions and velocities of these points are recorded."""
    inputs: dict[str, Input] = Field(default_factory=dict)
    """Inputs by name, such as the torque of a motor."""
    muscles: Annotated[
        dict[str, Muscle],
        BeforeValidator(
            _packaged, json_schema_input_type=dict[str, Muscle] | Literal["walking-muscles", "walking-two-legs"]
        ),
    ] = Field(default_factory=dict)
    """Muscles by name, or the name of a packaged example whose muscles the first leg has. In runs they exert forces; in
    inverse dynamics with `recruitment`, they share the moments of the actuators."""
    contacts: dict[str, Contact] = Field(default_factory=dict)
    """Contacts by name, such as those of the foot with the floor."""
    symmetric_muscles: bool = False
    """Whether the second leg has a copy `NAME_left` of each muscle that is attached to the first leg; only with ``legs:
    2``."""


class LegFourBarOptions(LegOptions):
    """Parameters of `leg-four-bar`."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*LegOptions.ABSENT_BY_DEFAULT, "pin_friction")

    links: KneeLinks = KneeLinks()
    """Lengths of the links of the knee [m]; the default lengths scale with `height`."""
    pitches: KneePitches = KneePitches()
    """Pitches of the links of the knee when the leg is straight [rad]."""
    rod_mass: Positive = 0.05
    """Mass of each of the two rods of the knee [kg]."""
    pin_friction: PinFriction | None = None
    """Dry friction in each pin of the knee, ``{coefficient: number, radius: length}``; by default, there is none."""


@model_builder
def build(options: LegOptions) -> Mechanism:
    """Return one or two legs.

    A leg has the bodies `thigh`, `shank` and `foot`, and the joints `hip`, `knee` and `ankle`. With ``root: trunk``,
    there is also a body `trunk`.

    Raises
    ------
    SpecError
        If the trunk has a motion although ``root: hip``, if an option of the second leg is given for one leg, or if a
        further joint, force, marker or muscle has the same name as one of the leg, or refers to a body that does not
        exist.
    """
    return _mechanism("leg", options, pinned_leg)


@model_builder
def build_four_bar(options: LegFourBarOptions) -> Mechanism:
    """Return one or two legs as `build`, but with bodies `acl` and `pcl`, and joints `A` to `D` in place of `knee`.

    Raises
    ------
    SpecError
        See `build`; also if the linkage cannot be assembled at the flexion of the knee.
    """
    four_bar = linkage(options.height, options.links, options.pitches)
    leg = partial(four_bar_leg, linkage=four_bar, rod_mass=options.rod_mass, friction=options.pin_friction)
    return _mechanism("leg-four-bar", options, leg)


def person_of(o: LegOptions) -> BodySegments:
    """Return the segments of the options."""
    return BodySegments(o.body_mass, o.height, o.table, o.thigh_length, o.shank_length)


def _mechanism(name: str, o: LegOptions, leg: Callable[[BodySegments, LegPose, Hip], LegParts]) -> Mechanism:
    person = person_of(o)
    trunk = MovingFrame.at(complex(*o.hip_position), o.trunk_angle, complex(*o.hip_velocity), o.trunk_rate)
    bodies: dict[str, Body] = {}
    root: dict[str, NamedCoordinate] = {}
    hip, at_hip = Hip(trunk, GROUND, o.hip_position), Marker(body="thigh", point=xy(-person.thigh.centre))
    if o.root == "trunk":
        bodies = {"trunk": trunk.carry(o.trunk_share * person.trunk)}
        hip = Hip(trunk, "trunk", xy(-person.trunk.centre))
        at_hip = Marker(body="trunk", point=hip.point)
        of = {"hip_x": "hip.x", "hip_y": "hip.y", "trunk_tilt": "trunk.angle"}
        root = {key: NamedCoordinate(of=quantity) for key, quantity in of.items()}
    for key in ("hip_velocity", "trunk_rate") if o.root == "hip" else ():
        if getattr(o, key) not in (0.0, (0.0, 0.0)):
            raise SpecError("with `root: hip` the trunk is at rest: leave this out, or use `root: trunk`", key=key)
    if o.root == "hip" and any(item.on == "trunk" for muscle in o.muscles.values() for item in muscle.path):
        raise SpecError("should be `trunk`, because muscles are attached to it", key="root")
    first = leg(person, o, hip)
    legs, muscles = [first], o.muscles
    if o.legs == 2:
        try:
            legs.append(second_leg(first, leg(person, o.left, hip)))
        except SpecError as error:
            raise SpecError(error.message, key=f"left.{error.key}") from None
        muscles = muscles_of_both(muscles, first) if o.symmetric_muscles else muscles
    elif o.left != LegPose() or o.symmetric_muscles:
        key = "symmetric_muscles" if o.left == LegPose() else "left"
        raise SpecError("is for a second leg only: add `legs: 2`, or leave this out", key=key)
    joints: dict[str, Joint] = {}
    coordinates: dict[str, NamedCoordinate] = {}
    markers: dict[str, Marker] = {"hip": at_hip}
    for one in legs:
        bodies, joints = bodies | one.bodies, joints | one.joints
        coordinates, markers = coordinates | one.coordinates, markers | one.markers
    for body, mass in o.added_mass.items():
        if body not in bodies:
            raise SpecError("should be left out, or use `root: trunk`, which has this body", key=f"added_mass.{body}")
        for key in {body, body + SUFFIX} & bodies.keys():
            bodies[key] = bodies[key].model_copy(update={"mass": bodies[key].mass + mass})
    for kind, own, further in (("joints", joints, o.joints), ("markers", markers, o.markers)):
        for key in own.keys() & further.keys():
            message = f"the leg itself has an element of this name (it has {listed(sorted(own))})"
            raise SpecError(message, key=f"{kind}.{quoted(key)}")
    data = {
        **{key: getattr(o, key) for key in ("gravity", "forces", "inputs", "contacts")},
        "bodies": bodies,
        "joints": joints | o.joints,
        "markers": markers | o.markers,
        "muscles": muscles,
        "coordinates": coordinates | root,
    }
    return Mechanism.from_data(MechanismData.model_validate(data), name=name)
