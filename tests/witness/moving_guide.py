"""A slider-crank whose guide is a body on a spring, in two coordinates: the crank's angle phi and the guide's psi.

Points are complex numbers. The crank turns about the origin, the guide about G, and the slider C sits on a line of the
guide at a distance d from G; crank end B and slider are a rod's length l apart:

    B = r exp(i phi),    C = G + (s + i d) exp(i psi),    |C - B| = l.

The last equation, differentiated twice, gives s' and s''. All accelerations are then affine in (phi'', psi''), and
Newton's and Euler's equations projected on the two motions (Jourdain's principle) give both. The guide's own equation
of moments leaves what presses the slider against it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import ode

Array = NDArray[np.floating[Any]]

CRANK, ROD, GUIDE, SLIDER = range(4)
NAMES = ("crank", "rod", "guide", "slider")


@dataclass(frozen=True)
class MovingGuide:
    """The mechanism; all lengths in m, masses in kg, inertias in kg m^2 about the centres of mass.

    Parameters
    ----------
    pivot
        G.
    crank, rod, offset
        r, l and d.
    masses, inertias
        Of crank, rod, guide and slider.
    centres
        Of the crank from the origin, of the rod from B and of the guide from G, in their own frames; the slider's is C.
    stiffness, damping, free_angle
        Torsion spring [N m/rad] and damper [N m s/rad] between ground and guide.
    gravity
        Downward acceleration of gravity [m/s^2].
    """

    pivot: complex = 0.5 - 0.3j
    crank: float = 0.25
    rod: float = 1.0
    offset: float = 0.06
    masses: tuple[float, float, float, float] = (1.0, 0.8, 2.0, 1.2)
    inertias: tuple[float, float, float, float] = (0.2, 0.05, 0.3, 0.01)
    centres: tuple[complex, complex, complex] = (0.14 + 0.01j, 0.35 + 0.05j, 0.4 - 0.05j)
    stiffness: float = 120.0
    damping: float = 3.0
    free_angle: float = 0.1
    gravity: float = 9.81

    def torque(self, time: float) -> float:
        """Return the motor's torque on the crank [N m]."""
        return 4.0 * float(np.sin(3.0 * time))

    def place(self, coordinates: Array) -> tuple[Any, Any, Any]:
        """Return the four centres of mass, the four angles and s."""
        phi, psi = coordinates
        b, e = self.crank * np.exp(1j * phi), np.exp(1j * psi)
        seen = (self.pivot - b) / e + 1j * self.offset
        s = float(-seen.real + np.sqrt(self.rod**2 - seen.imag**2))
        c = self.pivot + (s + 1j * self.offset) * e
        alpha = float(np.angle(c - b))
        turns = np.exp(1j * np.array([phi, alpha, psi, psi]))
        centres = np.array([0j, b, self.pivot, c])
        centres[:3] += np.array(self.centres) * turns[:3]
        return centres, np.array([phi, alpha, psi, psi]), s

    def motion(self, coordinates: Array, rates: Array, second: Array) -> tuple[Any, Any, Any, Any]:
        """Return velocities and accelerations of the centres of mass and of the angles: v, omega, a, omega'."""
        phi, psi = coordinates
        _, (_, alpha, _, _), s = self.place(coordinates)
        b, e = self.crank * np.exp(1j * phi), np.exp(1j * psi)
        arm = (s + 1j * self.offset) * e
        span = self.pivot + arm - b
        db, ddb = 1j * rates[0] * b, (1j * second[0] - rates[0] ** 2) * b
        carried = 1j * rates[1] * arm - db  # of C against B, but for s'
        ds = -_dot(span, carried) / _dot(span, e)
        dspan = carried + ds * e
        carried = (1j * second[1] - rates[1] ** 2) * arm + 2j * ds * rates[1] * e - ddb
        dds = -(_dot(span, carried) + abs(dspan) ** 2) / _dot(span, e)
        ddspan = carried + dds * e
        dalpha, ddalpha = (float((span.conjugate() * z).imag) / self.rod**2 for z in (dspan, ddspan))
        omega = np.array([rates[0], dalpha, rates[1], rates[1]])
        turning = np.array([second[0], ddalpha, second[1], second[1]])
        arms = np.array([*self.centres, 0j]) * np.exp(1j * np.array([phi, alpha, psi, psi]))
        v = np.array([0j, db, 0j, db + dspan]) + 1j * omega * arms
        a = np.array([0j, ddb, 0j, ddb + ddspan]) + (1j * turning - omega**2) * arms
        return v, omega, a, turning

    def accelerations(self, time: float, coordinates: Array, rates: Array) -> Any:
        """Return (phi'', psi'') [rad/s^2]."""
        masses, inertias = np.array(self.masses), np.array(self.inertias)
        still, none = np.zeros(2), np.zeros(2)
        ways = [self.motion(coordinates, way, none)[:2] for way in np.eye(2)]
        _, _, a, turning = self.motion(coordinates, rates, still)
        torques = np.array([self.torque(time), 0.0, self.spring(coordinates[1], rates[1]), 0.0])
        matrix, force = np.zeros((2, 2)), np.zeros(2)
        for i, (v, omega) in enumerate(ways):
            force[i] = np.sum(_dot(v, masses * (-1j * self.gravity - a)) + omega * (torques - inertias * turning))
            for j, (other, spin) in enumerate(ways):
                matrix[i, j] = np.sum(masses * _dot(v, other) + inertias * omega * spin)
        return np.linalg.solve(matrix, force)

    def spring(self, psi: float, rate: float) -> float:
        """Return the torque of spring and damper on the guide [N m]."""
        return -self.stiffness * (psi - self.free_angle) - self.damping * rate

    @ode.solved_once
    def solve(self, coordinates: Array, rates: Array, times: Array) -> Any:
        """Return (phi, psi, phi', psi', work of the motor, dissipated energy) at `times`, by DOP853, shape (T, 6)."""

        def right_side(time: Any, state: Any) -> Any:
            work, lost = self.torque(time) * state[2], self.damping * state[3] ** 2
            return np.array([*state[2:4], *self.accelerations(time, state[:2], state[2:4]), work, lost])

        return ode.dop853(right_side, np.array([*coordinates, *rates, 0.0, 0.0]), times)

    def energy(self, coordinates: Array, rates: Array) -> float:
        """Return kinetic plus potential energy [J]; gravity's potential is zero at y = 0."""
        v, omega, _, _ = self.motion(coordinates, rates, np.zeros(2))
        kinetic = np.sum(np.array(self.masses) * abs(v) ** 2 + np.array(self.inertias) * omega**2) / 2
        height = np.sum(np.array(self.masses) * self.place(coordinates)[0].imag)
        return float(kinetic + self.gravity * height + self.stiffness * (coordinates[1] - self.free_angle) ** 2 / 2)

    def pressure(self, time: float, coordinates: Array, rates: Array) -> tuple[complex, float]:
        """Return what the guide exerts on the slider at C: force [N] across the line, and torque [N m].

        The slider turns with the guide, by the torque J psi''; the pin at its centre has none. The guide's moments
        about G leave the force.
        """
        second = self.accelerations(time, coordinates, rates)
        centres, (_, _, psi, _), s = self.place(coordinates)
        _, _, a, _ = self.motion(coordinates, rates, second)
        torque = self.inertias[SLIDER] * float(second[1])
        arm = centres[GUIDE] - self.pivot
        thrust = self.masses[GUIDE] * (a[GUIDE] + 1j * self.gravity)
        needed = float((arm.conjugate() * thrust).imag) + self.inertias[GUIDE] * float(second[1])
        across = (self.spring(psi, rates[1]) - torque - needed) / s
        return 1j * across * np.exp(1j * psi), torque

    def model(self, coordinates: Array, rates: Array) -> dict[str, Any]:
        """Return the mechanism as a free-form model."""
        centres, angles, _ = self.place(coordinates)
        v, omega, _, _ = self.motion(coordinates, rates, np.zeros(2))
        bodies = {
            name: {
                "mass": self.masses[k],
                "inertia": self.inertias[k],
                "position": _pair(centres[k]),
                "angle": float(angles[k]),
                "velocity": _pair(v[k]),
                "angular_velocity": float(omega[k]),
            }
            for k, name in enumerate(NAMES)
        }
        on_crank, on_rod, on_guide = self.centres
        line = 1j * self.offset - on_guide  # a driver of x or y measures from the guide's centre of mass

        def pin(first: str, second: str, *points: complex) -> dict[str, Any]:
            return {"type": "revolute", "bodies": [first, second], "points": [_pair(point) for point in points]}

        joints = {
            "A": pin("ground", "crank", 0j, -on_crank),
            "B": pin("crank", "rod", self.crank - on_crank, -on_rod),
            "C": pin("rod", "slider", self.rod - on_rod, 0j),
            "G": pin("ground", "guide", self.pivot, -on_guide),
            "line": {"type": "driver", "bodies": ["guide", "slider"], "coordinate": "y", "motion": line.imag},
            "turn": {"type": "driver", "bodies": ["guide", "slider"], "coordinate": "angle", "motion": 0.0},
        }
        forces = {
            "motor": {"type": "torque", "body": "crank", "value": "4*sin(3*t)"},
            "spring": {
                "type": "torsion-spring",
                "bodies": ["ground", "guide"],
                "stiffness": self.stiffness,
                "damping": self.damping,
                "free_angle": self.free_angle,
            },
        }
        return {"name": "mechanism", "bodies": bodies, "joints": joints, "forces": forces}


def _dot(a: Any, b: Any) -> Any:
    return (np.conjugate(a) * b).real


def _pair(z: complex) -> list[float]:
    return [float(z.real), float(z.imag)]
