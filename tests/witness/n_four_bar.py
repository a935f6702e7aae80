"""N four-bar windows in one coordinate: the angle that all cranks share, by conservation of energy.

With n + 1 cranks and n couplers of mass m and length L, uniform, and the cranks at the angle phi,

    T = (n + 1) m L^2 w^2 / 6 + n m L^2 w^2 / 2,    V = m g L sin(phi) ((n + 1) / 2 + n),    w = phi'

so that w follows from phi by T + V = E, and the time from one phi to the next is the integral of 1 / |w|: no
differential equation is solved, and nothing is singular where the cranks lie flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sin, sqrt

from scipy.integrate import quad
from scipy.optimize import brentq


@dataclass(frozen=True)
class Windows:
    """n windows with rods of mass m [kg] and length [m], let go at `start` [rad] with the rate `rate` [rad/s] < 0."""

    n: int
    start: float
    rate: float
    mass: float = 1.0
    length: float = 1.0
    gravity: float = 9.81

    @property
    def _inertia(self) -> float:
        return self.mass * self.length**2 * ((self.n + 1) / 3 + self.n)

    def potential(self, phi: float) -> float:
        """Return the potential energy at the angle `phi` [J]."""
        return self.mass * self.gravity * self.length * sin(phi) * ((self.n + 1) / 2 + self.n)

    def speed(self, phi: float) -> float:
        """Return the cranks' angular velocity at the angle `phi` [rad/s], negative."""
        gained = self.potential(self.start) - self.potential(phi)
        return -sqrt(self.rate**2 + 2 * gained / self._inertia)

    def time(self, phi: float) -> float:
        """Return the time at which the cranks, which go round and round, pass `phi` < `start` [s]."""
        turns, total, at = int((self.start - phi) // 6.283185307179586), 0.0, self.start
        for k in range(turns + 1):
            end = max(phi, self.start - (k + 1) * 6.283185307179586)
            total += quad(lambda x: -1 / self.speed(x), end, at, epsabs=1e-14, epsrel=1e-13, limit=200)[0]
            at = end
        return total

    def angle(self, t: float) -> float:
        """Return the cranks' angle at time `t` [rad]."""
        low = self.start
        while self.time(low) < t:
            low -= 3.0
        return float(brentq(lambda x: self.time(x) - t, low, min(low + 3.0, self.start), xtol=1e-15, rtol=1e-15))


PUBLISHED = {
    0.5: (0.687926, 0.725781),
    1.0: (-0.115357, -0.993324),
    2.5: (0.754378, 0.656441),
    5.0: (-0.540191, -0.841543),
}
"""Point B0 of 40 windows [m] at some times [s], six digits: reference solution of problem A02 of the benchmark library,
http://lim.ii.udc.es/mbsbenchmark, by ADAMS/Solver 2003."""
