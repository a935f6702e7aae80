"""Read a URDF file: links at the zero position, and joints."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import yaml

from mbdkit_robots.documents import about, number, numbers, read_xml, unit
from mbdkit_robots.planar import GROUND, Follower, Link, LinkKind, Part, SpatialModel, refused
from mbdkit_robots.trees import leave_out_contacts

KINDS: dict[str, LinkKind] = {
    "revolute": "turn", "continuous": "turn", "prismatic": "slide", "fixed": "fixed", "floating": "free"
}  # fmt: skip
_NAMES = yaml.safe_load(Path(__file__).with_name("urdf_schema.yaml").read_text("utf-8"))
NOTED: dict[str, str] = _NAMES["noted"]


def read_urdf(file: str, *, floating: bool) -> SpatialModel:
    """Return the model of a URDF file.

    Parameters
    ----------
    floating
        Whether the root link moves freely; it is fixed to the ground otherwise.

    Raises
    ------
    SpecError
        If the file is not a tree of links, or has joints that mbdkit does not have.
    """
    robot = read_xml(file, "robot")
    model = SpatialModel(robot.get("name", "robot"))
    links: dict[str, Element] = {}
    for link in robot.iterfind("link"):
        if _name(link) in links:
            raise refused(f"there are two links with the name '{_name(link)}'")
        links[_name(link)] = link
    below: dict[str, list[Element]] = {name: [] for name in links}
    parents: dict[str, str] = {}
    for joint in robot.iterfind("joint"):
        parent, child = (_link(joint, tag, links) for tag in ("parent", "child"))
        if child in parents:
            raise refused(f"link '{child}' is the child of two joints")
        parents[child] = parent
        below[parent].append(joint)
    roots = [name for name in links if name not in parents]
    if len(roots) != 1:
        raise refused(f"the links should form one tree, but {len(roots)} of them have no parent")
    if GROUND in links and roots != [GROUND]:
        raise refused(f"a link that is not the root has the name '{GROUND}', which mbdkit uses for the ground")
    for tag, words in NOTED.items():
        for element in robot.iterfind(tag):
            model.leave_out(words, element.get("name", tag))
    for element in robot.iterfind("gazebo"):
        acts = any(inner.tag not in _names("without effect", "gazebo") for inner in element)
        model.leave_out("extensions of Gazebo", element.get("reference", "gazebo"), acts=acts)
    _leave_out_unknown(model, robot, "the file")
    root = roots[0]
    _add_part(model, links[root], np.eye(3), np.zeros(3), is_fixed=not floating)
    model.links.append(
        Link(f"{root} to ground", "free" if floating else "fixed", GROUND, root, np.zeros(3), np.zeros(3))
    )
    pending = [(root, np.eye(3), np.zeros(3))]
    while pending:
        name, turn, place = pending.pop(0)
        for joint in below[name]:
            frame = joint.find("origin")
            here = place + turn @ numbers(frame, "xyz", "0 0 0", 3)
            turned = turn @ _rotation(frame)
            child = _link(joint, "child", links)
            _add_part(model, links[child], turned, here)
            model.links.append(_joint(model, joint, name, child, here, turned))
            pending.append((child, turned, here))
    if len(model.parts) < len(links):
        raise refused("the links should form one tree, but some of them form a closed chain")
    shapes = {
        name: [(f"collision shape of {name}", 1, 1) for _ in link.iterfind("collision")] for name, link in links.items()
    }
    leave_out_contacts(model, shapes)
    return model


def _names(kind: str, tag: str) -> list[str]:
    """Return the attributes or elements of a kind in ``urdf_schema.yaml`` that an element may have."""
    return str(_NAMES[kind].get(tag, "")).split()


def _leave_out_unknown(model: SpatialModel, element: Element, label: str) -> None:
    """Note the attributes and elements that may change the motion but are not understood."""
    attributes, elements, silent = (_names(kind, element.tag) for kind in ("attributes", "elements", "without effect"))
    for name in element.attrib:
        if name not in attributes:
            model.leave_out(f"{name} of <{element.tag}>", label, acts=True)
    silent += [*NOTED, "gazebo"] if element.tag == "robot" else []
    for inner in element:
        if inner.tag in elements:
            if inner.tag not in ("link", "joint", "collision") and len(element.findall(inner.tag)) > 1:
                raise refused(f"<{element.tag}> of {label} has several elements <{inner.tag}>")
            if inner.tag != "collision":
                _leave_out_unknown(model, inner, inner.get("name", label))
        elif inner.tag not in silent:
            model.leave_out(f"elements <{inner.tag}>", label, acts=True)


def _joint(model: SpatialModel, joint: Element, parent: str, child: str, here: np.ndarray, turned: np.ndarray) -> Link:
    name, kind = _name(joint), joint.get("type", "")
    if kind not in KINDS:
        raise refused(f"joint '{name}' has the type '{kind}', which is not read")
    if (mimic := joint.find("mimic")) is not None:
        coefficients = number(mimic, "offset", 0.0), number(mimic, "multiplier", 1.0)
        model.followers.append(Follower(f"{name} mimic", name, mimic.get("joint", ""), coefficients))
    limits = None
    if (limit := joint.find("limit")) is not None and kind in ("revolute", "prismatic"):
        model.leave_out("limits of joints", name)
        limits = number(limit, "lower", 0.0), number(limit, "upper", 0.0)
    dynamics = joint.find("dynamics")
    axis = turned @ unit(numbers(joint.find("axis"), "xyz", "1 0 0", 3), f"the axis of joint '{name}'")
    damping, friction = number(dynamics, "damping", 0.0), number(dynamics, "friction", 0.0)
    if kind == "floating" and (damping or friction):
        model.leave_out("dynamics of floating joints", name, acts=True)
    return Link(name, KINDS[kind], parent, child, here, axis, damping=damping, friction=friction, limits=limits)


def _add_part(
    model: SpatialModel, link: Element, turn: np.ndarray, values: np.ndarray, *, is_fixed: bool = False
) -> None:
    """Add a link whose frame has the position `place` (3,) and the orientation `turn` (3, 3). A link fixed to the
    ground is added without mass.
    """
    name, inertial = _name(link), link.find("inertial")
    if inertial is None or is_fixed:
        model.parts.append(Part(name, 0.0, values, np.zeros((3, 3))))
        return
    frame, inertia = inertial.find("origin"), inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (number(inertia, f"i{pair}", 0.0) for pair in ("xx", "xy", "xz", "yy", "yz", "zz"))
    own = turn @ _rotation(frame)
    tensor = own @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ own.T
    mass = number(inertial.find("mass"), "value", 0.0)
    model.parts.append(Part(name, mass, values + turn @ numbers(frame, "xyz", "0 0 0", 3), tensor))


def _rotation(frame: Element | None) -> np.ndarray:
    roll, pitch, yaw = numbers(frame, "rpy", "0 0 0", 3)
    return about(2, yaw) @ about(1, pitch) @ about(0, roll)


def _name(element: Element) -> str:
    name = element.get("name")
    if not name:
        raise refused(f"a <{element.tag}> has no name")
    return name


def _link(joint: Element, tag: str, links: dict[str, Element]) -> str:
    result = joint.find(tag)
    name = "" if result is None else result.get("link", "")
    if name not in links:
        raise refused(f"joint '{_name(joint)}' has no <{tag}> among the links: '{name}'")
    return name
