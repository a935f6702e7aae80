"""MJCF and URDF files with attributes drawn from all of their schemas: each is refused in a sentence, doubtful by a
name, or has the masses and forces that MuJoCo computes.
"""

from __future__ import annotations

import copy
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError

from .attack import LONGEST_MESSAGE, Attack, in_child
from .robot_comparison import differences, mechanism

Random = np.random.Generator
Names = tuple[str, ...]

TRIES = 25
"""Number of values after which an attribute that MuJoCo refuses is kept as it is."""
SECTIONS = {"worldbody": 6, "default": 3, "actuator": 3, "option": 2, "compiler": 2, "equality": 2, "contact": 1,
            "tendon": 1, "sensor": 1}  # fmt: skip
"""Weights of the sections; all others have the weight 0.3."""
NUMBERS = (
    *(
        "0",
        "1",
        "-1",
        "0.3",
        "-0.4",
        "2",
        "3",
        "20",
        "0 0",
        "0.1 0.2",
        "-0.5 0.7",
        "0.2 0.9",
        "-1 -0.2",
        "1 2",
        "-30 40",
    ),
    *("0 0 0", "0.1 0.2 0.3", "0 0.3 0", "0 1 0", "0 -1 0", "1 0 0", "0.4 0 -0.2", "0.2 0.1 0.3", "5 2 1", "0 0 -3"),
    *("0 1 0 0.5", "0 1 0 30", "0.9 0 0.3 0", "1 0 0 0", "0.2 0.2 0.2 1", "0.5 0.25 1.5 1 1", "0 0 0 0.3 0 0.4"),
    *(
        "1 0 0.3 0 1 0",
        "0.02 0.02 0.03 0 0.003 0",
        "0 1 0 0 0 1 0",
        "0 0 0.1 1 0 0 0",
        "1 0 0 0 0 0 0 0 0 0",
        "1e400",
        "x",
    ),
)
WORDS = (
    *("true", "false", "auto", "enable", "disable", "none", "degree", "radian", "xyz", "XYZ", "zyx", "zyY", "local"),
    *("hinge", "slide", "ball", "free", "box", "sphere", "capsule", "cylinder", "ellipsoid", "plane", "mesh", "sdf"),
    *("fixed", "affine", "muscle", "integrator", "filter", "filterexact", "user", "pid", "dcmotor", "so3"),
    *(
        "Euler",
        "RK4",
        "implicit",
        "implicitfast",
        "discrete",
        "elliptic",
        "dense",
        "PGS",
        "CG",
        "never",
        "allowed",
        "init",
    ),
    *("revolute", "continuous", "prismatic", "floating", "planar"),
    *("zoh", "linear", "cubic", "pos", "vel", "warning", "merge", "textures", "shell", "convex"),
)
NAMES = ("b0", "b1", "b2", "j0", "j1", "s0", "s1", "g0", "mesh0", "soft", "world", "rope", "servo", "nobody", "base")
SEEDS: dict[str, dict[str, str]] = {
    "adhesion": {"body": "b0", "ctrlrange": "0 1"},
    "connect": {"body1": "b0", "anchor": "0 0 0.1"},
    "weld": {"body1": "b0"},
    "exclude": {"body1": "b0", "body2": "b1"},
    "pair": {"geom1": "g0", "geom2": "g1"},
    "site": {"site": "s0"},
    "geom": {"size": "0.1"},
    "inertial": {"pos": "0 0 0", "mass": "1", "diaginertia": "1 1 1"},
    "jointpos": {"joint": "j0"},
    "key": {"time": "1"},
    "numeric": {"name": "n", "data": "1"},
} | {
    name: {"joint": "j0"}
    for name in (
        "motor",
        "general",
        "position",
        "velocity",
        "damper",
        "muscle",
        "intvelocity",
        "pid",
        "dcmotor",
        "cylinder",
    )
}
"""Attributes that elements need."""


