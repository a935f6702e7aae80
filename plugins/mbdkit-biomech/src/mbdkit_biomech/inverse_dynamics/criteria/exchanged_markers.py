"""Search for two markers whose columns are exchanged, if a mechanism does not fit its data."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from mbdkit.mechanism.mechanism_quantities import GROUND
from mbdkit.plugin import RunError, listed
from mbdkit_biomech.inverse_dynamics.criteria.marker_distances import marker_columns
from mbdkit_biomech.inverse_dynamics.motion.fit import FitTarget, Fitter
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured

FITS, BETTER = 0.02, 3.0
"""Two markers are exchanged if the root mean square residual with their columns exchanged is below the first number
(angles in rad, lengths divided by the longest link), and if any other exchange makes it larger by the second factor.
"""

MOST = 150
"""Largest number of pairs that are tried; pairs on the same body come first."""


def exchanged_markers(fitter: Fitter, measured: Measured, row: int, start: np.ndarray) -> str | None:
    """Return a clause that names two markers with whose columns exchanged the mechanism fits the data of a row.

    Parameters
    ----------
    start
        (n,) pose from which the search for the pose in this row begins.
    """
    moving = [one for one in marker_columns(measured).items() if one[0].body != GROUND]
    if len(measured.names) <= fitter.manifold.freedoms:
        return None  # any exchange may fit
    pairs = sorted(combinations(moving, 2), key=lambda pair: pair[0][0].body != pair[1][0].body)[:MOST]
    one, found = measured.target.rows(slice(row, row + 1)), []
    for (first, a), (second, b) in pairs:
        values = one.values.copy()
        values[:, a], values[:, b] = one.values[:, b], one.values[:, a]
        size = _residual(fitter, FitTarget(one.time, one.quantities, values, one.root_weight), start)
        found.append(
            (size, sorted({first.body, second.body}), [measured.names[x[0]].removesuffix(".x") for x in (a, b)])
        )
    found.sort(key=lambda tried: tried[0])
    if not found or found[0][0] > FITS or (len(found) > 1 and found[1][0] < BETTER * found[0][0]):
        return None
    _, bodies, names = found[0]
    on = listed([fitter.bodies[body] for body in bodies], "and")
    return (
        f"markers {listed(names, 'and')} of {on} are probably exchanged: with the columns of the other one, the "
        f"mechanism fits the data at t = {one.time[0]:.6g} s"
    )


def _residual(fitter: Fitter, target: FitTarget, start: np.ndarray) -> float:
    """Return the root mean square residual of a target of one frame, in rad or longest links; inf without a fit."""
    try:
        pose, values = fitter.first_pose(target, start)
    except RunError:
        return np.inf
    quantities = target.quantities
    scale = np.where(quantities.is_angle, 1.0, fitter.manifold.length) * quantities.scale
    return float(np.sqrt(np.mean(((values - quantities.values(pose[None])[0]) / scale) ** 2)))
