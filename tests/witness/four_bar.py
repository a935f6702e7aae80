"""A planar four-bar linkage in one coordinate: the crank's angle, by Eksergian's equation of motion.

Crank, coupler and follower are links with two pins each; the crank's first pin A and the follower's pin D are
fixed, B joins crank and coupler, C coupler and follower. Angles are those of the lines A->B (phi), B->C (alpha) and
D->C (beta). Closure

    A + l1 e(phi) + l2 e(alpha) = D + l3 e(beta)

gives alpha and beta by the intersection of two circles, their first and second derivatives with respect to phi from the
differentiated closure, and with T = I(phi) phi'^2 / 2 the equation I phi'' + I' phi'^2 / 2 = Q(phi, phi'). Source:
Eksergian, Dynamical analysis of machines, J. Franklin Inst. 209 (1930); Paul, Kinematics and Dynamics of Planar
Machinery, 1979, chapter 12. A link's inertia enters only in the sum I, so that a tiny one does no harm here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import ode

Array = NDArray[np.floating[Any]]
Point = tuple[float, float]


@dataclass(frozen=True)
class Link:
    """A link: mass [kg], inertia about its centre of mass [kg m^2], two pins in its frame [m] (origin: the centre)."""

    mass: float
    inertia: float
    pins: tuple[Point, Point]

    @classmethod
    def uniform(cls, length: float, mass: float, inertia: float) -> Link:
        """Return a link of `length` [m] along its own x axis with its centre of mass in the middle."""
        return cls(mass=mass, inertia=inertia, pins=((-length / 2, 0.0), (length / 2, 0.0)))

    @property
    def line(self) -> Array:
        """Return the vector from the first pin to the second in the link's frame [m]."""
        return np.subtract(self.pins[1], self.pins[0])

    @property
    def length(self) -> float:
        """Return the distance of the two pins [m]."""
        return float(np.hypot(*self.line))

    @property
    def tilt(self) -> float:
        """Return the angle of the line of the pins in the link's frame [rad]."""
        return float(np.arctan2(self.line[1], self.line[0]))


@dataclass(frozen=True)
class Spring:
    """A spring-damper from ground to a point of the coupler: stiffness [N/m], damping [N s/m], free length [m]."""

    ground: Point
    coupler: Point
    stiffness: float
    damping: float = 0.0
    free_length: float = 0.0


@dataclass(frozen=True)
class State:
    """All three links (crank, coupler, follower) at one time: each array has three rows."""

    position: Array
    angle: Array
    velocity: Array
    angular_velocity: Array
    acceleration: Array
    angular_acceleration: Array