@cache
def mjcf_schema() -> list[tuple[Names, str]]:
    """Return all attributes of MJCF, with the path of their element, from MuJoCo's own schema."""
    import mujoco

    attributes: list[tuple[Names, str]] = []
    path: list[str] = []
    for line in mujoco.mj_printSchema(False, False).splitlines():
        if match := re.match(r"( *)(\S+) \(.\) ", line):
            level = len(match[1]) // 3
            path = [*path[:level], match[2].replace("(world)body", "body")]
        attributes += [(tuple(path[1:]), name) for name in line[30:].split()]
    return [(where, name) for where, name in attributes if where]


def _choose(random: Random, schema: list[tuple[Names, str]]) -> tuple[Names, str]:
    tops = sorted({path[0] for path, _ in schema})
    weights = np.array([SECTIONS.get("worldbody" if top == "body" else top, 0.3) for top in tops])
    top = str(random.choice(tops, p=weights / weights.sum()))
    paths = sorted({path for path, _ in schema if path[0] == top})
    path = paths[random.integers(len(paths))]
    names = [name for where, name in schema if where == path]
    return path, names[random.integers(len(names))]


def _element(root: ET.Element, path: Names, random: Random) -> ET.Element:
    """Return an element at a path of the schema, an existing one or a new one."""
    holder = root
    if path[0] == "body":
        bodies = list(root.iter("body"))
        holder, path = bodies[random.integers(len(bodies))], path[1:]
    for tag in path:
        there = holder.findall(tag)
        if there and random.random() < 0.75:
            holder = there[random.integers(len(there))]
        else:
            holder = ET.SubElement(holder, tag, SEEDS.get(tag, {}) if path[0] != "default" else {})
    return holder


def base_mjcf(random: Random) -> ET.Element:
    """Return a planar tree of bodies, which the importer reads without doubt."""
    root = ET.fromstring(
        '<mujoco><worldbody/><asset><mesh name="mesh0" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset></mujoco>'
    )
    if random.random() < 0.85:
        ET.SubElement(ET.SubElement(root, "option"), "flag", contact="disable")
    ET.SubElement(ET.SubElement(root, "default"), "default", {"class": "soft"})
    world = root.find("worldbody")
    bodies: list[ET.Element] = []
    for k in range(random.integers(1, 4)):
        holder = bodies[random.integers(len(bodies))] if bodies and random.random() < 0.7 else world
        x, z, angle = random.uniform(-0.4, 0.4, 3)
        body = ET.SubElement(holder, "body", name=f"b{k}", pos=f"{x:.3f} 0 {z:.3f}", euler=f"0 {40 * angle:.3f} 0")
        bodies.append(body)
        match random.integers(8):
            case 0:
                ET.SubElement(body, "joint", name=f"j{k}", type="slide", axis=str(random.choice(["1 0 0", "0 0 -1"])))
                del body.attrib["euler"]
            case 1 if holder is world:
                ET.SubElement(body, "freejoint", name=f"j{k}")
            case 2 if k:
                pass
            case _:
                ET.SubElement(body, "joint", name=f"j{k}", axis=f"0 {random.choice([-1, 1])} 0")
        joint = body.find("joint")
        if joint is not None and random.random() < 0.4:
            joint.set(str(random.choice(["stiffness", "damping", "frictionloss"])), "0.7")
        if random.random() < 0.3:
            ET.SubElement(body, "inertial", pos="0.1 0 -0.1", mass="1.3", diaginertia="0.02 0.03 0.025")
        for _ in range(random.integers(1, 3)):
            shape = [{"type": "box", "size": "0.1 0.05 0.2"},
                     {"type": "capsule", "size": "0.03", "fromto": "0 0 0 0.1 0 -.4"},
                     {"type": "cylinder", "size": "0.05 0.1"}, {"type": "ellipsoid", "size": "0.1 0.2 0.15"},
                     {"size": "0.1", "pos": "0.1 0 0.1"}][random.integers(5)]  # fmt: skip
            ET.SubElement(body, "geom", shape, name=f"g{len(list(root.iter('geom')))}")
        ET.SubElement(body, "site", name=f"s{k}")
    if random.random() < 0.3:
        ET.SubElement(ET.SubElement(root, "actuator"), "motor", joint="j0", name="servo")
    if len(bodies) > 1 and random.random() < 0.2:
        ET.SubElement(ET.SubElement(root, "equality"), "connect", body1="b0", body2="b1", anchor="0.1 0 0.2")
    return root


