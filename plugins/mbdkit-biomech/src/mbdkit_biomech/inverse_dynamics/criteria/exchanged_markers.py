"""Search for two markers whose columns are exchanged, if a mechanism does not fit its data."""

from __future__ import annotations

from contextlib import suppress
from itertools import combinations

import numpy as np

from mbdkit.base.errors import RunError
from mbdkit.base.text import listed
from mbdkit.mechanism.mechanism_quantities import GROUND
from mbdkit_biomech.inverse_dynamics.criteria.marker_distances import marker_columns
from mbdkit_biomech.inverse_dynamics.motion.fit import FitTarget, Fitter
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured

#: Two markers are exchanged if the root mean square residual with their columns exchanged is below the first number
#: (angles in rad, lengths divided by the longest link), and if any other exchange, and none, makes it larger by the
#: second factor.
FITS, BETTER = 0.02, 3.0

MOST = 150  #: Largest number of pairs that are tried; pairs on the same body come first.


def exchanged_markers(fitter: Fitter, measured: Measured, row: int, start: np.ndarray) -> str | None:
    """Return a clause that names two markers with whose columns exchanged the mechanism fits the data of a row.

    Parameters
    ----------
    start
        (n,) pose from which the search for the pose in this row begins.
    """
    moving = [marker for marker in marker_columns(measured).items() if marker[0].body != GROUND]
    if len(measured.names) <= fitter.manifold.freedoms:
        return None  # any exchange may fit
    pairs = sorted(combinations(moving, 2), key=lambda pair: pair[0][0].body != pair[1][0].body)[:MOST]
    frame, tried = measured.target.rows(slice(row, row + 1)), []
    for (first, a), (second, b) in ((moving[0], moving[0]), *pairs) if pairs else ():  # the first one exchanges nothing
        values, residual = frame.values.copy(), np.inf
        values[:, a], values[:, b] = frame.values[:, b], frame.values[:, a]
        with suppress(RunError):
            residual = fitter.misfit(FitTarget(frame.time, frame.quantities, values, frame.root_weight), start)[1]
        names = [measured.names[x[0]].removesuffix(".x") for x in (a, b)]
        tried.append((residual, sorted({first.body, second.body}), names))
    tried.sort(key=lambda pair: pair[0])
    if not tried or len(set(tried[0][2])) < 2 or tried[0][0] > FITS or tried[1][0] < BETTER * tried[0][0]:
        return None
    _, bodies, names = tried[0]
    on = listed([fitter.bodies[body] for body in bodies], "and")
    return (
        f"markers {listed(names, 'and')} of {on} are probably exchanged: with the columns of the other one, the "
        f"mechanism fits the data at t = {frame.time[0]:.6g} s"
    )
