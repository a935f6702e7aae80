"""Build a mechanism from the model of an `.osim` file."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias
from xml.etree.ElementTree import Element

import numpy as np

from mbdkit import Mechanism, SpecError
from mbdkit.plugin import did_you_mean, listed, quoted
from mbdkit_opensim.frames import FLAT, OffsetFrame, OsimFrames
from mbdkit_opensim.functions import center_of, constant, function_named
from mbdkit_opensim.osim_document import (
    flag_of,
    label_of,
    last_part,
    name_of,
    number_of,
    numbers_of,
    objects_of,
    read_model,
    refused,
    text_of,
)
from mbdkit_opensim.osim_muscles import CURVES, MuscleReader
from mbdkit_opensim.planar_joints import OsimCoordinate, PlanarJoint, Term, coordinates_of, planar_joint
from mbdkit_opensim.understood import IDLE, Unread, is_actuator, is_off, unread_in

Names: TypeAlias = defaultdict[str, list[str]]  #: Names of components by what is said about them.

MOST_NAMED = 6  #: Largest number of components of one class that a warning names.


@dataclass(frozen=True)
class _Pose:
    """Position (2,) [m], angle [rad], velocity (2,) [m/s] and angular velocity [rad/s] of a body's frame."""

    place: np.ndarray
    angle: float
    velocity: np.ndarray
    spin: float

    def point(self, local: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return position and velocity of a point with the coordinates `local` (2,) in the frame, which moves with
        `velocity` (2,) relative to the frame.
        """
        c, s = math.cos(self.angle), math.sin(self.angle)
        turned = np.array([[c, -s], [s, c]])
        arm = turned @ local
        return self.place + arm, self.velocity + self.spin * np.array([-arm[1], arm[0]]) + turned @ velocity


@dataclass(frozen=True)
class PairCoordinate:
    """A coordinate that follows from the relative pose of two bodies: `quantity` is ``slope * coordinate + offset``.

    `quantity` is an expression for the joint `coupling`, and `points` are the points of the pose, if it contains x or
    y.
    """

    bodies: tuple[str, str]
    quantity: str
    slope: float
    offset: float
    points: tuple[list[float], list[float]] | None = None

    def expression(self, first: str, second: str) -> str | None:
        """Return the coordinate as an expression for a coupling of two bodies; None if there is none."""
        own: str | None = self.quantity
        if self.bodies != (first, second):
            absolute = self.quantity == "angle" and self.bodies[0] == "ground"
            own = {first: "first", second: "second"}.get(self.bodies[1]) if absolute else None
        return own and f"({own} - ({float(self.offset)!r}))/({float(self.slope)!r})"


def build_mechanism(
    file: str, initial: Mapping[str, float], speeds: Mapping[str, float], *, muscles: bool = False
) -> Mechanism:
    """Return the mechanism of an `.osim` file.

    Parameters
    ----------
    file
        Path of the file.
    initial, speeds
        Initial values [m or rad] and speeds [m/s or rad/s] by name of the coordinate, which replace those in the file.
    muscles
        Whether muscles are read.

    Raises
    ------
    SpecError
        If the file is not a planar model, in which case the message names the component, or if a coordinate does not
        exist.
    """
    return _ModelBuilder(read_model(file), initial, speeds, muscles).mechanism()


class _ModelBuilder:
    """Places the bodies of a model one after another, from the ground outwards."""

    def __init__(self, model: Element, initial: Mapping[str, float], speeds: Mapping[str, float], muscles: bool):
        self.model, self.initial, self.speeds, self.with_muscles = model, initial, speeds, muscles
        gravity = numbers_of(model, "gravity", 3, "0 -9.80665 0")
        if gravity[2] != 0.0:
            raise refused("gravity has a component along z, out of the plane")
        for tag, *known in (("length_units", "meters", "m"), ("force_units", "N", "newtons")):
            if (unit := text_of(model, tag, known[0])) not in known:
                raise refused(f"<{tag}> is '{unit}', not '{known[0]}'")
        self.result = Mechanism(gravity[:2].tolist(), name=name_of(model))
        self.bodies = _by_name(objects_of(model, "BodySet"))
        self.centres = {name: numbers_of(body, "mass_center", 3, "0 0 0")[:2] for name, body in self.bodies.items()}
        self.centres["ground"] = np.zeros(2)
        self.frames = OsimFrames(self.bodies, model)
        self.poses = {"ground": _Pose(np.zeros(2), 0.0, np.zeros(2), 0.0)}
        self.heights = {"ground": 0.0}
        self.of_pairs: dict[str, PairCoordinate] = {}

    def mechanism(self) -> Mechanism:
        self.refuse_constraints()
        joints = [*_by_name(objects_of(self.model, "JointSet")).values()]
        self.check_names(joints)
        waiting = [(joint, *self.ends(joint)) for joint in joints]
        while waiting:
            ready = [one for one in waiting if one[1].body in self.poses]
            if not ready:
                raise refused(f"{label_of(waiting[0][0])} is not connected to the ground")
            waiting = [one for one in waiting if one[1].body not in self.poses]
            for joint, parent, child in ready:
                self.add(joint, parent, child)
        if loose := [name for name in self.bodies if name not in self.poses]:
            raise refused(f"body '{loose[0]}' has no joint, so it could move out of the plane")
        for constraint in self.constraints():
            add = self.add_point_on_line if constraint.tag == "PointOnLineConstraint" else self.add_coupler
            add(constraint)
        self.add_markers()
        of_muscles = self.add_muscles(joints) if self.with_muscles else []
        both, runs, idle = self.left_out()
        self.result.warnings = sentences_about(idle)
        self.result.left_out = (*of_muscles, *sentences_about(both), *self.prescribed(joints))
        self.result.left_out_of_runs = sentences_about(runs)
        return self.result

    def add_markers(self) -> None:
        """Add the markers."""
        for marker in objects_of(self.model, "MarkerSet"):
            body, place = self.frames.of_marker(marker)
            self.result.marker(name_of(marker), body, point=(place - self.centres[body]).tolist())

    def add_muscles(self, joints: list[Element]) -> list[str]:
        """Add the muscles, and return sentences about those that cannot be read, or not exactly."""
        values = {one.name: one.value for joint in joints for one in coordinates_of(joint, self.initial, self.speeds)}
        reader = MuscleReader(
            self.model, self.frames, self.centres, self.heights, self.result.coordinates, values, self.position
        )
        told, replaced = [], []
        for element in self.muscles():
            name = name_of(element)
            try:
                arguments = reader.muscle(element)
            except SpecError as reason:
                told.append(f"muscle '{name}' of the model of OpenSim is left out: {reason.message}")
                continue
            self.result.muscle(name, **arguments)
            if element.tag == "Thelen2003Muscle":
                replaced.append(name)
        if replaced:
            told.append(f"the curves of Thelen2003Muscle are replaced by those of Millard: {listed(replaced, 'and')}")
        return told

    def position(self, body: str, point: np.ndarray) -> np.ndarray:
        """Return the initial position (2,) of a point with the coordinates `point` (2,) in the frame of a body."""
        return self.poses[body].point(point, np.zeros(2))[0]

    def muscles(self) -> list[Element]:
        """Return the muscles that exert forces and whose classes can be read."""
        return [one for one in objects_of(self.model, "ForceSet") if one.tag in CURVES and not is_off(one)]

    def ends(self, joint: Element) -> tuple[OffsetFrame, OffsetFrame]:
        """Return the parent and the child frame of a joint."""
        return self.frames.of_joint(joint, "socket_parent_frame"), self.frames.of_joint(joint, "socket_child_frame")

    def constraints(self) -> list[Element]:
        """Return the constraints that are enforced."""
        found = objects_of(self.model, "ConstraintSet")
        return [constraint for constraint in found if flag_of(constraint, "isEnforced", default=True)]

    def refuse_constraints(self) -> None:
        """Raise SpecError if the model contains components that influence the motion but cannot be read."""
        for constraint in self.constraints():
            if constraint.tag not in ("CoordinateCouplerConstraint", "PointOnLineConstraint"):
                raise refused(f"{label_of(constraint)} is a constraint, which is not read; remove it or switch it off")
        for one in self.model.iterfind("components/*"):
            if one.tag == "Body" or one.tag.endswith(("Joint", "Constraint")):
                raise refused(f"{label_of(one)} stands outside of BodySet, JointSet and ConstraintSet")

    def check_names(self, joints: list[Element]) -> None:
        """Raise SpecError if a value is given for a coordinate that does not exist."""
        known = [name_of(one) for joint in joints for one in joint.iterfind("coordinates/Coordinate")]
        for key, values in (("initial", self.initial), ("speeds", self.speeds)):
            for name in values:
                if name not in known:
                    hint = did_you_mean(name, known) or f"; there are {listed(known)}"
                    raise SpecError(f"there is no coordinate '{name}'{hint}", key=f"model.{key}.{quoted(name)}")

    def left_out(self) -> tuple[Names, Names, Names]:
        """Return the names of components that are not read, by kind: those that may change motion or forces, those
        whose forces inverse dynamics computes anyway, and those that exert no force unless something controls them.
        """
        both, runs, idle = Names(list), Names(list), Names(list)
        read = {name_of(component) for component in self.muscles()} & {*self.result.muscles}
        unread = [*unread_in(self.model), *(unread for one in self.constraints() for unread in unread_in(one))]
        for component in (*objects_of(self.model, "ForceSet"), *objects_of(self.model, "ControllerSet")):
            if component.tag in CURVES and name_of(component) in read:
                unread += unread_in(component)
            elif component.tag in IDLE or is_off(component):
                idle[component.tag].append(name_of(component))
            elif component.tag not in CURVES or not self.with_muscles:  # add_muscles names the others
                unread.append(Unread(component.tag, name_of(component), component.tag))
        for label, name, kind in unread:
            (runs if is_actuator(kind) else both)[label].append(name)
        return both, runs, idle

    def prescribed(self, joints: list[Element]) -> list[str]:
        """Return a sentence that names the coordinates with a prescribed motion, which is left out."""
        coordinates = (component for joint in joints for component in joint.iterfind("coordinates/Coordinate"))
        names = [name_of(component) for component in coordinates if flag_of(component, "prescribed")]
        what = f"the prescribed motion of {listed(names, 'and')} is left out: these coordinates are free"
        return [what] if names else []

    def add(self, joint: Element, parent: OffsetFrame, child: OffsetFrame) -> None:
        """Add a joint and its child body."""
        label = label_of(joint)
        if child.body == "ground" or child.body in self.poses:
            raise refused(f"{label} closes a loop at '{child.body}'; make its child a body that no other joint holds")
        if parent.side != child.side:
            raise refused(f"{label} is not planar: it turns the z axis of '{child.body}' around")
        moved = planar_joint(joint, coordinates_of(joint, self.initial, self.speeds))
        self.place(child, parent, moved)
        self.connect(name_of(joint), parent, child, moved)

    def place(self, child: OffsetFrame, parent: OffsetFrame, moved: PlanarJoint) -> None:
        """Add the child body at its initial position."""
        angle, slope = self.relative(parent, child, moved)
        turned = 0.0 if moved.angle.coordinate is None else moved.angle.coordinate.value
        spin = 0.0 if moved.angle.coordinate is None else slope * moved.angle.coordinate.speed
        local, drift = parent.place.copy(), np.zeros(2)
        for direction, term in moved.directions:
            local = local + parent.axes @ direction * term.value
            drift = drift + parent.axes @ direction * term.rate
        base = self.poses[parent.body]
        place, velocity = base.point(local, drift)
        now = _Pose(place, base.angle + angle + slope * turned, velocity, base.spin + spin)
        origin, speed = now.point(-child.place, np.zeros(2))
        self.poses[child.body] = _Pose(origin, now.angle, speed, now.spin)
        self.heights[child.body] = self.heights[parent.body] + parent.height + parent.side * moved.height - child.height
        body = self.bodies[child.body]
        centre, motion = self.poses[child.body].point(self.centres[child.body], np.zeros(2))
        inertia = float(numbers_of(body, "inertia", 6, "0 0 0 0 0 0")[2])
        if (mass := number_of(body, "mass", "0")) <= 0:
            raise refused(f"body '{child.body}' has no mass; weld it to another body in OpenSim, or give it one")
        angles = {"angle": now.angle, "angular_velocity": now.spin} if inertia else {}
        self.result.body(
            child.body, mass=mass, inertia=inertia or None, position=centre.tolist(), velocity=motion.tolist(), **angles
        )

    def relative(self, parent: OffsetFrame, child: OffsetFrame, moved: PlanarJoint) -> tuple[float, float]:
        """Return offset and slope of the relative angle of the two bodies as a linear function of the joint's
        coordinate.
        """
        intercept, *slope = moved.angle.function.polynomial or (0.0,)
        between = _angle(parent.axes) - _angle(child.axes)
        return between + parent.side * intercept, parent.side * (slope[0] if slope else 0.0)

    def connect(self, name: str, parent: OffsetFrame, child: OffsetFrame, moved: PlanarJoint) -> None:
        """Add the joint between two bodies, and assign the names of its coordinates."""
        rest = parent.place + sum(
            (parent.axes @ direction * term.value for direction, term in moved.directions if not term.varies),
            np.zeros(2),
        )
        offset, _ = self.relative(parent, child, moved)
        if moved.angle.varies and {term.coordinate for _, term in moved.moving} <= {moved.angle.coordinate}:
            self.pin(name, parent, child, moved, rest)
        elif not moved.angle.varies and not moved.moving:
            self.result.weld(name, parent.body, child.body, points=self.points(parent, child, rest), angle=offset)
        elif not moved.angle.varies and len(moved.moving) == 1 and _is_linear(moved.moving[0][1]):
            direction, term = moved.moving[0]
            axis, points = (parent.axes @ direction).tolist(), self.points(parent, child, rest)
            self.result.prismatic(name, parent.body, child.body, points=points, axis=axis, angle=offset)
            quantity = f"({axis[0]!r})*x + ({axis[1]!r})*y"
            pair = PairCoordinate((parent.body, child.body), quantity, *_line(term), points)
            self.name_coordinate(term.coordinate, f"{name}.angle", pair)
        elif parent.body == "ground" and len(moved.coordinates) == 3 and all(_is_linear(t) for _, t in moved.moving):
            self.free(name, parent, child, moved, rest)
        else:
            raise refused(
                f"{moved.label} is not read: it is none of a pin, a pin whose center moves with its angle, a slide, a "
                "weld, and a body that moves freely against the ground"
            )

    def points(self, parent: OffsetFrame, child: OffsetFrame, place: np.ndarray) -> tuple[list[float], list[float]]:
        """Return the two points of a joint relative to the centres of mass; `place` is a position in the frame of the
        parent body.
        """
        return (place - self.centres[parent.body]).tolist(), (child.place - self.centres[child.body]).tolist()

    def pin(self, name: str, parent: OffsetFrame, child: OffsetFrame, moved: PlanarJoint, rest: np.ndarray) -> None:
        """Add a revolute joint. A moving center is given relative to its position where the coordinate is 0."""
        offset, slope = self.relative(parent, child, moved)
        parts = [(parent.axes @ direction, term.function) for direction, term in moved.moving]
        parts += [(-direction, constant(function(0.0))) for direction, function in parts]
        rest = rest + sum((parent.axes @ d * term.function(0.0) for d, term in moved.moving), np.zeros(2))
        center = {
            key: center_of([(float(d[axis]), function) for d, function in parts], slope, offset, moved.label)
            for axis, key in enumerate("xy")
        }
        points = self.points(parent, child, rest)
        self.result.revolute(name, parent.body, child.body, points=points, center=center if parts else None)
        pair = PairCoordinate((parent.body, child.body), "angle", slope, offset)
        self.name_coordinate(moved.angle.coordinate, f"{name}.angle", pair)

    def free(self, name: str, parent: OffsetFrame, child: OffsetFrame, moved: PlanarJoint, rest: np.ndarray) -> None:
        """Name the coordinates of a body that moves freely: those of a marker at the origin of its frame, and its
        angle.
        """
        marker = name if all(name_of(one) != name for one in objects_of(self.model, "MarkerSet")) else f"{name}_frame"
        self.result.marker(marker, child.body, point=(child.place - self.centres[child.body]).tolist())
        for direction, term in moved.moving:
            axis = parent.axes @ direction
            along = int(np.argmax(np.abs(axis)))
            if abs(axis[1 - along]) > 1e-9:
                raise refused(f"{moved.label} is not read: its displacements are not along the axes of the ground")
            slope, offset = _line(term)
            sign = float(np.sign(axis[along]))
            line = sign * slope, sign * offset + float(rest[along])
            points = [0.0, 0.0], (child.place - self.centres[child.body]).tolist()
            pair = PairCoordinate(("ground", child.body), "xy"[along], *line, points)
            self.name_coordinate(term.coordinate, f"{marker}.{'xy'[along]}", pair)
        offset, slope = self.relative(parent, child, moved)
        pair = PairCoordinate(("ground", child.body), "angle", slope, offset)
        self.name_coordinate(moved.angle.coordinate, f"{child.body}.angle", pair)

    def add_point_on_line(self, constraint: Element) -> None:
        """Add a point of a body that stays on a line of another one."""
        ends = []
        for body, place in (("line", "point_on_line"), ("follower", "point_on_follower")):
            name, origin, axes = self.frames.of_socket(constraint, f"socket_{body}_body")
            ends.append((name, origin + axes @ numbers_of(constraint, place, 3, "0 0 0"), axes))
        (first, on_line, axes), (second, point, _) = ends
        direction = axes @ numbers_of(constraint, "line_direction_vec", 3, "0 0 0")
        length = float(np.linalg.norm(direction))
        if length == 0.0:
            raise refused(f"{label_of(constraint)} has a line without direction")
        apart = self.heights[first] + on_line[2] - self.heights[second] - point[2]
        if abs(direction[2]) > FLAT * length or abs(apart) > FLAT:
            raise refused(f"{label_of(constraint)} is not planar: its line and its point are not at one constant z")
        points = (on_line[:2] - self.centres[first]).tolist(), (point[:2] - self.centres[second]).tolist()
        name = self.free_name(constraint)
        self.result.point_on_line(name, first, second, points=points, axis=(direction[:2] / length).tolist())

    def add_coupler(self, constraint: Element) -> None:
        """Add the coupling of two coordinates, if both follow from the relative pose of two bodies."""
        label = label_of(constraint)
        names = text_of(constraint, "independent_coordinate_names").split()
        if len(names) != 1:
            raise refused(f"{label} is not read: it depends on {len(names)} coordinates, not on one")
        function = function_named(constraint, "coupled_coordinates_function", label)
        if function.spline is not None:
            raise refused(f"{label} is not read: its function is a spline; polynomials and linear functions are")
        pairs = []
        for name in (text_of(constraint, "dependent_coordinate_name"), names[0]):
            if (pair := self.of_pairs.get(last_part(name))) is None:
                raise refused(f"{label} couples '{name}', which is no free coordinate of the model")
            pairs.append(pair)
        dependent, independent = pairs
        scale = number_of(constraint, "scale_factor", "1")
        for bodies in (dependent.bodies, independent.bodies, (independent.bodies[1], dependent.bodies[1])):
            own, other = dependent.expression(*bodies), independent.expression(*bodies)
            given = [pair.points for pair in pairs if pair.bodies == bodies and pair.points]
            if bodies[0] == bodies[1] or own is None or other is None or given[1:] not in ([], given[:1]):
                continue
            powers = [
                f"({scale * c!r})*({other})**{n}" if n else repr(scale * c) for n, c in enumerate(function.polynomial)
            ]
            self.result.add(
                "joints", self.free_name(constraint), type="coupling", bodies=list(bodies),
                points=list(given[0]) if given else [[0.0, 0.0], [0.0, 0.0]],
                equation=f"{own} - ({' + '.join(powers)})", unit="rad" if dependent.quantity == "angle" else "m",
            )  # fmt: skip
            return
        raise refused(
            f"{label} is not read: a coupling knows the relative position of two bodies and the angle of the first, "
            "from which its coordinates do not both follow"
        )

    def free_name(self, constraint: Element) -> str:
        """Return the name of a constraint, changed if a joint has it."""
        name = name_of(constraint)
        while name in self.result.joints:
            name += "'"
        return name

    def name_coordinate(self, coordinate: OsimCoordinate | None, of: str, pair: PairCoordinate) -> None:
        """Assign the name of a coordinate to the quantity `of`, whose line is that of the pair, and keep the pair."""
        assert coordinate is not None, "only a free coordinate moves a joint"
        self.of_pairs[coordinate.name] = pair
        self.result.coordinate(coordinate.name, of, scale=1.0 / pair.slope, offset=-float(pair.offset) / pair.slope)


def _by_name(elements: Iterable[Element]) -> dict[str, Element]:
    """Return components by name; raise SpecError if two have the same name."""
    named: dict[str, Element] = {}
    for element in elements:
        if named.setdefault(name_of(element), element) is not element:
            raise refused(f"two components are called {label_of(element)}")
    return named


def _is_linear(term: Term) -> bool:
    return term.function.spline is None and term.function.degree == 1


def _line(term: Term) -> tuple[float, float]:
    offset, slope, *_ = term.function.polynomial
    return slope, offset


def _angle(axes: np.ndarray) -> float:
    """Return the angle [rad] of the first of two axes."""
    return math.atan2(axes[1, 0], axes[0, 0])


def sentences_about(dropped: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Return a sentence for each kind of ignored components, with the names of some of them."""
    return tuple(
        f"the model of OpenSim has {len(names)} {kind}, which the mechanism leaves out: "
        f"{listed(names, 'and', MOST_NAMED)}"
        for kind, names in dropped.items()
    )