def _accepted(xml: str) -> Any:
    """Return the model that MuJoCo makes of a file, or None."""
    import mujoco

    mujoco.set_mju_user_warning(lambda text: None)  # otherwise, MuJoCo writes a log file into the current folder
    try:
        return mujoco.MjModel.from_xml_string(xml)
    except (ValueError, RuntimeError, mujoco.FatalError):
        return None


def _ours(kind: str, file: Path) -> tuple[Any, list[str]]:
    """Return the mechanism of a file, or None if it is refused, and what did not hold."""
    try:
        return mechanism(kind, str(file)), []
    except SpecError as error:
        long = len(str(error)) > LONGEST_MESSAGE
        return None, [f"the message has {len(str(error))} characters"] if long else []
    except Exception as error:
        return None, [f"{type(error).__name__}: {str(error)[:300]}"]


def _in_time(kind: str, attempt: Callable[[Random, Path], list[str]]) -> Callable[[Random, Path], list[str]]:
    """Return an attack in a process of its own, because MuJoCo 4.0.0 does not end for some actuators. Such files are
    read by mbdkit only.
    """

    def case(random: Random, folder: Path) -> list[str]:
        file = folder / f"model.{kind}"
        ending = in_child(attempt, random, file, seconds=10)
        if ending.exit_status is None and file.exists():
            ending = in_child(lambda: _ours(kind, file)[1])
        crashed = [f"it ended with {ending.exit_status}: {ending.errors[-900:]}"] if ending.exit_status else []
        return [*(ending.value or ()), *crashed] if file.exists() else []

    return case


def _mjcf(random: Random, file: Path) -> list[str]:
    def change(root: ET.Element) -> str:
        path, name = _choose(random, mjcf_schema())
        return _set(_element(root, path, random), name, "/".join(path), random)

    root, chosen = _changed(base_mjcf(random), change, lambda xml: xml, random)
    file.write_text(ET.tostring(root, encoding="unicode"))
    return [f"{', '.join(chosen)}: {problem}" for problem in _judge("mjcf", file, file.read_text(), random)]


def _set(element: ET.Element, name: str, where: str, random: Random) -> str:
    """Set an attribute to a drawn value, and return what was set."""
    pool = (NUMBERS, WORDS, NAMES)[random.choice(3, p=[0.5, 0.3, 0.2])]
    element.set(name, pool[random.integers(len(pool))])
    return f"{where} {name}={element.get(name)!r}"


def _changed(
    root: ET.Element, change: Callable[[ET.Element], str], for_mujoco: Callable[[str], str], random: Random
) -> tuple[ET.Element, list[str]]:
    """Return a file with one to three changes, and what they are: changes that MuJoCo accepts, and some others."""
    chosen: list[str] = []
    for _ in range(int(random.choice([1, 2, 3], p=[0.6, 0.25, 0.15]))):
        for attempt in range(TRIES):
            copied = copy.deepcopy(root)
            what = change(copied)
            is_kept = attempt == TRIES - 1 and random.random() < 0.2
            if is_kept or _accepted(for_mujoco(ET.tostring(copied, encoding="unicode"))) is not None:
                root = copied
                chosen.append(what)
                break
    return root, chosen


