"""A parallelogram linkage on any number of equal cranks, in the cranks' common angle phi alone.

All cranks keep the angle phi and the coupler only moves along a circle, so that with b_i the cranks' distances from the
first, e = (cos phi, sin phi) and L their length,

    (sum (J_i + m_i L^2 / 4) + M L^2) phi'' = T(t) - g cos(phi) L (sum m_i / 2 + M)

from Lagrange's equations of the second kind. One crank more than two adds a closed loop and no freedom: 12 pin forces
balance four bodies in the plane by 12 equations of rank 11. Of all forces that do, `pin_forces` returns the least,
from Newton's and Euler's equations of the single bodies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import ode

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Parallelogram:
    """The linkage; lengths in m, masses in kg.

    Parameters
    ----------
    bases
        Where the cranks are pinned to the ground, on the x axis; the first one at 0.
    masses
        Of the cranks, uniform rods.
    coupler
        Mass of the coupler, a uniform rod from the first crank's pin to the second's.
    length
        Of the cranks.
    torque, torque_text
        On the first crank [N m], a function of time, and the same as an expression of t.
    """

    bases: tuple[float, ...] = (0.0, 2.0, 0.7)
    masses: tuple[float, ...] = (1.0, 1.5, 0.8)
    coupler: float = 2.0
    length: float = 1.2
    torque: Callable[[float], float] = lambda time: float(1.5 * np.cos(3 * time))
    torque_text: str = "1.5*cos(3*t)"
    gravity: float = 9.81

    def acceleration(self, time: float, phi: float) -> float:
        """Return phi'' [rad/s^2]."""
        cranks = sum(self.masses)
        inertia = (cranks / 3 + self.coupler) * self.length**2
        weight = self.gravity * self.length * (cranks / 2 + self.coupler)
        return float((self.torque(time) - weight * np.cos(phi)) / inertia)

    @ode.solved_once
    def solve(self, phi: float, rate: float, times: Array) -> Array:
        """Return (phi, phi') at `times` [s], shape (T, 2)."""

        def right_side(time: float, state: Array) -> Array:
            return np.array([state[1], self.acceleration(time, state[0])])

        return ode.dop853(right_side, np.array([phi, rate]), times)

    def centres(self, phi: Any) -> dict[str, Any]:
        """Return every body's centre of mass as a complex number [m]."""
        arm = self.length * np.exp(1j * phi)
        found = {f"crank{i}": base + arm / 2 for i, base in enumerate(self.bases)}
        return {**found, "coupler": self.bases[1] / 2 + arm}

    def pin_forces(self, time: float, phi: float, rate: float) -> dict[str, Array]:
        """Return the force [N] on the second body at every pin: of all that balance the bodies, the least."""
        arm = self.length * np.exp(1j * phi)
        angular = self.acceleration(time, phi)
        swing = (1j * angular - rate**2) * arm
        n = len(self.bases)
        matrix, right = np.zeros((3 * (n + 1), 4 * n)), np.zeros(3 * (n + 1))

        def act(body: int, pin: int, lever: complex, sign: float) -> None:
            for axis in range(2):
                matrix[3 * body + axis, 2 * pin + axis] += sign
            matrix[3 * body + 2, 2 * pin] -= sign * lever.imag
            matrix[3 * body + 2, 2 * pin + 1] += sign * lever.real

        for i, (base, mass) in enumerate(zip(self.bases, self.masses, strict=True)):
            push = mass * (swing / 2 + 1j * self.gravity)
            moment = mass * self.length**2 / 12 * angular - (self.torque(time) if i == 0 else 0.0)
            right[3 * i : 3 * i + 3] = push.real, push.imag, moment
            act(i, 2 * i, -arm / 2, 1.0)
            act(i, 2 * i + 1, arm / 2, -1.0)
            act(n, 2 * i + 1, base - self.bases[1] / 2, 1.0)
        push = self.coupler * (swing + 1j * self.gravity)
        right[3 * n : 3 * n + 2] = push.real, push.imag
        forces, _, rank, _ = np.linalg.lstsq(matrix, right, rcond=1e-12)
        assert rank == 3 * (n + 1) - 1  # all but the one freedom
        np.testing.assert_allclose(matrix @ forces, right, rtol=0, atol=1e-11)
        names = [f"{where}{i}" for i in range(n) for where in ("base", "top")]
        return dict(zip(names, forces.reshape(-1, 2), strict=True))

    def model(self, phi: float, rate: float) -> dict[str, Any]:
        """Return mbdkit's free-form model of it, in absolute coordinates."""
        arm, across = (self.length * factor * np.exp(1j * phi) for factor in (1.0, 1j))
        bodies, joints = {}, {}
        for i, (base, mass) in enumerate(zip(self.bases, self.masses, strict=True)):
            centre, velocity = base + arm / 2, rate * across / 2
            bodies[f"crank{i}"] = {
                "mass": mass,
                "inertia": mass * self.length**2 / 12,
                "position": [centre.real, centre.imag],
                "angle": phi,
                "velocity": [velocity.real, velocity.imag],
                "angular_velocity": rate,
            }
            half = self.length / 2
            pins = {
                f"base{i}": (["ground", f"crank{i}"], [[base, 0.0], [-half, 0.0]]),
                f"top{i}": ([f"crank{i}", "coupler"], [[half, 0.0], [base - self.bases[1] / 2, 0.0]]),
            }
            for name, (ends, points) in pins.items():
                joints[name] = {"type": "revolute", "bodies": ends, "points": points}
        centre, velocity = self.bases[1] / 2 + arm, rate * across
        bodies["coupler"] = {
            "mass": self.coupler,
            "inertia": self.coupler * self.bases[1] ** 2 / 12,
            "position": [centre.real, centre.imag],
            "velocity": [velocity.real, velocity.imag],
        }
        forces = {"motor": {"type": "torque", "body": "crank0", "value": self.torque_text}}
        return {"name": "mechanism", "bodies": bodies, "joints": joints, "forces": forces}
