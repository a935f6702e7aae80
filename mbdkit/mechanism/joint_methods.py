"""Methods of a mechanism that add bodies, beams and joints, and what all methods that add elements have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeVar

from pydantic import ValidationError

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import parse_path, quoted
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.angle_function import Center
from mbdkit.mechanism.beams import Beam, last_nodes, with_body
from mbdkit.mechanism.bodies import Body, Element
from mbdkit.mechanism.checks import check_known, check_name
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.joint_friction import JointFriction
from mbdkit.mechanism.joints import Distance, Driver, Joint, PointOnLine, Prismatic, Revolute, Weld
from mbdkit.mechanism.parameters import with_expressions
from mbdkit.mechanism.values import Table

Pair = Sequence[float]
Value = float | str | Table | Mapping[str, Any]
"""A number, an expression of t, or ``{"table": [[t, ...], [value, ...]]}``."""
AnyElement = TypeVar("AnyElement", bound=StrictModel)
AnyPlaced = TypeVar("AnyPlaced", bound=Element)


class JointMethods:
    """The part of `Mechanism` that adds bodies, beams and joints."""

    bodies: dict[str, Body]
    beams: dict[str, Beam]
    joints: dict[str, Joint]
    forces: dict[str, Force]

    def body(
        self,
        name: str,
        *,
        mass: float,
        inertia: float | None = None,
        position: Pair = (0.0, 0.0),
        angle: float = 0.0,
        velocity: Pair = (0.0, 0.0),
        angular_velocity: float = 0.0,
    ) -> str:
        """Add a rigid body, or a point mass if `inertia` is omitted, and return its name.

        Parameters
        ----------
        name, mass
            Name of the body, and its mass [kg].
        inertia
            Moment of inertia about the centre of mass [kg m^2]; None for a point mass.
        position, angle
            Initial position of the centre of mass (x, y) [m] and angle from the +x axis [rad].
        velocity, angular_velocity
            Initial velocity (x, y) [m/s] and angular velocity [rad/s].

        Examples
        --------
        >>> m = Mechanism()
        >>> m.body("rod", mass=2.0, inertia=2.0 * 1.5**2 / 12, position=(0.75, 0.0))
        'rod'
        """
        key = self._new("bodies", name)
        start = {"position": position, "angle": angle, "velocity": velocity, "angular_velocity": angular_velocity}
        self.bodies[name] = made(Body, key, mass=mass, inertia=inertia, **start)
        return name

    def beam(
        self,
        name: str,
        *,
        a: Pair | None = None,
        b: Pair | None = None,
        points: Sequence[Pair] | None = None,
        elements: int = 16,
        nodes: Literal[2, 3] = 2,
        stiffness: Mapping[str, float | str] | None = None,
        **properties: Any,
    ) -> tuple[str, ...]:
        """Add a flexible beam and return the names of its nodes, which are bodies.

        Connect its ends, or any other node, with joints: a weld clamps it, a revolute joint pins it.

        Parameters
        ----------
        name
            Name of the beam; its nodes are ``name.0``, ``name.1``, ...
        a, b
            Ends of a straight beam (x, y) [m] in the global frame.
        points
            Alternative to `a` and `b`: three or more points (x, y) [m] of a curved beam.
        elements
            Number of elements.
        nodes
            Nodes of an element, 2 or 3; the errors are of order 2 or 4 in the length of an element.
        stiffness
            Stiffnesses in place of those that follow from E, G, A and I: ``{"axial": N, "shear": N or "none",
            "bending": N m^2}``.
        **properties
            ``E`` and ``G`` [Pa] or ``nu``, ``A`` [m^2], ``I`` [m^4], ``shear_factor``, ``density`` [kg/m^3];
            ``mass_per_length`` [kg/m], ``rotary_inertia`` [kg m], ``damping`` [s]; ``velocity`` (x, y) [m/s],
            ``angular_velocity`` [rad/s]; ``load`` (x, y) [N/m], ``load_frame``; ``start``; ``corrected``. See ``Beam``.

        Examples
        --------
        A cantilever of steel, 2 m long:

        >>> m = Mechanism()
        >>> steel = {"E": 2.1e11, "nu": 0.3, "density": 7850.0}
        >>> nodes = m.beam("arm", a=(0, 0), b=(2, 0), elements=8, A=1e-4, I=8.3e-10, **steel)
        >>> nodes[0], nodes[-1]
        ('arm.0', 'arm.8')
        >>> m.weld("clamp", m.ground, nodes[0], at=(0, 0))
        """
        key = self._new("beams", name)
        shape = {"a": a, "b": b, "points": points, "elements": elements, "nodes": nodes, "stiffness": stiffness}
        self._add_beam(name, made(Beam, key, **shape, **properties))
        return self.beams[name].node_names(name)

    def revolute(
        self,
        name: str,
        a: str,
        b: str,
        *,
        at: Pair | None = None,
        points: Sequence[Pair] | None = None,
        center: Mapping[str, Any] | Center | None = None,
        friction: Mapping[str, Any] | JointFriction | None = None,
    ) -> None:
        """Connect bodies `a` and `b` by a revolute joint.

        Parameters
        ----------
        name, a, b
            Name of the joint, and the two bodies.
        at
            Position of the joint (x, y) [m] in the global frame at the initial positions.
        points
            Alternative to `at`: position of the joint in the frames of a and of b, ((x, y), (x, y)) [m].
        center
            Displacement of a's point in a's frame as a function of angle_b - angle_a, ``{"x": ..., "y": ...}`` [m]:
            numbers, expressions of `angle`, or tables ``{"table": [[angle, ...], [value, ...]]}``. `at` is then the
            displaced point at the initial positions.
        friction
            Dry friction of the pin, such as ``{"coefficient": 0.1, "radius": 0.01}``.

        Examples
        --------
        >>> m = Mechanism()
        >>> rod = m.body("rod", mass=2.0, inertia=0.375, position=(0.75, 0.0))
        >>> m.revolute("A", m.ground, rod, at=(0.0, 0.0))

        A wheel of radius 0.3 m that rolls on the x axis:

        >>> wheel = m.body("wheel", mass=1.0, inertia=0.045, position=(0.0, 0.3))
        >>> m.revolute("rolls", m.ground, wheel, at=(0.0, 0.3), center={"x": "-0.3*angle"})
        """
        self._add("joints", Revolute, name, bodies=(a, b), points=points, at=at, center=center, friction=friction)

    def prismatic(
        self,
        name: str,
        a: str,
        b: str,
        *,
        at: Pair | None = None,
        points: Sequence[Pair] | None = None,
        axis: Pair,
        angle: float | None = None,
        friction: Mapping[str, Any] | JointFriction | None = None,
    ) -> None:
        """Connect bodies `a` and `b` by a prismatic joint: `b` slides along a line of `a` without relative rotation.

        Parameters
        ----------
        name, a, b
            Name of the joint, and the two bodies; the line is fixed to a.
        at
            Point (x, y) [m] in the global frame at the initial positions: both the sliding point of b and a point of
            the line.
        points
            Alternative to `at`: a point of the line in a's frame and the sliding point in b's, ((x, y), (x, y)) [m].
        axis
            Direction of the line (x, y) in a's frame; any length.
        angle
            angle_b - angle_a [rad]; by default, the difference between the given initial angles.
        friction
            Dry friction of the slide, such as ``{"coefficient": 0.1, "length": 0.05}``.

        Examples
        --------
        >>> m = Mechanism()
        >>> slider = m.body("slider", mass=1.0, inertia=0.1, position=(2.0, 0.0))
        >>> m.prismatic("guide", m.ground, slider, at=(2.0, 0.0), axis=(1, 0))
        """
        values = {"bodies": (a, b), "points": points, "at": at, "axis": axis, "angle": angle, "friction": friction}
        self._add("joints", Prismatic, name, **values)

    def point_on_line(
        self,
        name: str,
        a: str,
        b: str,
        *,
        at: Pair | None = None,
        points: Sequence[Pair] | None = None,
        axis: Pair,
        friction: Mapping[str, Any] | JointFriction | None = None,
    ) -> None:
        """Hold a point of `b` on a line of `a`, as a pin in a slot or a roller does; `b` may turn.

        Parameters
        ----------
        name, a, b
            Name of the joint, and the two bodies; the line is fixed to a.
        at
            Point (x, y) [m] in the global frame at the initial positions: both the point of b and a point of the line.
        points
            Alternative to `at`: a point of the line in a's frame and the point of b in b's, ((x, y), (x, y)) [m].
        axis
            Direction of the line (x, y) in a's frame; any length.
        friction
            Dry friction along the line, such as ``{"coefficient": 0.1}``.
        """
        self._add("joints", PointOnLine, name, bodies=(a, b), points=points, at=at, axis=axis, friction=friction)

    def weld(
        self,
        name: str,
        a: str,
        b: str,
        *,
        at: Pair | None = None,
        points: Sequence[Pair] | None = None,
        angle: float | None = None,
    ) -> None:
        """Connect bodies `a` and `b` rigidly.

        Parameters
        ----------
        name, a, b
            Name of the joint, and the two bodies.
        at
            Position of the joint (x, y) [m] in the global frame at the initial positions.
        points
            Alternative to `at`: position of the joint in the frames of a and of b, ((x, y), (x, y)) [m].
        angle
            angle_b - angle_a [rad]; by default, the difference between the given initial angles.
        """
        self._add("joints", Weld, name, bodies=(a, b), points=points, at=at, angle=angle)

    def distance(
        self,
        name: str,
        a: str,
        b: str,
        *,
        from_: Pair | None = None,
        to: Pair | None = None,
        points: Sequence[Pair] | None = None,
        length: float | None = None,
    ) -> None:
        """Hold a point of `a` and a point of `b` at a constant distance.

        Parameters
        ----------
        name, a, b
            Name of the joint, and the two bodies.
        from_, to
            The point of a and the point of b (x, y) [m] in the global frame at the initial positions.
        points
            Alternative to `from_` and `to`: the points in the frames of a and of b, ((x, y), (x, y)) [m].
        length
            Distance [m]; by default, the distance between `from_` and `to`.
        """
        values = {"bodies": (a, b), "points": points, "from": from_, "to": to, "length": length}
        self._add("joints", Distance, name, **values)

    def driver(
        self,
        name: str,
        a: str,
        b: str,
        *,
        coordinate: Literal["angle", "x", "y"],
        motion: Value,
        points: Sequence[Pair] | None = None,
    ) -> None:
        """Prescribe the motion of `b` relative to `a`.

        Parameters
        ----------
        name, a, b
            Name of the driver, and the two bodies.
        coordinate
            ``angle`` (angle_b - angle_a), or the coordinate ``x`` or ``y`` of b's point in a's frame.
        motion
            Prescribed value of the coordinate [rad or m]: number, expression of t, or table.
        points
            For `x` and `y`: ((0, 0), b's point in b's frame) [m]; by default, b's origin.

        Examples
        --------
        >>> m = Mechanism()
        >>> crank = m.body("crank", mass=1.0, inertia=0.1)
        >>> m.revolute("A", m.ground, crank, at=(0.0, 0.0))
        >>> m.driver("motor", m.ground, crank, coordinate="angle", motion="2*pi*t")
        """
        self._add("joints", Driver, name, bodies=(a, b), coordinate=coordinate, motion=motion, points=points)

    def _new(self, kind: str, name: str) -> str:
        """Return the key of a new element in a spec; raise SpecError if the name is not valid or in use."""
        key = f"model.{kind}.{quoted(name)}"
        check_name(name, key)
        if name in getattr(self, kind):
            raise SpecError(f"the name '{name}' is already in use", key=key)
        return key

    def _add_beam(self, name: str, beam: Beam) -> None:
        """Add a beam with its nodes and with the forces that replace its load."""
        self.beams[name] = beam
        self.bodies |= beam.bodies(name)
        self.forces |= beam.loads(name)

    def _known(self, name: str, key: str) -> None:
        check_known(name, self.bodies, key)

    def _add(self, kind: str, cls: type[Element], name: str, /, **values: Any) -> None:
        """Add an element with its points in the frames of its bodies."""
        key = self._new(kind, name)
        getattr(self, kind)[name] = self._with_points(made(cls, key, **values), key)

    def _with_points(self, element: AnyPlaced, key: str) -> AnyPlaced:
        """Return an element with its points in the frames of its bodies, which must exist."""
        last = last_nodes(self.beams)
        for place, body in element.places():
            # ``BEAM.last`` is not accepted in `among`, because its shapes are a mapping by names of bodies.
            if body in last and not place.startswith("among"):
                element = with_body(element, parse_path(place), last[body])
                continue
            self._known(body, f"{key}.{place}")
        return element.placed(self.bodies, key)


def made(cls: type[AnyElement], key: str, /, **values: Any) -> AnyElement:
    """Return an element with these values; raise SpecError, with the element's `key`, if they are not valid."""
    try:
        return cls.model_validate(values)
    except ValidationError:
        opened = _opened(values)
    try:  # rejected values may be numbers with units, such as "2 N/mm"
        made, _ = with_expressions(lambda data: cls.model_validate(_closed(data)), opened, cls, {}, prefix=key)
    except SpecError as error:
        raise error if error.key.startswith(key) else error.located(prefix=key) from None
    return made


class _Tuple(list[Any]):
    """A mutable copy of a tuple."""


def _opened(value: Any) -> Any:
    """Return data in which tuples are replaced by mutable copies."""
    if isinstance(value, Mapping):
        return {name: _opened(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return (list if isinstance(value, list) else _Tuple)(map(_opened, value))
    return value


def _closed(value: Any) -> Any:
    """Return the data with which `_opened` was called, with the items replaced since then."""
    if isinstance(value, dict):
        return {name: _closed(item) for name, item in value.items()}
    if isinstance(value, list):
        return (tuple if isinstance(value, _Tuple) else list)(map(_closed, value))
    return value
