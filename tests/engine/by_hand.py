"""The equations of a mechanism written by hand from the contract, for complex numbers: an outside witness.

Coordinates are (3 (B + 1), ...) arrays, ground last, with any axes behind, so that many states are evaluated at once.
Nothing here is shared with the engine but the numbers in the mechanism.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, PPoly, make_interp_spline

from mbdkit.mechanism.beams import Beam
from mbdkit.mechanism.forces import PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.joints import Distance, Driver, PointOnLine, Prismatic, Revolute, Weld
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import Coordinate, RelativeAngle, TwoPoints
from mbdkit.mechanism.values import Table

TINY = 1e-200
"""Size of a complex step: its square vanishes beside anything."""

FIRST = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
SECOND = {0: -205 / 72, 1: 8 / 5, 2: -1 / 5, 3: 8 / 315, 4: -1 / 560}
"""Central differences of order 8: weights of the states at 0, 1, 2, 3 and 4 steps (Fornberg 1988)."""


def first_derivative(function: Callable[[float], Any], step: float) -> Any:
    """Return the first derivative at 0."""
    return sum(w * (function(k * step) - function(-k * step)) for k, w in FIRST.items()) / step


def second_derivative(function: Callable[[float], Any], step: float) -> Any:
    """Return the second derivative at 0."""
    sides = sum(w * (function(k * step) + function(-k * step)) for k, w in SECOND.items() if k)
    return (SECOND[0] * function(0.0) + sides) / step**2


def steps_along(x: np.ndarray, n: int) -> np.ndarray:
    """Return `x` with a complex step along each of its first `n` entries: (len(x), n)."""
    return x[:, None] + 1j * TINY * np.eye(len(x), n)


def derivatives(values: np.ndarray) -> np.ndarray:
    """Return what complex steps left in function values (m, n): the Jacobian."""
    found: np.ndarray = values.imag / TINY
    return found


def _atan2(y: Any, x: Any) -> Any:
    assert np.all(np.real(x) > 0), "the other branches have other constants"
    return np.arctan(y / x)


_NAMES: dict[str, Any] = {
    "pi": np.pi, "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "atan2": _atan2, "exp": np.exp, "log": np.log, "sqrt": np.sqrt, "tanh": np.tanh,
    "abs": lambda x: np.where(np.real(x) < 0, -x, x),
    "min": lambda x, y: np.where(np.real(x) <= np.real(y), x, y),
    "max": lambda x, y: np.where(np.real(x) >= np.real(y), x, y),
}  # fmt: skip


@lru_cache(maxsize=1024)
def _spline(table: Table) -> Any:
    if table.interpolation == "cubic":
        return CubicSpline(*table.table, bc_type=table.ends)
    assert table.interpolation == "quintic"
    ends = {"natural": [(3, 0.0), (4, 0.0)], "clamped": [(1, 0.0), (2, 0.0)]}[table.ends]
    return PPoly.from_spline(make_interp_spline(*table.table, k=5, bc_type=(ends, ends)))


@lru_cache(maxsize=1024)
def _code(text: str) -> Any:
    return compile(text, "<motion>", "eval")


def motion(value: Any, t: Any) -> Any:
    """Return a number, an expression or a table at the time `t`, which may be complex."""
    if isinstance(value, str):  # by Python itself, which the package never lets see a user's text
        return eval(_code(value), {"__builtins__": {}}, {**_NAMES, "t": t})
    if not isinstance(value, Table):
        return value
    spline, real = _spline(value), float(np.real(t))
    piece = int(np.clip(np.searchsorted(spline.x, real, side="right") - 1, 0, len(spline.x) - 2))
    return np.polyval(spline.c[:, piece], t - spline.x[piece])


def law_force(force: Any, length: Any, rate: Any) -> Any:
    """Return the force of a `linear`, `one-sided` or `table` law, positive where it pulls, for complex numbers too."""
    if force.law == "table":
        spline = CubicSpline(*force.table)
        inside = np.where(np.real(length) < spline.x[0], spline.x[0], length)
        inside = np.where(np.real(length) > spline.x[-1], spline.x[-1], inside)
        piece = np.clip(np.searchsorted(spline.x, np.real(inside), side="right") - 1, 0, len(spline.x) - 2)
        c3, c2, c1, c0 = spline.c[:, piece]
        x = inside - spline.x[piece]
        pull = ((c3 * x + c2) * x + c1) * x + c0
        return pull + ((3 * c3 * x + 2 * c2) * x + c1) * (length - inside) + force.damping * rate
    pull = force.stiffness * (length - force.free_length) + force.damping * rate
    if force.law == "linear":
        return pull
    assert force.law == "one-sided", "the law is written down here"
    side = 1.0 if force.acts == "tension" else -1.0
    touches = (side * np.real(length - force.free_length) > 0) & (side * np.real(pull) > 0)
    return np.where(touches, pull, 0.0)


def turned(angle: Any, vector: tuple[float, float]) -> Any:
    """Return a vector of a body's frame in the global frame."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def cross(u: Any, v: Any) -> Any:
    return u[0] * v[1] - u[1] * v[0]


