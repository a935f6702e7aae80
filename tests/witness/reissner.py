"""Cantilevers by Reissner's equations as a boundary value problem, solved by SciPy.

The cantilever lies on the x axis, is clamped at the origin and carries a constant force and a moment at its tip, and a
constant load per length. With the arc length s of the unloaded beam, the force (F_x, F_y) on what lies beyond s, the
angle theta and the bending moment M,

    N = F_x cos(theta) + F_y sin(theta),        Q = F_y cos(theta) - F_x sin(theta),
    x' = (1 + N/EA) cos(theta) - Q/GA sin(theta),   y' = (1 + N/EA) sin(theta) + Q/GA cos(theta),
    theta' = M/EI,                              M' = -(x' F_y - y' F_x).

E. Reissner, On one-dimensional finite-strain beam theory: the plane problem, J. Appl. Math. Phys. 23 (1972).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_bvp


@dataclass(frozen=True)
class Cantilever:
    """A cantilever along the x axis; `shear` may be infinite. SI units."""

    length: float
    axial: float
    shear: float
    bending: float

    def under(
        self,
        force: tuple[float, float],
        moment: float = 0.0,
        *,
        load: tuple[float, float] = (0.0, 0.0),
        tolerance: float = 1e-11,
    ) -> np.ndarray:
        """Return displacement (x, y) and rotation of the tip under a force and a moment there, and a load [N/m]."""
        unit = self.bending / self.length  # of moments
        s = np.linspace(0.0, self.length, 101)
        guess = np.vstack([s, 0 * s, 0 * s, 0 * s])
        for share in (0.25, 0.5, 0.75, 1.0):  # load steps

            def slopes(s: np.ndarray, y: np.ndarray, share: float = share) -> np.ndarray:
                fx, fy = (share * (f + p * (self.length - s)) for f, p in zip(force, load, strict=True))
                c, sn = np.cos(y[2]), np.sin(y[2])
                stretch, slide = 1 + (fx * c + fy * sn) / self.axial, (fy * c - fx * sn) / self.shear
                dx, dy = stretch * c - slide * sn, stretch * sn + slide * c
                return np.vstack([dx, dy, y[3] * unit / self.bending, -(dx * fy - dy * fx) / unit])

            def ends(a: np.ndarray, b: np.ndarray, share: float = share) -> np.ndarray:
                return np.array([a[0], a[1], a[2], b[3] - share * moment / unit])

            solved = solve_bvp(slopes, ends, s, guess, tol=tolerance, max_nodes=200_000)
            assert solved.success, solved.message
            s, guess = solved.x, solved.y
        return solved.y[:3, -1] - (self.length, 0.0, 0.0)


@dataclass(frozen=True)
class Arch:
    """A circular arch between clamps at (-span/2, 0) and (span/2, 0), without stress; it bends symmetrically.

    The half from the left clamp to the crown is solved, with the unknown force (F_x, F_y) in it.
    """

    span: float
    rise: float
    axial: float
    shear: float
    bending: float

    @property
    def radius(self) -> float:
        """Radius of the circle [m]."""
        return self.rise / 2 + self.span**2 / (8 * self.rise)

    @property
    def half_angle(self) -> float:
        """Angle of the tangent at the left clamp [rad]."""
        return float(np.arcsin(self.span / 2 / self.radius))

    def load(self, depths: np.ndarray, *, tolerance: float = 1e-10) -> np.ndarray:
        """Return the force on the crown, downwards, that pushes it down by each of the increasing `depths` [N]."""
        length = self.radius * self.half_angle
        unit = self.bending / length**2
        s = np.linspace(0.0, length, 41)
        angle = self.half_angle - s / self.radius
        guess = np.vstack(
            [-self.radius * np.sin(angle), self.radius * (np.cos(angle) - np.cos(self.half_angle)), angle, 0 * s]
        )
        forces, loads = np.zeros(2), []
        for depth in depths.tolist():

            def slopes(_: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
                fx, fy = p * unit
                c, sn = np.cos(y[2]), np.sin(y[2])
                stretch, slide = 1 + (fx * c + fy * sn) / self.axial, (fy * c - fx * sn) / self.shear
                dx, dy = stretch * c - slide * sn, stretch * sn + slide * c
                bend = y[3] * unit * length / self.bending - 1 / self.radius
                return np.vstack([dx, dy, bend, -(dx * fy - dy * fx) / (unit * length)])

            def ends(a: np.ndarray, b: np.ndarray, _: np.ndarray, depth: float = depth) -> np.ndarray:
                crown = self.rise - depth
                return np.array([a[0] + self.span / 2, a[1], a[2] - self.half_angle, b[0], b[1] - crown, b[2]])

            solved = solve_bvp(slopes, ends, s, guess, p=forces, tol=tolerance, max_nodes=100_000)
            assert solved.success, solved.message
            s, guess, forces = solved.x, solved.y, solved.p
            loads.append(-2 * forces[1] * unit)
        return np.array(loads)
