"""One leg on a given hip, with a pinned knee or a four-bar knee. A second leg is built alike and has other names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Set
from typing import Any, NamedTuple

from pydantic import BaseModel

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.bodies import Body, Marker
from mbdkit.mechanism.joint_friction import PinFriction
from mbdkit.mechanism.joints import Joint, Revolute
from mbdkit.mechanism.mechanism_data import NamedCoordinate
from mbdkit.mechanism.values import Number
from mbdkit_biomech.models._crossed_four_bar import CrossedFourBar
from mbdkit_biomech.models._knee_linkage import MovingFrame, knee_of, xy
from mbdkit_biomech.models._segments import BodySegments
from mbdkit_biomech.muscles.muscle import Muscle

SUFFIX = "_left"  #: Suffix of the names of the second leg.
_WORD = re.compile(r"[^\W\d]\w*")


class LegPose(StrictModel):
    """Pose of a leg and its motion at the start."""

    hip_flexion: Number = 0.0
    """Initial angle from trunk to thigh, forward [rad]."""
    knee_flexion: Number = 0.0
    """Initial angle of the shank relative to the thigh [rad], positive if the knee is bent."""
    ankle_dorsiflexion: Number = 0.0
    """Initial angle from shank to foot, toes up [rad]."""
    hip_flexion_rate: Number = 0.0
    """Initial rate of hip flexion [rad/s]."""
    knee_flexion_rate: Number = 0.0
    """Initial rate of knee flexion [rad/s]."""
    ankle_dorsiflexion_rate: Number = 0.0
    """Initial rate of ankle dorsiflexion [rad/s]."""


class Hip(NamedTuple):
    """The hip of a leg.

    Attributes
    ----------
    frame
        Frame of the trunk, with its origin at the hip.
    body
        Name of the body that carries the leg.
    point
        Position of the hip in the frame of this body [m].
    """

    frame: MovingFrame
    body: str
    point: tuple[float, float]


class LegParts(NamedTuple):
    """Elements of a leg by name."""

    bodies: dict[str, Body]
    joints: dict[str, Joint]
    coordinates: dict[str, NamedCoordinate]
    markers: dict[str, Marker]


def pinned_leg(person: BodySegments, pose: LegPose, hip: Hip) -> LegParts:
    """Return a leg with a pinned knee."""
    thigh, knee = _thigh(pose, hip), -1j * person.thigh_length
    parts = _leg(person, pose, hip, thigh, thigh.hinged(knee, -pose.knee_flexion, -pose.knee_flexion_rate))
    points = (xy(knee - person.thigh.centre), xy(-person.shank.centre))
    pin = Revolute(bodies=("thigh", "shank"), points=points)
    return parts._replace(joints={"hip": parts.joints["hip"], "knee": pin, "ankle": parts.joints["ankle"]})


def four_bar_leg(
    person: BodySegments,
    pose: LegPose,
    hip: Hip,
    *,
    linkage: CrossedFourBar,
    rod_mass: float,
    friction: PinFriction | None = None,
) -> LegParts:
    """Return a leg with a four-bar knee.

    Raises
    ------
    SpecError
        If the linkage cannot be assembled at the flexion of the knee.
    """
    thigh, down = _thigh(pose, hip), -1j * person.thigh_length
    top = MovingFrame(thigh.to_global(down), thigh.turn, thigh.angle, thigh.velocity_of(down), thigh.rate)
    try:
        knee = knee_of(linkage, person.height, top, (pose.knee_flexion, pose.knee_flexion_rate), rod_mass)
    except SpecError as error:
        raise SpecError(error.message, key="knee_flexion") from None
    parts = _leg(person, pose, hip, thigh, knee.shank)
    joints = knee.pins("thigh", lambda point: point - person.thigh.centre + down, person.shank.centre, friction)
    flexion = NamedCoordinate(of="shank.angle", relative_to="thigh", scale=-1.0)
    return LegParts(
        parts.bodies | knee.rods, parts.joints | joints, parts.coordinates | {"knee_flexion": flexion}, parts.markers
    )


def _thigh(pose: LegPose, hip: Hip) -> MovingFrame:
    return hip.frame.hinged(0j, pose.hip_flexion, pose.hip_flexion_rate)


def _leg(person: BodySegments, pose: LegPose, hip: Hip, thigh: MovingFrame, shank: MovingFrame) -> LegParts:
    """Return a leg without the joints of its knee, given the frames of thigh and shank."""
    ankle = -1j * person.shank_length
    foot = shank.hinged(ankle, pose.ankle_dorsiflexion, pose.ankle_dorsiflexion_rate)
    segments = {"thigh": person.thigh, "shank": person.shank, "foot": person.foot}
    frames = {"thigh": thigh, "shank": shank, "foot": foot}
    places = {"knee": ("shank", 0j), "ankle": ("foot", 0j), "heel": ("foot", person.heel), "toe": ("foot", person.toe)}
    on_foot = (xy(ankle - person.shank.centre), xy(-person.foot.centre))
    return LegParts(
        {name: frame.carry(segments[name]) for name, frame in frames.items()},
        {
            "hip": Revolute(bodies=(hip.body, "thigh"), points=(hip.point, xy(-person.thigh.centre))),
            "ankle": Revolute(bodies=("shank", "foot"), points=on_foot),
        },
        {
            "hip_flexion": NamedCoordinate(of="hip.angle"),
            "knee_flexion": NamedCoordinate(of="knee.angle", scale=-1.0),
            "ankle_dorsiflexion": NamedCoordinate(of="ankle.angle"),
        },
        {name: Marker(body=body, point=xy(point - segments[body].centre)) for name, (body, point) in places.items()},
    )


def second_leg(first: LegParts, same: LegParts) -> LegParts:
    """Return the elements of a second leg.

    Parameters
    ----------
    first
        The first leg, whose names get the suffix `SUFFIX`.
    same
        A leg with the same names, in the pose of the second leg.
    """
    own = {name for kind in first for name in kind}
    return LegParts(*(_of_second(kind, own) for kind in same))


def muscles_of_both(muscles: Mapping[str, Muscle], first: LegParts) -> dict[str, Muscle]:
    """Return muscles, each followed by its copy on the second leg if it is attached to the first one.

    Raises
    ------
    SpecError
        If another muscle already has the name of a copy.
    """
    results: dict[str, Muscle] = {}
    leg = {name for kind in first for name in kind}
    for name, muscle in muscles.items():
        results[name] = muscle
        if not any(item.on in first.bodies for item in muscle.path):
            continue
        if name + SUFFIX in muscles:
            raise SpecError(
                f"with `symmetric_muscles: true`, '{name}' is on the second leg under this name; choose another one",
                key=f"muscles.{quoted(name + SUFFIX)}",
            )
        excitation = _of_second(muscle.excitation, leg | set(muscles))
        results[name + SUFFIX] = _of_second(muscle, leg).model_copy(update={"excitation": excitation})
    return results


def _of_second(value: Any, own: Set[str]) -> Any:
    """Return a value with names of the second leg for those of the first, `own`, in all its texts and expressions."""
    if isinstance(value, BaseModel):
        fields = {name: getattr(value, name) for name in type(value).model_fields}
        return value.model_copy(update={name: new for name, x in fields.items() if (new := _of_second(x, own)) != x})
    if isinstance(value, Mapping):
        return {_of_second(key, own): _of_second(x, own) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_of_second(x, own) for x in value)
    if not isinstance(value, str):
        return value
    return value + SUFFIX if value in own else re.sub(_WORD, lambda word: word[0] + SUFFIX * (word[0] in own), value)
