"""Converts models in the format of OpenSim 3 to that of OpenSim 4, which describes joints and points by frames.

The rules are those by which OpenSim 4 reads older files: the joint of a body becomes a member of `JointSet`, with one
frame on each of its two bodies.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from mbdkit import SpecError

INERTIAS = ("xx", "yy", "zz", "xy", "xz", "yz")
#: Properties of points of muscles that name coordinates; in the format of OpenSim 4, they begin with ``socket_``.
COORDINATES = ("coordinate", "x_coordinate", "y_coordinate", "z_coordinate")
GROUND = "ground"
#: Properties of a joint that describe its frames on the parent body and on the child body.
SIDES = (("parent_body", "location_in_parent", "orientation_in_parent"), ("", "location", "orientation"))


def as_format_4(model: Element) -> None:
    """Convert a model from the format of OpenSim 3 to that of OpenSim 4, in place.

    Raises
    ------
    SpecError
        If a joint is reversed.
    """
    SubElement(model, "Ground", name=GROUND)
    joints = SubElement(SubElement(model, "JointSet"), "objects")
    bodies = model.find("BodySet/objects")
    for body in list(bodies if bodies is not None else ()):
        held = body.find("Joint")
        if held is not None:
            joints.extend([_joint(joint, body.get("name", "")) for joint in held])
            body.remove(held)
        if body.get("name") == GROUND and bodies is not None:
            bodies.remove(body)
        elif body.find("inertia") is None:
            _add(body, "inertia", " ".join(body.findtext(f"inertia_{axes}") or "0" for axes in INERTIAS))
    for point in model.iter():
        if (body_name := point.findtext("body")) is not None and point.find("location") is not None:
            _add(point, "socket_parent_frame", _path(body_name.strip()))
        for tag in COORDINATES if "PathPoint" in point.tag else ():
            if (name := point.findtext(tag)) is not None:
                _add(point, f"socket_{tag}", name.strip())


def rename_switches(model: Element) -> None:
    """Replace `isDisabled`, as OpenSim 3 writes it, by the properties `appliesForce`, `isEnforced` and `enabled`."""
    for element in model.iter():
        if (switch := element.find("isDisabled")) is not None:
            switch.text = str((switch.text or "").strip().lower() not in ("true", "1"))
            kind = "isEnforced" if element.tag.endswith("Constraint") else "appliesForce"
            switch.tag = "enabled" if "Controller" in element.tag else kind


def _joint(joint: Element, child: str) -> Element:
    if (joint.findtext("reverse") or "false").strip().lower() == "true":
        raise SpecError(f"joint '{joint.get('name')}' is reversed, which is not read", key="model.file")
    frames = SubElement(joint, "frames")
    for (body, location, orientation), side in zip(SIDES, ("parent", "child"), strict=True):
        frame = SubElement(frames, "PhysicalOffsetFrame", name=f"{side}_offset")
        _add(frame, "socket_parent", _path((joint.findtext(body) or "").strip() if body else child))
        _add(frame, "translation", joint.findtext(location) or "0 0 0")
        _add(frame, "orientation", joint.findtext(orientation) or "0 0 0")
        _add(joint, f"socket_{side}_frame", f"{side}_offset")
    coordinates = SubElement(joint, "coordinates")
    for group in joint.findall("CoordinateSet"):
        coordinates.extend(group.iterfind("objects/Coordinate"))
        joint.remove(group)
    return joint


def _path(body: str) -> str:
    return f"/{GROUND}" if body == GROUND else f"/bodyset/{body}"


def _add(element: Element, tag: str, text: str) -> None:
    SubElement(element, tag).text = text
