"""Criterion of the verdict on error bars: actuators whose values are mostly noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbdkit.base.text import listed
from mbdkit.plugin import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.doubt import doubt
from mbdkit_biomech.inverse_dynamics.error_bars import ErrorBars
from mbdkit_biomech.inverse_dynamics.inverse_sections import NoSmoothing

MOSTLY, OF_LARGEST = 1.5, 0.1
"""The values of an actuator are mostly noise if the root mean square of their error bars exceeds `MOSTLY` times their
own root mean square, and `MOSTLY` times the share `OF_LARGEST` of the largest one of all actuators with the same unit.

Noise alone gives 1.96. In the packaged examples of walking, the ratio is at most 1.15.
"""

NAMED = 4
"""Largest number of actuators that are named."""


def large_errors(result: Inverse, bars: ErrorBars | None) -> Iterator[Finding]:
    """Yield a doubt about the actuators, except residual ones and reserves, whose values are mostly noise.

    The parts of errors due to the ends of the record are left out, because they have their own criterion.
    """
    if bars is None:
        return
    own = [(place, one) for place, one in enumerate(result.problem.recorded_actuators) if one.kind == "actuator"]
    values = np.sqrt(np.mean(result.actuators[:, :, 0] ** 2, axis=0))
    squares = bars.actuators**2 - bars.of_ends[0] ** 2
    told = []
    for place, one in own:
        known = squares[np.isfinite(squares[:, place]), place]
        error = float(np.sqrt(max(0.0, np.mean(known)))) if known.size else 0.0
        largest = max(values[other] for other, another in own if another.unit == one.unit)
        if error > MOSTLY * max(values[place], OF_LARGEST * largest):
            told.append(f"{one.name} ({values[place]:.3g} {one.unit}, with error bars of {error:.3g} {one.unit})")
    if told:
        more = [f"{len(told) - NAMED} more"] if len(told) > NAMED else []
        is_smoothed = not isinstance(result.problem.spec.motion.smooth, NoSmoothing)
        cure = "use a lower cutoff" if is_smoothed else "smooth the motion with `motion.smooth`"
        yield doubt(
            "large-errors",
            f"values of actuators are mostly noise, according to their root mean squares: "
            f"{listed([*told[:NAMED], *more], 'and')} (doubtful above {MOSTLY:g} times as much; noise alone gives 2): "
            f"{cure}, or check deviations that the spec states.",
        )
