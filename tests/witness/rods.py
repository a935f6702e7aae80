"""Two uniform rods in a row, in the two angles alone: moved by gravity, springs, torques, a force or a driver.

With absolute angles from the +x axis, a_i = L_i / 2, and d = theta1 - theta2,

    (J1 + m1 a1^2 + m2 L1^2) theta1'' + m2 L1 a2 cos(d) theta2'' = - m2 L1 a2 sin(d) theta2'^2 + Q1
    m2 L1 a2 cos(d) theta1'' + (J2 + m2 a2^2) theta2''           = + m2 L1 a2 sin(d) theta1'^2 + Q2

from Lagrange's equations of the second kind. A torsion spring in each joint acts with -k (Delta - free) - c Delta'
on the outer rod and with the opposite on the inner one; `torque` acts on rod 2 with its reaction on rod 1; `force`
acts on the end of rod 2. A driver prescribes theta1(t), which leaves theta2. The dissipated energy and the work are
integrated along.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import ode

Array = NDArray[np.floating[Any]]
Scalar = Any  # float, or long double where the yardstick itself is checked


def _nothing(time: Scalar) -> Scalar:
    return 0 * time


def _no_force(time: Scalar) -> tuple[Scalar, Scalar]:
    return 0 * time, 0 * time


@dataclass(frozen=True)
class TwoRods:
    """The data of the double pendulum; all lengths in m, masses in kg, angles in rad.

    Parameters
    ----------
    lengths, masses
        Two each; the inertias are those of uniform rods.
    stiffness, damping, free_angles
        Torsion springs [N m/rad] and dampers [N m s/rad] of the inner and the outer joint.
    torque
        Torque on rod 2 with its reaction on rod 1 [N m], a function of time.
    force
        Force on the end of rod 2 [N], a function of time.
    gravity
        Downward acceleration of gravity [m/s^2].
    """

    lengths: tuple[float, float] = (1.0, 1.0)
    masses: tuple[float, float] = (1.0, 1.0)
    stiffness: tuple[float, float] = (0.0, 0.0)
    damping: tuple[float, float] = (0.0, 0.0)
    free_angles: tuple[float, float] = (0.0, 0.0)
    torque: Callable[[Scalar], Scalar] = _nothing
    force: Callable[[Scalar], tuple[Scalar, Scalar]] = _no_force
    gravity: float = 9.81

    def _inertias(self, kind: type) -> tuple[Scalar, Scalar, Scalar]:
        """Return the two constant entries of the mass matrix and the coupling m2 L1 a2 [kg m^2]."""
        (l1, l2), (m1, m2) = (tuple(map(kind, pair)) for pair in (self.lengths, self.masses))
        return m1 * l1 * l1 / 3 + m2 * l1 * l1, m2 * l2 * l2 / 3, m2 * l1 * l2 / 2

    def loads(self, time: Scalar, angles: Array, rates: Array) -> tuple[Scalar, Scalar]:
        """Return the generalized forces (Q1, Q2) [N m] of gravity, springs, torque and force."""
        kind = type(angles[0])
        (l1, l2), (m1, m2) = (tuple(map(kind, pair)) for pair in (self.lengths, self.masses))
        c1, s1, c2, s2 = np.cos(angles[0]), np.sin(angles[0]), np.cos(angles[1]), np.sin(angles[1])
        gravity = kind(self.gravity)
        inner = -kind(self.stiffness[0]) * (angles[0] - kind(self.free_angles[0])) - kind(self.damping[0]) * rates[0]
        outer = -kind(self.stiffness[1]) * (angles[1] - angles[0] - kind(self.free_angles[1])) - kind(
            self.damping[1]
        ) * (rates[1] - rates[0])
        outer = outer + self.torque(time)
        fx, fy = self.force(time)
        return (
            -(m1 / 2 + m2) * gravity * l1 * c1 + inner - outer + l1 * (fy * c1 - fx * s1),
            -m2 * gravity * l2 / 2 * c2 + outer + l2 * (fy * c2 - fx * s2),
        )

    def accelerations(self, time: Scalar, angles: Array, rates: Array) -> tuple[Scalar, Scalar]:
        """Return (theta1'', theta2'') [rad/s^2] of the free double pendulum."""
        m11, m22, coupling = self._inertias(type(angles[0]))
        cosine, sine = np.cos(angles[0] - angles[1]), np.sin(angles[0] - angles[1])
        q1, q2 = self.loads(time, angles, rates)
        r1 = q1 - coupling * sine * rates[1] ** 2
        r2 = q2 + coupling * sine * rates[0] ** 2
        m12 = coupling * cosine
        determinant = m11 * m22 - m12 * m12
        return (m22 * r1 - m12 * r2) / determinant, (m11 * r2 - m12 * r1) / determinant

    def powers(self, time: Scalar, angles: Array, rates: Array) -> tuple[Scalar, Scalar]:
        """Return the power lost in the dampers and the power of torque and force [W]."""
        relative = rates[1] - rates[0]
        lost = self.damping[0] * rates[0] ** 2 + self.damping[1] * relative**2
        fx, fy = self.force(time)
        l1, l2 = self.lengths
        vx = -l1 * np.sin(angles[0]) * rates[0] - l2 * np.sin(angles[1]) * rates[1]
        vy = l1 * np.cos(angles[0]) * rates[0] + l2 * np.cos(angles[1]) * rates[1]
        return lost, self.torque(time) * relative + fx * vx + fy * vy

    def right_side(self, time: Scalar, state: Array) -> Array:
        """Return the derivative of (theta1, theta2, theta1', theta2', dissipated, work)."""
        angles, rates = state[:2], state[2:4]
        lost, power = self.powers(time, angles, rates)
        return np.array([*rates, *self.accelerations(time, angles, rates), lost, power], dtype=state.dtype)

    @ode.solved_once
    def solve(self, angles: tuple[float, float], rates: tuple[float, float], times: Array) -> Array:
        """Return (theta1, theta2, theta1', theta2', dissipated [J], work [J]) at `times` [s], shape (T, 6)."""
        return ode.dop853(self.right_side, np.array([*angles, *rates, 0.0, 0.0]), times)


@dataclass(frozen=True)
class Motion:
    """A prescribed motion of time: its value, first and second derivative, each a function of time [s]."""

    value: Callable[[Scalar], Scalar]
    rate: Callable[[Scalar], Scalar]
    acceleration: Callable[[Scalar], Scalar]


@dataclass(frozen=True)
class DrivenRods:
    """The same two rods with theta1 prescribed: one equation is left, the other gives the driver's torque."""

    rods: TwoRods
    motion: Motion

    def _first(self, time: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return self.motion.value(time), self.motion.rate(time), self.motion.acceleration(time)

    def _second(self, time: Scalar, state: Array) -> tuple[Scalar, Scalar]:
        """Return theta2'' [rad/s^2] and the driver's torque on rod 1 [N m]."""
        angle, rate, acceleration = self._first(time)
        kind = type(state[0])
        m11, m22, coupling = self.rods._inertias(kind)
        angles, rates = np.array([angle, state[0]], dtype=state.dtype), np.array([rate, state[1]], dtype=state.dtype)
        cosine, sine = np.cos(angle - state[0]), np.sin(angle - state[0])
        q1, q2 = self.rods.loads(time, angles, rates)
        second = (q2 + coupling * sine * rate**2 - coupling * cosine * acceleration) / m22
        torque = m11 * acceleration + coupling * cosine * second + coupling * sine * state[1] ** 2 - q1
        return second, torque

    def right_side(self, time: Scalar, state: Array) -> Array:
        """Return the derivative of (theta2, theta2', dissipated, work); work includes the driver's."""
        second, torque = self._second(time, state)
        angle, rate, _ = self._first(time)
        angles, rates = np.array([angle, state[0]], dtype=state.dtype), np.array([rate, state[1]], dtype=state.dtype)
        lost, power = self.rods.powers(time, angles, rates)
        return np.array([state[1], second, lost, power + torque * rate], dtype=state.dtype)

    @ode.solved_once
    def solve(self, angle: float, rate: float, times: Array) -> Array:
        """Return (theta1, theta2, theta1', theta2', dissipated [J], work [J], driver torque [N m]), shape (T, 7)."""
        inner = ode.dop853(self.right_side, np.array([angle, rate, 0.0, 0.0]), times)
        rows = []
        for time, state in zip(times, inner, strict=True):
            first, first_rate, _ = self._first(time)
            rows.append([first, state[0], first_rate, state[1], state[2], state[3], self._second(time, state)[1]])
        return np.array(rows)
