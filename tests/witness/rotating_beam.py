"""Natural frequencies of a beam that rotates at constant speed, in its plane, by Chebyshev collocation.

A beam along the radius is clamped at the axis. At constant speed omega, its cross-section s is at the radius
r = sin(k s) / (k cos(k L)), k = omega sqrt(rho A / EA), and its axial force is N = EA (r' - 1). In the rotating frame,
small vibrations u along the radius, w across it and theta obey Reissner's equations, linearised about this state:

    rho A (u'' - 2 omega w' - omega^2 u) = d/ds (EA u_s),
    rho A (w'' + 2 omega u' - omega^2 w) = d/ds Q,             Q = GA (w_s - r' theta) + N theta,
    rho I theta'' = d/ds (EI theta_s) + r' Q - N w_s,

with u = w = theta = 0 at the axis, and u_s = Q = theta_s = 0 at the tip.

For small strains r' = 1 and N = rho A omega^2 (L^2 - s^2) / 2. Without shear and rotary inertia, these are the
equations of H. H. Yoo and S. H. Shin, Vibration analysis of rotating cantilever beams, Journal of Sound and Vibration
212 (1998). L. N. Trefethen, Spectral Methods in MATLAB (2000) has the differentiation matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eig


def differentiation(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return Chebyshev's points (size + 1,) on [-1, 1], from 1 to -1, and the matrix that differentiates there."""
    x = np.cos(np.pi * np.arange(size + 1) / size)
    c = np.array([2.0, *np.ones(size - 1), 2.0]) * (-1.0) ** np.arange(size + 1)
    matrix = np.outer(c, 1 / c) / (x[:, None] - x + np.eye(size + 1))
    return x, matrix - np.diag(np.sum(matrix, axis=1))


@dataclass(frozen=True)
class StraightBeam:
    """Length, axial, shear and bending stiffness, and mass and moment of inertia per length; SI units."""

    length: float
    axial: float
    shear: float
    bending: float
    mass: float
    inertia: float


class RotatingBeam(StraightBeam):
    """A beam along the radius, at constant speed."""

    def radius(self, s: np.ndarray, omega: float) -> np.ndarray:
        """Return the radius of cross-sections at constant speed [m]."""
        k = omega * np.sqrt(self.mass / self.axial)
        return np.asarray(np.sin(k * s) / (k * np.cos(k * self.length)))

    def frequencies(self, omega: float, count: int, *, size: int = 20, small_strains: bool = False) -> np.ndarray:
        """Return the lowest natural frequencies at the speed `omega` [rad/s]."""
        x, matrix = differentiation(size)
        s, by_s = self.length * (1 + x) / 2, 2 / self.length * matrix
        k = omega * np.sqrt(self.mass / self.axial)
        stretch = np.ones(size + 1) if small_strains else np.cos(k * s) / np.cos(k * self.length)
        pull = self.mass * omega**2 * (self.length**2 - s**2) / 2 if small_strains else self.axial * (stretch - 1)
        none, turned = np.zeros_like(by_s), np.diag(pull - self.shear * stretch)
        forces = (  # axial force, shear force and moment
            np.hstack([self.axial * by_s, none, none]),
            np.hstack([none, self.shear * by_s, turned]),
            np.hstack([none, none, self.bending * by_s]),
        )
        arms = stretch[:, None] * forces[1] - pull[:, None] * np.hstack([none, by_s, none])
        inertia = np.kron(np.diag([self.mass, self.mass, self.inertia]), np.eye(size + 1))
        turning = 2 * omega * self.mass * np.kron([[0, -1, 0], [1, 0, 0], [0, 0, 0]], np.eye(size + 1))
        force = np.vstack([by_s @ forces[0], by_s @ forces[1], by_s @ forces[2] + arms])
        force += omega**2 * self.mass * np.kron(np.diag([1, 1, 0]), np.eye(size + 1))
        for first, at_tip in zip(range(0, 3 * (size + 1), size + 1), forces, strict=True):
            force[first], force[first + size] = at_tip[0], np.eye(3 * (size + 1))[first + size]
            for place in (first, first + size):
                inertia[place] = turning[place] = 0.0
        unit, nothing = np.eye(len(force)), np.zeros_like(force)
        values = eig(np.block([[nothing, unit], [force, -turning]]), np.block([[unit, nothing], [nothing, inertia]]))[0]
        found = values[np.isfinite(values) & (values.imag > 0) & (np.abs(values.real) < 1e-3 * np.abs(values))].imag
        return np.sort(found)[:count]
