"""A crank and any number of dyads, four-bar and six-bar linkages among them, in the crank's angle phi alone.

A dyad is two links pinned to each other at W, and to earlier links or the ground at U and V. Points are complex
numbers. The circles about U and V meet in W, and

    U + a exp(i alpha) = V + b exp(i beta)

differentiated once and twice with respect to phi gives the derivatives of both angles. With the kinetic energy I(phi)
phi'^2 / 2, Eksergian's equation of motion is I phi'' + I' phi'^2 / 2 = Q. Sources: Assur's groups in Paul, Kinematics
and Dynamics of Planar Machinery, 1979, chapters 1 and 12; Eksergian, Dynamical analysis of machines, J. Franklin Inst.
209 (1930).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import ode

Array = NDArray[np.generic]
Place = tuple[str, complex]  #: a link, or `ground`, and a point of its frame


@dataclass(frozen=True)
class Link:
    """A link: mass [kg], inertia about its centre of mass [kg m^2], and its pins by name in its own frame [m]."""

    mass: float
    inertia: float
    pins: dict[str, complex]


@dataclass(frozen=True)
class Dyad:
    """Two links and where they are pinned: `u` to an earlier `base_u` at U, `v` to `base_v` at V, to each other at W.

    `side` is +1 where W lies to the left of the line from U to V, and -1 where it lies to the right. A pin has one name
    in both links that it joins.
    """

    u: str
    v: str
    base_u: str
    base_v: str
    pins: tuple[str, str, str]
    side: int = 1


@dataclass(frozen=True)
class Pose:
    """A link's centre of mass [m] and tilt [rad]: value, first and second derivative with respect to phi."""

    centre: tuple[complex, complex, complex]
    angle: tuple[float, float, float]

    def point(self, local: complex) -> tuple[complex, complex, complex]:
        """Return a point of the link's frame in the global one, with its derivatives."""
        c, a = self.centre, self.angle
        arm = local * np.exp(1j * a[0])
        return c[0] + arm, c[1] + 1j * a[1] * arm, c[2] + (1j * a[2] - a[1] ** 2) * arm


