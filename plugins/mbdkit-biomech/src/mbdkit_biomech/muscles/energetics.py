"""Power of fibres, and the energy that muscles consume by the models of Umberger and of Bhargava.

The model of Umberger adds the following powers per mass of the muscle:

    activation    S A^0.6 (128 fast + 25), times 0.4 + 0.6 f if l > 1
    shortening    S A^2 (slow min(100, 100 u_slow) + fast 153 u_fast), times f if l > 1       u_slow = 2.5 v / v_max
    lengthening   S A 0.3 * 100 u_slow,                                times f if l > 1       u_fast = v / v_max
    work          F v / m in shortening, none in lengthening

Here S is the factor for aerobic conditions, slow and fast are the shares of slow and fast fibres, l is the length of
the fibres in optimal lengths, f their isometric force at this length relative to `max_force`, v their speed, v_max the
largest speed of the muscle, F the active force of the fibres, and m the mass of the muscle. A is the excitation if it
exceeds the activation, and otherwise the mean of both. The sum of the first three powers is at least 1 W/kg. With
`smoothing`, each max(x, 0) in these is (x + sqrt(x^2 + smoothing^2)) / 2, as in Koelewijn et al. (2018).

The model of Bhargava adds, with s = slow sin(pi/2 u) and w = fast (1 - cos(pi/2 u)) at the excitation u:

    activation    m (40 s + 133 w)
    maintenance   m (74 s + 111 w) L       L is linear between (0.5, 0.5), (1, 1) and (1.5, 0) in l, and constant beyond
    shortening    (0.16 F_iso + 0.18 F) v
    lengthening   -0.157 F |v|
    work          F_a v in shortening, -F_a |v| in lengthening

F_iso is the active force at rest, F_a the active force, and F includes the passive one. As in OpenSim, the heat of
activation does not depend on the time since the stimulation began, the heat is at least 1 W/kg, and the sum at least 0.

B. R. Umberger, K. G. M. Gerritsen, P. E. Martin, A model of human muscle energy expenditure, Computer Methods in
Biomechanics and Biomedical Engineering 6:99-111, 2003; B. R. Umberger, Stance and swing phase costs in human walking,
Journal of the Royal Society Interface 7:1329-1340, 2010, for the factor 0.3 and for no work in lengthening; A. D.
Koelewijn, E. Dorschky, A. J. van den Bogert, A metabolic energy expenditure model with a continuous first derivative
and its application to predictive simulations of gait, Computer Methods in Biomechanics and Biomedical Engineering
21:521-531, 2018; L. J. Bhargava, M. G. Pandy, F. C. Anderson, A phenomenological model for estimating metabolic energy
consumption in muscle contraction, Journal of Biomechanics 37:81-88, 2004.
"""

from __future__ import annotations

import math

import numpy as np

from mbdkit.base import elementary
from mbdkit_biomech.muscles.force_curves import CURVES
from mbdkit_biomech.muscles.muscle import Muscle

LEAST_HEAT = 1.0  #: Smallest rate of heat, also at rest [W/kg].
#: Largest rate of heat of slow fibres due to shortening [W/kg], which is reached at their largest velocity.
LARGEST_SLOW_HEAT = 100.0
FAST_HEAT = 153.0  #: Rate of heat of fast fibres due to shortening at their largest velocity [W/kg].
#: Ratio of the largest velocities of fast and slow fibres.
#:
#: The largest velocity of a muscle is that of its fast fibres.
FAST_OVER_SLOW = 2.5
#: Ratio of the rate of heat during lengthening to the rate of heat of slow fibres that shorten at the same speed.
LENGTHENING = 0.3


def fiber_power(muscle: Muscle, tension: np.ndarray, length: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the power (...) [W] that the fibres of a muscle supply; nan where they are perpendicular to the tendon.

    Parameters
    ----------
    tension
        (...) tension of the tendon [N].
    length, rate
        (...) length of the fibres [m] and its rate [m/s].
    """
    along = np.sqrt(np.maximum(length**2 - muscle.thickness**2, 0.0))
    return np.asarray(-tension * length / np.where(along > 0, along, np.nan) * rate)


def _positive(x: np.ndarray, width: float) -> np.ndarray:
    """Return the larger of x (...) and 0; with a width, rounded: x = 0 gives half the width."""
    rounded: np.ndarray = np.maximum(x, 0.0) if width == 0.0 else 0.5 * (x + elementary.hypot(x, width))
    return rounded


def metabolic_power(
    muscle: Muscle, activation: np.ndarray, excitation: np.ndarray, length: np.ndarray, rate: np.ndarray
) -> np.ndarray:
    """Return the power (...) [W] that a muscle consumes, as heat and work; nan without `Muscle.metabolics`.

    Parameters
    ----------
    activation, excitation
        (...) activation and excitation, from 0 to 1.
    length, rate
        (...) length of the fibres [m] and its rate [m/s].
    """
    metabolics, curves = muscle.metabolics, CURVES[muscle.curves]
    if metabolics is None:
        return np.full_like(activation, np.nan)
    slow, fast, width = metabolics.slow_fibers, 1.0 - metabolics.slow_fibers, metabolics.smoothing
    normal, speed = length / muscle.optimal_length, rate / (muscle.max_velocity * muscle.optimal_length)
    isometric = _positive(curves.active(normal)[0], width)
    away, closer = _positive(speed, width), _positive(-speed, width)
    active = muscle.max_force * activation * isometric * _positive(curves.velocity(speed)[0], width)
    if metabolics.model == "bhargava":
        of_slow = slow * elementary.sin(0.5 * math.pi * excitation)
        of_fast = fast * (1.0 - elementary.cos(0.5 * math.pi * excitation))
        beyond = (_positive(normal - corner, width) for corner in (0.5, 1.0, 1.5))
        maintenance = 0.5 + sum(slope * part for slope, part in zip((1.0, -3.0, 2.0), beyond, strict=True))
        total = active + muscle.max_force * curves.passive(normal)[0]
        shortening = 0.16 * muscle.max_force * activation * isometric + 0.18 * total
        per_force = muscle.max_velocity * muscle.optimal_length / muscle.mass
        heat = 40.0 * of_slow + 133.0 * of_fast + maintenance * (74.0 * of_slow + 111.0 * of_fast)
        heat = heat + per_force * (shortening * closer - 0.157 * total * away) - LEAST_HEAT
        work = per_force * active * (closer - away)
        return muscle.mass * _positive(LEAST_HEAT + _positive(heat, width) + work, width)
    when_long = _positive(curves.active(1.0 + _positive(normal - 1.0, width))[0], width)
    scale = 0.5 * (excitation + activation + _positive(excitation - activation, width))
    maintained = elementary.pow(scale, 0.6) * (128.0 * fast + 25.0) * (0.4 + 0.6 * when_long)
    of_slow = [LARGEST_SLOW_HEAT * FAST_OVER_SLOW * part for part in (closer, away)]
    largest = of_slow[0] - _positive(of_slow[0] - LARGEST_SLOW_HEAT, LARGEST_SLOW_HEAT * width)
    shortening = slow * largest + fast * FAST_HEAT * closer
    moved = (scale**2 * shortening + scale * LENGTHENING * of_slow[1]) * when_long
    heat = LEAST_HEAT + _positive(metabolics.aerobic_factor * (maintained + moved) - LEAST_HEAT, width)
    work = active * muscle.max_velocity * muscle.optimal_length * closer
    return np.asarray(muscle.mass * heat + work)
