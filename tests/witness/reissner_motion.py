"""The motion of a beam on a turning hub by Reissner's equations, collocated at Chebyshev's points.

In the frame of the hub, with the position (x, y) and the angle theta of the cross-sections along the arc length s of
the unloaded beam, and the angular velocity w of the hub,

    rho A (x'' - 2 w y' - w' y - w^2 x) = d/ds n_x,     rho A (y'' + 2 w x' + w' x - w^2 y) = d/ds n_y,
    rho I (theta'' + w') = d/ds (EI theta_s) + x_s n_y - y_s n_x,
    n = R(theta) (EA (e_x - 1), GA e_y),    (e_x, e_y) = R(theta)^T (x_s, y_s),

clamped to the hub, with n = 0 and theta_s = 0 at the tip. Errors decrease exponentially with the number of points, for
the motion is smooth. The steps are those of the implicit midpoint rule, extrapolated.

J. C. Simo and L. Vu-Quoc, On the dynamics of flexible beams under large overall motions - the plane case, Journal of
Applied Mechanics 53 (1986).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .extrapolation import limit
from .rotating_beam import StraightBeam, differentiation

TINY = 1e-30
"""Complex step of derivatives, which are exact then."""


@dataclass(frozen=True)
class SpunBeam(StraightBeam):
    """A beam from the origin along the x axis of the hub's frame; SI units.

    `turning` gives angular velocity and angular acceleration of the hub at a time.
    """

    turning: Callable[[float], tuple[float, float]]

    def tip(self, end: float, *, points: int, steps: tuple[int, ...]) -> np.ndarray:
        """Return the displacement of the tip along and across the hub's direction at the time `end`, from rest.

        `steps` are numbers of steps, each twice the one before.
        """
        return limit([self._stepped(end / count, count, points) for count in steps], 2)

    def _stepped(self, step: float, count: int, points: int) -> np.ndarray:
        state = np.zeros(6 * points)
        unit = np.eye(len(state))
        for i in range(count):
            middle, t = state.copy(), (i + 0.5) * step
            columns = self._rates(t, middle[:, None] + TINY * 1j * unit)
            inverse = np.linalg.inv(unit - step / 2 * columns.imag / TINY)
            for _ in range(4):
                middle -= inverse @ (middle - state - step / 2 * self._rates(t, middle[:, None])[:, 0])
            state = 2 * middle - state
        return state[[0, points]]

    def _rates(self, t: float, state: np.ndarray) -> np.ndarray:
        """Return the derivatives of states (6 n, k): displacement, angle and velocities at the points, tip first."""
        n = len(state) // 6
        nodes, matrix = differentiation(n - 1)
        s, by_s = self.length * (1 + nodes[:, None]) / 2, 2 / self.length * matrix
        u, y, angle, vx, vy, turn = state.reshape(6, n, -1)
        x_s, y_s = by_s @ u + 1, by_s @ y
        c, sn = np.cos(angle), np.sin(angle)
        along, across = self.axial * (c * x_s + sn * y_s - 1), self.shear * (c * y_s - sn * x_s)
        force_x, force_y, moment = c * along - sn * across, sn * along + c * across, self.bending * (by_s @ angle)
        force_x[0] = force_y[0] = moment[0] = 0.0
        w, dw = self.turning(t)
        ax = by_s @ force_x / self.mass + 2 * w * vy + dw * y + w**2 * (s + u)
        ay = by_s @ force_y / self.mass - 2 * w * vx - dw * (s + u) + w**2 * y
        turned = (by_s @ moment + x_s * force_y - y_s * force_x) / self.inertia - dw
        ax[-1] = ay[-1] = turned[-1] = 0.0
        return np.concatenate([vx, vy, turn, ax, ay, turned])
