"""Search for a marker that contradicts all others, because it is assigned to the wrong body or misplaced on its own."""

from __future__ import annotations

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import RunError
from mbdkit.base.text import listed
from mbdkit.mechanism.mechanism_quantities import GROUND
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.criteria.marker_distances import marker_columns
from mbdkit_biomech.inverse_dynamics.motion.fit import FitTarget

#: A marker seems to be on another body if the residuals of the other columns are smaller by the first factor without
#: it, and if the second factor is exceeded by the ratio of its root mean square distances from a fixed point of its own
#: body and of the other body.
ON_OTHER, FARTHER = 3.0, 4.0

ALONE = 8.0  #: A marker contradicts the others if their residuals are smaller by this factor without it.

CLEARER = 2.0  #: A marker is named only if leaving out any other one leaves residuals larger by this factor.

LEAST = 1e-6  #: Residuals below this size, in rad or longest links, are not compared.

#: Largest numbers of rows that are fitted, and of markers that are left out: those with the largest residuals.
ROWS, MOST = 24, 12


def misplaced_marker(result: Inverse, share: np.ndarray) -> str | None:
    """Return a sentence on the marker without which the mechanism fits all other columns much better.

    Parameters
    ----------
    share
        (T, K) magnitudes of the residuals [rad, or longest links].
    """
    measured, fitter = result.fitted.measured, result.problem.fitter
    moving = {point: columns for point, columns in marker_columns(measured).items() if point.body != GROUND}
    if len(measured.names) - 2 <= fitter.manifold.freedoms or len(moving) < 3:
        return None
    rms = np.sqrt(np.nanmean(share**2, axis=0))
    rows = np.unique(np.linspace(0, len(measured.time) - 1, ROWS).astype(int))
    results = []
    for point, columns in sorted(moving.items(), key=lambda one: -float(np.sum(rms[one[1]] ** 2)))[:MOST]:
        others = np.setdiff1d(np.arange(len(measured.names)), columns)
        try:
            q, left = _without(result, rows, columns)
        except RunError:
            continue
        after = max(LEAST, float(np.sqrt(np.nanmean(left[:, others] ** 2))))
        results.append((after, float(np.sqrt(np.nanmean(share[rows][:, others] ** 2))), point, columns, q))
    results.sort(key=lambda tried: tried[0])
    if len(results) < 2 or results[1][0] < CLEARER * results[0][0]:
        return None
    after, before, point, columns, q = results[0]
    at = measured.values[rows][:, columns]
    spread = [_spread(q[:, 3 * body : 3 * body + 3], at) for body in range(len(fitter.bodies))]
    own, least = spread[point.body], min(spread)
    moves_with_other = before > ON_OTHER * after and own > FARTHER * least
    if not moves_with_other and before <= ALONE * after:
        return None
    name, length = measured.names[columns[0]].removesuffix(".x"), fitter.manifold.length
    text = (
        f"marker {name} of {fitter.bodies[point.body]} contradicts the others, whose residuals are "
        f"{before * length:.2g} m with it and {after * length:.2g} m without it (root mean squares"
    )
    if not moves_with_other:
        return f"{text}; doubtful above {ALONE:g} times as much): check its place on the body."
    likely = [body for body, one in zip(fitter.bodies, spread, strict=True) if one < CLEARER * least]
    return (
        f"{text}; doubtful above {ON_OTHER:g} times as much): it seems to be on {listed(likely, 'or')}, where it moves "
        f"by {least:.2g} m relative to the body, instead of {own:.2g} m on {fitter.bodies[point.body]}."
    )


def _without(result: Inverse, rows: np.ndarray, columns: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses (R, n) that fit some rows without some columns, and the residuals (R, K) as shares."""
    fitted, manifold = result.fitted, result.problem.fitter.manifold
    target = fitted.measured.target.rows(rows)
    weight = np.array(np.broadcast_to(target.root_weight, target.values.shape))
    weight[:, columns] = 0.0
    q = result.problem.fitter.refined(FitTarget(target.time, target.quantities, target.values, weight), fitted.q[rows])
    return q, (target.values - target.quantities.values(q)) / target.quantities.sizes(manifold.length)


def _spread(pose: np.ndarray, at: np.ndarray) -> float:
    """Return the root mean square distance of positions (R, 2) from a fixed point of a body with poses (R, 3)."""
    x, y = (at - pose[:, :2]).T
    c, s = elementary.cos(pose[:, 2]), elementary.sin(pose[:, 2])
    return float(np.sqrt(np.sum(np.var([c * x + s * y, c * y - s * x], axis=1))))
