"""Bodies and joints of a knee that is a crossed four-bar linkage, on a thigh in any pose and motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mbdkit.base import elementary
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.joint_friction import PinFriction
from mbdkit.mechanism.joints import Joint, Revolute
from mbdkit_biomech.models._crossed_four_bar import CrossedFourBar, LinkagePose
from mbdkit_biomech.models._segments import RigidSegment

#: Distance of the midpoint of the tibial link below the knee, as a share of body height.
MOUNTING = 0.009 / 1.78


@dataclass(frozen=True)
class MovingFrame:
    """A moving frame in the plane; points and velocities are complex numbers x + i y.

    Attributes
    ----------
    origin, velocity
        Position [m] and velocity [m/s] of the origin.
    turn
        Direction of the x axis, with modulus 1.
    angle, rate
        Angle [rad] and angular velocity [rad/s].
    """

    origin: complex
    turn: complex
    angle: float
    velocity: complex = 0j
    rate: float = 0.0

    @classmethod
    def at(cls, origin: complex, angle: float, velocity: complex = 0j, rate: float = 0.0) -> MovingFrame:
        """Return the frame at this angle."""
        return cls(origin, elementary.unit_vector(angle), angle, velocity, rate)

    def hinged(self, point: complex, angle: float, rate: float) -> MovingFrame:
        """Return the frame with its origin at a point of this one, turned relative to it by an angle at a rate."""
        return MovingFrame.at(self.to_global(point), self.angle + angle, self.velocity_of(point), self.rate + rate)

    def to_global(self, point: complex) -> complex:
        """Return the position of a point of the frame [m]."""
        return self.origin + self.turn * point

    def velocity_of(self, point: complex) -> complex:
        """Return the velocity of a point of the frame [m/s]."""
        return self.velocity + 1j * self.rate * (self.turn * point)

    def carry(self, segment: RigidSegment) -> Body:
        """Return a segment, given in this frame, as a body that moves with the frame."""
        return Body(
            mass=segment.mass,
            inertia=segment.inertia,
            position=xy(self.to_global(segment.centre)),
            angle=self.angle,
            velocity=xy(self.velocity_of(segment.centre)),
            angular_velocity=self.rate,
        )


@dataclass(frozen=True)
class Knee:
    """A four-bar knee in a pose.

    Attributes
    ----------
    rods
        The bodies `acl` and `pcl`, whose x axes point from the femoral to the tibial joint.
    ends
        Half of the length of each rod [m]: the distance of its joints from its centre.
    femoral
        Joints C and D in the thigh frame [m].
    tibial
        Joints A and B in the shank frame [m].
    shank
        Frame of the shank, whose origin is the knee of the straight leg.
    """

    rods: dict[str, Body]
    ends: dict[str, float]
    femoral: dict[str, complex]
    tibial: dict[str, complex]
    shank: MovingFrame

    def pins(
        self, body: str, on_body: Callable[[complex], complex], centre: complex, friction: PinFriction | None
    ) -> dict[str, Joint]:
        """Return the joints A to D.

        Parameters
        ----------
        body, on_body
            Body that carries the femoral joints, and the function that returns a point of the thigh in its frame [m].
        centre
            Centre of mass of body `shank` in the shank frame [m].
        """
        acl, pcl = self.ends["acl"], self.ends["pcl"]
        ends = {
            "A": (("pcl", "shank"), ((pcl, 0.0), xy(self.tibial["A"] - centre))),
            "B": (("acl", "shank"), ((acl, 0.0), xy(self.tibial["B"] - centre))),
            "C": ((body, "acl"), (xy(on_body(self.femoral["C"])), (-acl, 0.0))),
            "D": ((body, "pcl"), (xy(on_body(self.femoral["D"])), (-pcl, 0.0))),
        }
        return {name: Revolute(bodies=two, points=points, friction=friction) for name, (two, points) in ends.items()}


def knee_of(
    linkage: CrossedFourBar, height: float, thigh: MovingFrame, flexion: tuple[float, float], rod_mass: float
) -> Knee:
    """Return the knee on a thigh.

    Parameters
    ----------
    linkage
        The linkage.
    height
        Body height [m].
    thigh
        Frame of the thigh, with its origin at the knee of the straight leg and y towards the hip.
    flexion
        Flexion [rad] and its rate [rad/s].
    rod_mass
        Mass of each rod [kg].

    Raises
    ------
    SpecError
        If the linkage cannot be assembled at this flexion.
    """
    straight, pose = linkage.pose(0.0), linkage.pose(flexion[0])
    knee = 0.5 * (straight.A + straight.B) + 1j * MOUNTING * height  # in the frame of the tibial link
    femoral = {"C": straight.C - knee, "D": straight.D - knee}
    tibial = {"A": pose.A - knee, "B": pose.B - knee}
    shank = _shank(thigh, pose, femoral["C"], tibial["B"], linkage, flexion)
    rods, ends = {}, {}
    acl, pcl = linkage.rod_rates(pose, -flexion[1])
    for name, length, top, end, rate in (("acl", linkage.acl, "C", "B", acl), ("pcl", linkage.pcl, "D", "A", pcl)):
        start, stop = thigh.to_global(femoral[top]), shank.to_global(tibial[end])
        spin = thigh.rate + rate
        rods[name] = Body(
            mass=rod_mass,
            inertia=rod_mass * (length * length) / 12,
            position=xy(0.5 * (start + stop)),
            angle=elementary.atan2((stop - start).imag, (stop - start).real),
            velocity=xy(thigh.velocity_of(femoral[top]) + 0.5j * spin * (stop - start)),
            angular_velocity=spin,
        )
        ends[name] = 0.5 * length
    return Knee(rods, ends, femoral, tibial, shank)


def _shank(
    thigh: MovingFrame, pose: LinkagePose, c: complex, b: complex, linkage: CrossedFourBar, flexion: tuple[float, float]
) -> MovingFrame:
    """Return the frame of the shank; `c` and `b` are joint C in the thigh frame and joint B in the shank frame."""
    turn = thigh.turn * elementary.unit_vector(-flexion[0])
    rate = thigh.rate - flexion[1]
    acl = turn * (pose.B - pose.C)
    spin = thigh.rate + linkage.rod_rates(pose, -flexion[1])[0]
    place = thigh.to_global(c) + acl
    velocity = thigh.velocity_of(c) + 1j * spin * acl
    return MovingFrame(place - turn * b, turn, thigh.angle - flexion[0], velocity - 1j * rate * (turn * b), rate)


def xy(point: complex) -> tuple[float, float]:
    """Return the coordinates of a point."""
    return point.real, point.imag