class Polynomials:
    """Lagrange's polynomials of some nodes from -1 to 1; `scale` is the derivative of the place with respect to the arc
    length.
    """

    def __init__(self, nodes: np.ndarray, scale: float):
        self.nodes, self.scale = nodes, scale

    def _one(self, i: int) -> np.polynomial.Polynomial:
        others = np.delete(self.nodes, i)
        return np.polynomial.Polynomial.fromroots(others) / np.prod(self.nodes[i] - others)

    def value(self, i: int, x: float) -> float:
        return float(self._one(i)(x))

    def slope(self, i: int, x: float) -> float:
        return float(self._one(i).deriv()(x)) * self.scale

    def state(self, x: float, values: list[Any]) -> tuple[Any, Any]:
        """Return the derivatives of x, y and angle with respect to the arc length, and the angle, for `values` at the
        nodes.
        """
        slopes = sum(self.slope(i, x) * np.asarray(value) for i, value in enumerate(values))
        angle = sum(self.value(i, x) * value[2] for i, value in enumerate(values))
        return slopes, angle


class ByHand:
    """The equations of one mechanism."""

    def __init__(self, mechanism: Mechanism):
        self.mechanism = mechanism
        self.number = {name: i for i, name in enumerate([*mechanism.bodies, mechanism.ground])}
        self.n = 3 * len(mechanism.bodies)
        # the angle of a point mass means nothing; the engine keeps it at rest with an inertia of 1
        self.mass = np.array([(b.mass, b.mass, b.inertia or 1.0) for b in mechanism.bodies.values()]).ravel()

    @property
    def q(self) -> np.ndarray:
        """The given positions (3 (B + 1),), not assembled."""
        return np.array([(*b.position, b.angle) for b in self.mechanism.bodies.values()] + [(0.0, 0.0, 0.0)]).ravel()

    @property
    def v(self) -> np.ndarray:
        """The given velocities (3 (B + 1),), not assembled."""
        bodies = self.mechanism.bodies.values()
        return np.array([(*b.velocity, b.angular_velocity) for b in bodies] + [(0.0, 0.0, 0.0)]).ravel()

    def centre(self, q: Any, body: str) -> Any:
        """Return where a body's origin is."""
        i = 3 * self.number[body]
        return q[i : i + 2]

    def angle(self, q: Any, body: str) -> Any:
        return q[3 * self.number[body] + 2]

    def point(self, q: Any, body: str, point: tuple[float, float]) -> Any:
        """Return where a point of a body's frame is."""
        return self.centre(q, body) + turned(self.angle(q, body), point)

    def held_angle(self, joint: Prismatic | Weld) -> float:
        """Return the relative angle that a slide or weld keeps: by default that of the given start."""
        given = self.q
        a, b = joint.bodies
        return joint.angle if joint.angle is not None else float(self.angle(given, b) - self.angle(given, a))

    def phi(self, q: Any, t: Any) -> np.ndarray:
        """Return Phi(q, t), (m, ...), rows in the order of the joints."""
        rows: list[Any] = []
        for joint in self.mechanism.joints.values():
            a, b = joint.bodies
            turn = self.angle(q, b) - self.angle(q, a)
            if isinstance(joint, Driver):
                reached: Any = turn
                if joint.coordinate != "angle":
                    arm = self.point(q, b, joint.point) - self.centre(q, a)
                    axis = turned(self.angle(q, a), (1.0, 0.0))
                    reached = axis[0] * arm[0] + axis[1] * arm[1] if joint.coordinate == "x" else cross(axis, arm)
                rows.append(reached - motion(joint.motion, t))
                continue
            gap = self.point(q, b, joint.points[1]) - self.point(q, a, joint.points[0])
            if isinstance(joint, Revolute | Weld):
                rows += list(gap)
            elif isinstance(joint, Distance):
                rows.append(np.sqrt(gap[0] ** 2 + gap[1] ** 2) - joint.length)
            else:
                assert isinstance(joint, Prismatic | PointOnLine)
                rows.append(cross(turned(self.angle(q, a), joint.axis), gap) / np.hypot(*joint.axis))
            if isinstance(joint, Prismatic | Weld):
                rows.append(turn - self.held_angle(joint))
        shape = np.shape(q)[1:]
        return np.array([np.broadcast_to(row, shape) for row in rows]).reshape(len(rows), *shape)

    def jacobian(self, q: np.ndarray, t: float) -> np.ndarray:
        """Return Phi_q (m, 3 B)."""
        return derivatives(self.phi(steps_along(q, self.n), t))

    def phi_t(self, q: np.ndarray, t: float) -> np.ndarray:
        """Return Phi_t (m,)."""
        found: np.ndarray = np.imag(self.phi(q + 0j, t + 1j * TINY)) / TINY
        return found

    def conditioning(self, q: np.ndarray, t: float) -> float:
        """Return the least singular value of Phi_q M^-1/2 with rows of length 1: 0 where constraints are dependent."""
        jacobian = self.jacobian(q, t) / np.sqrt(self.mass)
        if len(jacobian) == 0:
            return 1.0
        if len(jacobian) > self.n:
            return 0.0
        return float(np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=1)[:, None], compute_uv=False)[-1])

    def forces(self, q: Any, v: Any, t: Any) -> np.ndarray:
        """Return the generalized applied forces with gravity, (3 B, ...)."""
        found = np.zeros(np.broadcast_shapes(np.shape(q), np.shape(v)), dtype=np.result_type(q, v))
        for name, body in self.mechanism.bodies.items():
            for axis in range(2):
                found[3 * self.number[name] + axis] += body.mass * self.mechanism.gravity[axis]
        for force in self.mechanism.forces.values():
            for name, push, at, torque in self.actions(force, q, v, t):
                i = 3 * self.number[name]
                found[i] += push[0]
                found[i + 1] += push[1]
                found[i + 2] += cross(turned(self.angle(q, name), at), push) + torque
        for name, beam in self.mechanism.beams.items():
            self.bend(name, beam, q, v, found)
        return found[: self.n]

    def bend(self, name: str, beam: Beam, q: Any, v: Any, found: np.ndarray) -> None:
        """Add the forces of a beam on its nodes, element by element, by virtual work at the points of Gauss."""
        points, weights = np.polynomial.legendre.leggauss(beam.nodes - 1)
        rest = Polynomials(np.linspace(-1.0, 1.0, beam.nodes), 2.0 / beam.element_length)
        for element in range(beam.elements):
            nodes = [f"{name}.{element * (beam.nodes - 1) + i}" for i in range(beam.nodes)]
            places = [beam.places[int(node.rpartition(".")[2])] for node in nodes]
            for x, weight in zip(points, weights * beam.element_length / 2, strict=True):
                (dx, dy, turn), angle = rest.state(x, [np.array(place) for place in places])
                unbent = self.strain(dx, dy, angle, turn)
                at, rate = ([self.whole(u, node) for node in nodes] for u in (q, v))
                (dx, dy, turn), angle = rest.state(x, at)
                (vx, vy, bending), spin = rest.state(x, rate)
                strain = self.strain(dx, dy, angle, turn)
                c, s = np.cos(angle), np.sin(angle)
                change = (c * vx + s * vy + strain[1] * spin, c * vy - s * vx - strain[0] * spin, bending)
                normal, shear, moment = (
                    k * (e - free + beam.damping * e_t)
                    for k, e, free, e_t in zip(beam.element_stiffness, strain, unbent, change, strict=True)
                )
                for i, node in enumerate(nodes):
                    shape, slope, place = rest.value(i, x), rest.slope(i, x), 3 * self.number[node]
                    found[place] -= weight * slope * (c * normal - s * shear)
                    found[place + 1] -= weight * slope * (s * normal + c * shear)
                    couple = normal * strain[1] - shear * strain[0]
                    found[place + 2] -= weight * (shape * couple + slope * moment)

    def whole(self, q: Any, body: str) -> Any:
        """Return x, y and angle of a body."""
        i = 3 * self.number[body]
        return q[i : i + 3]

    def strain(self, dx: Any, dy: Any, angle: Any, turn: Any) -> tuple[Any, Any, Any]:
        """Return the derivatives of the position along the tangent and across it, and the curvature."""
        c, s = np.cos(angle), np.sin(angle)
        return c * dx + s * dy, c * dy - s * dx, turn

    def actions(self, force: Any, q: Any, v: Any, t: Any) -> list[tuple[str, Any, tuple[float, float], Any]]:
        """Return what a force element does to bodies: (body, global force, point in the body's frame, torque).

        A new type of force element is written down here.
        """
        nothing, centre = np.zeros(2), (0.0, 0.0)
        if isinstance(force, PointForce):
            x, y = (motion(value, t) for value in force.value)
            push = turned(self.angle(q, force.body), (x, y)) if force.frame == "body" else np.array([x, y])
            return [(force.body, push, force.point, 0.0)]
        if isinstance(force, Torque):
            torque = motion(force.value, t)
            other = [] if force.reaction_body is None else [(force.reaction_body, nothing, centre, -torque)]
            return [(force.body, nothing, centre, torque), *other]
        path = force.pathway if isinstance(force, Law) else force
        a, b = path.bodies
        if isinstance(path, TorsionSpring | RelativeAngle):
            rate = self.angle(v, b) - self.angle(v, a)
            turn = self.angle(q, b) - self.angle(q, a)
            if isinstance(force, Law):
                torque = -law_force(force, turn, rate)
            else:
                torque = -force.stiffness * (turn - force.free_angle) - force.damping * rate
            return [(a, nothing, centre, -torque), (b, nothing, centre, torque)]
        if isinstance(path, Coordinate):
            axis = turned(self.angle(q, a), (1.0, 0.0) if path.coordinate == "x" else (0.0, 1.0))
            arm = self.point(q, b, path.point) - self.centre(q, a)
            away = self.speed(q, v, b, path.point) - self.centre(v, a)
            rate = axis[0] * away[0] + axis[1] * away[1] + self.angle(v, a) * cross(axis, arm)
            pull = law_force(force, axis[0] * arm[0] + axis[1] * arm[1], rate) * axis
            return [(a, pull, centre, cross(arm, pull)), (b, -pull, path.point, 0.0)]
        gap = self.point(q, b, path.points[1]) - self.point(q, a, path.points[0])
        length = np.sqrt(gap[0] ** 2 + gap[1] ** 2)
        speed = self.speed(q, v, b, path.points[1]) - self.speed(q, v, a, path.points[0])
        rate = (gap[0] * speed[0] + gap[1] * speed[1]) / length
        if isinstance(force, Law):
            pull = law_force(force, length, rate) * gap / length
        else:
            pull = (force.stiffness * (length - force.free_length) + force.damping * rate) * gap / length
        return [(a, pull, path.points[0], 0.0), (b, -pull, path.points[1], 0.0)]

    def speed(self, q: Any, v: Any, body: str, point: tuple[float, float]) -> Any:
        """Return the velocity of a point of a body's frame."""
        arm = turned(self.angle(q, body), point)
        return self.centre(v, body) + self.angle(v, body) * np.array([-arm[1], arm[0]])

    def spring_lengths(self, q: Any) -> np.ndarray:
        """Return the distance between the two ends of every pathway between two points, (S, ...) [m]."""
        paths = [getattr(force, "pathway", force) for force in self.mechanism.forces.values()]
        springs = [path for path in paths if isinstance(path, SpringDamper | TwoPoints)]
        ends = [[self.point(q, *end) for end in zip(s.bodies, s.points, strict=True)] for s in springs]
        return np.array([np.hypot(*(b - a)) for a, b in ends])