def base_urdf(random: Random) -> ET.Element:
    """Return a planar robot, which the importer reads without doubt."""
    root = ET.Element("robot", name="robot")
    ET.SubElement(root, "link", name="base")
    for k in range(random.integers(1, 4)):
        link = ET.SubElement(root, "link", name=f"b{k}")
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz="0.1 0 -0.2", rpy="0 0.3 0")
        ET.SubElement(inertial, "mass", value="1.3")
        inertia = {"ixx": "0.02", "iyy": "0.03", "izz": "0.025", "ixy": "0", "ixz": "0.002", "iyz": "0"}
        ET.SubElement(inertial, "inertia", inertia)
        kind = str(random.choice(["continuous", "revolute", "prismatic", "fixed"], p=[0.45, 0.25, 0.15, 0.15]))
        joint = ET.SubElement(root, "joint", name=f"j{k}", type=kind)
        x, z, angle = random.uniform(-0.4, 0.4, 3) * (1.0, 1.0, 0.0 if kind == "prismatic" else 1.0)
        ET.SubElement(joint, "origin", xyz=f"{x:.3f} 0 {z:.3f}", rpy=f"0 {angle:.3f} 0")
        ET.SubElement(joint, "parent", link=f"b{random.integers(k)}" if k and random.random() < 0.7 else "base")
        ET.SubElement(joint, "child", link=f"b{k}")
        ET.SubElement(joint, "axis", xyz="1 0 0" if kind == "prismatic" else f"0 {random.choice([-1, 1])} 0")
        if kind in ("revolute", "prismatic"):
            ET.SubElement(joint, "limit", lower="-0.5", upper="0.7", effort="3", velocity="2")
        if random.random() < 0.4:
            ET.SubElement(joint, "dynamics", {str(random.choice(["damping", "friction"])): "0.7"})
    return root


URDF = {
    "robot": "name version", "link": "name type", "inertial/origin": "xyz rpy quat_xyzw", "inertial/mass": "value",
    "inertial/inertia": "ixx ixy ixz iyy iyz izz", "visual/geometry/sphere": "radius", "visual": "name",
    "collision/geometry/sphere": "radius", "collision/geometry/box": "size", "joint": "name type",
    "joint/origin": "xyz rpy quat_xyzw", "joint/parent": "link", "joint/child": "link", "joint/axis": "xyz",
    "joint/calibration": "reference_position rising falling", "joint/dynamics": "damping friction",
    "joint/limit": "lower upper effort velocity", "joint/mimic": "joint multiplier offset",
    "joint/safety_controller": "soft_lower_limit soft_upper_limit k_position k_velocity", "material": "name",
    "transmission": "name type", "mujoco/option": "gravity density", "mujoco/compiler": "boundmass balanceinertia",
    "gazebo": "reference", "gazebo/turnGravityOff": "value",
}  # fmt: skip
"""Attributes by element: those of `urdf.xsd` of urdfdom, and extensions of Gazebo and MuJoCo."""


def _urdf(random: Random, file: Path) -> list[str]:
    def change(root: ET.Element) -> str:
        path = list(URDF)[random.integers(len(URDF))]
        names = URDF[path].split()
        tags = path.split("/")
        holder = root
        if tags[0] in ("joint", "link", "inertial", "visual", "collision"):
            many = root.findall("joint" if tags[0] == "joint" else "link")
            holder = many[random.integers(len(many))]
            tags = tags[tags[0] in ("joint", "link") :]
        for tag in tags if path != "robot" else ():
            there = holder.find(tag)
            holder = ET.SubElement(holder, tag) if there is None or random.random() < 0.1 else there
        return _set(holder, names[random.integers(len(names))], path, random)

    def for_mujoco(xml: str) -> str:
        return xml.replace("<link", '<mujoco><compiler fusestatic="false"/></mujoco><link', 1)

    root, chosen = _changed(base_urdf(random), change, for_mujoco, random)
    xml = ET.tostring(root, encoding="unicode")
    file.write_text(xml)
    return [f"{', '.join(chosen)}: {problem}" for problem in _judge("urdf", file, for_mujoco(xml), random)]


def _judge(kind: str, file: Path, xml: str, random: Random) -> list[str]:
    ours, problems = _ours(kind, file)
    theirs = _accepted(xml)
    if ours is None or theirs is None or ours.left_out:
        return problems
    return differences(theirs, kind, str(file), random)


ATTACKS = (
    Attack(
        "mjcf",
        "MJCF files are refused, doubtful by a name, or as in MuJoCo",
        1_500,
        _in_time("mjcf", _mjcf),
        ("mujoco", "mbdkit_robots"),
    ),
    Attack(
        "urdf",
        "URDF files are refused, doubtful by a name, or as in MuJoCo",
        500,
        _in_time("urdf", _urdf),
        ("mujoco", "mbdkit_robots"),
    ),
)
