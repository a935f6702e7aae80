"""A chain of uniform rods between two pins, in its absolute angles with two multipliers for the far pin.

With c_ij = L_i (m_j a_j + L_j sum_k>j m_k) for i < j and c_ii the inertia about the near end with all that hangs on it,

    sum_j c_ij cos(th_i - th_j) th_j'' + c_ij sin(th_i - th_j) th_j'^2 + L_i (lam_x (-sin th_i) + lam_y cos th_i) = Q_i

from Lagrange's equations of the first kind, Q_i = -g cos(th_i) (m_i a_i + L_i sum_k>i m_k).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import ode

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class HungChain:
    """Rods of length 1 m and masses [kg] from the origin at tilts [rad], at rest; the last one's end is pinned."""

    masses: tuple[float, ...]
    angles: tuple[float, ...]
    gravity: float = 9.81

    def model(self) -> dict[str, Any]:
        """Return the free-form model: bodies `rod1`.. on joints `J1`.., the last joint on the ground."""
        bodies: dict[str, Any] = {}
        joints: dict[str, Any] = {}
        end, before, point = 0j, "ground", [0.0, 0.0]
        for k, (mass, angle) in enumerate(zip(self.masses, self.angles, strict=True)):
            middle = end + 0.5 * np.exp(1j * angle)
            end += np.exp(1j * angle)
            name = f"rod{k + 1}"
            at = [float(middle.real), float(middle.imag)]
            bodies[name] = {"mass": mass, "inertia": mass / 12, "position": at, "angle": angle}
            joints[f"J{k + 1}"] = {"type": "revolute", "bodies": [before, name], "points": [point, [-0.5, 0.0]]}
            before, point = name, [0.5, 0.0]
        pin = [float(end.real), float(end.imag)]
        joints["end"] = {"type": "revolute", "bodies": ["ground", before], "points": [pin, point]}
        return {"name": "mechanism", "gravity": [0.0, -self.gravity], "bodies": bodies, "joints": joints}

    @ode.solved_once
    def solve(self, times: Array) -> Array:
        """Return the angles at `times` [s], (T, n)."""
        n = len(self.masses)
        m = np.array(self.masses)
        outer = np.cumsum(m[::-1])[::-1] - m
        c = np.zeros((n, n))
        for j in range(n):
            c[:j, j] = c[j, :j] = 0.5 * m[j] + outer[j]
            c[j, j] = m[j] / 3 + outer[j]
        weight = self.gravity * (0.5 * m + outer)

        def right_side(time: Any, y: Array) -> Array:
            th, w = y[:n], y[n:]
            between = th[:, None] - th
            jacobian = np.array([-np.sin(th), np.cos(th)])
            matrix = np.block([[c * np.cos(between), jacobian.T], [jacobian, np.zeros((2, 2))]])
            force = -weight * np.cos(th) - (c * np.sin(between)) @ w**2
            bent = np.array([np.cos(th) @ w**2, np.sin(th) @ w**2])
            return np.concatenate([w, np.linalg.solve(matrix, np.concatenate([force, bent]))[:n]])

        start = np.concatenate([np.array(self.angles), np.zeros(n)])
        return ode.dop853(right_side, start, times)[:, :n]
