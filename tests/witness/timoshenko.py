"""Natural frequencies of Timoshenko's beam, from its equations as a boundary value problem of the matrix exponential.

Small vibrations w (deflection), theta (rotation), M and Q of frequency omega along a straight beam obey

    w' = theta + Q/GA,   theta' = M/EI,   M' = -Q - rho I omega^2 theta,   Q' = -rho A omega^2 w,

a linear system with constant coefficients. A frequency is natural where the matrix of the conditions at both ends is
singular. S. P. Timoshenko, On the correction for shear of the differential equation for transverse vibrations of
prismatic bars, Phil. Mag. 41 (1921).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

ZERO_AT = {"clamped": (0, 1), "pinned": (0, 2), "free": (2, 3)}
"""Places of the quantities among (w, theta, M, Q) that are zero at an end."""


@dataclass(frozen=True)
class TimoshenkoBeam:
    """Length, shear and bending stiffness, and mass and moment of inertia per length; SI units."""

    length: float
    shear: float
    bending: float
    mass: float
    inertia: float

    def frequencies(self, ends: tuple[str, str], count: int) -> np.ndarray:
        """Return the lowest natural frequencies above zero [rad/s] with the given conditions at both ends."""
        unit = np.sqrt(self.bending / self.mass) / self.length**2
        found: list[float] = []
        omega = 0.5 * unit
        value = self._determinant(ends, omega)
        while len(found) < count:
            step = 0.02 * omega
            after = self._determinant(ends, omega + step)
            if value * after < 0:
                found.append(brentq(lambda x: self._determinant(ends, x), omega, omega + step, xtol=1e-13 * omega))
            omega, value = omega + step, after
        return np.array(found)

    def _determinant(self, ends: tuple[str, str], omega: float) -> float:
        # lengths in units of the beam, moments in EI / L, forces in EI / L^2
        length, bending = self.length, self.bending
        square = omega**2
        matrix = np.array(
            [
                [0, 1, 0, bending / (self.shear * length**2)],
                [0, 0, 1, 0],
                [0, -self.inertia * square * length**2 / bending, 0, -1],
                [-self.mass * square * length**4 / bending, 0, 0, 0],
            ]
        )
        first, last = ZERO_AT[ends[0]], ZERO_AT[ends[1]]
        free = [i for i in range(4) if i not in first]
        return float(np.linalg.det(expm(matrix)[np.ix_(last, free)]))