FIXED = Pose((0j, 0j, 0j), (0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Linkage:
    """The linkage.

    Parameters
    ----------
    ground
        Fixed pins by name [m].
    links
        All links by name; the first is the crank, with the pins `A` on the ground and `B`.
    dyads
        What closes the loops, in an order in which each finds the links before it placed.
    torque, torque_text
        The motor's torque on the crank [N m], a function of time, and the same as an expression of t.
    gravity
        Downward acceleration of gravity [m/s^2].
    """

    ground: dict[str, complex]
    links: dict[str, Link]
    dyads: tuple[Dyad, ...]
    torque: Callable[[Any], Any]
    torque_text: str
    gravity: float = 9.81

    def poses(self, phi: float) -> dict[str, Pose]:
        """Return every link's pose where the crank's line from A to B has the angle `phi` [rad]."""
        crank = next(iter(self.links))
        placed = {crank: self._hung(crank, ("A", "B"), (self.ground["A"], 0j, 0j), (phi, 1.0, 0.0))}
        for dyad in self.dyads:
            at_u, at_v, at_w = dyad.pins
            U = self._pin(placed, dyad.base_u, at_u)
            V = self._pin(placed, dyad.base_v, at_v)
            alpha, beta = self._closed(dyad, U, V)
            placed[dyad.u] = self._hung(dyad.u, (at_u, at_w), U, alpha)
            placed[dyad.v] = self._hung(dyad.v, (at_v, at_w), V, beta)
        return placed

    def _pin(self, placed: dict[str, Pose], body: str, pin: str) -> tuple[complex, complex, complex]:
        return (self.ground[pin], 0j, 0j) if body == "ground" else placed[body].point(self.links[body].pins[pin])

    def _line(self, link: str, first: str, second: str) -> complex:
        return self.links[link].pins[second] - self.links[link].pins[first]

    def _hung(self, link: str, pins: tuple[str, str], start: Any, line: tuple[float, float, float]) -> Pose:
        """Return the pose of a link whose pin is at `start` and whose line of pins has the angle `line`."""
        angle = (line[0] - float(np.angle(self._line(link, *pins))), line[1], line[2])
        arm = Pose((0j, 0j, 0j), angle).point(self.links[link].pins[pins[0]])
        return Pose((start[0] - arm[0], start[1] - arm[1], start[2] - arm[2]), angle)

    def _closed(self, dyad: Dyad, U: Any, V: Any) -> Any:
        at_u, at_v, at_w = dyad.pins
        a, b = abs(self._line(dyad.u, at_u, at_w)), abs(self._line(dyad.v, at_v, at_w))
        gap = V[0] - U[0]
        cosine = (a**2 + abs(gap) ** 2 - b**2) / (2 * a * abs(gap))
        if abs(cosine) >= 1.0:
            raise ValueError(f"The links {dyad.u} and {dyad.v} do not reach each other.")
        alpha = float(np.angle(gap)) + dyad.side * float(np.arccos(cosine))
        beta = float(np.angle(U[0] + a * np.exp(1j * alpha) - V[0]))
        along, across = a * np.exp(1j * alpha), b * np.exp(1j * beta)
        matrix = np.array([[-along.imag, across.imag], [along.real, -across.real]])

        def solve(right: complex) -> Any:
            return np.linalg.solve(matrix, np.array([right.real, right.imag]))

        da, db = solve(V[1] - U[1])
        dda, ddb = solve(V[2] - U[2] + along * da**2 - across * db**2)
        return (alpha, da, dda), (beta, db, ddb)

    def equation(self, phi: float) -> tuple[float, float, float]:
        """Return I [kg m^2], dI/dphi and the generalized force of gravity [N m] at `phi`."""
        inertia = slope = force = 0.0
        for name, pose in self.poses(phi).items():
            link, c, a = self.links[name], pose.centre, pose.angle
            inertia += link.mass * abs(c[1]) ** 2 + link.inertia * a[1] ** 2
            slope += 2 * (link.mass * (c[1].conjugate() * c[2]).real + link.inertia * a[1] * a[2])
            force -= link.mass * self.gravity * c[1].imag
        return inertia, slope, force

    def acceleration(self, time: Any, phi: float, rate: float) -> Any:
        """Return phi'' [rad/s^2]."""
        inertia, slope, force = self.equation(phi)
        return (force + self.torque(time) - slope * rate**2 / 2) / inertia

    @ode.solved_once
    def solve(self, phi: float, rate: float, times: Any) -> Any:
        """Return (phi [rad], phi' [rad/s], work of the motor [J]) at `times` [s], shape (T, 3), by DOP853."""

        def right_side(time: Any, state: Any) -> Any:
            return np.array([state[1], self.acceleration(time, state[0], state[1]), self.torque(time) * state[1]])

        return ode.dop853(right_side, np.array([phi, rate, 0.0]), times)

    def model(self, phi: float, rate: float) -> dict[str, Any]:
        """Return the linkage as a free-form model at the crank's `phi` [rad] and `rate` [rad/s]."""
        bodies = {
            name: {
                "mass": self.links[name].mass,
                "inertia": self.links[name].inertia,
                "position": _pair(pose.centre[0]),
                "angle": float(pose.angle[0]),
                "velocity": _pair(pose.centre[1] * rate),
                "angular_velocity": float(pose.angle[1] * rate),
            }
            for name, pose in self.poses(phi).items()
        }
        crank = next(iter(self.links))
        joints = {"A": self._revolute("A", "ground", crank)}
        for dyad in self.dyads:
            at_u, at_v, at_w = dyad.pins
            joints[at_u] = self._revolute(at_u, dyad.base_u, dyad.u)
            joints[at_v] = self._revolute(at_v, dyad.base_v, dyad.v)
            joints[at_w] = self._revolute(at_w, dyad.u, dyad.v)
        motor = {"type": "torque", "body": crank, "value": self.torque_text}
        return {"name": "mechanism", "bodies": bodies, "joints": joints, "forces": {"motor": motor}}

    def _revolute(self, pin: str, first: str, second: str) -> dict[str, Any]:
        points = [self.ground[pin] if body == "ground" else self.links[body].pins[pin] for body in (first, second)]
        return {"type": "revolute", "bodies": [first, second], "points": [_pair(point) for point in points]}


def _pair(z: complex) -> list[float]:
    return [float(z.real), float(z.imag)]
