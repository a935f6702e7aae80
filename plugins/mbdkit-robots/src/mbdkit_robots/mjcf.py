"""Read an MJCF file: bodies at the zero position, joints, and equality constraints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element

import numpy as np

from mbdkit.plugin import listed
from mbdkit_robots import mjcf_schema as schema
from mbdkit_robots.documents import about, keyword, number, numbers, read_xml, unit
from mbdkit_robots.planar import GROUND, Closure, Follower, Link, Part, SpatialModel, refused
from mbdkit_robots.shapes import SIZES, volume_and_inertia
from mbdkit_robots.trees import leave_out_contacts

#: Attributes of <compiler> that are rejected, because they would change masses.
REFUSED = ("balanceinertia", "boundmass", "boundinertia", "settotalmass", "inertiagrouprange")
#: Elements that stand for bodies or place them.
MACROS = ("frame", "replicate", "composite", "flexcomp", "attach")
#: Flags that are rejected, because they would switch off forces or constraints.
FLAGS = ("gravity", "passive", "spring", "damper", "frictionloss", "limit", "equality", "constraint")
BOOLEAN = ("false", "true")


def read_mjcf(file: str) -> SpatialModel:
    """Return the model of an MJCF file; raise SpecError if the file contains something that influences the motion but
    cannot be read.
    """
    return _MjcfReader(read_xml(file, "mujoco")).model


class _MjcfReader:
    def __init__(self, root: Element):
        self.root, self.model = root, SpatialModel(root.get("model", "mujoco"))
        if next(root.iter("include"), None) is not None:
            raise refused("<include> is not read; save the model as one file, as MuJoCo's mj_saveLastXML does")
        self.compiler, self.option, self.flag = (self._merged(path) for path in ("compiler", "option", "option/flag"))
        self.model.gravity = numbers(self.option, "gravity", "0 0 -9.81", 3)
        self._check_globals()
        self.defaults: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        for default in root.iterfind("default"):
            if default.get("class", "main") != "main":
                raise refused(f"the outermost <default> has the class '{default.get('class')}', which should be 'main'")
            self._read_defaults(default, "main", self.defaults["main"])
        self.geoms: dict[str, list[Element]] = {GROUND: []}
        self.places: dict[str, tuple[np.ndarray, np.ndarray]] = {GROUND: (np.eye(3), np.zeros(3))}
        worlds = root.findall("worldbody")
        if not worlds:
            raise refused("the file has no <worldbody>")
        for world in worlds:
            self._check_parts(world, "the world")
            self.geoms[GROUND] += [self._with_defaults(geom, "main") for geom in world.iterfind("geom")]
        for world in worlds:
            for body in world.iterfind("body"):
                self._add_body(body, GROUND, "main")
        for equality in root.iterfind("equality/*"):
            self._add_closure(equality)
        for name, geoms in self.geoms.items():
            for geom in geoms:
                schema.leave_out_attributes(self.model, geom, _label(geom, name))
        self._leave_out()

    def _merged(self, path: str) -> Element:
        """Return the sections of a name as one: MuJoCo reads them in their order, and later values replace earlier
        ones.
        """
        values: dict[str, str] = {}
        for section in self.root.iterfind(path):
            values |= section.attrib
        return Element(path.rpartition("/")[2], values)

    def _check_globals(self) -> None:
        for name in REFUSED:
            if self.compiler.get(name) not in (None, "false", "0", "-1"):
                raise refused(f"{name} of <compiler> is not read")
        for name in FLAGS:
            if self.flag.get(name) == "disable":
                raise refused(f'the flag {name}="disable" is not read; change the model instead')
        keyword(self.compiler, "coordinate", "local", ("local",))
        self.is_degree = keyword(self.compiler, "angle", "degree", ("degree", "radian")) == "degree"
        self.from_geoms = keyword(self.compiler, "inertiafromgeom", "auto", ("auto", *BOOLEAN))
        self.order = self.compiler.get("eulerseq", "xyz")
        if len(self.order) != 3 or set(self.order.lower()) - set("xyz"):
            raise refused(f'eulerseq="{self.order[:60]}" of <compiler> should have three of the letters xyzXYZ')
        for element in (self.compiler, self.option, self.flag):
            schema.leave_out_attributes(self.model, element, "the file")

    def _leave_out(self) -> None:
        known = (*schema.MODEL_SECTIONS, *schema.IDLE_SECTIONS, *schema.NOTED_SECTIONS, *schema.LACKING_SECTIONS)
        for section in self.root:
            if section.tag not in known:
                self.model.leave_out(f"elements <{section.tag}>", "the file", acts=True)
        for tag in schema.NOTED_SECTIONS:
            for element in self.root.iterfind(f"{tag}/*"):
                self.model.leave_out(f"elements of <{tag}>", element.get("name", element.tag))
        for tag, words in schema.LACKING_SECTIONS.items():
            for element in self.root.iterfind(f"{tag}/*"):
                self.model.leave_out(words, element.get("name", element.tag), acts=True)
        for actuator in self.root.iterfind("actuator/*"):
            self._leave_out_actuator(self._with_defaults(actuator, "main"))
        for name in ("density", "viscosity"):
            if number(self.option, name, 0.0):
                self.model.leave_out("forces of the surrounding fluid", name, acts=True)
        excluded = []
        for element in self.root.iterfind("contact/*"):
            if element.tag == "exclude":
                schema.leave_out_attributes(self.model, element, element.get("name", "exclude"))
                excluded.append(frozenset(_body(element, key) for key in ("body1", "body2")))
            else:
                self.model.leave_out("contacts", element.get("name", element.tag), acts=True)
        if self.flag.get("contact") != "disable":
            shapes = {
                name: [
                    (_label(geom, name), *(int(number(geom, key, 1.0)) for key in ("contype", "conaffinity")))
                    for geom in geoms
                ]
                for name, geoms in self.geoms.items()
            }
            with_parents = self.flag.get("filterparent") == "disable"
            leave_out_contacts(self.model, shapes, excluded, with_parents=with_parents)

    def _leave_out_actuator(self, actuator: Element) -> None:
        """Note an actuator, and whether it acts while its control is zero."""
        name, shortcut = actuator.get("name", actuator.tag), actuator.attrib.pop("", "general")
        is_idle = actuator.tag in schema.WITHOUT_FORCE or (
            actuator.tag == "general"
            and shortcut in ("general", *schema.WITHOUT_FORCE)
            and actuator.get("biastype", "none") == "none"
            and actuator.get("gaintype", "fixed") in ("fixed", "affine")
            and actuator.get("dyntype", "none") in ("none", "integrator", "filter", "filterexact")
            and _has_zero(actuator, "act")
        )
        is_idle = is_idle and _has_zero(actuator, "ctrl") and _has_zero(actuator, "force")
        words = "actuators without control" if is_idle else "actuators that act without control"
        self.model.leave_out(words, name, acts=not is_idle)
        for key in ("armature", "damping"):
            if np.any(numbers(actuator, key, "0")):
                self.model.leave_out(f"{key} of actuators", name, acts=True)
        if is_idle:
            schema.leave_out_attributes(self.model, actuator, name, "actuator")

    def _check_parts(self, body: Element, label: str) -> None:
        for part in body:
            if part.tag in MACROS:
                raise refused(f"<{part.tag}> is not read; save the model as one file, as MuJoCo's mj_saveLastXML does")
            if part.tag not in schema.BODY_PARTS:
                self.model.leave_out(f"elements <{part.tag}>", label, acts=True)
            elif part.tag == "geom":
                for inner in part:
                    self.model.leave_out(f"elements <{inner.tag}> of geoms", label, acts=True)

    def _read_defaults(self, default: Element, name: str, above: Mapping[str, dict[str, str]]) -> None:
        own = {tag: dict(values) for tag, values in above.items()}
        for element in default:
            if element.tag != "default":
                key = _key(element)
                own[key] = _inherit(element, own.get(key, {}))
        self.defaults[name] = own
        for inner in default.iterfind("default"):
            if inner.get("class", "") in ("", *self.defaults):
                raise refused(f"the class '{inner.get('class', '')}' of a <default> should have a name of its own")
            self._read_defaults(inner, inner.get("class", ""), own)

    def _with_defaults(self, element: Element, childclass: str) -> Element:
        name = element.get("class", childclass)
        if name not in self.defaults:
            raise refused(f"<{element.tag}> has the class '{name}', for which there is no <default>")
        return Element(element.tag, _inherit(element, self.defaults[name].get(_key(element), {})))

    def _angle(self, value: float) -> float:
        return math.radians(value) if self.is_degree else value

    def _rotation(self, element: Element) -> np.ndarray:
        if len(names := [name for name in schema.ORIENTATIONS if element.get(name)]) > 1:
            raise refused(f"<{element.tag}> has several orientations: {listed(names)}")
        if element.get("quat"):
            w, x, y, z = unit(numbers(element, "quat", "", 4), "a quaternion")
            return np.array([
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ])  # fmt: skip
        if element.get("euler"):
            turned = np.eye(3)
            for axis, angle in zip(self.order, numbers(element, "euler", "", 3).tolist(), strict=True):
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
        self._check_parts(body, name)
        schema.leave_out_attributes(self.model, body, name)
        if number(body, "gravcomp", 0.0):
            self.model.leave_out("compensations of gravity", name, acts=True)
        childclass = body.get("childclass", childclass)
        self.geoms[name] = [self._with_defaults(one, childclass) for one in body.iterfind("geom")]
        turn, place = self.places[parent]
        here, turned = place + turn @ numbers(body, "pos", "0 0 0", 3), turn @ self._rotation(body)
        self.places[name] = turned, here
        self.model.parts.append(self._part(name, body))
        joints = [self._with_defaults(joint, childclass) for joint in body.iterfind("joint")]
        free_joints = body.findall("freejoint")
        if len(joints) + len(free_joints) > 1:
            raise refused(
                f"body '{name}' has {len(joints) + len(free_joints)} joints; give each direction a body with a mass, "
                "or use <freejoint>"
            )
        for joint in (*joints, *free_joints):
            schema.leave_out_attributes(self.model, joint, joint.get("name", name))
        free = bool(free_joints) or any(joint.get("type") == "free" for joint in joints)
        if free and parent != GROUND:
            raise refused(f"body '{name}' has a free joint, but is not a child of the world")
        for joint in joints if free else ():
            for attribute in ("damping", "armature", "frictionloss", "stiffness"):
                if np.any(numbers(joint, attribute, "0")):
                    self.model.leave_out(f"{attribute} of free joints", joint.get("name", name), acts=True)
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
        if not _has_zero(joint, "actuatorfrc"):
            self.model.leave_out("actuators that act without control", f"actuatorfrcrange of {name}", acts=True)
        if joint.get("range") and keyword(joint, "limited", "auto", ("auto", *BOOLEAN)) != "false":
            self.model.leave_out("limits of joints", name)
            low, high = (scale * numbers(joint, "range", "", 2)).tolist()
            limits = low, high
        if np.any(numbers(joint, "springdamper", "0")):
            raise refused(f"joint '{name}' has a springdamper, which is not read; give stiffness and damping")
        values = {"armature": number(joint, "armature", 0.0), "friction": number(joint, "frictionloss", 0.0)}
        for key in ("stiffness", "damping"):
            values[key], *powers = numbers(joint, key, "0").tolist() or [0.0]
            if any(powers):
                self.model.leave_out(f"the nonlinear part of the {key} of joints", name, acts=True)
        kind = "turn" if kind == "hinge" else "slide"
        return Link(name, kind, parent, child, point, axis, **values, rest=rest, limits=limits)

    def _part(self, name: str, body: Element) -> Part:
        turned, here = self.places[name]
        inertial = body.find("inertial")
        if inertial is None and self.from_geoms == "false":
            raise refused(f"body '{name}' has no <inertial>, although inertiafromgeom is false")
        if inertial is not None and self.from_geoms != "true":
            schema.leave_out_attributes(self.model, inertial, name)
            own = turned @ self._rotation(inertial)
            if inertial.get("fullinertia"):
                xx, yy, zz, xy, xz, yz = numbers(inertial, "fullinertia", "", 6)
                tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            else:
                tensor = np.diag(numbers(inertial, "diaginertia", "0 0 0", 3))
            center = here + turned @ numbers(inertial, "pos", "0 0 0", 3)
            return Part(name, number(inertial, "mass", 0.0), center, own @ tensor @ own.T)
        solids = [result for one in self.geoms[name] if (result := self._solid(one, name, here, turned)).mass > 0]
        return Part.joined(name, solids) if solids else Part(name, 0.0, here, np.zeros((3, 3)))

    def _solid(self, geom: Element, body: str, here: np.ndarray, turned: np.ndarray) -> Part:
        kind, size = geom.get("type", "sphere"), numbers(geom, "size", "0")
        key = "mass" if geom.get("mass") else "density"
        amount = number(geom, key, 1000.0)
        if amount < 0:
            raise refused(f"body '{body}' has a geom with a negative {key}")
        if amount == 0 or kind in ("plane", "hfield"):
            return Part(body, 0.0, here, np.zeros((3, 3)))
        if kind not in SIZES or geom.get("mesh"):
            raise refused(f"body '{body}' has a geom of type '{kind}', whose mass is not computed; give <inertial>")
        if keyword(geom, "shellinertia", "false", BOOLEAN) == "true":
            raise refused(f"body '{body}' has a geom with shellinertia, which is not computed; give <inertial>")
        place, own = numbers(geom, "pos", "0 0 0", 3), self._rotation(geom)
        if geom.get("fromto"):
            if kind == "sphere":
                raise refused(f"body '{body}' has a sphere with fromto; give pos and size")
            ends = numbers(geom, "fromto", "", 6)
            along = ends[3:] - ends[:3]
            place, own = (ends[:3] + ends[3:]) / 2, _z_along(unit(along, "fromto"))
            size = np.array([*size[:1].repeat(SIZES[kind] - 1), float(np.linalg.norm(along)) / 2])
        if len(size) < SIZES[kind] or np.any(size[: SIZES[kind]] <= 0):
            raise refused(f"body '{body}' has a geom of type '{kind}', which needs {SIZES[kind]} positive sizes")
        volume, moments = volume_and_inertia(kind, size)
        mass = amount if key == "mass" else amount * volume
        tensor = turned @ own @ np.diag(moments * mass / volume) @ (turned @ own).T
        return Part(body, mass, here + turned @ place, tensor)

    def _add_closure(self, element: Element) -> None:
        """Add an equality constraint. MuJoCo satisfies such constraints approximately, mbdkit exactly."""
        equality = self._with_defaults(Element("equality", element.attrib), "main")
        if keyword(equality, "active", "true", BOOLEAN) == "false":
            return
        if element.tag == "joint":
            self._add_follower(equality)
            return
        first, second = _body(equality, "body1"), _body(equality, "body2")
        name = equality.get("name", f"{first} to {second}")
        if element.tag not in ("connect", "weld") or not equality.get("body1") or not {first, second} <= {*self.places}:
            raise refused(
                f"the equality <{element.tag}> '{name}' is not read; connect and weld of two bodies, and joint are"
            )
        if element.tag == "weld" and (equality.get("relpose") or not number(equality, "torquescale", 1.0)):
            raise refused(f"the weld '{name}' has a relpose or a torquescale of 0, which are not read")
        schema.leave_out_attributes(self.model, equality, name, "equality")
        turned, here = self.places[second if element.tag == "weld" else first]
        anchor = here + turned @ numbers(equality, "anchor", "0 0 0", 3)
        self.model.closures.append(Closure(name, element.tag, (first, second), anchor))  # type: ignore[arg-type]

    def _add_follower(self, equality: Element) -> None:
        """Add a joint whose coordinate is a polynomial of that of another one, or constant."""
        joint, leader = equality.get("joint1", ""), equality.get("joint2")
        name = equality.get("name", f"{joint} to {leader}" if leader else f"{joint} held")
        schema.leave_out_attributes(self.model, equality, name, "equality")
        given = numbers(equality, "polycoef", "").tolist()
        self.model.followers.append(Follower(name, joint, leader, (*given, *(0.0, 1.0, 0.0, 0.0, 0.0)[len(given) :])))


def _key(element: Element) -> str:
    """Return the key of the defaults of an element; actuators share theirs, and so do equality constraints."""
    if element.tag in schema.ACTUATORS:
        return "actuator"
    return "equality" if element.tag in ("connect", "weld", "tendon", "flex", "flexstrain") else element.tag


def _inherit(element: Element, above: Mapping[str, str]) -> dict[str, str]:
    """Return the attributes of an element or default, with those that it inherits.

    An orientation replaces an inherited one, the rest of a longer inherited list follows a shorter one, and a shortcut
    for an actuator replaces the inherited force law. The key "" has the shortcut that made the force law.
    """
    values = dict(above)
    if any(name in element.attrib for name in schema.ORIENTATIONS):
        values = {name: text for name, text in values.items() if name not in schema.ORIENTATIONS}
    if element.tag in schema.ACTUATORS and element.tag != "general":
        values = {name: text for name, text in values.items() if name in schema.INHERITED} | {"": element.tag}
    for name, text in element.attrib.items():
        rest = values.get(name, "").split()[len(text.split()) :] if name in schema.LISTS else []
        values[name] = " ".join([text, *rest])
    return values


def _has_zero(element: Element, name: str) -> bool:
    """Return whether the range of a quantity contains zero, or does not limit it."""
    if not element.get(f"{name}range") or element.get(f"{name}limited") == "false":
        return True
    low, high = numbers(element, f"{name}range", "", 2).tolist()
    return bool(low <= 0 <= high)


def _body(element: Element, key: str) -> str:
    name = element.get(key, "world")
    return GROUND if name == "world" else name


def _label(geom: Element, body: str) -> str:
    return geom.get("name", f"{geom.get('type', 'sphere')} of {'the world' if body == GROUND else body}")


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
