"""The patella: it leads the pull of the quadriceps around the knee, by the planar model of van Eijden et al.

The path of a muscle with a patella ends at the patella on the thigh. From there to the shank, by knee flexion x [deg],

- the length increases with the integral of the effective lever arm r, so that the moment is the tension times r;
- the patellar ligament pulls the shank with a share of the tension, at an angle to its axis that is positive forward;
- the patella presses on the thigh with another share of the tension.

The lever arm and the last share are polynomials by J. H. Brechter and C. M. Powers, Med. Sci. Sports Exerc. 34 (2002)
1582-1593, of the data and the model of T. M. G. J. van Eijden et al., J. Biomech. 19 (1986) 219-229. The data of the
lever arm end at 90 degrees; where it would increase again, it is constant, as that of a tendon on the round condyles.
The angle is that of van Eijden et al., Acta Morphol. Neerl.-Scand. 23 (1985) 27-37. The share of the ligament is within
10 % of the measured ones: 1.16 at 10 and 0.65 at 70 degrees (H.-U. Buff et al., J. Biomech. 21 (1988) 17-23), more than
1 up to 20 degrees (F. T. Sheehan et al., in living persons), and half of the largest one in flexion (M. I. Ellis et
al., Eng. Med. 9 (1980) 189-194).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.joints import Revolute
from mbdkit.mechanism.mechanism_quantities import GROUND, Point
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.mechanism.values import Positive

FLEXION = np.radians(np.arange(0.0, 121.0, 10.0))
#: Angle of the ligament [rad].
ANGLE = np.radians([20.6, 19.2, 15.9, 13.7, 11.6, 8.3, 5.0, 1.9, -1.9, -6.6, -9.7, -13.7, -17.3])
#: Standard deviation of the lever arm between persons and sources, as a share of it.
#:
#: Sources differ by 5 % at 10 degrees and 11 % at 50 degrees: 47.6 and 37.5 mm here; 45.9 and 32.6 mm in 40 living
#: persons (the effective quadriceps moment arm, J. Biomech. 48 (2015), PMC4662057); 43 and 30 mm by the arm of the
#: ligament in images (Arch. Bone Jt. Surg., article 16466), times its share of the tension. Persons differ by 8 to 10 %
#: in the last source. Beyond 60 degrees, no data of persons were found; there, the deviation is an assumption.
SCATTER = np.array([0.11, 0.11, 0.11, 0.12, 0.13, 0.14, 0.14, 0.15, 0.15, 0.2, 0.2, 0.2, 0.2])
#: Force of the ligament, as a share of the tension of the quadriceps.
SHARE = np.array([1.05, 1.05, 1.0, 0.95, 0.88, 0.81, 0.74, 0.67, 0.62, 0.58, 0.56, 0.55, 0.55])
ARM = (0.046, 2.8e-4, -1.3e-5, 8e-8)  #: Coefficients of the powers of x in the lever arm [m].
FARTHEST = 100.0  #: Flexion from which the lever arm is constant [deg].
#: Flexions [rad] at which polynomial pieces of these functions begin and end; the outer pieces go on.
KNOTS = np.radians(np.arange(-10.0, 131.0, 10.0))


class Patella(StrictModel):
    """The patella and its ligament, to which the last point of the path of a muscle belongs."""

    joint: str = "knee"
    """Name of the joint, a pin from the thigh to the shank. In the frame of the shank, the knee is on the positive y
    axis, and x points forward."""
    flexion: str = "knee_flexion"
    """Name of the coordinate of the model that is the flexion of the knee [rad]."""
    scale: Positive = 1.0
    """Factor of the lever arm, which is that of an adult of average size."""
    deviations: float = 0.0
    """By how many standard deviations, which depend on the angle, the arm is longer than the published mean."""


def contact_share(flexion: np.ndarray) -> np.ndarray:
    """Return the force of the patella on the thigh, as a share of the tension, for flexions (T,) [rad]."""
    x = np.clip(np.degrees(flexion), 0.0, 120.0)
    below = 1.0 + x * (-0.0162 + x * (1.55e-4 - 6.98e-7 * x))
    return np.asarray((0.462 + x * (0.00147 - 3.84e-5 * x)) / below)


def lever_arm(flexion: np.ndarray) -> np.ndarray:
    """Return the effective lever arm (T,) [m] for flexions (T,) [rad]."""
    return np.asarray(np.polynomial.polynomial.polyval(np.clip(np.degrees(flexion), 0.0, FARTHEST), ARM))


def path_length(flexion: np.ndarray) -> np.ndarray:
    """Return the integral (T,) [m] of the lever arm from 0 to flexions (T,) [rad]."""
    x = np.clip(np.degrees(flexion), 0.0, FARTHEST)
    within = np.radians(np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyint(ARM)))
    return np.asarray(within + lever_arm(flexion) * (flexion - np.radians(x)))


def scatter(flexion: np.ndarray) -> np.ndarray:
    """Return the standard deviation (T,) of the lever arm between persons and sources [m]."""
    return np.asarray(lever_arm(flexion) * np.interp(flexion, FLEXION, SCATTER))


def scatter_of_length(flexion: np.ndarray) -> np.ndarray:
    """Return the integral (T,) [m] of the standard deviation of the lever arm from 0 to flexions (T,) [rad]."""
    at = np.radians(np.arange(-60.0, 181.0))
    whole = np.append(0.0, np.cumsum(0.5 * np.diff(at) * (scatter(at)[1:] + scatter(at)[:-1])))
    return np.asarray(np.interp(flexion, at, whole - whole[60]))


@dataclass(frozen=True)
class PatellaGuide:
    """The part of a path from the patella to the shank in a run: the function of a guided segment.

    The flexion is `sign` times the angle of the shank relative to the thigh, plus `offset` [rad]. For `scale` and
    `deviations` see `Patella`.
    """

    sign: float
    offset: float
    scale: float
    deviations: float

    def __call__(self, angle: Any) -> tuple[Any, Any, Any]:
        """Return the length [m] at a recorded relative angle [rad], and what its derivative by the displacement of the
        shank from the centre of the joint is in the frame of the shank: the share of the ligament, downward.
        """
        flexion = self.sign * angle + self.offset
        share, pull = (angle.recorder.table(KNOTS, _pieces(values), flexion) for values in (SHARE, ANGLE))
        return angle.recorder.table(KNOTS, self._lengths, flexion), -share * np.sin(pull), -share * np.cos(pull)

    @property
    def _lengths(self) -> np.ndarray:
        found = np.zeros((len(KNOTS) - 1, 6))
        for piece, begin, spread in zip(found, KNOTS, _pieces(SCATTER), strict=False):
            arm = Polynomial([float(lever_arm(begin))])
            if 0.0 <= begin < np.radians(FARTHEST):
                arm = Polynomial(ARM)(Polynomial([np.degrees(begin), np.degrees(1.0)]))
            length = (self.scale * arm * (1.0 + self.deviations * Polynomial(spread))).integ().coef
            piece[: len(length)] = length
        steps = found @ FLEXION[1] ** np.arange(6)
        found[:, 0] = np.cumsum(steps) - steps - steps[0]
        return found


def _pieces(values: np.ndarray) -> np.ndarray:
    """Return coefficients (K - 1, 2), between `KNOTS`, of values (13,) at `FLEXION`, which are constant outside."""
    ends = np.pad(values, 1, mode="edge")
    return np.stack([ends[:-1], np.diff(ends) / FLEXION[1]], axis=1)


class PatellaPath:
    """The part of a path from the patella to the shank.

    Raises
    ------
    SpecError
        If there is no such joint or coordinate, the joint is not a pin on whose first body the path ends, or the
        coordinate is not its angle.
    """

    def __init__(self, patella: Patella, last: str, names: QuantityNames, key: str):
        joints = names.mechanism.joints
        angle, joint = names.joint(patella.joint, f"{key}.joint"), joints[patella.joint]
        if not isinstance(joint, Revolute) or joint.points is None or joint.bodies[0] != last:
            raise SpecError(
                f"should be a revolute joint whose first body is '{last}', on which the path ends", key=f"{key}.joint"
            )
        self.joint, self._scale, self._longer = patella.joint, patella.scale, patella.deviations
        self._flexion = names.find(patella.flexion, f"{key}.flexion")
        self._ends = [
            Point(GROUND if body == names.mechanism.ground else names.body(body, f"{key}.joint"), *point)
            for body, point in zip(joint.bodies, joint.points, strict=True)
        ]
        at = np.zeros((1, 3 * len(names.mechanism.bodies)))
        turn, wanted = np.zeros_like(at), np.zeros_like(at)
        self._flexion.add_gradient(at, turn)
        angle.add_gradient(at, wanted)
        sign = float(np.sum(turn * wanted) / np.sum(wanted * wanted))
        if abs(sign) != 1.0 or np.any(turn != sign * wanted):
            raise SpecError(f"should be the angle of joint '{self.joint}', or its negative", key=f"{key}.flexion")
        #: The function of this part as a guided segment.
        self.guide = PatellaGuide(sign, float(self.flexion(at)[0]), self._scale, self._longer)

    def flexion(self, q: np.ndarray) -> np.ndarray:
        """Return the flexion of the knee (T,) [rad] at positions (T, n)."""
        return np.asarray(self._flexion.value(q))

    def beyond_data(self, q: np.ndarray) -> str:
        """Return a sentence if the knee bends farther than the data of patellas; empty if it does not."""
        most, end = np.degrees([np.max(self.flexion(q)), FLEXION[-1]])
        if most <= end:
            return ""
        return (
            f"{self.joint} bends by {most:.0f} degrees, but data of the patella end at {end:.0f}; its shares and "
            "angles are those there, and forces between thigh and calf are left out"
        )

    def add(self, q: np.ndarray, length: np.ndarray, gradient: np.ndarray) -> None:
        """Add this part to the length (T,) of a path and its derivatives (T, n).

        The derivatives contain the pull of the ligament on the shank, and the opposite force on the thigh, at the
        centre of the joint. They do no work, but the joint carries them.
        """
        flexion = self.flexion(q)
        length += self._scale * (path_length(flexion) + self._longer * scatter_of_length(flexion))
        turn = np.zeros_like(gradient)
        self._flexion.add_gradient(q, turn)
        arm = self._scale * (lever_arm(flexion) + self._longer * scatter(flexion))
        gradient += arm[:, None] * turn
        thigh, shank = self._ends
        angle = q[:, 3 * shank.body + 2] - np.interp(flexion, FLEXION, ANGLE)
        share = np.interp(flexion, FLEXION, SHARE)
        x, y = share * elementary.sin(angle), -share * elementary.cos(angle)
        shank.add_force(q, x, y, gradient)
        thigh.add_force(q, -x, -y, gradient)
