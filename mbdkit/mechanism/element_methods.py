"""Methods of a mechanism that add forces, markers, muscles, contacts, coordinates, states and controllers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.mechanism.bodies import Marker
from mbdkit.mechanism.contacts import Contact, check_contacts
from mbdkit.mechanism.forces import PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.joint_methods import JointMethods, Pair, Value, made
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism_data import Assembly, NamedCoordinate, check_coordinates
from mbdkit.mechanism.muscles import Muscle, check_moving_points
from mbdkit.mechanism.state_values import Controller, FirstOrderState


class ElementMethods(JointMethods):
    """The part of `Mechanism` that adds its elements; bodies, beams and joints are those of the base class."""

    markers: dict[str, Marker]
    muscles: dict[str, Muscle]
    contacts: dict[str, Contact]
    coordinates: dict[str, NamedCoordinate]
    states: dict[str, FirstOrderState]
    controllers: dict[str, Controller]
    assembly: Assembly

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
        key = self._new("coordinates", name)
        one = made(NamedCoordinate, key, of=of, relative_to=relative_to, scale=scale, offset=offset)
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
        key = self._new("states", name)
        self.states[name] = made(FirstOrderState, key, rate=rate, initial=initial, unit=unit)

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
        key = self._new("controllers", name)
        given = {"period": period, "delay": delay, "outputs": dict(outputs), "states": dict(states or {})}
        self.controllers[name] = made(Controller, key, **given)

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
        self.assembly = made(Assembly, "model.assembly", fix=bodies, tolerance=tolerance)
