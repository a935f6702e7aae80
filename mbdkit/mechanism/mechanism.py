"""The mechanism: named bodies, beams, joints, forces and markers, with a builder, checks, and conversion to specs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from pydantic import TypeAdapter, ValidationError

from mbdkit.base import higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.base.html_view import HtmlView
from mbdkit.base.plain_data import parse_path, plain, quoted, value_text
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.text import counted
from mbdkit.mechanism.angle_function import Center
from mbdkit.mechanism.beams import Beam, last_nodes, parts_of, with_body
from mbdkit.mechanism.bodies import GROUND, Body, Element, Marker
from mbdkit.mechanism.checks import check_centers, check_known, check_mechanism, check_name, check_names, check_tables
from mbdkit.mechanism.contacts import Contact, Treatment, check_contacts, feet
from mbdkit.mechanism.forces import Force, PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.joint_friction import JointFriction
from mbdkit.mechanism.joints import Distance, Driver, Joint, PointOnLine, Prismatic, Revolute, Weld
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism_data import ELEMENTS, Assembly, MechanismData, NamedCoordinate, check_coordinates
from mbdkit.mechanism.muscles import Muscle, check_moving_points
from mbdkit.mechanism.parameters import parameter_values, with_expressions
from mbdkit.mechanism.state_values import Controller, FirstOrderState
from mbdkit.mechanism.validation_errors import spec_error
from mbdkit.mechanism.values import Motion, Point, Table

if TYPE_CHECKING:
    from mbdkit_statics.symbolic_system import SymbolicSystem

Pair = Sequence[float]
Value = float | str | Table | Mapping[str, Any]
"""A number, an expression of t, or ``{"table": [[t, ...], [value, ...]]}``."""
AnyElement = TypeVar("AnyElement", bound=StrictModel)
AnyPlaced = TypeVar("AnyPlaced", bound=Element)
AnyValue = TypeVar("AnyValue")

_POINT: TypeAdapter[tuple[float, float]] = TypeAdapter(Point)


def gravity_text(gravity: Sequence[float]) -> str:
    """Return a gravitational acceleration (x, y) [m/s^2] as text; ``none`` if it is zero."""
    x, y = gravity
    return f"({x:g}, {y:g}) m/s^2" if x or y else "none"


class Mechanism(HtmlView):
    """A planar multibody system as data.

    Build it with its methods or with :meth:`from_spec`. Bodies are referred to by name: :meth:`body` returns the name,
    and `ground` is the fixed global frame. Points are given either in the frames of the bodies (`points`) or in the
    global frame at the initial positions (`at`, `from_`, `to`). Add a body before the elements that refer to it.

    Parameters
    ----------
    gravity
        Gravitational acceleration (x, y) [m/s^2].
    name
        Name of the mechanism, the title of its runs.

    Attributes
    ----------
    bodies, joints, forces, markers, muscles, contacts : dict
        The elements by name, in the order in which they were added.
    beams : dict
        The beams by name. Their nodes are among `bodies`, and the forces that replace their distributed loads are among
        `forces`.
    assembly : Assembly
        Settings for making the initial state consistent.
    coordinates : dict
        Named coordinates, `NamedCoordinate` by name.
    states : dict
        First-order states of the mechanism itself by name.
    controllers : dict
        Sampled controllers by name.
    muscles_act : bool
        Whether muscles are force elements, as in runs. In inverse dynamics they are not; the moments of actuators are
        distributed to the muscles instead.
    contact_treatment : Treatment
        How contacts act in a run.
    warnings : tuple of str
        Warnings for every run of the mechanism, such as parts of a file that were ignored. They do not change the
        verdict, and are not part of a spec.
    left_out : tuple of str
        Sentences about effects that the model describes and the mechanism lacks, such as a contact in a file, although
        they change the motion. They make the verdict doubtful unless a spec accepts `left-out`, and are not part of a
        spec.
    left_out_of_runs : tuple of str
        Sentences about muscles, actuators and controllers in a file that the mechanism lacks. They are like `left_out`
        for runs, and `warnings` for inverse dynamics, which computes the forces of actuators from the motion.

    Examples
    --------
    >>> m = Mechanism()
    >>> rod = m.body("rod", mass=1, inertia=1 / 12, position=(0.5, 0))
    >>> m.revolute("A", m.ground, rod, at=(0, 0))
    >>> m.joints["A"].points
    ((0.0, 0.0), (-0.5, 0.0))
    """

    joints: dict[str, Joint]
    forces: dict[str, Force]
    markers: dict[str, Marker]
    muscles: dict[str, Muscle]
    contacts: dict[str, Contact]

    def __init__(self, gravity: Pair = (0.0, -9.81), *, name: str = "mechanism"):
        self.name = name
        self.gravity = _point(gravity, "model.gravity")
        self.bodies: dict[str, Body] = {}
        self.beams: dict[str, Beam] = {}
        for kind in ELEMENTS:
            setattr(self, kind, {})
        self.assembly = Assembly()
        self.coordinates: dict[str, NamedCoordinate] = {}
        self.states: dict[str, FirstOrderState] = {}
        self.controllers: dict[str, Controller] = {}
        self.muscles_act = False
        self.contact_treatment = Treatment()
        self.warnings: tuple[str, ...] = ()
        self.left_out: tuple[str, ...] = ()
        self.left_out_of_runs: tuple[str, ...] = ()

    @property
    def ground(self) -> str:
        """Name of the fixed global frame, for use as a body argument."""
        return GROUND

    @property
    def elements(self) -> dict[str, dict[str, Element]]:
        """The joints, forces, markers, muscles and contacts: for each kind, the elements by name."""
        return {kind: getattr(self, kind) for kind in ELEMENTS}

    # ---- builder -------------------------------------------------------------------------------------------------

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
        key = self._new(name, self.bodies, "bodies")
        self.bodies[name] = _make(
            Body,
            key,
            mass=mass,
            inertia=inertia,
            position=position,
            angle=angle,
            velocity=velocity,
            angular_velocity=angular_velocity,
        )
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
        key = self._new(name, self.beams, "beams")
        shape = {"a": a, "b": b, "points": points, "elements": elements, "nodes": nodes, "stiffness": stiffness}
        self._add_beam(name, _make(Beam, key, **shape, **properties))
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

    def spring_damper(
        self,
        name: str,
        a: str,
        b: str,
        *,
        from_: Pair | None = None,
        to: Pair | None = None,
        points: Sequence[Pair] | None = None,
        stiffness: float = 0.0,
        damping: float = 0.0,
        free_length: float = 0.0,
    ) -> None:
        """Add a linear spring and damper between a point of `a` and a point of `b`.

        Parameters
        ----------
        name, a, b
            Name of the force element, and the two bodies.
        from_, to
            The point of a and the point of b (x, y) [m] in the global frame at the initial positions.
        points
            Alternative to `from_` and `to`: the points in the frames of a and of b, ((x, y), (x, y)) [m].
        stiffness, damping, free_length
            Stiffness [N/m], damping [N s/m], and length at which the spring exerts no force [m].

        Examples
        --------
        >>> m = Mechanism()
        >>> ball = m.body("ball", mass=1.0, position=(0.0, -1.0))
        >>> m.spring_damper("s", m.ground, ball, from_=(0, 0), to=(0, -1), stiffness=100, damping=0.5, free_length=0.9)
        """
        ends = {"bodies": (a, b), "points": points, "from": from_, "to": to}
        self._add("forces", SpringDamper, name, **ends, stiffness=stiffness, damping=damping, free_length=free_length)

    def torsion_spring(
        self, name: str, a: str, b: str, *, stiffness: float = 0.0, damping: float = 0.0, free_angle: float = 0.0
    ) -> None:
        """Add a linear torsion spring and damper between `a` and `b`, acting on angle_b - angle_a.

        Parameters
        ----------
        name, a, b
            Name of the force element, and the two bodies.
        stiffness, damping, free_angle
            Stiffness [N m/rad], damping [N m s/rad], and relative angle at which the spring exerts no torque [rad].

        Examples
        --------
        >>> m = Mechanism()
        >>> shank = m.body("shank", mass=3.0, inertia=0.05)
        >>> m.torsion_spring("knee", m.ground, shank, stiffness=20.0, damping=0.1)
        """
        self._add(
            "forces", TorsionSpring, name, bodies=(a, b), stiffness=stiffness, damping=damping, free_angle=free_angle
        )

    def law(
        self,
        name: str,
        a: str,
        b: str,
        *,
        law: str,
        along: Literal["line", "angle", "x", "y"] = "line",
        from_: Pair | None = None,
        to: Pair | None = None,
        points: Sequence[Pair] | None = None,
        **options: Any,
    ) -> None:
        """Add a force given by a force law along a pathway between `a` and `b`.

        Parameters
        ----------
        name, a, b
            Name of the force element, and the two bodies.
        law
            Name of the force law: ``one-sided``, ``exponential``, ``gas-spring``, ``table``, ``linear``, or a plugin's.
        along
            The length of the pathway: ``line``, the distance between two points [m]; ``angle``, angle_b - angle_a
            [rad]; or ``x`` or ``y``, a coordinate of b's point in a's frame [m].
        from_, to
            For a line: the point of a and the point of b (x, y) [m] in the global frame at the initial positions.
        points
            For a line, alternative to `from_` and `to`: the points in the frames of a and of b, ((x, y), (x, y)) [m].
            For `x` and `y`: ((0, 0), b's point in b's frame) [m]; by default, b's origin.
        **options
            Options of the force law; ``mbdkit plugins show LAW`` lists them.

        Examples
        --------
        A rope, which only pulls:

        >>> m = Mechanism()
        >>> ball = m.body("ball", mass=1.0, position=(0.0, -1.0))
        >>> m.law("rope", m.ground, ball, law="one-sided", from_=(0, 0), to=(0, -1), stiffness=1e4, acts="tension")
        """
        pathway: dict[str, Any] = {"bodies": (a, b)}
        if along == "line":
            pathway |= {"type": "two-points", "points": points, "from": from_, "to": to}
        else:
            if from_ is not None or to is not None:
                raise SpecError(
                    f"from_ and to can be given only with along='line', not with along='{along}'",
                    key=f"model.forces.{quoted(name)}",
                )
            pathway |= {"type": "relative-angle"} if along == "angle" else {"type": "coordinate", "coordinate": along}
            if points is not None:
                pathway["points"] = points
        self._add("forces", Law, name, law=law, pathway=pathway, **options)

    def cable(
        self, name: str, radii: Mapping[str, float], *, law: str = "one-sided", length: float = 0.0, **options: Any
    ) -> None:
        """Add a cable over pulleys at one or several joints, such as an exotendon, with a force law.

        Its length is ``length - sum(radius * angle of the joint)``. Add the joints before the cable.

        Parameters
        ----------
        name
            Name of the force element.
        radii
            Radius of the pulley at each joint, by the name of the joint [m]. The tension of the cable increases the
            angle of a joint with positive radius, and decreases it with negative radius.
        law
            Name of the force law, ``one-sided`` by default.
        length
            Length where all angles are zero [m].
        **options
            Options of the force law; ``mbdkit plugins show LAW`` lists them.

        Examples
        --------
        >>> m = Mechanism()
        >>> shank = m.body("shank", mass=3.0, inertia=0.05, position=(0.0, -0.2))
        >>> m.revolute("knee", m.ground, shank, at=(0, 0))
        >>> m.cable("tendon", {"knee": 0.04}, stiffness=1e4, free_length=-0.01, acts="tension")
        """
        pathway = {"type": "joint-angles", "angles": dict(radii), "length": length}
        self._add("forces", Law, name, law=law, pathway=pathway, **options)

    def torque(self, name: str, body: str, *, value: Value, reaction_body: str | None = None) -> None:
        """Apply a torque to a body.

        Parameters
        ----------
        name, body
            Name of the force element, and of the body that the torque acts on.
        value
            Torque [N m]: number, expression of t or of the state, or table.
        reaction_body
            Name of the body that the opposite torque acts on, if any.

        Examples
        --------
        >>> m = Mechanism()
        >>> crank = m.body("crank", mass=1.0, inertia=0.1)
        >>> m.torque("motor", crank, value="5*sin(2*t)")
        """
        self._add("forces", Torque, name, body=body, value=value, reaction_body=reaction_body)

    def force(
        self,
        name: str,
        body: str,
        *,
        value: Sequence[Value],
        at: Pair | None = None,
        point: Pair | None = None,
        frame: Literal["global", "body"] = "global",
    ) -> None:
        """Apply a force to a point of a body.

        Parameters
        ----------
        name, body
            Name of the force element, and of the body that the force acts on.
        value
            Force (x, y) [N]: numbers, expressions of t or of the state, or tables.
        at
            Point of application (x, y) [m] in the global frame at the initial position.
        point
            Alternative to `at`: point of application in the body's frame (x, y) [m]; the centre of mass by default.
        frame
            Frame of the components of `value`: ``global``, or ``body``, in which case the force turns with the body.

        Examples
        --------
        >>> m = Mechanism()
        >>> foot = m.body("foot", mass=1.0, inertia=0.01)
        >>> m.force("ground reaction", foot, value=(0.0, "700*sin(pi*t)"), point=(0.1, -0.05))
        """
        where = {"at": at} if point is None else {"at": at, "point": point}
        self._add("forces", PointForce, name, body=body, value=value, frame=frame, **where)

    def marker(self, name: str, body: str, *, at: Pair | None = None, point: Pair | None = None) -> None:
        """Name a point of a body, whose position and velocity the run records.

        Parameters
        ----------
        name, body
            Name of the marker, and of its body.
        at
            The point (x, y) [m] in the global frame at the initial position.
        point
            Alternative to `at`: the point in the body's frame (x, y) [m]; the centre of mass by default.

        Examples
        --------
        >>> m = Mechanism()
        >>> foot = m.body("foot", mass=1.0, inertia=0.01, position=(1.0, 0.0))
        >>> m.marker("toe", foot, at=(1.15, -0.04))
        """
        where = {"at": at} if point is None else {"at": at, "point": point}
        self._add("markers", Marker, name, body=body, **where)

    def muscle(
        self,
        name: str,
        path: Sequence[Mapping[str, Any]],
        *,
        max_force: float,
        optimal_length: float,
        tendon_length: float,
        **properties: Any,
    ) -> None:
        """Add a muscle. In runs it exerts a force; in inverse dynamics, `recruitment` computes its share of the
        moments.

        Parameters
        ----------
        name
            Name of the muscle.
        path
            Points and circles from origin to insertion: ``{"body": ..., "point": (x, y)}`` in the frame of the body
            [m], perhaps with a range ``"when"`` or an offset z, and ``{"wrap": {"body": ..., "center": (x, y),
            "radius": ..., "side": "left" or "right"}}``.
        max_force
            Isometric force of the fibres at optimal length [N].
        optimal_length, tendon_length
            Length of the fibres at their largest force, and length of the tendon without force [m].
        **properties
            ``pennation`` [rad], ``curves``, ``tendon``, ``damping``, ``activation``, ``excitation``, ``max_velocity``
            and ``weight``; see ``Muscle``.

        Examples
        --------
        >>> m = Mechanism()
        >>> shank = m.body("shank", mass=3.0, inertia=0.05, position=(0.0, -0.2))
        >>> m.revolute("knee", m.ground, shank, at=(0.0, 0.0))
        >>> path = [{"body": "ground", "point": (-0.03, 0.3)}, {"body": shank, "point": (-0.03, 0.1)}]
        >>> m.muscle("flexor", path, max_force=2000.0, optimal_length=0.11, tendon_length=0.3)
        """
        values = {"max_force": max_force, "optimal_length": optimal_length, "tendon_length": tendon_length}
        self._add("muscles", Muscle, name, path=[dict(item) for item in path], **values, **properties)
        check_moving_points({name: self.muscles[name]}, self.coordinates, "model.")

    def contact(
        self,
        name: str,
        a: str | None = None,
        b: str | None = None,
        *,
        shapes: Sequence[Mapping[str, Any]] | Mapping[str, Mapping[str, Any]],
        among: Sequence[str] | None = None,
        restitution: float = 0.0,
        friction: float | Mapping[str, float] = 0.0,
        compliance: Mapping[str, Any] | None = None,
    ) -> None:
        """Add a contact between two bodies, or between all pairs of several bodies.

        Parameters
        ----------
        name
            Name of the contact.
        a, b
            The two bodies; the normal points from `a` to `b`.
        shapes
            The shapes of a and b in their frames: ``{"line": {"point": (x, y), "normal": (x, y)}}``,
            ``{"point": (x, y)}``, ``{"circle": {"center": (x, y), "radius": r}}``, ``{"hole": {...}}`` with the keys of
            a circle, or ``{"polygon": [(x, y), ...]}``. With `among`, a mapping from the body to its shape.
        among
            Bodies that may touch each other, as an alternative to `a` and `b`. All pairs of them are included, except
            those that a joint connects.
        restitution
            Ratio of the normal velocity after an impact to that before it, from 0 to 1.
        friction
            Coefficient of friction, or ``{"static": number, "kinetic": number}``.
        compliance
            ``law``, ``stiffness``, ``dissipation`` or ``impact_speed``, and ``transition_speed``; see ``Compliance``.

        Examples
        --------
        >>> m = Mechanism()
        >>> ball = m.body("ball", mass=0.5, inertia=2e-4, position=(0.0, 1.0))
        >>> floor, outline = {"line": {"normal": (0, 1)}}, {"circle": {"radius": 0.03}}
        >>> m.contact("floor", m.ground, ball, shapes=[floor, outline], friction=0.4, compliance={"stiffness": 1e6})
        """
        for key, body in ((f"model.contacts.{quoted(name)}.bodies[{i}]", one) for i, one in enumerate((a, b))):
            if among is None and body is None:
                raise SpecError("is missing: a contact needs two bodies, or `among`", key=key)
        pair = None if a is None and b is None else (a, b)
        own: Any = dict(shapes) if isinstance(shapes, Mapping) else [dict(shape) for shape in shapes]
        values = {"bodies": pair, "among": among, "shapes": own, "restitution": restitution, "friction": friction}
        self._add("contacts", Contact, name, **values, compliance=compliance)
        check_contacts({name: self.contacts[name]}, self.joints)

    def coordinate(
        self, name: str, of: str, *, relative_to: str | None = None, scale: float = 1.0, offset: float = 0.0
    ) -> None:
        """Define a named coordinate: a quantity with its own name, sign and zero, for example those of a measured file.

        Parameters
        ----------
        name
            Name of the coordinate.
        of
            ``JOINT.angle`` (relative angle, or travel of a slide), ``BODY.x``, ``BODY.y``, ``BODY.angle``, ``MARKER.x``
            or ``MARKER.y`` [rad or m].
        relative_to
            Body whose angle is subtracted; only if `of` is the angle of another body.
        scale, offset
            The coordinate is ``scale * of + offset``.

        Examples
        --------
        >>> m = Mechanism()
        >>> shank = m.body("shank", mass=3.0, inertia=0.05, position=(0.0, -0.2))
        >>> m.revolute("knee", m.ground, shank, at=(0.0, 0.0))
        >>> m.coordinate("knee_flexion", "knee.angle", scale=-1.0)
        """
        key = self._new(name, self.coordinates, "coordinates")
        one = _make(NamedCoordinate, key, of=of, relative_to=relative_to, scale=scale, offset=offset)
        check_coordinates({name: one}, self.joints, self.bodies, self.markers)
        self.coordinates[name] = one

    def state(self, name: str, *, rate: float | str, initial: float = 0.0, unit: str = "1") -> None:
        """Add a first-order state z, such as the current of a motor or the output of a filter.

        Parameters
        ----------
        name
            Name of the state; expressions contain it as ``states.NAME``.
        rate
            Time derivative of the state: an expression of t, of kinematic quantities of bodies, joints and markers, of
            lengths, rates and values of springs, and of states.
        initial, unit
            Value at the start, and its unit.

        Examples
        --------
        >>> m = Mechanism()
        >>> leg = m.body("leg", mass=3.0, inertia=0.05)
        >>> m.state("lagged", rate="(bodies.leg.angle - states.lagged)/0.05", unit="rad")
        """
        key = self._new(name, self.states, "states")
        self.states[name] = _make(FirstOrderState, key, rate=rate, initial=initial, unit=unit)

    def controller(
        self,
        name: str,
        *,
        period: float,
        outputs: Mapping[str, float | str],
        states: Mapping[str, Mapping[str, float | str]] | None = None,
        delay: float = 0.0,
    ) -> None:
        """Add a sampled controller, whose outputs are constant between samples.

        Parameters
        ----------
        name
            Name of the controller; expressions contain its outputs and states as ``controllers.NAME.OUTPUT``.
        period, delay
            Time between two samples, and time from a sample until its outputs apply [s]. The first sample is at the
            start of the run; outputs are 0 until those of the first sample apply.
        outputs
            Expressions of the state at a sample, by name.
        states
            For each state of the controller ``{"initial": value, "next": expression}``, by name; `next` is its value
            after the sample.

        Examples
        --------
        >>> m = Mechanism()
        >>> leg = m.body("leg", mass=3.0, inertia=0.05)
        >>> m.controller("pd", period=0.01, outputs={"u": "-20*leg.angle - 2*leg.angular_velocity"})
        >>> m.torque("motor", leg, value="controllers.pd.u")
        """
        key = self._new(name, self.controllers, "controllers")
        given = {"period": period, "delay": delay, "outputs": dict(outputs), "states": dict(states or {})}
        self.controllers[name] = _make(Controller, key, **given)

    def hold(self, *bodies: str, tolerance: float = 1e-12) -> None:
        """Set the bodies that assembly does not move, and the tolerance of assembly.

        Parameters
        ----------
        bodies
            Names of the bodies that assembly does not move; they replace those of an earlier call.
        tolerance
            Largest constraint residual of a consistent initial state [m, rad].
        """
        for index, name in enumerate(bodies):
            self._known(name, f"model.assembly.fix[{index}]")
        self.assembly = _make(Assembly, "model.assembly", fix=bodies, tolerance=tolerance)

    # ---- queries -------------------------------------------------------------------------------------------------

    def to_local(self, body: str, point: Pair) -> tuple[float, float]:
        """Return the coordinates of a global `point` (x, y) [m] in the frame of `body`, at its initial position."""
        self._known(body, "body")
        return (point[0], point[1]) if body == GROUND else self.bodies[body].to_local((point[0], point[1]))

    def to_global(self, body: str, point: Pair) -> tuple[float, float]:
        """Return the global coordinates of a `point` (x, y) [m] in the frame of `body`, at its initial position."""
        self._known(body, "body")
        return (point[0], point[1]) if body == GROUND else self.bodies[body].to_global((point[0], point[1]))

    def relative_angle(self, a: str, b: str) -> float:
        """Return angle_b - angle_a [rad] at the initial positions; the ground's angle is 0."""
        for key, name in (("a", a), ("b", b)):
            self._known(name, key)
        angle_a, angle_b = (0.0 if name == GROUND else self.bodies[name].angle for name in (a, b))
        return angle_b - angle_a

    def constraint_rows(self) -> list[tuple[str, str]]:
        """Return (name, unit) of each constraint row, such as ``("A.x", "m")``, in the order of the joints."""
        return [
            (f"{name}.{row}", unit)
            for name, joint in self.joints.items()
            for row, unit in zip(joint.rows, joint.units, strict=True)
        ]

    def state_names(self) -> list[str]:
        """Return the names of all first-order states; states of force elements and muscles are named
        ``element.state``.
        """
        of_elements = [
            f"{name}.{state.name}"
            for name, force in self.forces.items()
            if isinstance(force, Law)
            for state in force.force_law.states
        ]
        of_muscles = [f"{name}.{state}" for name, muscle in self.muscles.items() for state in muscle.states]
        return [*of_elements, *of_muscles, *self.states]

    def held_names(self) -> list[str]:
        """Return the names of all outputs and states of controllers, ``controller.output`` or ``controller.state``."""
        return [f"{name}.{value}" for name, one in self.controllers.items() for value in (*one.outputs, *one.states)]

    def contact_names(self) -> list[str]:
        """Return the names of all possible contact points: ``contact``, or ``contact.a.b`` for two bodies of a group.

        If a shape is a polygon, there is one name for each corner, which ends with the number of the corner.
        """
        return [pair.name for name, one in self.contacts.items() for pair in one.pairs(name, self.joints)]

    def feet(self) -> list[str]:
        """Return the names of the bodies that may touch the ground."""
        return feet(pair.ordered for name, one in self.contacts.items() for pair in one.pairs(name, self.joints))

    def description(self) -> str:
        """Return a line of text with the numbers of elements and of constraint rows."""
        drivers = sum(joint.is_driver for joint in self.joints.values())
        rows = sum(len(joint.rows) for joint in self.joints.values())
        nodes = sum(beam.node_count for beam in self.beams.values())
        parts = [counted(len(self.bodies) - nodes, "body", "bodies")] if nodes < len(self.bodies) else []
        parts += [counted(len(self.beams), "beam")] if self.beams else []
        parts += [counted(len(self.joints) - drivers, "joint"), counted(drivers, "driver")]
        named = {kind: len(elements) for kind, elements in self.elements.items() if elements or kind == "forces"}
        parts += [counted(number, kind[:-1]) for kind, number in named.items() if kind != "joints"]
        return f"{', '.join(parts)}; {counted(rows, 'constraint row')}"

    def validate(self) -> None:
        """Check that names are valid, that references exist, and that each element is compatible with its bodies.

        Raises
        ------
        SpecError
            For the first error; it contains the key path.
        """
        check_mechanism(self.bodies, self.beams, self.elements, self.joints, self.assembly)
        check_contacts(self.contacts, self.joints)
        check_centers(self.joints, self.bodies.__getitem__)
        for name in self.coordinates:
            check_name(name, f"model.coordinates.{quoted(name)}")
        check_coordinates(self.coordinates, self.joints, self.bodies, self.markers)
        check_moving_points(self.muscles, self.coordinates, "model.")
        for kind, names in {
            "states": list(self.states),
            "controllers": list(self.controllers),
            **{f"controllers.{quoted(name)}.states": list(one.states) for name, one in self.controllers.items()},
            **{f"controllers.{quoted(name)}.outputs": list(one.outputs) for name, one in self.controllers.items()},
        }.items():
            for name in names:
                check_name(name, f"model.{kind}.{quoted(name)}")
        for name, controller in self.controllers.items():
            if name in self.forces:
                raise SpecError(
                    f"'{name}' is also a force; choose another name", key=f"model.controllers.{quoted(name)}"
                )
            if twice := [one for one in controller.outputs if one in controller.states]:
                key = f"model.controllers.{quoted(name)}.outputs.{quoted(twice[0])}"
                raise SpecError(f"'{twice[0]}' is also a state of the controller; choose another name", key=key)
        named = [*self.state_names(), *self.held_names()]
        if twice := [name for name in named if named.count(name) > 1]:
            raise SpecError(f"two states or outputs of controllers are called '{twice[0]}'; rename one", key="model")
        for key, text in self.expressions():
            try:
                higher_layers.state_program(text, self)
            except SpecError as error:
                raise error.located(prefix=key) from None

    def expressions(self) -> list[tuple[str, str]]:
        """Return (key path, text) of every expression of the state."""
        of_elements = self._of_elements(lambda one: one.expressions())
        of_states = [(f"model.states.{quoted(name)}.rate", one.rate) for name, one in self.states.items()]
        sampled = [
            (f"model.controllers.{quoted(name)}.{key}", text)
            for name, one in self.controllers.items()
            for key, text in one.expressions()
        ]
        return of_elements + of_states + sampled

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key path, motion) of every driver, load and excitation that is a function of time."""
        return self._of_elements(lambda one: one.motions())

    def check_span(self, start: float, end: float) -> None:
        """Check that every table of a function of time covers the times from `start` to `end` [s], or is periodic.

        Raises
        ------
        SpecError
            For the first table that does not cover these times; it contains the key path.
        """
        check_tables(self.motions(), start, end)

    # ---- to and from a spec --------------------------------------------------------------------------------------

    def to_spec(self) -> dict[str, Any]:
        """Return the mechanism as the `model` mapping of a spec: plain data of the model `mechanism`, without default
        values.

        Examples
        --------
        >>> m = Mechanism()
        >>> ball = m.body("ball", mass=1.0)
        >>> m.to_spec()["bodies"]
        {'ball': {'mass': 1.0}}
        """
        spec: dict[str, Any] = {"name": "mechanism"}
        if self.gravity != MechanismData.model_fields["gravity"].default:
            spec["gravity"] = list(self.gravity)
        parts = parts_of(self.beams)
        spec["bodies"] = {name: _plain(body) for name, body in self.bodies.items() if name not in parts}
        if self.beams:
            spec["beams"] = {name: _plain(beam) for name, beam in self.beams.items()}
        for kind, elements in self.elements.items():
            if own := {name: element for name, element in elements.items() if name not in parts}:
                spec[kind] = {name: _with_type(one) for name, one in own.items()}
        if self.coordinates:
            spec["coordinates"] = {
                name: coordinate.of if coordinate == NamedCoordinate(of=coordinate.of) else _plain(coordinate)
                for name, coordinate in self.coordinates.items()
            }
        if self.states:
            spec["states"] = {name: _plain(state) for name, state in self.states.items()}
        if self.controllers:
            spec["controllers"] = {name: _plain(one) for name, one in self.controllers.items()}
        if self.assembly != Assembly():
            spec["assembly"] = _plain(self.assembly)
        return spec

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], parameters: Mapping[str, float | str] | None = None) -> Mechanism:
        """Return the mechanism described by a `model` mapping, the format of :meth:`to_spec`.

        Parameters
        ----------
        spec
            Mapping with the keys ``gravity``, ``bodies``, ``beams``, ``joints``, ``forces``, ``markers``, ``muscles``,
            ``contacts``, ``coordinates``, ``states``, ``controllers`` and ``assembly``; ``name`` is optional and must
            be ``mechanism``.
        parameters
            Named parameters: numbers, or expressions of other parameters. Numbers in `spec` may be expressions of them.

        Raises
        ------
        SpecError
            For the first error; it contains the key path.

        Examples
        --------
        >>> m = Mechanism.from_spec({"bodies": {"ball": {"mass": "2*half"}}}, {"half": 0.5})
        >>> m.bodies["ball"].mass
        1.0
        """
        if not isinstance(spec, Mapping):
            raise SpecError(
                f"should be a mapping (`key: value`), not {value_text(spec)}; the mechanism of a loaded spec is "
                "`spec.mechanism()`",
                key="model",
            )
        values = plain(spec, ("model",))
        name = values.pop("name", "mechanism")
        if name != "mechanism":
            raise SpecError(f"only the free-form model 'mechanism' can be read here; got {name!r}", key="model.name")
        numbers = parameter_values(parameters)
        data, _ = with_expressions(MechanismData.model_validate, values, MechanismData, numbers, prefix="model")
        return cls.from_data(data)

    @classmethod
    def from_data(cls, data: MechanismData, *, name: str = "mechanism") -> Mechanism:
        """Return the mechanism described by validated `data`, after checks that involve several of its elements."""
        mechanism = cls(data.gravity, name=name)
        check_names(data.bodies, data.beams, {kind: getattr(data, kind) for kind in ELEMENTS})
        mechanism.bodies = dict(data.bodies)
        for name, beam in data.beams.items():
            mechanism._add_beam(name, beam)
        for kind, elements in mechanism.elements.items():
            given: dict[str, Element] = getattr(data, kind)
            elements |= {
                name: mechanism._with_points(one, f"model.{kind}.{quoted(name)}") for name, one in given.items()
            }
        last = last_nodes(mechanism.beams)
        fixed = tuple(last.get(name, name) for name in data.assembly.fix)
        mechanism.assembly = data.assembly.model_copy(update={"fix": fixed})
        mechanism.coordinates = {name: _with_last(one, last) for name, one in data.coordinates.items()}
        mechanism.states = dict(data.states)
        mechanism.controllers = dict(data.controllers)
        mechanism.validate()
        return mechanism

    # ---- equations of motion -------------------------------------------------------------------------------------

    def to_sympy(self, *, numbers: bool = True) -> SymbolicSystem:
        """Return the index-1 equations of motion as SymPy matrices, for LaTeX output and numerical evaluation.

        Parameters
        ----------
        numbers
            If True, insert the values of masses, lengths, stiffnesses and other parameters. If False, keep them as
            symbols, whose values are in `SymbolicSystem.parameters`. Expressions of t are inserted as written in both
            cases.

        Raises
        ------
        SpecError
            For the first error of the mechanism, or for a force that has no symbolic form. The error contains the key
            path.
        """
        system: SymbolicSystem = higher_layers.symbolic_system(self, numbers=numbers)
        return system

    # ---- private -------------------------------------------------------------------------------------------------

    def _of_elements(self, values: Callable[[Element], list[tuple[str, AnyValue]]]) -> list[tuple[str, AnyValue]]:
        """Return (key path, value) for each pair (key, value) that the function `values` returns for an element."""
        return [
            (f"model.{kind}.{quoted(name)}.{key}", value)
            for kind in ELEMENTS
            for name, one in getattr(self, kind).items()
            for key, value in values(one)
        ]

    def _new(self, name: str, taken: Mapping[str, Any], kind: str) -> str:
        key = f"model.{kind}.{quoted(name)}"
        check_name(name, key)
        if name in taken:
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
        elements = getattr(self, kind)
        key = self._new(name, elements, kind)
        elements[name] = self._with_points(_make(cls, key, **values), key)

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


def _with_last(one: NamedCoordinate, last: Mapping[str, str]) -> NamedCoordinate:
    """Return a coordinate with the names of last nodes of beams in place of ``BEAM.last``."""
    owner, dot, quantity = one.of.rpartition(".")
    other = one.relative_to
    names = {"of": last.get(owner, owner) + dot + quantity, "relative_to": last.get(other, other) if other else other}
    return one.model_copy(update=names)


def _make(cls: type[AnyElement], key: str, /, **values: Any) -> AnyElement:
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


def _point(value: Any, key: str) -> tuple[float, float]:
    try:
        return _POINT.validate_python(value, strict=True)
    except ValidationError as error:
        raise spec_error(error, Point, prefix=key) from None


def _with_type(element: Element) -> dict[str, Any]:
    """Return an element as plain data, with its type if the kind of element has several types."""
    return {"type": element.type, **_plain(element)} if hasattr(element, "type") else _plain(element)


def _plain(element: StrictModel) -> dict[str, Any]:
    return element.model_dump(mode="json", exclude_defaults=True)
