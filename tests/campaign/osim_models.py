"""Draws planar models as OpenSim files, over all types and properties in the registry of OpenSim."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

REGISTRY = Path(__file__).parents[2] / "plugins/mbdkit-opensim/src/mbdkit_opensim/registry.json"

PLANAR = ("PinJoint", "CustomJoint", "SliderJoint", "WeldJoint")
SETS = {
    **dict.fromkeys(("Actuator", "Muscle", "Force"), "ForceSet"),
    "Controller": "ControllerSet",
    "Constraint": "ConstraintSet",
}
"""Set of a model in which components of a base class usually stand."""

NEVER = (
    "Model",
    "BodySet",
    "JointSet",
    "ForceSet",
    "ComponentSet",
    "Ground",
    "Coordinate",
    "PathPointSet",
    "PathWrapSet",
)
"""Types that are not drawn as components of their own."""

AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}

EXPRESSIONS = {
    "ExpressionBasedCoordinateForce": "-3*q+1",
    "ExpressionBasedPathForce": "5*s+1",
    "ExpressionBasedPointToPointForce": "2*d+1",
}
SPECIAL = ("1_0", "1e0", "+2", "2.", " 3 ", "nan", "", "1,5", "2 3", "1<!-- comment -->5", "<![CDATA[2]]>", "0x2", "-1")
"""Texts of numbers that parsers may read differently."""


@cache
def registry() -> dict[str, dict[str, dict[str, str]]]:
    """Return the properties and default values of all types, by base class."""
    data = json.loads(REGISTRY.read_text())
    return {kind: of for kind, of in data.items() if kind != "source"}


def properties_of(kind: str) -> Mapping[str, str]:
    """Return the properties of a type with their default values; empty if it is not registered."""
    return next((of[kind] for of in registry().values() if kind in of), {})


class ModelText:
    """Draws one model.

    Attributes
    ----------
    text
        The file.
    free
        Names of the coordinates that are neither locked nor prescribed.
    planted
        Types and properties that were added to a plain chain of bodies, each of which may change the motion.
    """

    def __init__(self, random: np.random.Generator):
        self.random = random
        self.planted: set[str] = set()
        self.free: list[str] = []
        self.count = 0
        self.bodies = [f"b{i}" for i in range(int(random.integers(1, 4)))]
        self.coordinates: list[tuple[str, str]] = []  # joint and name
        self.frames: list[str] = []
        self.actuators: list[str] = []
        joints = [self.joint(i) for i in range(len(self.bodies))]
        bodies = [self.body(name) for name in self.bodies]
        sets: dict[str, list[str]] = {name: [] for name in (*SETS.values(), "ComponentSet", "ContactGeometrySet")}
        self.of_model, self.of_bodies = "", dict.fromkeys(self.bodies, "")
        for _ in range(int(random.integers(0, 3))):
            self.add_component(sets)
        for name in self.bodies:
            if inner := self.of_bodies[name]:
                index = self.bodies.index(name)
                bodies[index] = bodies[index].replace("</Body>", f"<components>{inner}</components></Body>")
        gravity = "" if self.chance(0.1) else f"<gravity>{self.pick(('0 -9.81 0', '1 -9.81 0', '0 0 0'))}</gravity>"
        more = "".join(f"<{tag}><objects>{''.join(of)}</objects></{tag}>" for tag, of in sets.items() if of)
        if self.chance(0.05):
            more += "<defaults><Coordinate name='default'><default_value>0.3</default_value></Coordinate></defaults>"
        if self.of_model:
            more += f"<components>{self.of_model}</components>"
        version = self.pick(("40500", "40600", "40000", "30516"))
        self.text = (
            f'<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="{version}"><Model name="m">'
            f'<Ground name="ground"/>{gravity}<BodySet><objects>{"".join(bodies)}</objects></BodySet>'
            f"<JointSet><objects>{''.join(joints)}</objects></JointSet>{more}</Model></OpenSimDocument>"
        )

    def chance(self, share: float) -> bool:
        return bool(self.random.random() < share)

    def pick(self, values: tuple[str, ...] | list[str]) -> str:
        return values[int(self.random.integers(len(values)))]

    def numbers(self, count: int, size: float = 1.0) -> str:
        return " ".join(repr(round(float(x), 3)) for x in self.random.uniform(-size, size, count))

    def name(self, prefix: str) -> str:
        self.count += 1
        return f"{prefix}{self.count}"

    def body(self, name: str) -> str:
        parts = {
            "mass": repr(round(float(self.random.uniform(0.5, 5)), 3)),
            "mass_center": self.numbers(3, 0.3),
            "inertia": f"0.3 0.3 {self.random.uniform(0.1, 0.4):.3f} 0 0 0",
        }
        if self.chance(0.04):
            special = self.pick(SPECIAL)
            parts["mass"] = special
        if self.chance(0.02):
            parts["inertia"] = "0.3 0.3 0.2 0.05 0.1 0.1"
        inner = "".join(f"<{tag}>{text}</{tag}>" for tag, text in parts.items())
        inner += "<mass>9</mass>" * self.chance(0.03)
        return f'<Body name="{name}">{self.extra("Body", parts)}{inner}</Body>'

    def extra(self, kind: str, given: Mapping[str, str]) -> str:
        """Return at times another property of a type."""
        others = [tag for tag in properties_of(kind) if tag not in given and tag != "components"]
        if not others or not self.chance(0.08):
            return ""
        tag = self.pick(others)
        self.planted.add(tag)
        return self.property(kind, tag, 0)

    def flag(self) -> str:
        return self.pick(("true", "false", "True", "FALSE", "1", "0", " true "))

    def joint(self, index: int) -> str:
        child, parent = self.bodies[index], self.pick(["ground", *self.bodies[:index]])
        kinds = (*PLANAR, *PLANAR, "PlanarJoint") if index == 0 else PLANAR * 2
        kind = self.pick((*registry()["Joint"],) if self.chance(0.05) else kinds)
        if kind not in (*PLANAR, "PlanarJoint"):
            self.planted.add(kind)
        name = f"j{index}"
        flipped = "3.141592653589793" if self.chance(0.15) else "0"
        is_free = kind == "PlanarJoint" or (index == 0 and self.chance(0.2))
        turns = [0.0 if is_free else self.random.uniform(-1, 1), self.random.uniform(-1, 1)]
        offsets = [f"{parent}_offset", f"{child}_offset"] if self.chance(0.8) else ["offset", "offset2"]
        frames = "".join(
            f'<PhysicalOffsetFrame name="{frame}"><socket_parent>{path}</socket_parent>'
            f"<translation>{self.numbers(3, 0.4)}</translation>"
            f"<orientation>0 {flipped} {turn:.3f}</orientation></PhysicalOffsetFrame>"
            for frame, path, turn in zip(offsets, map(self.path_of, (parent, child)), turns, strict=True)
        )
        sockets = [self.pick((frame, f"/jointset/{name}/{frame}")) for frame in offsets]
        if self.chance(0.1):
            sockets[0] = self.path_of(parent)
        elif self.frames and self.chance(0.15):  # of another joint; it may have the name of a frame of this one
            sockets[0] = self.pick(self.frames)
        self.frames += [f"/jointset/{name}/{frame}" for frame in offsets]
        inner = "".join(
            f"<socket_{side}_frame>{path}</socket_{side}_frame>"
            for side, path in zip(("parent", "child"), sockets, strict=True)
        )
        count = {"PinJoint": 1, "SliderJoint": 1, "WeldJoint": 0, "PlanarJoint": 3, "UniversalJoint": 2}.get(kind, 3)
        if kind == "CustomJoint":
            count = 3 if is_free else 1
        inner += "<coordinates>" + "".join(self.coordinate(name, f"q{index}{'abc'[k]}") for k in range(count))
        inner += f"</coordinates><frames>{frames}</frames>"
        if kind == "CustomJoint":
            inner += self.transform(index, count)
        given = ("coordinates", "frames", "SpatialTransform", "socket_parent_frame", "socket_child_frame")
        return f'<{kind} name="{name}">{inner}{self.extra(kind, dict.fromkeys(given, ""))}</{kind}>'

    def path_of(self, body: str) -> str:
        return "/ground" if body == "ground" else f"/bodyset/{body}"

    def coordinate(self, joint: str, name: str) -> str:
        self.coordinates.append((joint, name))
        parts = {}
        for tag, share in (("default_value", 0.6), ("default_speed_value", 0.3), ("range", 0.4), ("clamped", 0.2)):
            if self.chance(share):
                parts[tag] = {"range": "-2 2", "clamped": self.flag()}.get(tag) or self.numbers(1)
        if self.chance(0.15):
            parts["locked"] = self.flag() if self.chance(0.9) else "yes"
        if self.chance(0.08):
            parts["prescribed_function"] = self.function("prescribed_function")
            parts["prescribed"] = self.flag()
            self.planted.add("prescribed")
        if self.chance(0.1):
            parts["is_free_to_satisfy_constraints"] = self.flag()
        if not {parts.get("locked", "0").strip().lower(), parts.get("prescribed", "0").strip().lower()} & {"true", "1"}:
            self.free.append(name)
        inner = "".join(f"<{tag}>{text}</{tag}>" for tag, text in parts.items())
        return f'<Coordinate name="{name}">{inner}{self.extra("Coordinate", parts)}</Coordinate>'

    def transform(self, index: int, count: int) -> str:
        """Return a spatial transform that turns about z, or moves along a line, or both."""
        names = [f"q{index}{'abc'[k]}" for k in range(count)]
        plain = '<LinearFunction name="function"><coefficients>1 0</coefficients></LinearFunction>'
        zero = '<Constant name="function"><value>0</value></Constant>'
        axes = {
            f"{kind}{number}": (direction, zero, "")
            for kind, directions in (("rotation", "zyx"), ("translation", "xyz"))
            for number, direction in enumerate((AXES[axis] for axis in directions), 1)
        }
        if count == 3:
            for axis, name in zip(("rotation1", "translation1", "translation2"), names, strict=True):
                axes[axis] = (axes[axis][0], plain, name)
        elif self.chance(0.75):
            slope = self.pick(("1 0", "-1 0.2", "0.5 -0.1", "2 0"))
            function = f'<LinearFunction name="function"><coefficients>{slope}</coefficients></LinearFunction>'
            axes["rotation1"] = (self.pick(("0 0 1", "0 0 -1", "0 0 2")), function, names[0])
            for axis in ("translation1", "translation2"):
                if self.chance(0.4):
                    function = (
                        self.function("function") if self.chance(0.5) else f"<function>{self.function('')}</function>"
                    )
                    axes[axis] = (axes[axis][0], function, names[0])
        else:
            axes["translation1"] = (self.pick(("1 0 0", "0.6 0.8 0", "1 1 0")), plain, names[0])
        if self.chance(0.1):
            del axes[self.pick([axis for axis, (_, _, name) in axes.items() if not name])]
        rows = "".join(
            f'<TransformAxis name="{axis}"><coordinates>{name}</coordinates><axis>{direction}</axis>{function}'
            "</TransformAxis>"
            for axis, (direction, function, name) in axes.items()
        )
        return f"<SpatialTransform>{rows}</SpatialTransform>"

    def function(self, name: str, depth: int = 0) -> str:
        """Return a function of any registered type."""
        common = ("Constant", "LinearFunction", "PolynomialFunction", "SimmSpline", "MultiplierFunction")
        kind = self.pick(common if self.chance(0.8) else (*registry()["Function"],))
        title = f' name="{name}"' if name else ""
        if kind == "MultiplierFunction":
            if depth > 2:
                return self.function(name, depth)
            inner = f"<function>{self.function('', depth + 1)}</function><scale>{self.numbers(1)}</scale>"
            return f"<{kind}{title}>{inner}</{kind}>"
        if "x" in (properties := properties_of(kind)):
            count = int(self.random.integers(4, 8))
            x = np.round(np.sort(self.random.uniform(-3, 3, count)) + np.linspace(-3, 3, count), 3)
            inner = f"<x>{' '.join(map(repr, x.tolist()))}</x><y>{self.numbers(count, 0.2)}</y>"
            inner += "<half_order>3</half_order>" * (kind == "GCVSpline")
        elif "coefficients" in properties and kind != "MultivariatePolynomialFunction":
            count = 2 if kind == "LinearFunction" else int(self.random.integers(1, 5))
            inner = f"<coefficients>{self.numbers(count, 0.3)}</coefficients>"
        else:
            inner = "".join(self.property(kind, tag, 2) for tag in properties if self.chance(0.5))
        return f"<{kind}{title}>{inner}</{kind}>"

    def add_component(self, sets: dict[str, list[str]]) -> None:
        """Add a component of any registered type to a set or to the components of the model or a body."""
        base = self.pick(("Actuator", "Muscle", "Force", "Force", "Controller", "Component"))
        base = "Constraint" if self.chance(0.05) else base
        kind = self.pick([kind for kind in registry()[base] if kind not in NEVER])
        self.planted.add(kind)
        text = self.component(kind)
        where = self.random.random()
        if base in SETS and where < 0.75:
            sets[SETS[base]].append(text)
            if base in ("Actuator", "Muscle"):
                self.actuators.append(f"/forceset/c{self.count}")
        elif where < 0.85:
            self.of_model += text
        elif where < 0.93:
            self.of_bodies[self.pick(self.bodies)] += text
        else:
            sets["ComponentSet"].append(text)

    def component(self, kind: str, depth: int = 0) -> str:
        """Return a component with some of its properties."""
        needed = ("socket", "path", "coordinate", "body", "point", "geometry")
        inner = ""
        for tag, default in properties_of(kind).items():
            switch = tag in ("appliesForce", "isEnforced", "enabled")
            share = 0.15 if switch else 1.0 if tag.lower().startswith(needed) or default == "nan" else 0.25
            if tag != "components" and not tag.endswith("actuators") and self.chance(share):
                inner += self.property(kind, tag, depth)
        if "socket_actuators" in properties_of(kind) and self.actuators:
            inner += f"<socket_actuators>{self.actuators[-1]}</socket_actuators>"
        inner += "<isDisabled>true</isDisabled>" * self.chance(0.04)
        return f'<{kind} name="{self.name("c")}">{inner}</{kind}>'

    def property(self, kind: str, tag: str, depth: int) -> str:
        """Return a property with a drawn value."""
        default = properties_of(kind)[tag]
        if default.startswith(":"):
            if depth > 2:
                return ""
            return f"<{tag}>{self.objects(default[1:], tag, depth)}</{tag}>"
        return f"<{tag}>{self.value(kind, tag, default)}</{tag}>"

    def objects(self, kind: str, tag: str, depth: int) -> str:
        """Return the objects in a property of the class `kind`."""
        if kind == "Function":
            return self.function("")
        if kind == "FunctionSet":
            return f"<objects>{''.join(self.function('') for _ in range(3))}</objects>"
        if kind == "AbstractGeometryPath":
            ends = [self.path_of(self.pick(["ground", *self.bodies])), self.path_of(self.bodies[-1])]
            points = "".join(
                f'<PathPoint name="p{i}"><socket_parent_frame>{end}</socket_parent_frame>'
                f"<location>{self.numbers(3, 0.5)}</location></PathPoint>"
                for i, end in enumerate(ends)
            )
            return f'<GeometryPath name="path"><PathPointSet><objects>{points}</objects></PathPointSet></GeometryPath>'
        if kind == tag:  # an object that is the property itself
            return "".join(self.property(kind, inner, depth + 1) for inner in properties_of(kind) if self.chance(0.3))
        return self.component(kind, depth + 1) if properties_of(kind) and self.chance(0.5) else ""

    def value(self, kind: str, tag: str, default: str) -> str:
        """Return a text for a property."""
        body = self.pick(["ground", *self.bodies])
        if "coordinate" in tag and default in ("", "UNASSIGNED", "Unassigned"):
            joint, name = self.pick_coordinate()
            return f"/jointset/{joint}/{name}" if "socket" in tag else name
        if tag.startswith("socket"):
            return self.path_of(body)
        if tag.lower() in ("body", "bodya", "bodyb", "body1", "body2", "applied_to_body"):
            return self.pick((self.bodies[0], self.path_of(body))) if self.chance(0.2) else self.bodies[-1]
        if "xpression" in tag:
            return EXPRESSIONS.get(kind, "2.0")
        if default in ("true", "false", "(true)", "(false)"):
            return self.flag()
        words = default.split()
        try:
            sizes = [max(abs(float(word)), 0.5) if float(word) * 0 == 0 else 1.0 for word in words]
        except ValueError:
            return default
        return " ".join(f"{size * self.random.uniform(0.5, 1.5):.4g}" for size in sizes)

    def pick_coordinate(self) -> tuple[str, str]:
        if not self.coordinates:
            return "j0", "q0a"
        return self.coordinates[int(self.random.integers(len(self.coordinates)))]
