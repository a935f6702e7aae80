"""Joints in `.osim` files as motions in the plane of their parent frame: an angle and a displacement.

The child frame is rotated by ``angle`` and displaced by ``x, y`` in the parent frame. Each of the three is a function
of at most one coordinate. Joints that move out of the plane are rejected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from mbdkit_opensim.frames import FLAT, about
from mbdkit_opensim.functions import Function, constant, function_in
from mbdkit_opensim.osim_document import flag_of, label_of, name_of, number_of, numbers_of, refused, text_of

IDENTITY = Function((0.0, 1.0))


@dataclass(frozen=True)
class OsimCoordinate:
    """A coordinate in a file: its name, its initial value and speed, and whether it is locked at this value."""

    name: str
    value: float
    speed: float
    locked: bool


@dataclass(frozen=True)
class Term:
    """A function of a coordinate; `coordinate` is None if the function is constant."""

    function: Function
    coordinate: OsimCoordinate | None = None

    @property
    def value(self) -> float:
        """Value of the function at the start."""
        return self.function(0.0 if self.coordinate is None else self.coordinate.value)

    @property
    def rate(self) -> float:
        """Rate of the function at the start."""
        return 0.0 if self.coordinate is None else self.function.slope(self.coordinate.value) * self.coordinate.speed

    @property
    def varies(self) -> bool:
        """Whether the value changes during a motion."""
        return self.coordinate is not None and (self.function.spline is not None or self.function.degree > 0)

    def held(self) -> Term:
        """Return the term; as a constant if its coordinate is locked or its function is constant."""
        if self.coordinate is None or (self.varies and not self.coordinate.locked):
            return self
        return Term(constant(self.value))


@dataclass(frozen=True)
class PlanarJoint:
    """A joint in the plane of its parent frame.

    Attributes
    ----------
    label
        Class and name, for messages.
    angle
        Angle of the child frame [rad]; a linear function.
    directions
        Unit vectors (2,) of the displacements, each with the term that gives the displacement along it [m].
    height
        Constant displacement along z [m].
    """

    label: str
    angle: Term
    directions: tuple[tuple[np.ndarray, Term], ...]
    height: float = 0.0

    @property
    def moving(self) -> list[tuple[np.ndarray, Term]]:
        """The displacements that change during a motion."""
        return [direction for direction in self.directions if direction[1].varies]

    @property
    def coordinates(self) -> list[OsimCoordinate]:
        """The free coordinates; that of the angle comes first."""
        terms = [self.angle, *(term for _, term in self.directions)]
        results = {term.coordinate.name: term.coordinate for term in terms if term.varies and term.coordinate}
        return list(results.values())


def coordinates_of(joint: Element, values: Mapping[str, float], speeds: Mapping[str, float]) -> list[OsimCoordinate]:
    """Return the coordinates of a joint; given values and speeds replace those in the file."""
    coordinates = []
    for one in joint.iterfind("coordinates/Coordinate"):
        name = name_of(one)
        value = values.get(name, number_of(one, "default_value", "0"))
        speed = speeds.get(name, number_of(one, "default_speed_value", "0"))
        coordinates.append(OsimCoordinate(name, value, speed, flag_of(one, "locked")))
    return coordinates


def planar_joint(joint: Element, coordinates: list[OsimCoordinate]) -> PlanarJoint:
    """Return a joint as a motion in the plane. SpecError is raised if it leaves the plane, or if its class is
    unknown.
    """
    label = label_of(joint)
    x, y = np.eye(2)
    free = [Term(IDENTITY, coordinate).held() for coordinate in coordinates]
    nothing = Term(constant(0.0))
    expected = {"WeldJoint": 0, "PinJoint": 1, "SliderJoint": 1, "PlanarJoint": 3}
    if joint.tag in expected and len(free) != expected[joint.tag]:
        raise refused(f"{label} should have {expected[joint.tag]} coordinates, not {len(free)}")
    match joint.tag:
        case "WeldJoint":
            return PlanarJoint(label, nothing, ())
        case "PinJoint":
            return PlanarJoint(label, free[0], ())
        case "SliderJoint":
            return PlanarJoint(label, nothing, ((x, free[0]),))
        case "PlanarJoint":
            return PlanarJoint(label, free[0], ((x, free[1]), (y, free[2])))
        case "CustomJoint":
            return _custom(joint, {coordinate.name: coordinate for coordinate in coordinates})
    raise refused(f"{label} is not planar, or its class is not known here")


def _custom(joint: Element, coordinates: Mapping[str, OsimCoordinate]) -> PlanarJoint:
    label = label_of(joint)
    axes = {name_of(one): one for one in joint.iterfind("SpatialTransform/TransformAxis")}
    angle, turned = Term(constant(0.0)), np.eye(3)
    for name in sorted(axes.keys() & {"rotation1", "rotation2", "rotation3"}):
        axis, term = _axis_and_term(axes[name], coordinates, f"{name} of {label}")
        if not term.varies:
            turned = turned @ about(axis, term.value)
            continue
        along = float((turned @ axis)[2])
        if abs(abs(along) - 1.0) > FLAT:
            raise refused(
                f"{label} is not planar: {name} turns about {axis.tolist()}; lock its coordinate or remove it"
            )
        if angle.varies:
            raise refused(f"{label} turns about the z axis twice")
        if term.function.degree != 1 or term.function.spline is not None:
            raise refused(f"{label} is not read: {name} is not a linear function of its coordinate")
        angle = Term(term.function.times(math.copysign(1.0, along)), term.coordinate)
    if math.hypot(turned[0, 2], turned[1, 2]) > FLAT or turned[2, 2] < 0:
        raise refused(f"{label} is not planar: its constant rotations turn the z axis")
    fixed = math.atan2(turned[1, 0], turned[0, 0])
    intercept, *slope = angle.function.polynomial or (0.0,)
    angle = Term(Function((intercept + fixed, *slope)), angle.coordinate)
    directions, height = [], 0.0
    for name in sorted(axes.keys() & {"translation1", "translation2", "translation3"}):
        axis, term = _axis_and_term(axes[name], coordinates, f"{name} of {label}")
        if term.varies and abs(axis[2]) > FLAT:
            raise refused(
                f"{label} is not planar: {name} moves along {axis.tolist()}; lock its coordinate or remove it"
            )
        directions.append((axis[:2], term))
        height += 0.0 if term.varies else float(axis[2]) * term.value
    return PlanarJoint(label, angle, tuple(directions), height)


def _axis_and_term(element: Element, coordinates: Mapping[str, OsimCoordinate], owner: str) -> tuple[np.ndarray, Term]:
    names = text_of(element, "coordinates").split()
    axis = numbers_of(element, "axis", 3)
    length = float(np.linalg.norm(axis))
    if length == 0:
        raise refused(f"{owner} has no axis")
    function = function_in(element, owner)
    if len(names) > 1:
        raise refused(f"{owner} depends on several coordinates")
    if names and names[0] not in coordinates:
        raise refused(f"{owner} depends on '{names[0]}', which is no coordinate of the joint")
    return axis / length, Term(function, coordinates[names[0]] if names else None).held()
