"""Read an MJCF file: bodies at the zero position, joints, and equality constraints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element

import numpy as np

from mbdkit_robots.documents import about, number, numbers, read_xml, unit
from mbdkit_robots.planar import GROUND, Closure, Link, Part, SpatialModel, refused
from mbdkit_robots.shapes import volume_and_inertia

LEFT_OUT = ("sensor", "keyframe")
"""Sections that are ignored, with a warning."""
LACKING = {"tendon": "tendons", "deformable": "deformable objects"}
"""Sections that are ignored although they change the motion, and words for their elements."""
WITHOUT_FORCE = ("motor", "damper", "adhesion")
"""Actuators that exert no force while their control is zero."""
REFUSED = ("balanceinertia", "boundmass", "boundinertia", "settotalmass", "strippath", "inertiagrouprange")
"""Attributes of <compiler> that are rejected, because they would change masses."""
MACROS = ("frame", "replicate", "composite", "flexcomp", "attach")
"""Elements that stand for bodies or place them."""
FLAGS = ("gravity", "passive", "spring", "damper", "frictionloss", "limit", "equality", "constraint")
"""Flags that are rejected, because they would switch off forces or constraints."""


def read_mjcf(file: str) -> SpatialModel:
    """Return the model of an MJCF file; raise SpecError if the file contains something that influences the motion but
    cannot be read.
    """
    return _Reader(read_xml(file, "mujoco")).model


class _Reader:
    """Reads the bodies of a file recursively, starting with the world."""

    def __init__(self, root: Element):
        self.root, self.compiler = root, root.find("compiler")
        self.model = SpatialModel(root.get("model", "mujoco"))
        self.model.gravity = numbers(root.find("option"), "gravity", "0 0 -9.81", 3)
        for name in REFUSED:
            if self.compiler is not None and self.compiler.get(name) not in (None, "false", "0", "-1"):
                raise refused(f"{name} of <compiler> is not read")
        if next(root.iter("include"), None) is not None:
            raise refused("<include> is not read; save the model as one file, as MuJoCo's mj_saveLastXML does")
        for name in FLAGS:
            if any(flag.get(name) == "disable" for flag in root.iterfind("option/flag")):
                raise refused(f'the flag {name}="disable" is not read; change the model instead')
        self.defaults: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        self.geoms: dict[str, list[Element]] = {}
        for default in root.iterfind("default"):
            self._read_defaults(default, "main", {})
        self.places: dict[str, tuple[np.ndarray, np.ndarray]] = {GROUND: (np.eye(3), np.zeros(3))}
        world = root.find("worldbody")
        if world is None:
            raise refused("the file has no <worldbody>")
        self._refuse_macros(world)
        self.geoms[GROUND] = [self._with_defaults(one, "main") for one in world.iterfind("geom")]
        for body in world.iterfind("body"):
            self._add_body(body, GROUND, "main")
        for equality in root.iterfind("equality"):
            for one in equality:
                self._add_closure(one)
        self._leave_out()

    def _leave_out(self) -> None:
        """Note the elements that are ignored, and those of them that change the motion."""
        for tag in LEFT_OUT:
            for one in self.root.iterfind(f"{tag}/*"):
                self.model.leave_out(f"elements of <{tag}>", one.get("name", one.tag))
        for tag, words in LACKING.items():
            for one in self.root.iterfind(f"{tag}/*"):
                self.model.leave_out(words, one.get("name", one.tag), acts=True)
        for one in self.root.iterfind("actuator/*"):
            given = self._with_defaults(one, "main")
            is_idle = one.tag in WITHOUT_FORCE or (one.tag == "general" and given.get("biastype", "none") == "none")
            words = "actuators without control" if is_idle else "actuators that act without control"
            self.model.leave_out(words, one.get("name", one.tag), acts=not is_idle)
        for one in self.root.iterfind("contact/pair"):
            self.model.leave_out("contacts", one.get("name", "pair"), acts=True)
        if all(flag.get("contact") != "disable" for flag in self.root.iterfind("option/flag")):
            self._leave_out_contacts()
        option = self.root.find("option")
        for name in ("density", "viscosity"):
            if number(option, name, 0.0):
                self.model.leave_out("forces of the surrounding fluid", name, acts=True)

    def _leave_out_contacts(self) -> None:
        """Note the geoms that could collide: those of moving bodies with each other, and with geoms that are fixed."""
        fixed = {GROUND}
        for link in self.model.links:
            if link.kind == "fixed" and link.parent in fixed:
                fixed.add(link.child)
        masks: dict[bool, list[tuple[int, int]]] = {True: [], False: []}
        for body, geoms in self.geoms.items():
            for one in geoms:
                mask = int(number(one, "contype", 1.0)), int(number(one, "conaffinity", 1.0))
                masks[body in fixed].append(mask)
                if any(mask) and body not in fixed:
                    label = one.get("name", f"{one.get('type', 'sphere')} of {body}")
                    self.model.leave_out("contacts of geoms", label)
        for body in fixed:
            for one in self.geoms.get(body, ()):
                kind, affinity = int(number(one, "contype", 1.0)), int(number(one, "conaffinity", 1.0))
                if any(kind & other[1] or affinity & other[0] for other in masks[False]):
                    label = one.get("name", f"{one.get('type', 'sphere')} of {'the world' if body == GROUND else body}")
                    self.model.leave_out("contacts with fixed geoms", label, acts=True)

    def _refuse_macros(self, body: Element) -> None:
        for one in body:
            if one.tag in MACROS:
                raise refused(f"<{one.tag}> is not read; save the model as one file, as MuJoCo's mj_saveLastXML does")

    def _read_defaults(self, default: Element, name: str, above: Mapping[str, dict[str, str]]) -> None:
        own = {tag: dict(values) for tag, values in above.items()}
        for one in default:
            if one.tag != "default":
                own[one.tag] = own.get(one.tag, {}) | dict(one.attrib)
        self.defaults[name] = own
        for inner in default.iterfind("default"):
            self._read_defaults(inner, inner.get("class", name), own)

    def _with_defaults(self, element: Element, childclass: str) -> Element:
        """Return an element with the attributes of its default class."""
        values = self.defaults.get(element.get("class", childclass), {}).get(element.tag, {})
        return Element(element.tag, values | dict(element.attrib))

    def _angle(self, value: float) -> float:
        is_degree = self.compiler is None or self.compiler.get("angle", "degree") == "degree"
        return math.radians(value) if is_degree else value

    def _rotation(self, element: Element) -> np.ndarray:
        """Return the matrix (3, 3) of the orientation of an element."""
        if element.get("quat"):
            w, x, y, z = unit(numbers(element, "quat", "", 4), "a quaternion")
            return np.array([
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ])  # fmt: skip
        if element.get("euler"):
            order = "xyz" if self.compiler is None else self.compiler.get("eulerseq", "xyz")
            turned = np.eye(3)
            for axis, angle in zip(order, numbers(element, "euler", "", 3).tolist(), strict=True):
                turn = about("xyz".index(axis.lower()), self._angle(angle))
                turned = turned @ turn if axis.islower() else turn @ turned
            return turned
        if element.get("axisangle"):
            *axis, angle = numbers(element, "axisangle", "", 4).tolist()
            return _about_axis(unit(np.array(axis), "an axis"), self._angle(angle))
        for name in ("xyaxes", "zaxis"):
            if element.get(name):
                raise refused(f"{name} of <{element.tag}> is not read; give quat or euler")
        return np.eye(3)

    def _add_body(self, body: Element, parent: str, childclass: str) -> None:
        name = body.get("name")
        if not name:
            raise refused("a <body> has no name")
        if name in self.places:
            raise refused(f"there are two bodies with the name '{name}'")
        self._refuse_macros(body)
        if number(body, "gravcomp", 0.0):
            self.model.leave_out("compensations of gravity", name, acts=True)
        childclass = body.get("childclass", childclass)
        self.geoms[name] = [self._with_defaults(one, childclass) for one in body.iterfind("geom")]
        turn, place = self.places[parent]
        here, turned = place + turn @ numbers(body, "pos", "0 0 0", 3), turn @ self._rotation(body)
        self.places[name] = turned, here
        self.model.parts.append(self._part(name, body))
        joints = [self._with_defaults(one, childclass) for one in body.iterfind("joint")]
        free = body.find("freejoint") is not None or any(one.get("type") == "free" for one in joints)
        if len(joints) > 1:
            raise refused(
                f"body '{name}' has {len(joints)} joints; give each direction a body with a mass, or use <freejoint>"
            )
        for one in joints if free else ():
            for attribute in ("damping", "armature", "frictionloss", "stiffness"):
                if number(one, attribute, 0.0):
                    self.model.leave_out(f"{attribute} of free joints", one.get("name", name), acts=True)
        if free or not joints:
            label = f"{name} to {parent}"
            self.model.links.append(Link(label, "free" if free else "fixed", parent, name, here, np.zeros(3)))
        else:
            self.model.links.append(self._joint(joints[0], parent, name, here, turned))
        for inner in body.iterfind("body"):
            self._add_body(inner, name, childclass)

    def _joint(self, joint: Element, parent: str, child: str, here: np.ndarray, turned: np.ndarray) -> Link:
        name, kind = joint.get("name", f"{child} joint"), joint.get("type", "hinge")
        if kind not in ("hinge", "slide"):
            raise refused(f"joint '{name}' has the type '{kind}', which is not read")
        scale = self._angle(1.0) if kind == "hinge" else 1.0
        ref, rest = number(joint, "ref", 0.0) * scale, number(joint, "springref", 0.0) * scale
        if ref:
            raise refused(f"joint '{name}' has a reference that is not 0 (ref), which is not read")
        axis = turned @ unit(numbers(joint, "axis", "0 0 1", 3), f"the axis of joint '{name}'")
        point = here + turned @ numbers(joint, "pos", "0 0 0", 3)
        limits = None
        if joint.get("range") and joint.get("limited") != "false":
            self.model.leave_out("limits of joints", name)
            low, high = (scale * numbers(joint, "range", "", 2)).tolist()
            limits = low, high
        if np.any(numbers(joint, "springdamper", "0")):
            raise refused(f"joint '{name}' has a springdamper, which is not read; give stiffness and damping")
        values = {key: number(joint, key, 0.0) for key in ("stiffness", "damping", "armature")}
        friction = number(joint, "frictionloss", 0.0)
        return Link(
            name, "turn" if kind == "hinge" else "slide", parent, child, point, axis, **values,
            rest=rest, friction=friction, limits=limits,
        )  # fmt: skip

    def _part(self, name: str, body: Element) -> Part:
        turned, here = self.places[name]
        inertial = body.find("inertial")
        if inertial is not None and (self.compiler is None or self.compiler.get("inertiafromgeom") != "true"):
            own = turned @ self._rotation(inertial)
            if inertial.get("fullinertia"):
                xx, yy, zz, xy, xz, yz = numbers(inertial, "fullinertia", "", 6)
                tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            else:
                tensor = np.diag(numbers(inertial, "diaginertia", "0 0 0", 3))
            center = here + turned @ numbers(inertial, "pos", "0 0 0", 3)
            return Part(name, number(inertial, "mass", 0.0), center, own @ tensor @ own.T)
        solids = [found for one in self.geoms[name] if (found := self._solid(one, name, here, turned)).mass > 0]
        mass = sum(one.mass for one in solids)
        if not mass:
            return Part(name, 0.0, here, np.zeros((3, 3)))
        center = np.sum([one.mass * one.center for one in solids], axis=0) / mass
        tensor = np.zeros((3, 3))
        for one in solids:
            arm = one.center - center
            tensor = tensor + one.inertia + one.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return Part(name, mass, center, tensor)

    def _solid(self, geom: Element, body: str, here: np.ndarray, turned: np.ndarray) -> Part:
        """Return the mass of a geom at the zero position."""
        kind, size = geom.get("type", "sphere"), numbers(geom, "size", "0")
        place, own = numbers(geom, "pos", "0 0 0", 3), self._rotation(geom)
        if geom.get("fromto"):
            ends = numbers(geom, "fromto", "", 6)
            along = ends[3:] - ends[:3]
            place, own = (ends[:3] + ends[3:]) / 2, _z_along(unit(along, "fromto"))
            size = np.array([size[0], float(np.linalg.norm(along)) / 2])
        found = volume_and_inertia(kind, size)
        if found is None:
            if number(geom, "mass", math.nan if geom.get("mass") else 1.0) == 0.0:
                return Part(body, 0.0, here, np.zeros((3, 3)))
            raise refused(f"body '{body}' has a geom of type '{kind}', whose mass is not computed; give <inertial>")
        volume, moments = found
        mass = number(geom, "mass", 0.0) if geom.get("mass") else number(geom, "density", 1000.0) * volume
        tensor = turned @ own @ np.diag(moments * mass / volume) @ (turned @ own).T
        return Part(body, mass, here + turned @ place, tensor)

    def _add_closure(self, one: Element) -> None:
        """Add an equality constraint. MuJoCo satisfies such constraints approximately, mbdkit exactly."""
        if one.get("active") == "false":
            return
        first, second = one.get("body1", ""), one.get("body2") or GROUND
        name = one.get("name", f"{first} to {second}")
        if one.tag not in ("connect", "weld") or first not in self.places or second not in self.places:
            raise refused(f"the equality <{one.tag}> '{name}' is not read; connect and weld of two bodies are")
        if one.tag == "weld" and one.get("relpose"):
            raise refused(f"the weld '{name}' has a relpose, which is not read")
        turned, here = self.places[first]
        anchor = here + turned @ numbers(one, "anchor", "0 0 0", 3)
        self.model.closures.append(Closure(name, one.tag, (first, second), anchor))  # type: ignore[arg-type]


def _about_axis(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def _z_along(direction: np.ndarray) -> np.ndarray:
    """Return a rotation (3, 3) that turns the z axis into a direction."""
    axis = np.cross([0.0, 0.0, 1.0], direction)
    size = float(np.linalg.norm(axis))
    if size < 1e-12:
        return np.eye(3) if direction[2] > 0 else about(0, math.pi)
    return _about_axis(axis / size, math.atan2(size, float(direction[2])))
