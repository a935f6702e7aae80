"""A planar mechanism with contacts in MuJoCo: the same bodies, pins, torsion springs, shapes and friction.

Bodies of a pin hang from its first body; all others move freely in the plane. Positions x, y of mbdkit are x, z of
MuJoCo. Polygons must be rectangles about the centre of mass, and lines those of the ground.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

DEPTH = 0.05  # half, of boxes [m]


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _shapes(contacts: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every shape once, with its body."""
    seen = []
    for contact in contacts.values():
        pairs = (
            contact["shapes"].items() if "among" in contact else zip(contact["bodies"], contact["shapes"], strict=True)
        )
        for pair in pairs:
            if pair not in seen:
                seen.append(pair)
                yield pair


def mujoco_model(
    model: dict[str, Any], step: float, integrator: str, solref: tuple[float, float], solimp: tuple[float, ...]
) -> tuple[Any, Any]:
    """Return an `MjModel` and its `MjData` at the start.

    Parameters
    ----------
    model
        Data of the model `mechanism`.
    step
        Time step [s].
    integrator
        Name in MuJoCo, such as ``implicitfast``.
    solref, solimp
        Parameters of all contacts: time constant [s] and damping ratio; impedances and their width.
    """
    import mujoco

    bodies, contacts = model["bodies"], model["contacts"]
    joints, springs = model.get("joints", {}), model.get("forces", {})
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    ET.SubElement(root, "option", integrator=integrator, timestep=repr(step), gravity="0 0 -9.81")
    world = ET.SubElement(root, "worldbody")
    elements = {"ground": world}
    start: list[tuple[float, float]] = []  # position and velocity by coordinate, in the order of MuJoCo
    parent = {joint["bodies"][1]: (name, joint) for name, joint in joints.items()}

    def add(name: str) -> None:
        body = bodies[name]
        angle, rate = body.get("angle", 0.0), body.get("angular_velocity", 0.0)
        at, v = body["position"], body.get("velocity", (0.0, 0.0))
        spring: dict[str, str] = {}
        if name in parent:
            label, joint = parent[name]
            above, points = joint["bodies"][0], joint["points"]
            offset, pin = np.subtract(*points), points[1]
            other = bodies.get(above, {})
            angle, rate = angle - other.get("angle", 0.0), rate - other.get("angular_velocity", 0.0)
            if label in springs:
                law = springs[label]
                spring = {
                    "stiffness": repr(law["stiffness"]),
                    "damping": repr(law["damping"]),
                    "springref": repr(law["free_angle"]),
                }
        else:
            above, offset, pin = "ground", np.zeros(2), (0.0, 0.0)
        element = ET.SubElement(elements[above], "body", name=name, pos=_text(offset[0], 0.0, offset[1]))
        inertia = body["inertia"]
        ET.SubElement(element, "inertial", pos="0 0 0", mass=repr(body["mass"]), diaginertia=_text(*[inertia] * 3))
        if name not in parent:
            for axis, x, speed in (("1 0 0", at[0], v[0]), ("0 0 1", at[1], v[1])):
                ET.SubElement(element, "joint", type="slide", axis=axis)
                start.append((x, speed))
        ET.SubElement(element, "joint", type="hinge", axis="0 -1 0", pos=_text(pin[0], 0.0, pin[1]), **spring)
        start.append((angle, rate))
        elements[name] = element
        for child, (_, joint) in parent.items():
            if joint["bodies"][0] == name:
                add(child)

    for name in bodies:
        if name not in parent or parent[name][1]["bodies"][0] == "ground":
            add(name)
    friction = repr(next(iter(contacts.values()))["friction"])
    collide = any("ground" not in contact.get("bodies", ()) for contact in contacts.values())
    common = {"friction": f"{friction} 0 0", "solref": _text(*solref), "solimp": _text(*solimp), "condim": "3"}
    for name, shape in _shapes(contacts):
        kind, given = next(iter(shape.items()))
        own = {"contype": str(2 * collide), "conaffinity": str(1 + 2 * collide)}
        if kind == "line":
            (x, y), (nx, ny) = given.get("point", (0.0, 0.0)), given["normal"]
            geometry = {"type": "plane", "size": "0 0 1", "pos": _text(x, 0.0, y), "zaxis": _text(nx, 0.0, ny)}
            own = {"contype": "1", "conaffinity": "0"}
        elif kind == "circle":
            x, y = given.get("center", (0.0, 0.0))
            geometry = {"type": "sphere", "size": repr(given["radius"]), "pos": _text(x, 0.0, y)}
        else:
            x, y = np.max(given, axis=0)
            geometry = {"type": "box", "size": _text(x, DEPTH, y)}
        ET.SubElement(elements[name], "geom", **geometry, **own, **common)
    built = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(built)
    data.qpos[:], data.qvel[:] = np.transpose(start)
    return built, data
