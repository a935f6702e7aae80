"""Criterion of the verdict on the sign of knee flexion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbdkit.plugin import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.doubt import doubt

KNEE = "knee_flexion"
"""Coordinates whose names begin with this are positive if the knee is bent."""

HYPEREXTENDED, FRAMES = 20.0, 0.1
"""The sign is doubtful if the knee is hyperextended by more than the first number of degrees in more than this share of
the frames, and flexed by at most half as much in all but this share. Healthy knees extend to between 0 and 10 degrees
beyond the straight leg.
"""


def knee_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield a doubt for each coordinate of knee flexion that is negative beyond what knees allow."""
    names = result.problem.names
    for name in names.mechanism.coordinates:
        if not name.startswith(KNEE):
            continue
        values = np.degrees(names.coordinate(name).value(result.fitted.q))
        least, most = np.quantile(values, (FRAMES, 1 - FRAMES)).tolist()
        if least < -HYPEREXTENDED and most <= -least / 2:
            yield doubt(
                "knee",
                f"{name} is below {least:.3g} degrees in {FRAMES:.0%} of the rows (doubtful below "
                f"{-HYPEREXTENDED:g}), although flexion is positive: the knee is hyperextended. If its "
                "column has the other sign, write `scale: -1`; otherwise check the sign and offset of the coordinate.",
            )
