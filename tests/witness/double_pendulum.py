"""The double pendulum of two equal uniform rods: 18 to 30 reference digits, and the states in mbdkit's coordinates.

The digits were made by Gragg-Bulirsch-Stoer extrapolation of the two angles' equations at 60 and at 70 decimal
digits, with two settings of step and order; only digits on which both runs agree were kept. m = 1 kg, L = 1 m, J =
1/12 kg m^2, g = 9.81 m/s^2, released at rest. A state is (phi1, phi2, phi1', phi2'), both angles absolute,
counter-clockwise from the *downward vertical*; mbdkit measures from the +x axis, theta = phi - pi/2.
`test_double_pendulum.py` checks the digits by an integration of another kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mpmath
import numpy as np
from numpy.typing import NDArray

Row = tuple[float, tuple[str, ...]]


def rows_of(file: str) -> tuple[Row, ...]:
    """Read times and digits of a motion, one row a line."""
    lines = (Path(__file__).parent / "digits" / file).read_text(encoding="utf-8").splitlines()
    return tuple((float(time), tuple(digits)) for time, *digits in map(str.split, lines))


RODS_MODERATE = rows_of("rods_moderate.txt")

RODS_HORIZONTAL = rows_of("rods_horizontal.txt")


@dataclass(frozen=True)
class Reference:
    """One reference motion of the double pendulum, in mbdkit's coordinates.

    Parameters
    ----------
    start
        Both rods' angles at t = 0 from the downward vertical [rad], as a decimal or "pi/2".
    rows
        Time [s] and state (phi1, phi2, phi1', phi2') with all digits.
    """

    start: str
    rows: tuple[Row, ...]

    @property
    def start_angle(self) -> float:
        """Return both rods' angle from the +x axis at t = 0 [rad]."""
        with mpmath.workdps(40):
            return 0.0 if self.start == "pi/2" else float(mpmath.mpf(self.start) - mpmath.pi / 2)

    @property
    def times(self) -> NDArray[np.float64]:
        """Return the reference times [s], shape (T,)."""
        return np.array([time for time, _ in self.rows])

    @property
    def angles(self) -> NDArray[np.float64]:
        """Return both rods' angles from the +x axis [rad], shape (T, 2)."""
        with mpmath.workdps(40):
            return np.array([[float(mpmath.mpf(phi) - mpmath.pi / 2) for phi in state[:2]] for _, state in self.rows])

    @property
    def rates(self) -> NDArray[np.float64]:
        """Return both rods' angular velocities [rad/s], shape (T, 2)."""
        return np.array([[float(rate) for rate in state[2:]] for _, state in self.rows])

    @property
    def positions(self) -> NDArray[np.float64]:
        """Return both rods' centres of mass [m], shape (T, 2 rods, 2), rounded once from all digits."""
        return self._points(0.5)

    @property
    def ends(self) -> NDArray[np.float64]:
        """Return both rods' outer ends [m], shape (T, 2 rods, 2), rounded once from all digits."""
        return self._points(1.0)

    def at(self, time: float) -> int:
        """Return the row that belongs to `time` [s]."""
        return [row_time for row_time, _ in self.rows].index(time)

    def _points(self, fraction: float) -> NDArray[np.float64]:
        points = []
        with mpmath.workdps(40):
            for _, state in self.rows:
                first, second = ((mpmath.sin(phi), -mpmath.cos(phi)) for phi in map(mpmath.mpf, state[:2]))
                points.append(
                    [
                        [float(fraction * component) for component in first],
                        [float(one + fraction * two) for one, two in zip(first, second, strict=True)],
                    ]
                )
        return np.array(points)


MODERATE = Reference(start="0.5", rows=RODS_MODERATE)
HORIZONTAL = Reference(start="pi/2", rows=RODS_HORIZONTAL)
