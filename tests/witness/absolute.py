"""The n-rod pendulum in absolute coordinates with dense NumPy matrices, and two textbook Runge-Kutta codes for it.

The equations are those of mbdkit's index-1 formulation, written for this one chain without any sparsity:

    [ M      Phi_q^T ] [ a      ]   [ Q     ]      Phi = second point minus first point of every joint, x and y,
    [ Phi_q  0       ] [ lambda ] = [ gamma ]      then theta1 - motion(t) if the first rod is driven.

`rk4` is the classical method (Kutta 1901). `rk_gill` is Gill's method in his own storage scheme (S. Gill, A process
for the step-by-step integration of differential equations in an automatic digital computing machine, Proc. Camb.
Phil. Soc. 47, 1951), with the running register q that carries the rounding over; in exact arithmetic it is the
tableau of Gill's method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .rods import Motion, TwoRods

Array = NDArray[Any]
RightSide = Callable[[float, Array], Array]


@dataclass(frozen=True)
class AbsoluteRods:
    """A chain of uniform rods that hangs from the origin; q is (x, y, theta) of every rod, shape (3 n,).

    Parameters
    ----------
    lengths, masses
        One for each rod [m], [kg].
    load
        Applied forces (3 n,) besides gravity, a function of t, q, v.
    motion
        theta1(t), if the first rod is driven.
    gravity
        Downward acceleration of gravity [m/s^2].

    All numbers may be complex, for derivatives by complex steps.
    """

    lengths: tuple[float, ...]
    masses: tuple[float, ...]
    load: Callable[[float, Array, Array], Array] | None = None
    motion: Motion | None = None
    gravity: float = 9.81

    @classmethod
    def of(cls, rods: TwoRods, motion: Motion | None = None) -> AbsoluteRods:
        """Return the two rods of `rods.py` with their springs, torque and force, in absolute coordinates."""

        def load(time: float, q: Array, v: Array) -> Array:
            inner = -rods.stiffness[0] * (q[2] - rods.free_angles[0]) - rods.damping[0] * v[2]
            outer = -rods.stiffness[1] * (q[5] - q[2] - rods.free_angles[1]) - rods.damping[1] * (v[5] - v[2])
            outer += rods.torque(time)
            fx, fy = rods.force(time)
            half = rods.lengths[1] / 2
            moment = half * (np.cos(q[5]) * fy - np.sin(q[5]) * fx)
            return np.array([0.0, 0.0, inner - outer, fx, fy, outer + moment])

        return cls(lengths=rods.lengths, masses=rods.masses, load=load, motion=motion, gravity=rods.gravity)

    def state(self, angles: Array, rates: Array) -> Array:
        """Return (q, v), shape (6 n,), on the constraints, from the rods' angles [rad] and rates [rad/s]."""
        kind = np.result_type(angles, rates, *self.lengths)
        q, v = np.zeros((len(angles), 3), kind), np.zeros((len(angles), 3), kind)
        end, end_rate = np.zeros(2), np.zeros(2)
        for i, (length, angle, rate) in enumerate(zip(self.lengths, angles, rates, strict=True)):
            along = length * np.array([np.cos(angle), np.sin(angle)])
            across = rate * np.array([-along[1], along[0]])
            q[i], v[i] = [*(end + along / 2), angle], [*(end_rate + across / 2), rate]
            end, end_rate = end + along, end_rate + across
        return np.concatenate([q.ravel(), v.ravel()])

    def solve(self, time: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return accelerations (3 n,) and multipliers (2 n or 2 n + 1,)."""
        n = len(self.lengths)
        rows = 2 * n + (self.motion is not None)
        kind = np.result_type(q, v, *self.lengths)
        jacobian, gamma = np.zeros((rows, 3 * n), kind), np.zeros(rows, kind)
        for i, length in enumerate(self.lengths):
            half, angle, rate = length / 2, q[3 * i + 2], v[3 * i + 2]
            x, y = half * np.cos(angle), half * np.sin(angle)
            jacobian[2 * i : 2 * i + 2, 3 * i : 3 * i + 3] = [[1, 0, y], [0, 1, -x]]
            gamma[2 * i : 2 * i + 2] += [-(rate**2) * x, -(rate**2) * y]
            if i + 1 < n:
                jacobian[2 * i + 2 : 2 * i + 4, 3 * i : 3 * i + 3] = [[-1, 0, y], [0, -1, -x]]
                gamma[2 * i + 2 : 2 * i + 4] += [-(rate**2) * x, -(rate**2) * y]
        if self.motion is not None:
            jacobian[-1, 2] = 1.0
            gamma[-1] = self.motion.acceleration(time)
        mass = np.array([[m, m, m * length**2 / 12] for m, length in zip(self.masses, self.lengths, strict=True)])
        applied = np.array([[0.0, -m * self.gravity, 0.0] for m in self.masses]).ravel()
        if self.load is not None:
            applied = applied + self.load(time, q, v)
        matrix = np.block([[np.diag(mass.ravel()), jacobian.T], [jacobian, np.zeros((rows, rows))]])
        solved = np.linalg.solve(matrix, np.concatenate([applied, gamma]))
        return solved[: 3 * n], solved[3 * n :]

    def right_side(self, time: float, state: Array) -> Array:
        """Return the derivative of (q, v)."""
        n = 3 * len(self.lengths)
        return np.concatenate([state[n:], self.solve(time, state[:n], state[n:])[0]])

    def misalignment(self, state: Array) -> Array:
        """Return the distance [m] by which the two points of each joint fail to meet, shape (n,)."""
        gaps, end = [], np.zeros(2)
        for i, length in enumerate(self.lengths):
            half = length / 2 * np.array([np.cos(state[3 * i + 2]), np.sin(state[3 * i + 2])])
            centre = state[3 * i : 3 * i + 2]
            gaps.append(float(np.hypot(*(centre - half - end))))
            end = centre + half
        return np.array(gaps)


def rk4(right_side: RightSide, state: Array, step: float, steps: int) -> Array:
    """Return the states of `steps` steps of the classical method, the start included, shape (steps + 1, n)."""
    rows = [state]
    for k in range(steps):
        time, y = k * step, rows[-1]
        k1 = right_side(time, y)
        k2 = right_side(time + step / 2, y + step / 2 * k1)
        k3 = right_side(time + step / 2, y + step / 2 * k2)
        k4 = right_side(time + step, y + step * k3)
        rows.append(y + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.array(rows)


def rk_gill(right_side: RightSide, state: Array, step: float, steps: int) -> Array:
    """Return the states of `steps` steps of Gill's process, the start included, shape (steps + 1, n)."""
    root = np.sqrt(0.5)
    first, second, third = (0.5, 1 - root, 1 + root, 1 / 6), (2.0, 1.0, 1.0, 2.0), (0.5, 1 - root, 1 + root, 0.5)
    nodes = (0.0, 0.5, 0.5, 1.0)
    register = np.zeros_like(state)
    rows = [state]
    for k in range(steps):
        y = rows[-1]
        for a, b, c, node in zip(first, second, third, nodes, strict=True):
            slope = right_side((k + node) * step, y)
            change = a * (slope - b * register)
            y = y + step * change
            register = register + 3 * change - c * slope
        rows.append(y)
    return np.array(rows)
