"""Parts and joints of a spatial model that moves in one plane, and the planar mechanism that they form."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from mbdkit import Mechanism, SpecError
from mbdkit.plugin import did_you_mean, listed, quoted

GROUND = "ground"
KEY = "model.file"
Plane = Literal["xy", "xz", "yz"]
LinkKind = Literal["turn", "slide", "fixed", "free"]
PARALLEL = 1e-6  #: Largest sine of the angle between an axis and the direction that it should have.
MOST_NAMED = 6  #: Largest number of names that a warning lists.


def refused(message: str) -> SpecError:
    """Return the exception for a file that cannot be read or is not planar."""
    return SpecError(message, key=KEY)


@dataclass(frozen=True)
class Part:
    """A body at the zero position of all joints: its centre of mass (3,) [m] and inertia (3, 3) [kg m^2] in the global
    frame.
    """

    name: str
    mass: float
    center: np.ndarray
    inertia: np.ndarray

    @classmethod
    def joined(cls, name: str, parts: Sequence[Part]) -> Part:
        """Return parts that are fixed to each other as one part; their mass together is not 0."""
        mass = sum(part.mass for part in parts)
        center = np.sum([part.mass * part.center for part in parts], axis=0) / mass
        inertia = np.zeros((3, 3))
        for part in parts:
            arm = part.center - center
            inertia = inertia + part.inertia + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return cls(name, mass, center, inertia)


@dataclass(frozen=True)
class Link:
    """A joint of the tree at the zero position: a point (3,) [m] and an axis (3,) in the global frame.

    `stiffness`, `damping` and `rest` describe a spring that acts on the coordinate, which is 0 at the zero position;
    `friction` is the magnitude [N m or N] of dry friction that does not depend on the load. `armature` is the inertia
    [kg m^2 or kg] of a rotor that turns with the coordinate. `limits` is the range of the coordinate.
    """

    name: str
    kind: LinkKind
    parent: str
    child: str
    point: np.ndarray
    axis: np.ndarray
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class Closure:
    """A constraint that closes a loop: two parts share a point (3,) [m], given at the zero position, or are welded
    there.
    """

    name: str
    kind: Literal["connect", "weld"]
    parts: tuple[str, str]
    point: np.ndarray


@dataclass(frozen=True)
class Follower:
    """A joint that follows another one: its coordinate is a polynomial of that of `leader`, or constant without one.

    `coefficients` are in ascending powers.
    """

    name: str
    joint: str
    leader: str | None
    coefficients: tuple[float, ...]


@dataclass
class SpatialModel:
    """A model that was read from a file, before it is projected onto a plane."""

    name: str
    parts: list[Part] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    closures: list[Closure] = field(default_factory=list)
    followers: list[Follower] = field(default_factory=list)
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    #: Names of the ignored components, by a phrase for their kind.
    left_out: dict[str, list[str]] = field(default_factory=dict)
    #: Names of those ignored components that change the motion, by a phrase for their kind.
    lacking: dict[str, list[str]] = field(default_factory=dict)

    def leave_out(self, kind: str, name: str, *, acts: bool = False) -> None:
        """Note the name of an ignored component, and whether it changes the motion."""
        (self.lacking if acts else self.left_out).setdefault(kind, []).append(name)


class PlanarMechanism:
    """Projects a model onto a plane. At the zero position the frames of all bodies are parallel to the global frame."""

    def __init__(self, model: SpatialModel, plane: Plane, transition_speed: float):
        axes = np.eye(3)
        self.model, self.across, self.transition_speed = model, plane, transition_speed
        self.u, self.w = axes["xyz".index(plane[0])], axes["xyz".index(plane[1])]
        self.normal = np.cross(self.u, self.w)
        self.parts = {part.name: part for part in model.parts}
        self.owner = self._owners()

    def mechanism(self, initial: Mapping[str, float], speeds: Mapping[str, float]) -> Mechanism:
        """Return the mechanism with the joint coordinates at their initial values [rad or m] and speeds [rad/s or m/s].

        Raises
        ------
        SpecError
            If a joint leaves the plane, or a coordinate does not exist.
        """
        names = [link.name for link in self.model.links if link.kind in ("turn", "slide")]
        for given, key in ((initial, "initial"), (speeds, "speeds")):
            for name in given:
                if name not in names:
                    hint = did_you_mean(name, names) or f"; there are {listed(names)}"
                    raise SpecError(f"the file has no joint '{name}'{hint}", key=f"model.{key}.{quoted(name)}")
        data: dict[str, Any] = {"gravity": self._flat(self.model.gravity), "bodies": {}, "joints": {}, "forces": {},
                                "coordinates": {}}  # fmt: skip
        moved, rotors = self._moved(initial, speeds), self._rotors()
        for part in self.model.parts:
            if self.owner[part.name] == part.name:
                data["bodies"][part.name] = self._body(part, rotors.get(part.name, 0.0), *moved[part.name])
        for link in self.model.links:
            self._add(link, data)
        for closure in self.model.closures:
            bodies = [self.owner[name] for name in closure.parts]
            points = [self._local(body, closure.point) for body in bodies]
            joint = {"type": "weld" if closure.kind == "weld" else "revolute", "bodies": bodies, "points": points}
            data["joints"][_free_name(closure.name, data["joints"])] = joint
        for follower in self.model.followers:
            data["joints"][_free_name(follower.name, data["joints"])] = self._coupling(follower)
        found = Mechanism.from_spec(data)
        found.name = self.model.name
        turns = {link.name for link in self.model.links if link.kind == "turn"}
        turned = (
            f"the initial angle of joint '{name}', {value:g} rad, is more than a full rotation; for degrees, "
            f"write degrees({value:g})"
            for name, value in initial.items()
            if name in turns and abs(value) > 2 * math.pi
        )
        found.warnings = (*_sentences("left out", self.model.left_out), *turned)
        found.left_out = _sentences("left out, which may change the motion", self.model.lacking)
        return found

    def _owners(self) -> dict[str, str]:
        """Return the body that each part belongs to. Parts without mass belong to the body that they are fixed to."""
        owner = {GROUND: GROUND}
        for link in self.model.links:
            part = self.parts[link.child]
            if part.mass > 0:
                owner[part.name] = part.name
            elif link.kind == "fixed":
                owner[part.name] = owner[link.parent]
            else:
                raise refused(f"'{part.name}' moves, by joint '{link.name}', but has no mass")
        return owner

    def _flat(self, vector: np.ndarray) -> list[float]:
        return [float(self.u @ vector), float(self.w @ vector)]

    def _local(self, body: str, point: np.ndarray) -> list[float]:
        return self._flat(point if body == GROUND else point - self.parts[body].center)

    def _sign(self, link: Link) -> float:
        """Return 1 if positive rotations of a joint are counter-clockwise in the plane, and -1 if they are
        clockwise.
        """
        if np.linalg.norm(np.cross(link.axis, self.normal)) > PARALLEL:
            raise refused(
                f"joint '{link.name}' turns about ({_text(link.axis)}), not normal to the plane {self.across}; "
                "choose another `plane` if the mechanism is planar"
            )
        return math.copysign(1.0, float(link.axis @ self.normal))

    def _direction(self, link: Link) -> np.ndarray:
        if abs(link.axis @ self.normal) > PARALLEL:
            raise refused(f"joint '{link.name}' slides along ({_text(link.axis)}), out of the plane {self.across}")
        return np.array(self._flat(link.axis))

    def _moved(self, initial: Mapping[str, float], speeds: Mapping[str, float]) -> dict[str, tuple[object, ...]]:
        """Return angle, displacement (2,), angular velocity, and velocity (2,) at the origin, of every part, relative
        to the zero position.
        """
        found: dict[str, tuple[Any, ...]] = {GROUND: (0.0, np.zeros(2), 0.0, np.zeros(2))}
        for link in self.model.links:
            angle, shift, rate, velocity = found[link.parent]
            value, speed = initial.get(link.name, 0.0), speeds.get(link.name, 0.0)
            if link.kind == "turn":
                turn, spin = self._sign(link) * value, self._sign(link) * speed
                point = np.array(self._flat(link.point))
                shift = _turned(angle, point) + shift
                velocity = velocity + spin * np.array([shift[1], -shift[0]])
                angle, rate = angle + turn, rate + spin
                shift = shift - _turned(angle, point)
            elif link.kind == "slide":
                way = _turned(angle, self._direction(link))
                shift = shift + value * way
                velocity = velocity + speed * way
            found[link.child] = angle, shift, rate, velocity
        return found

    def _rotors(self) -> dict[str, float]:
        """Return the inertia [kg m^2] that armatures add to bodies by name, and note the armatures that are left out.

        A rotor has the relative angular velocity of its joint. If the first body of the joint does not rotate, this is
        the angular velocity of the second body, so that the rotor acts as additional inertia of it.
        """
        found: dict[str, float] = {}
        rotates = {GROUND: False}
        for link in self.model.links:
            rotates[link.child] = rotates[link.parent] or link.kind in ("turn", "free")
            if not link.armature:
                continue
            if link.kind == "turn" and not rotates[link.parent]:
                found[link.child] = link.armature
            else:
                what = "joints on rotating bodies" if link.kind == "turn" else f"{link.kind} joints"
                self.model.leave_out(f"armatures of {what}", link.name, acts=True)
        return found

    def _body(
        self, part: Part, rotor: float, angle: float, shift: np.ndarray, rate: float, velocity: np.ndarray
    ) -> dict[str, object]:
        inertia = float(self.normal @ part.inertia @ self.normal) + rotor
        position = _turned(angle, np.array(self._flat(part.center))) + shift
        moving = velocity + rate * np.array([-position[1], position[0]])
        rigid = {"inertia": inertia, "angle": angle, "angular_velocity": rate} if inertia > 0 else {}
        return {"mass": part.mass, "position": position.tolist(), "velocity": moving.tolist(), **rigid}

    def _add(self, link: Link, data: dict[str, Any]) -> None:
        first, second = self.owner[link.parent], self.owner[link.child]
        if link.kind == "free" or first == second:
            return
        if link.name in data["joints"]:
            raise refused(f"there are two joints with the name '{link.name}'")
        points = [self._local(first, link.point), self._local(second, link.point)]
        joint: dict[str, Any] = {"bodies": [first, second], "points": points}
        if link.kind == "fixed":
            data["joints"][link.name] = {"type": "weld", **joint}
            return
        bodies = {"bodies": [first, second]}
        if link.kind == "turn":
            sign, zero, pathway = self._sign(link), 0.0, {"type": "relative-angle", **bodies}
            data["joints"][link.name] = {"type": "revolute", **joint}
        else:
            way = self._direction(link)
            axis = int(np.argmax(np.abs(way)))
            apart = self.parts[second].center - (0.0 if first == GROUND else self.parts[first].center)
            sign, zero = float(np.sign(way[axis])), self._flat(apart)[axis]
            pathway = {"type": "coordinate", **bodies, "coordinate": "xy"[axis]}
            data["joints"][link.name] = {"type": "prismatic", **joint, "axis": way.tolist(), "angle": 0.0}
            if abs(abs(way[axis]) - 1.0) > PARALLEL:
                pathway = {}
        data["forces"] |= self._forces(link, pathway, sign, zero)
        data["coordinates"][link.name] = {"of": f"{link.name}.angle", "scale": sign if link.kind == "turn" else 1.0}

    def _coupling(self, follower: Follower) -> dict[str, object]:
        """Return the coupling of two bodies that makes a joint follow another one.

        Raises
        ------
        SpecError
            If the coordinates of both joints do not follow from the relative pose of two bodies and the angle of one.
        """
        links = {link.name: link for link in self.model.links if link.kind in ("turn", "slide")}
        for name in (follower.joint, follower.leader):
            if name is not None and name not in links:
                raise refused(f"'{follower.name}' refers to '{name}', which is no joint that turns or slides")
        joint, leader = links[follower.joint], links.get(follower.leader or "")
        ends = [(self.owner[link.parent], self.owner[link.child]) for link in (joint, leader or joint)]
        for pair in (*ends, (ends[1][1], ends[0][1])):
            own, other = (self._coordinate(link, *pair) for link in (joint, leader or joint))
            if pair[0] == pair[1] or own is None or (leader and other is None):
                continue
            terms = follower.coefficients if leader else follower.coefficients[:1]
            powers = (f"({c!r})*({other})**{power}" if power else repr(c) for power, c in enumerate(terms) if c)
            slide = next((link for link in (joint, leader) if link is not None and link.kind == "slide"), None)
            points = [self._local(body, slide.point) if slide else [0.0, 0.0] for body in pair]
            return {
                "type": "coupling", "bodies": [*pair], "points": points, "unit": "rad" if joint.kind == "turn" else "m",
                "equation": f"{own} - ({' + '.join(powers) or '0'})",
            }  # fmt: skip
        raise refused(
            f"joint '{follower.joint}' follows '{follower.leader}', which is not read: a coupling knows the relative "
            "position of two bodies and the angle of the first, from which the coordinates of both joints do not follow"
        )

    def _coordinate(self, link: Link, first: str, second: str) -> str | None:
        """Return the coordinate of a joint as an expression for a coupling of two bodies; None if there is none."""
        parent, child = self.owner[link.parent], self.owner[link.child]
        if link.kind == "slide":
            x, y = self._direction(link).tolist()
            return f"(({x!r})*x + ({y!r})*y)" if (parent, child) == (first, second) else None
        if (parent, child) == (first, second):
            return f"({self._sign(link)!r})*angle"
        own = {first: "first", second: "second"}.get(child)
        return f"({self._sign(link)!r})*{own}" if parent == GROUND and own else None

    def _forces(self, link: Link, pathway: Mapping[str, object], sign: float, zero: float) -> dict[str, object]:
        """Return the spring, the friction and the limits of a joint as forces by name.

        The length of the pathway is ``zero + sign * coordinate``. The pathway is empty if the joint slides along a line
        that is oblique to the axes.
        """
        found: dict[str, Any] = {}
        spring = {"stiffness": link.stiffness, "damping": link.damping}
        if any(spring.values()):
            found["spring"] = {"law": "linear", **spring, "free_length": zero + sign * link.rest}
        if link.friction:
            speed = self.transition_speed
            found["friction"] = {"law": "dry-friction", "loss": link.friction, "transition_speed": speed}
        if found and not pathway:
            raise refused(
                f"the spring, damping or friction of joint '{link.name}' acts along a line that is oblique to the axes"
            )
        if link.limits is not None and not (pathway and link.limits[0] < link.limits[1]):
            why = "without a range" if pathway else "along lines that are oblique to the axes"
            self.model.leave_out(f"limits {why}", link.name, acts=True)
        elif link.limits is not None:
            ends = sorted(zero + sign * value for value in link.limits)
            found["limits"] = {"law": "table", "table": [ends, [0.0, 0.0]]}
        return {f"{link.name} {name}": {"type": "law", "pathway": pathway, **one} for name, one in found.items()}


def _free_name(name: str, taken: Mapping[str, Any]) -> str:
    """Return a name that is not taken; names of joints and of constraints may agree in a file."""
    while name in taken:
        name += "'"
    return name


def _sentences(what: str, components: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    return tuple(
        f"{kind} {what}: {listed(names[:MOST_NAMED])}{', ...' if len(names) > MOST_NAMED else ''}"
        for kind, names in components.items()
    )


def _turned(angle: float, vector: np.ndarray) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def _text(vector: Sequence[float] | np.ndarray) -> str:
    return ", ".join(f"{x:.3g}" for x in vector)
