"""Force curves of muscles: active and passive force by length, force by velocity, and force of the tendon.

Lengths of fibres are relative to the optimal length, velocities to the largest velocity (negative for shortening),
lengths of tendons to the length without force, and forces to `max_force`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

import numpy as np

from mbdkit.base import elementary
from mbdkit_biomech.muscles.bezier_curve import BezierCurve, CurvePoint

Curve = tuple[np.ndarray, np.ndarray]  #: Values of a curve and its slopes, both of the shape of the argument.


class ForceCurves(Protocol):
    """Interface of the curves of a muscle; each function returns values and slopes."""

    def active(self, length: np.ndarray, /) -> Curve:
        """Return the active isometric force at full activation."""

    def passive(self, length: np.ndarray, /) -> Curve:
        """Return the passive force."""

    def velocity(self, velocity: np.ndarray, /) -> Curve:
        """Return the factor of the active force that depends on velocity."""

    def tendon(self, length: np.ndarray, /) -> Curve:
        """Return the force of the tendon."""

    def stretch(self, force: np.ndarray, /) -> Curve:
        """Return the length of the tendon for a positive force."""


@dataclass(frozen=True)
class DeGrooteFregly:
    """Smooth curves in closed form.

    F. De Groote, A. L. Kinney, A. V. Rao, B. J. Fregly, Evaluation of direct collocation optimal control problem
    formulations for solving the muscle redundancy problem, Annals of Biomedical Engineering 44:2922-2936, 2016,
    supplementary material. Passive force and tendon are scaled as in OpenSim 4.1 (DeGrooteFregly2016Muscle): the
    passive force is zero at 0.2 and never negative above, and the force of the tendon is zero at its length without
    force, where the published constants give -0.012.
    """

    def active(self, length: np.ndarray) -> Curve:
        """Return the active isometric force at full activation: a sum of three Gaussians."""
        value, slope = 0.0 * length, 0.0 * length
        for height, center, width, growth in _GAUSSIANS:
            spread = width + growth * length
            x = (length - center) / spread
            own = height * elementary.exp(-0.5 * x * x)
            value += own
            slope -= own * x * (1.0 - growth * x) / spread
        return value, slope

    def passive(self, length: np.ndarray) -> Curve:
        """Return the passive force, an exponential function that is 1 at a strain of 0.6."""
        shape, strain, least = 4.0, 0.6, 0.2
        start = elementary.exp(shape * (least - 1.0) / strain)
        grown = elementary.exp(shape * (length - 1.0) / strain) / (elementary.exp(shape) - start)
        return grown - start / (elementary.exp(shape) - start), grown * shape / strain

    #: Constants d1 to d4 of the force-velocity curve.
    VELOCITY: ClassVar[tuple[float, float, float, float]] = -0.3211346127989808, -8.149, -0.374, 0.8825327733249912

    def velocity(self, velocity: np.ndarray) -> Curve:
        """Return the factor of the active force that depends on velocity, -0.0015 at -1 and 1.004 at 0."""
        d1, d2, d3, d4 = self.VELOCITY
        x = d2 * velocity + d3
        return d1 * elementary.asinh(x) + d4, d1 * d2 / np.sqrt(x * x + 1.0)

    #: Constants c1 and c3 of the force of the tendon, and its stiffness; the force is 1 at a strain of 0.049.
    TENDON: ClassVar[tuple[float, float, float]] = 0.2, 0.2, elementary.log((1.0 + 0.2) / 0.2) / 0.049

    def tendon(self, length: np.ndarray) -> Curve:
        """Return the force of the tendon, which is 1 at a strain of 0.049."""
        c1, c3, stiffness = self.TENDON
        grown = c1 * elementary.exp(stiffness * (length - 1.0))
        return grown - c3, grown * stiffness

    def stretch(self, force: np.ndarray) -> Curve:
        """Return the length of the tendon for a positive force, the inverse of `tendon`."""
        c1, c3, stiffness = self.TENDON
        return 1.0 + elementary.log((force + c3) / c1) / stiffness, 1.0 / (stiffness * (force + c3))


#: Height, center, width, and growth of the width of each Gaussian.
_GAUSSIANS = (
    (0.8150671134243542, 1.055033428970575, 0.162384573599574, 0.063303448465465),
    (0.433004984392647, 0.716775413397760, -0.029947116970696, 0.200356847296188),
    (0.1, 1.0, 0.353553390593274, 0.0),
)


class Millard:
    """Quintic Bezier curves with two continuous derivatives.

    M. Millard, T. Uchida, A. Seth, S. L. Delp, Flexing computational muscle: modeling and simulation of musculotendon
    dynamics, Journal of Biomechanical Engineering 135:021005, 2013, with the default parameters of OpenSim 4
    (Millard2012EquilibriumMuscle with damping, for which active forces may vanish).

    The active force is zero outside of the lengths 0.4441 to 1.8123, and the passive force 1 at a strain of 0.7 and
    zero below length 1. The factor by velocity is 0 up to -1, and 1.4 from 1 on. The force of the tendon is 1 at a
    strain of 0.049 and zero below length 1.
    """

    def __init__(self) -> None:
        self.curves: Mapping[Literal["active", "passive", "velocity", "tendon"], BezierCurve] = {
            "active": _active(),
            "passive": _passive(),
            "velocity": _velocity(),
            "tendon": _tendon(),
        }
        self.active, self.passive, self.velocity, self.tendon = (curve.at for curve in self.curves.values())
        tendon = self.curves["tendon"]
        self.stretch = BezierCurve(tendon.y, tendon.x, (0.0, 1.0 / tendon.slopes[1])).at


def _active() -> BezierCurve:
    start, bend, top, end, slope, curviness = 0.4441, 0.73, 1.0, 1.8123, 0.8616, 1.0
    gap = 0.05 * top  # half of the width of the plateau
    shoulder = top - gap
    y1 = 1.0 - slope * (shoulder - bend)
    steep = 1.25 * y1 / (bend - start)
    descent = -1.0 / ((end - gap) - (top + gap))
    return BezierCurve.through(
        [
            CurvePoint(start, 0.0, 0.0),
            CurvePoint(0.5 * (start + bend), 0.5 * y1, steep),
            CurvePoint(0.5 * (bend + shoulder), 0.5 * (y1 + 1.0), slope),
            CurvePoint(top, 1.0, 0.0),
            CurvePoint(0.5 * (top + gap + end), 0.5, descent),
            CurvePoint(end, 0.0, 0.0),
        ],
        [curviness] * 5,
    )


def _passive() -> BezierCurve:
    strain, low, curviness = 0.7, 0.2, 0.75
    stiff = 2.0 / strain
    foot = min(0.1 / stiff, 0.1 * strain)
    return BezierCurve.through(
        [
            CurvePoint(1.0, 0.0, 0.0),
            CurvePoint(1.0 + foot, 0.5 * low * foot, low),
            CurvePoint(1.0 + strain, 1.0, stiff),
        ],
        [curviness] * 2,
    )


def _velocity() -> BezierCurve:
    largest, near_shortening, isometric, near_lengthening = 1.4, 0.25, 5.0, 0.15
    return BezierCurve.through(
        [
            CurvePoint(-1.0, 0.0, 0.0),
            CurvePoint(-0.9, 0.05 * near_shortening, near_shortening),
            CurvePoint(0.0, 1.0, isometric),
            CurvePoint(0.9, largest - 0.05 * near_lengthening, near_lengthening),
            CurvePoint(1.0, largest, 0.0),
        ],
        [0.6, 0.6, 0.9, 0.9],
    )


def _tendon() -> BezierCurve:
    strain, toe, curviness = 0.049, 2.0 / 3.0, 0.5
    stiff = 1.375 / strain
    x_toe = (toe - 1.0) / stiff + 1.0 + strain
    foot = 1.0 + 0.1 * (x_toe - 1.0)
    run = x_toe - 0.5 * toe / stiff - foot  # from the foot to where the straight line has half of the force `toe`
    slope = 0.5 * toe / run
    return BezierCurve.through(
        [CurvePoint(1.0, 0.0, 0.0), CurvePoint(foot + 0.5 * run, 0.25 * toe, slope), CurvePoint(x_toe, toe, stiff)],
        [curviness] * 2,
    )


#: Curves by their name in specs.
CURVES: Mapping[str, ForceCurves] = {"de-groote-fregly": DeGrooteFregly(), "millard": Millard()}
