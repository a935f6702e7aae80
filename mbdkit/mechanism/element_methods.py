"""Methods of a mechanism that add one type of element each, with the fields of its model as arguments.

Type checkers read the signatures in ``element_methods.pyi``, which ``python -m mbdkit_builder methods`` writes.
"""

from __future__ import annotations

from typing import Literal

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.mechanism.beams import Beam
from mbdkit.mechanism.bodies import Body, Marker
from mbdkit.mechanism.forces import PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.joints import Distance, Driver, PointOnLine, Prismatic, Revolute, Weld
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism_data import NamedCoordinate
from mbdkit.mechanism.model_methods import of_models
from mbdkit.mechanism.named_elements import NamedElements
from mbdkit.mechanism.pathways import JointAngles, TwoPoints
from mbdkit.mechanism.state_values import Controller, FirstOrderState, Input


class ElementMethods(NamedElements):
    """The part of `Mechanism` that adds its elements."""

    @of_models(Body)
    def body(self, name, **keys) -> str:
        """Add a body and return its name.

        >>> m = Mechanism()
        >>> m.body("rod", mass=2.0, inertia=2.0 * 1.5**2 / 12, position=(0.75, 0.0))
        'rod'
        """
        self.add("bodies", name, **keys)
        return name

    @of_models(Beam)
    def beam(self, name, **keys) -> tuple[str, ...]:
        """Add a flexible beam and return the names of its nodes, which are bodies: ``name.0``, ``name.1``, ...
        Connect its ends, or any other node, with joints: a weld clamps it, a revolute joint pins it.

        A cantilever of steel, 2 m long:

        >>> m = Mechanism()
        >>> steel = {"E": 2.1e11, "nu": 0.3, "density": 7850.0}
        >>> nodes = m.beam("arm", a=(0, 0), b=(2, 0), elements=8, A=1e-4, I=8.3e-10, **steel)
        >>> nodes[0], nodes[-1]
        ('arm.0', 'arm.8')
        >>> m.weld("clamp", m.ground, nodes[0], at=(0, 0))
        """
        self.add("beams", name, **keys)
        return self.beams[name].node_names(name)

    @of_models(Revolute)
    def revolute(self, name, a, b, **keys):
        """Connect bodies `a` and `b` by a revolute joint.

        >>> m = Mechanism()
        >>> rod = m.body("rod", mass=2.0, inertia=0.375, position=(0.75, 0.0))
        >>> m.revolute("A", m.ground, rod, at=(0.0, 0.0))

        A wheel of radius 0.3 m that rolls on the x axis:

        >>> wheel = m.body("wheel", mass=1.0, inertia=0.045, position=(0.0, 0.3))
        >>> m.revolute("rolls", m.ground, wheel, at=(0.0, 0.3), center={"x": "-0.3*angle"})
        """
        self.add("joints", name, type="revolute", bodies=(a, b), **keys)

    @of_models(Prismatic)
    def prismatic(self, name, a, b, **keys):
        """Connect bodies `a` and `b` by a prismatic joint.

        >>> m = Mechanism()
        >>> slider = m.body("slider", mass=1.0, inertia=0.1, position=(2.0, 0.0))
        >>> m.prismatic("guide", m.ground, slider, at=(2.0, 0.0), axis=(1, 0))
        """
        self.add("joints", name, type="prismatic", bodies=(a, b), **keys)

    @of_models(PointOnLine)
    def point_on_line(self, name, a, b, **keys):
        """Hold a point of `b` on a line of `a`."""
        self.add("joints", name, type="point-on-line", bodies=(a, b), **keys)

    @of_models(Weld)
    def weld(self, name, a, b, **keys):
        """Connect bodies `a` and `b` rigidly."""
        self.add("joints", name, type="weld", bodies=(a, b), **keys)

    @of_models(Distance)
    def distance(self, name, a, b, **keys):
        """Hold a point of `a` and a point of `b` at a constant distance."""
        self.add("joints", name, type="distance", bodies=(a, b), **keys)

    @of_models(Driver)
    def driver(self, name, a, b, **keys):
        """Prescribe the motion of `b` relative to `a`.

        >>> m = Mechanism()
        >>> crank = m.body("crank", mass=1.0, inertia=0.1)
        >>> m.revolute("A", m.ground, crank, at=(0.0, 0.0))
        >>> m.driver("motor", m.ground, crank, coordinate="angle", motion="2*pi*t")
        """
        self.add("joints", name, type="driver", bodies=(a, b), **keys)

    @of_models(SpringDamper)
    def spring_damper(self, name, a, b, **keys):
        """Add a linear spring and damper between a point of `a` and a point of `b`.

        >>> m = Mechanism()
        >>> ball = m.body("ball", mass=1.0, position=(0.0, -1.0))
        >>> m.spring_damper("s", m.ground, ball, from_=(0, 0), to=(0, -1), stiffness=100, damping=0.5, free_length=0.9)
        """
        self.add("forces", name, type="spring-damper", bodies=(a, b), **keys)

    @of_models(TorsionSpring)
    def torsion_spring(self, name, a, b, **keys):
        """Add a linear torsion spring and damper between `a` and `b`, acting on angle_b - angle_a.

        >>> m = Mechanism()
        >>> shank = m.body("shank", mass=3.0, inertia=0.05)
        >>> m.torsion_spring("knee", m.ground, shank, stiffness=20.0, damping=0.1)
        """
        self.add("forces", name, type="torsion-spring", bodies=(a, b), **keys)

    @of_models(Law, TwoPoints)
    def law(
        self,
        name,
        a,
        b,
        *,
        law,
        along: Literal["line", "angle", "x", "y"] = "line",
        from_=None,
        to=None,
        points=None,
        **options,
    ):
        """Add a force given by a force law along a pathway between `a` and `b`.

        A rope, which only pulls:

        >>> m = Mechanism()
        >>> ball = m.body("ball", mass=1.0, position=(0.0, -1.0))
        >>> m.law("rope", m.ground, ball, law="one-sided", from_=(0, 0), to=(0, -1), stiffness=1e4, acts="tension")
        """
        if along != "line" and (from_ is not None or to is not None):
            message = f"from_ and to can be given only with along='line', not with along='{along}'"
            raise SpecError(message, key=f"model.forces.{quoted(name)}")
        types = {"line": {"type": "two-points"}, "angle": {"type": "relative-angle"}}
        where = _given(**{"points": points, "from": from_, "to": to})
        pathway = {"bodies": (a, b), **types.get(along, {"type": "coordinate", "coordinate": along}), **where}
        self.add("forces", name, type="law", law=law, pathway=pathway, **options)

    @of_models(JointAngles, Law)
    def cable(self, name, radii, *, law="one-sided", length=0.0, **options):
        """Add a cable over pulleys at one or several joints, which exist already, with a force law.

        >>> m = Mechanism()
        >>> shank = m.body("shank", mass=3.0, inertia=0.05, position=(0.0, -0.2))
        >>> m.revolute("knee", m.ground, shank, at=(0, 0))
        >>> m.cable("tendon", {"knee": 0.04}, stiffness=1e4, free_length=-0.01, acts="tension")
        """
        pathway = {"type": "joint-angles", "angles": dict(radii), "length": length}
        self.add("forces", name, type="law", law=law, pathway=pathway, **options)

    @of_models(Torque)
    def torque(self, name, body, **keys):
        """Apply a torque to a body.

        >>> m = Mechanism()
        >>> crank = m.body("crank", mass=1.0, inertia=0.1)
        >>> m.torque("motor", crank, value="5*sin(2*t)")
        """
        self.add("forces", name, type="torque", body=body, **keys)

    @of_models(PointForce)
    def force(self, name, body, *, point=None, **keys):
        """Apply a force to a point of a body.

        >>> m = Mechanism()
        >>> foot = m.body("foot", mass=1.0, inertia=0.01)
        >>> m.force("ground reaction", foot, value=(0.0, "700*sin(pi*t)"), point=(0.1, -0.05))
        """
        self.add("forces", name, type="force", body=body, **_given(point=point), **keys)

    @of_models(Marker)
    def marker(self, name, body, *, point=None, **keys):
        """Add a marker.

        >>> m = Mechanism()
        >>> foot = m.body("foot", mass=1.0, inertia=0.01, position=(1.0, 0.0))
        >>> m.marker("toe", foot, at=(1.15, -0.04))
        """
        self.add("markers", name, body=body, **_given(point=point), **keys)

    @of_models(NamedCoordinate)
    def coordinate(self, name, of, **keys):
        """Define a named coordinate, for example one of a measured file.

        >>> m = Mechanism()
        >>> shank = m.body("shank", mass=3.0, inertia=0.05, position=(0.0, -0.2))
        >>> m.revolute("knee", m.ground, shank, at=(0.0, 0.0))
        >>> m.coordinate("knee_flexion", "knee.angle", scale=-1.0)
        """
        self.add("coordinates", name, of=of, **keys)

    @of_models(FirstOrderState)
    def state(self, name, **keys):
        """Add a first-order state.

        >>> m = Mechanism()
        >>> leg = m.body("leg", mass=3.0, inertia=0.05)
        >>> m.state("lagged", rate="(bodies.leg.angle - states.lagged)/0.05", unit="rad")
        """
        self.add("states", name, **keys)

    @of_models(Input)
    def input(self, name, **keys):
        """Add an input, whose values the `inputs` of a run spec give.

        >>> m = Mechanism()
        >>> leg = m.body("leg", mass=3.0, inertia=0.05)
        >>> m.input("pull", unit="N m", bounds=(-5.0, 5.0))
        >>> m.torque("motor", leg, value="inputs.pull")
        """
        self.add("inputs", name, **keys)

    @of_models(Controller)
    def controller(self, name, *, states=None, python=None, **keys):
        """Add a sampled controller.

        >>> m = Mechanism()
        >>> leg = m.body("leg", mass=3.0, inertia=0.05)
        >>> m.controller("pd", period=0.01, outputs={"u": "-20*leg.angle - 2*leg.angular_velocity"})
        >>> m.torque("motor", leg, value="controllers.pd.u")
        """
        self.add("controllers", name, **_given(states=states, python=python), **keys)


def _given(**keys):
    """Return the keys whose value is not None."""
    return {key: value for key, value in keys.items() if value is not None}