@dataclass(frozen=True)
class FourBar:
    """The linkage.

    Parameters
    ----------
    ground
        The fixed pins A and D [m].
    crank, coupler, follower
        The links; pins are (A, B), (B, C) and (D, C).
    branch
        +1 or -1: on which side of the line from B to D the pin C lies (+1: C is to the left).
    springs, damping
        Spring-dampers between ground and coupler; damping [N m s/rad] of the coupler's rotation against the ground.
    gravity
        Downward acceleration of gravity [m/s^2].
    """

    ground: tuple[Point, Point]
    crank: Link
    coupler: Link
    follower: Link
    branch: int = 1
    springs: tuple[Spring, ...] = ()
    damping: float = 0.0
    gravity: float = 9.81

    @property
    def links(self) -> tuple[Link, Link, Link]:
        """Return crank, coupler and follower."""
        return self.crank, self.coupler, self.follower

    def _geometry(self, phi: float) -> tuple[Array, Array, Array]:
        """Return the three line angles and their first and second derivatives with respect to phi."""
        l1, l2, l3 = (link.length for link in self.links)
        joint = np.array(self.ground[0]) + l1 * _e(phi)
        gap = np.subtract(self.ground[1], joint)
        distance = float(np.hypot(*gap))
        cosine = (l2**2 + distance**2 - l3**2) / (2 * l2 * distance)
        if abs(cosine) >= 1.0:
            raise ValueError(f"The linkage cannot be closed at the crank angle {phi} rad.")
        alpha = float(np.arctan2(gap[1], gap[0])) + self.branch * float(np.arccos(cosine))
        to_c = joint + l2 * _e(alpha) - self.ground[1]
        beta = float(np.arctan2(to_c[1], to_c[0]))
        da = -l1 * np.sin(beta - phi) / (l2 * np.sin(beta - alpha))
        db = l1 * np.sin(alpha - phi) / (l3 * np.sin(alpha - beta))
        dda = (l1 * np.cos(phi - beta) + da**2 * l2 * np.cos(alpha - beta) - db**2 * l3) / (l2 * np.sin(beta - alpha))
        ddb = (db**2 * l3 * np.cos(alpha - beta) - l1 * np.cos(phi - alpha) - da**2 * l2) / (l3 * np.sin(alpha - beta))
        return np.array([phi, alpha, beta]), np.array([1.0, da, db]), np.array([0.0, dda, ddb])

    def _centres(self, lines: Array, first: Array, second: Array) -> tuple[Array, Array, Array]:
        """Return the links' centres of mass and their first and second derivatives with respect to phi, each (3, 2)."""
        start = np.array(self.ground[0]) + self.crank.length * _e(lines[0])
        start_first = self.crank.length * _n(lines[0])
        start_second = -self.crank.length * _e(lines[0])
        anchors = (
            (np.array(self.ground[0]), np.zeros(2), np.zeros(2)),
            (start, start_first, start_second),
            (np.array(self.ground[1]), np.zeros(2), np.zeros(2)),
        )
        rows = [
            _carried(anchor, -np.array(link.pins[0]), line - link.tilt, rate, acceleration)
            for anchor, link, line, rate, acceleration in zip(anchors, self.links, lines, first, second, strict=True)
        ]
        position, velocity, acceleration = (np.array([row[k] for row in rows]) for k in range(3))
        return position, velocity, acceleration

    def equation(self, phi: float) -> tuple[float, float, float]:
        """Return I [kg m^2], dI/dphi and the generalized force of gravity and springs (no damping) at `phi`."""
        lines, first, second = self._geometry(phi)
        position, velocity, acceleration = self._centres(lines, first, second)
        masses = np.array([link.mass for link in self.links])
        inertias = np.array([link.inertia for link in self.links])
        inertia = float(masses @ np.sum(velocity**2, axis=1) + inertias @ first**2)
        slope = float(2 * (masses @ np.sum(velocity * acceleration, axis=1) + inertias @ (first * second)))
        force = -float(masses @ velocity[:, 1]) * self.gravity
        for spring in self.springs:
            end, end_first = self._coupler_point(spring, lines, first, position, velocity)
            reach = end - np.array(spring.ground)
            length = float(np.hypot(*reach))
            force -= spring.stiffness * (length - spring.free_length) * float(reach @ end_first) / length
        return inertia, slope, force

    def _coupler_point(
        self, spring: Spring, lines: Array, first: Array, position: Array, velocity: Array
    ) -> tuple[Array, Array]:
        turned = _turn(lines[1] - self.coupler.tilt) @ np.array(spring.coupler)
        return position[1] + turned, velocity[1] + first[1] * np.array([-turned[1], turned[0]])

    def _damping(self, phi: float) -> float:
        """Return c(phi) [N m s/rad] in the damping force -c(phi) phi'."""
        lines, first, second = self._geometry(phi)
        position, velocity, _ = self._centres(lines, first, second)
        total = self.damping * first[1] ** 2
        for spring in self.springs:
            end, end_first = self._coupler_point(spring, lines, first, position, velocity)
            reach = end - np.array(spring.ground)
            total += spring.damping * float(reach @ end_first) ** 2 / float(reach @ reach)
        return float(total)

    @property
    def _damped(self) -> bool:
        return self.damping != 0.0 or any(spring.damping for spring in self.springs)

    def acceleration(self, phi: float, rate: float) -> float:
        """Return phi'' [rad/s^2]."""
        inertia, slope, force = self.equation(phi)
        if self._damped:
            force -= self._damping(phi) * rate
        return (force - slope * rate**2 / 2) / inertia

    @ode.solved_once
    def solve(self, phi: float, rate: float, times: Array) -> Array:
        """Return (phi [rad], phi' [rad/s], dissipated energy [J]) at `times` [s], shape (T, 3)."""

        def right_side(time: Any, state: Any) -> Any:
            lost = self._damping(state[0]) * state[1] ** 2 if self._damped else 0.0
            return np.array([state[1], self.acceleration(state[0], state[1]), lost])

        return ode.dop853(right_side, np.array([phi, rate, 0.0]), times)

    def state(self, phi: float, rate: float) -> State:
        """Return all three links at the crank's `phi` [rad] and `rate` [rad/s]; other angles up to whole turns."""
        lines, first, second = self._geometry(phi)
        position, velocity, acceleration = self._centres(lines, first, second)
        push = self.acceleration(phi, rate)
        tilts = np.array([link.tilt for link in self.links])
        return State(
            position=position,
            angle=lines - tilts,
            velocity=velocity * rate,
            angular_velocity=first * rate,
            acceleration=velocity * push + acceleration * rate**2,
            angular_acceleration=first * push + second * rate**2,
        )

    def transmission(self, phi: float) -> float:
        """Return |sin| of the angle between coupler and follower: zero at a dead centre of the crank's equation."""
        lines = self._geometry(phi)[0]
        return float(abs(np.sin(lines[2] - lines[1])))

    def pin_forces(self, phi: float, rate: float) -> Array:
        """Return the forces [N] on the crank at A, the coupler at B, the follower at C and the follower at D, (4, 2).

        The other body at the pin is the ground, the crank, the coupler and the ground. Newton's and Euler's equations
        of the three links: nine for eight unknowns, consistent on a motion of the linkage.
        """
        state = self.state(phi, rate)
        matrix, load = np.zeros((9, 8)), np.zeros(9)
        acting = (((0, 0, 1), (1, 1, -1)), ((1, 0, 1), (2, 1, -1)), ((3, 0, 1), (2, 1, 1)))  # pin, which of two, sign
        for body, link in enumerate(self.links):
            load[3 * body : 3 * body + 2] = link.mass * (state.acceleration[body] + np.array([0.0, self.gravity]))
            load[3 * body + 2] = link.inertia * state.angular_acceleration[body]
            for pin, which, sign in acting[body]:
                arm = _turn(state.angle[body]) @ np.array(link.pins[which])
                matrix[3 * body, 2 * pin] = matrix[3 * body + 1, 2 * pin + 1] = sign
                matrix[3 * body + 2, 2 * pin : 2 * pin + 2] = -sign * arm[1], sign * arm[0]
        lines, first, second = self._geometry(phi)
        position, velocity, _ = self._centres(lines, first, second)
        for spring in self.springs:
            end, end_first = self._coupler_point(spring, lines, first, position, velocity)
            reach = end - np.array(spring.ground)
            length = float(np.hypot(*reach))
            pull = (
                spring.stiffness * (length - spring.free_length)
                + spring.damping * float(reach @ end_first) * rate / length
            )
            force, arm = -pull * reach / length, end - position[1]
            load[3:5] -= force
            load[5] -= arm[0] * force[1] - arm[1] * force[0]
        load[5] += self.damping * first[1] * rate
        forces = np.linalg.lstsq(matrix, load, rcond=None)[0]
        if np.abs(matrix @ forces - load).max() > 1e-10 * (1.0 + np.abs(load).max()):
            raise ValueError("The nine equations contradict each other: this is no motion of the linkage.")
        return np.asarray(forces.reshape(4, 2))

    def model(self, phi: float, rate: float) -> dict[str, Any]:
        """Return the `model:` mapping of the same linkage, started at `phi` and `rate`, for mbdkit's `mechanism`."""
        state = self.state(phi, rate)
        names = ("crank", "coupler", "follower")
        bodies = {
            name: {
                "mass": link.mass,
                "inertia": link.inertia,
                "position": state.position[k].tolist(),
                "angle": float(state.angle[k]),
                "velocity": state.velocity[k].tolist(),
                "angular_velocity": float(state.angular_velocity[k]),
            }
            for k, (name, link) in enumerate(zip(names, self.links, strict=True))
        }

        def revolute(first: str, second: str, at_first: Point, at_second: Point) -> dict[str, Any]:
            return {"type": "revolute", "bodies": [first, second], "points": [list(at_first), list(at_second)]}

        forces: dict[str, Any] = {
            f"spring{k + 1}": {
                "type": "spring-damper",
                "bodies": ["ground", "coupler"],
                "points": [list(spring.ground), list(spring.coupler)],
                "stiffness": spring.stiffness,
                "damping": spring.damping,
                "free_length": spring.free_length,
            }
            for k, spring in enumerate(self.springs)
        }
        if self.damping:
            forces["damper"] = {
                "type": "torsion-spring",
                "bodies": ["ground", "coupler"],
                "stiffness": 0.0,
                "damping": self.damping,
            }
        return {
            "name": "mechanism",
            "gravity": [0.0, -self.gravity],
            "bodies": bodies,
            "joints": {
                "A": revolute("ground", "crank", self.ground[0], self.crank.pins[0]),
                "B": revolute("crank", "coupler", self.crank.pins[1], self.coupler.pins[0]),
                "C": revolute("coupler", "follower", self.coupler.pins[1], self.follower.pins[1]),
                "D": revolute("ground", "follower", self.ground[1], self.follower.pins[0]),
            },
            "forces": forces,
        }


def _e(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle)])


def _n(angle: float) -> Array:
    return np.array([-np.sin(angle), np.cos(angle)])


def _turn(angle: float) -> Array:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _carried(
    anchor: tuple[Array, Array, Array], local: Array, angle: float, rate: float, acceleration: float
) -> tuple[Array, Array, Array]:
    """Return a point fixed in a body, given from its anchor in the body's frame, with both derivatives."""
    arm = _turn(angle) @ local
    side = np.array([-arm[1], arm[0]])
    return anchor[0] + arm, anchor[1] + rate * side, anchor[2] + acceleration * side - rate**2 * arm
