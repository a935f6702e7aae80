"""The double pendulum of two equal uniform rods: 18 to 30 reference digits, and the states in mbdkit's coordinates.

The digits were made by Gragg-Bulirsch-Stoer extrapolation of the two angles' equations at 60 and at 70 decimal
digits, with two settings of step and order; only digits on which both runs agree were kept. m = 1 kg, L = 1 m, J =
1/12 kg m^2, g = 9.81 m/s^2, released at rest. A state is (phi1, phi2, phi1', phi2'), both angles absolute,
counter-clockwise from the *downward vertical*; mbdkit measures from the +x axis, theta = phi - pi/2.
`test_double_pendulum.py` checks the digits by an integration of another kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import mpmath
import numpy as np
from numpy.typing import NDArray

Row = tuple[float, tuple[str, str, str, str]]

RODS_MODERATE: tuple[Row, ...] = (
    (
        1.0,
        (
            "-0.37078951247010209627174268504",
            "-0.592636748503493593505604668851",
            "-0.918660877067404377668161902111",
            "-0.00612505951051214461403289832872",
        ),
    ),
    (
        5.0,
        (
            "0.34156687064589925691956892929",
            "0.54445157258301806984983944903",
            "-0.643925672307639175258050092399",
            "-1.125592115164409898846090332987",
        ),
    ),
    (
        10.0,
        (
            "0.0701197091276653590116691919366",
            "0.273346866716689414766417564848",
            "-1.116722359253210855780551367588",
            "-1.646438491481301583768736503174",
        ),
    ),
    (
        20.0,
        (
            "-0.347517324055895882220092113638",
            "-0.606217542985737149565656270089",
            "-0.668353950915637679675955757236",
            "-0.774803851939029613597006772935",
        ),
    ),
    (
        50.0,
        (
            "0.455541502017654279132745693095",
            "0.580445956649041431036302480061",
            "-0.51493241433324369303426093975",
            "0.428676467980414099769795410213",
        ),
    ),
    (
        100.0,
        (
            "0.398326196680143293903923245458",
            "0.648394095439331531455653112956",
            "-0.532741947678837455268145322796",
            "-0.220944702811684303410169529952",
        ),
    ),
    (
        150.0,
        (
            "0.388427823842688693694495834012",
            "0.561207242597215805699247124668",
            "-0.508732634355896503473813722537",
            "-0.93633109927581467997702936528",
        ),
    ),
)

RODS_HORIZONTAL: tuple[Row, ...] = (
    (
        0.5,
        (
            "0.448142625932001507799638199753",
            "1.041962887303866759574154831039",
            "-2.414308312648259742265080684644",
            "-5.949104936117636964912380859554",
        ),
    ),
    (
        1.0,
        (
            "-1.207716238190637993869756826727",
            "-0.814391023091296351454272894765",
            "-3.406517532971957774379263133796",
            "-0.516045472105208916757394450593",
        ),
    ),
    (
        2.0,
        (
            "-0.082758306820570846952385507",
            "0.40736207491190723400351291",
            "-0.96114544454599847323628397",
            "11.8989550530452952633568513",
        ),
    ),
    (
        3.0,
        (
            "1.025086012288729147372084367",
            "0.495734647626975377515829763",
            "-4.593357105474980226116078193",
            "1.184320880614229942912041214",
        ),
    ),
    (
        5.0,
        (
            "1.13854379667187968615070661",
            "1.24437992775025584038717554",
            "4.91095002400445422684209516",
            "-5.42471059315887601446171483",
        ),
    ),
    (
        10.0,
        (
            "-0.744407088509041121316",
            "-14.345719734713967157673",
            "-4.035171320493370867167",
            "4.896814078173598188121",
        ),
    ),
    (
        15.0,
        (
            "-0.876943273650294634",
            "-8.14904959070040966",
            "-0.512449468735524076",
            "7.280407150523668968",
        ),
    ),
    (
        20.0,
        (
            "0.7260379844429613",
            "-21.3133131588800403",
            "1.6966612004654398",
            "-3.6262336336086907",
        ),
    ),
)


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
