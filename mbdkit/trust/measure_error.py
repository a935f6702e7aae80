"""Estimates the error of a measure from its values in comparison runs.

The criteria are those of `mbdkit.runs.accuracy.error_estimate`, which uses the same limits, applied to a single number.
The error is known if a run of another method (the guard) confirms the most accurate run, if the differences between the
run and two runs of increasing accuracy decrease and the guard does not contradict them, or if all values are almost
equal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from mbdkit.base import elementary
from mbdkit.base.units import Unit

#: Largest ratio of two differences that count as decreasing: a little above 0.5, the value of a method of order 1.
LARGEST_RATIO = 0.6
#: Without an observed order, an error is known if the distance of the most accurate run from the guard is at most this
#: share of the distance of the run from the guard. The value is that of a method of order 1.
CONFIRMED = 0.25
#: Largest difference from the guard, relative to the estimate. A larger difference indicates an error that all other
#: runs share.
GUARD_RATIO = 3.0
#: If the differences of all runs are below this share of the size, they need not decrease; the largest one is then the
#: estimate. Rounding errors, which chaotic motions amplify from 1e-13 at the start, do not depend on the step. For the
#: same reason the guard may be less accurate than the run; the estimate then includes the difference from the guard.
AGREED = 1e-5
#: Differences below this share of the natural size for the unit need not decrease either.
#:
#: They occur for measures that differ from zero by rounding errors only.
ZERO = 1e-12
ROUND_OFF = 1e-15  #: Smallest estimate, as a share of the value.


def measure_error(value: float, compared: Sequence[float], natural: float = 0.0) -> float:
    """Return the estimated error of a measure; nan where it is unknown.

    `value`: the measure of the run. `compared`: the measure in two runs of increasing accuracy, and in a run of another
    method. `natural`: natural size of numbers with the unit of the measure; see `natural_size`.
    """
    every = value, *compared
    if len(compared) != 3 or not all(map(math.isfinite, every)):
        return math.nan
    first, second, other = compared
    to_first, between, to_second = abs(value - first), abs(first - second), abs(value - second)
    to_other, apart = abs(value - other), abs(second - other)
    size, spread = max(map(abs, every)), max(every) - min(every)
    falls = to_first > 0.0 and between <= LARGEST_RATIO * to_first
    if apart <= CONFIRMED * to_other:
        error = max(to_second, to_other)
    elif falls and apart <= GUARD_RATIO * (extrapolated := to_second / (1.0 - (between / to_first) ** 2)):
        error = max(extrapolated, to_other) if apart > 0.5 * extrapolated else extrapolated
    elif spread <= max(AGREED * size, ZERO * natural):
        error = spread
    else:
        return math.nan
    return max(error, ROUND_OFF * size)


def natural_scales(length: float, mass: float, gravity: Sequence[float], duration: float) -> tuple[float, float, float]:
    """Return length [m], mass [kg] and time [s] of a mechanism, from which `natural_size` is computed.

    The time is about that of a free fall by the length, or the duration of the run [s] if that is shorter; 1 s if there
    is no gravity and no duration.
    """
    pull = elementary.hypot(*gravity)
    fall = math.sqrt(length / pull) if pull > 0.0 else math.inf
    time = min(fall, duration) if duration > 0.0 else fall
    return length, mass, time if math.isfinite(time) else 1.0


def natural_size(unit: Unit, length: float, mass: float, time: float) -> float:
    """Return the natural size of quantities with a unit, in this unit.

    It distinguishes rounding errors from results: numbers that differ from zero by rounding errors only, such as the
    height of a rod that lies still, have no digits to compare.
    """
    powers = [float(elementary.pow(x, power)) for x, power in zip((length, mass, time), unit.exponents, strict=True)]
    return math.prod(powers) / unit.factor
