"""What is understood of an `.osim` file, what cannot change motions and forces, and what else a file contains.

OpenSim publishes no schema. `registry.json` lists its types of components with their properties and default values; it
is printed by ``tests.benchmarks.registry_of_opensim`` from the registry of the Python package `opensim`, whose version
it states.
A property is reported unless it is in `READ` or `IGNORED`, or has its default value.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import NamedTuple
from xml.etree.ElementTree import Element

from mbdkit_opensim.osim_document import flag_of, name_of

_JOINT = "socket_parent_frame socket_child_frame coordinates frames"
_OLD_JOINT = "parent_body location_in_parent orientation_in_parent location orientation reverse"
_MUSCLE = (
    "appliesForce path GeometryPath max_isometric_force optimal_fiber_length tendon_slack_length "
    "pennation_angle_at_optimal max_contraction_velocity activation_time_constant deactivation_time_constant "
    "default_activation ignore_tendon_compliance"
)
_FUNCTIONS = "Constant LinearFunction PolynomialFunction MultiplierFunction SimmSpline NaturalCubicSpline"
_POINT = "socket_parent_frame location body"

READ: Mapping[str, frozenset[str]] = {
    kind: frozenset(properties.split())
    for kind, properties in {
        "Model": "ground Ground gravity length_units force_units BodySet JointSet ConstraintSet ForceSet ControllerSet "
        "MarkerSet",
        "Ground": "WrapObjectSet",
        "Body": "mass mass_center inertia inertia_xx inertia_yy inertia_zz inertia_xy inertia_xz inertia_yz "
        "WrapObjectSet",
        "PinJoint": f"{_JOINT} {_OLD_JOINT}",
        "SliderJoint": f"{_JOINT} {_OLD_JOINT}",
        "WeldJoint": f"{_JOINT} {_OLD_JOINT}",
        "PlanarJoint": f"{_JOINT} {_OLD_JOINT}",
        "CustomJoint": f"{_JOINT} {_OLD_JOINT} SpatialTransform",
        "Coordinate": "default_value default_speed_value locked prescribed prescribed_function",
        "SpatialTransform": "TransformAxis",
        "TransformAxis": f"coordinates axis function {_FUNCTIONS}",
        "Constant": "value",
        "LinearFunction": "coefficients",
        "PolynomialFunction": "coefficients",
        "MultiplierFunction": f"function scale {_FUNCTIONS}",
        "SimmSpline": "x y",
        "NaturalCubicSpline": "x y",
        "PiecewiseLinearFunction": "x y",
        "CoordinateCouplerConstraint": "isEnforced coupled_coordinates_function independent_coordinate_names "
        "dependent_coordinate_name scale_factor",
        "PointOnLineConstraint": "isEnforced socket_line_body socket_follower_body line_body follower_body "
        "line_direction_vec point_on_line point_on_follower",
        "PhysicalOffsetFrame": "socket_parent translation orientation",
        "Marker": _POINT,
        "GeometryPath": "PathPointSet PathWrapSet",
        "PathPoint": _POINT,
        "ConditionalPathPoint": f"{_POINT} socket_coordinate coordinate range",
        "MovingPathPoint": f"{_POINT} x_location y_location z_location socket_x_coordinate socket_y_coordinate "
        "socket_z_coordinate x_coordinate y_coordinate z_coordinate",
        "PathWrap": "wrap_object",
        "WrapCylinder": "xyz_body_rotation translation quadrant radius active",
        "Millard2012EquilibriumMuscle": f"{_MUSCLE} fiber_damping ActiveForceLengthCurve",
        "ActiveForceLengthCurve": "",
        "DeGrooteFregly2016Muscle": f"{_MUSCLE} fiber_damping",
        "Thelen2003Muscle": _MUSCLE,
    }.items()
}
"""Properties that are read, by the type of the component."""

SETS = ("ForceSet", "ControllerSet", "ConstraintSet")
"""Sets of a model whose objects `unread_in` does not look at."""

IGNORED: Mapping[str, frozenset[str]] = {
    kind: frozenset(properties.split())
    for kind, properties in {
        "": "Appearance attached_geometry frame_geometry FrameGeometry VisibleObject groups display display_preference",
        "Model": "credits publications defaults assembly_accuracy ModelVisualPreferences ContactGeometrySet ProbeSet",
        "Coordinate": "range clamped is_free_to_satisfy_constraints motion_type",
        "Marker": "fixed",
        "WrapCylinder": "length",
        "PathWrap": "method",
        "ActiveForceLengthCurve": "minimum_value",  # zero in muscles with a rigid tendon, whatever the file says
        "Millard2012EquilibriumMuscle": "default_fiber_length optimal_force",
        "DeGrooteFregly2016Muscle": "default_normalized_tendon_force optimal_force tendon_compliance_dynamics_mode",
        "Thelen2003Muscle": "default_fiber_length optimal_force",
    }.items()
}
"""Properties that cannot change motions and forces, by type; those of the empty name, in all types."""

_IDLE = (
    "BodyActuator CoordinateActuator PathActuator PointActuator PointToPointActuator TorqueActuator ClutchedPathSpring "
    "McKibbenActuator"
)
IDLE = frozenset(_IDLE.split())
"""Actuators that exert no force while their control is zero."""

_GEOMETRY = (
    "Arrow Brick Cone Cylinder Ellipsoid FrameGeometry LineGeometry Mesh Sphere Torus ContactCylinder ContactEllipsoid "
    "ContactHalfSpace ContactMesh ContactSphere ContactTorus WrapCylinder WrapEllipsoid WrapSphere WrapTorus"
)
_PROBES = (
    "ActuatorForceProbe ActuatorPowerProbe Bhargava2004MuscleMetabolicsProbe Bhargava2004SmoothedMuscleMetabolics "
    "JointInternalPowerProbe SystemEnergyProbe Umberger2010MuscleMetabolicsProbe ConsoleReporter__Vec3_ "
    "ConsoleReporter__double_ StatesTrajectoryReporter TableReporter__Vec3_ TableReporter__Vector_ "
    "TableReporter__double_ TableSource__Vec3_ TableSource__double_"
)
INERT = frozenset(f"PhysicalOffsetFrame Station StationDefinedFrame Marker IMU {_GEOMETRY} {_PROBES}".split())
"""Types of components that exert no force and constrain nothing."""


class Unread(NamedTuple):
    """A component, or a property of a component, that is not read.

    `label` says what it is, `name` is the name of the component, and `kind` its type if the component is not read.
    """

    label: str
    name: str
    kind: str = ""


@cache
def registry() -> Mapping[str, Mapping[str, Mapping[str, str]]]:
    """Return the properties and their default values by base class and type; objects are ``:CLASS``."""
    data = json.loads((files("mbdkit_opensim") / "registry.json").read_text("utf-8"))
    return {kind: of for kind, of in data.items() if kind != "source"}


@cache
def defaults_of(kind: str) -> Mapping[str, str]:
    """Return the properties of a type in the registry with their default values; empty if it is not registered."""
    return next((of[kind] for of in registry().values() if kind in of), {})


def is_actuator(kind: str) -> bool:
    """Return whether a type is a muscle, another actuator or a controller, whose forces inverse dynamics computes."""
    return any(kind in registry()[base] for base in ("Actuator", "Muscle", "Controller"))


def is_off(element: Element) -> bool:
    """Return whether a component that may act is switched off."""
    return not all(flag_of(element, tag, default=True) for tag in ("appliesForce", "isEnforced", "enabled"))


def unread_in(element: Element) -> Iterator[Unread]:
    """Yield what is not read of a component of a type in `READ`, and of the objects in its properties."""
    kind, defaults = element.tag, defaults_of(element.tag)
    for part in element:
        tag = part.tag
        if tag in IGNORED[""] | IGNORED.get(kind, frozenset()):
            continue
        if tag in ("components", "ComponentSet"):
            yield from (_component(inner, kind) for inner in _objects(part) if _may_act(inner))
        elif tag in READ[kind]:
            objects = () if tag in SETS else _objects(part)
            yield from (unread for inner in objects if inner.tag in READ for unread in unread_in(inner))
            yield from (_component(inner, tag) for inner in part.iterfind("components/*") if _may_act(inner))
        elif not _is_default(part, defaults.get(tag)):
            yield Unread(f"<{tag}> of {kind}", name_of(element))


def _objects(part: Element) -> Iterator[Element]:
    """Yield the objects in a property, which may be one object, a set, or a list."""
    if part.tag in READ:
        yield part
    else:
        yield from part.iterfind("objects/*" if part.tag.endswith("Set") else "*")


def _component(element: Element, owner: str) -> Unread:
    return Unread(f"{element.tag} in {owner}", name_of(element), element.tag)


def _may_act(component: Element) -> bool:
    """Return whether a component outside of the sets that are read may change motions or forces."""
    return component.tag not in INERT | IDLE and not is_off(component)


def _is_default(part: Element, default: str | None) -> bool:
    """Return whether a property is empty or has its default value."""
    text = (part.text or "").strip()
    if len(part):
        kind = part.tag if default is not None and defaults_of(part.tag) else ""
        return bool(kind) and all(_is_default(inner, defaults_of(kind).get(inner.tag)) for inner in part)
    return not text or (default is not None and _values(text) == _values(default))


def _values(text: str) -> list[float | str]:
    return [_value(word) for word in text.lower().split()]


def _value(word: str) -> float | str:
    try:
        return word if math.isnan(float(word)) else float(word)
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get(word, word)
