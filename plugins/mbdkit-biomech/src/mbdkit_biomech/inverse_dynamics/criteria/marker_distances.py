"""Mistakes in tables of markers, if a mechanism does not fit them: units, axes, exchanged and misplaced markers."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from itertools import combinations

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import RunError, SpecError
from mbdkit.base.text import listed
from mbdkit.mechanism.mechanism_quantities import GROUND, Point
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem
from mbdkit_biomech.inverse_dynamics.motion.fit import FitTarget, Fitter
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured, rows_within, si_values, source_table, times_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import ColumnOfTable

#: The unit is doubtful if distances between markers of one body differ from the model by more than this factor.
#:
#: Wrong units cause factors of 10, 100 or 1000.
UNLIKE = 5.0

#: Markers that are closer to each other in the model than this share of the longest link are not compared.
LEAST_DISTANCE = 0.05

#: The unit is suspicious if markers are farther apart than this multiple of the sum of all links, each counted with the
#: length of the longest one.
APART = 20.0


def unlike_distances(measured: Measured, length: float) -> str | None:
    """Return a sentence if the distances between markers of the same body contradict the model by a large factor.

    The distances do not depend on the pose, so that they can be compared even if no pose fits the data.

    Parameters
    ----------
    length
        Longest link of the mechanism [m].
    """
    ratios = []
    for (one, (first, at)), (other, (second, there)) in combinations(_markers(measured).items(), 2):
        expected = float(elementary.hypot(one.x - other.x, one.y - other.y))
        if one.body == other.body and expected > LEAST_DISTANCE * length:
            apart = float(np.median(np.linalg.norm(at - there, axis=1)))
            ratios.append((apart / expected, f"{first} and {second} are {apart:.3g} m apart, but {expected:.3g} m"))
    if not ratios:
        return None
    ratio = float(np.median([one for one, _ in ratios]))
    if 1 / UNLIKE <= ratio <= UNLIKE:
        return None
    words = min(ratios, key=lambda one: abs(one[0] - ratio))[1]
    return (
        f"markers {words} in the model, and the distances between markers of one body are {ratio:.3g} times those of "
        f"the model (median; doubtful above {UNLIKE:g} or below {1 / UNLIKE:g}): check the unit of the markers."
    )


def far_apart(measured: Measured, length: float) -> str | None:
    """Return a sentence if markers are much farther apart than a connected mechanism can reach.

    Parameters
    ----------
    length
        Longest link of the mechanism [m].
    """
    markers = _markers(measured)
    if len(markers) < 2:
        return None
    spread = float(np.max(np.ptp(np.array([at for _, at in markers.values()]), axis=0)))
    reach = length * (1 + len({marker.body for marker in markers}))
    if spread <= APART * reach:
        return None
    return (
        f"the markers are up to {spread:.3g} m apart, but the longest link of the mechanism is {length:.3g} m long: "
        "check the unit of the markers."
    )


def marker_columns(measured: Measured) -> dict[Point, list[int]]:
    """Return the columns of x and y of each marker whose x and y are measured."""
    columns: dict[Point, dict[int, int]] = {}
    for index, quantity in enumerate(measured.quantities.quantities):
        if quantity.marker is not None:
            point, axis = quantity.marker
            columns.setdefault(point, {})[axis] = index
    return {point: [axes[0], axes[1]] for point, axes in columns.items() if len(axes) == 2}


def _markers(measured: Measured) -> dict[Point, tuple[str, np.ndarray]]:
    """Return the name and the measured positions (T, 2) of each marker whose x and y are measured."""
    return {
        point: (measured.names[columns[0]].removesuffix(".x"), measured.values[:, columns])
        for point, columns in marker_columns(measured).items()
    }


#: Two markers are exchanged if the root mean square residual with their columns exchanged is below the first number
#: (angles in rad, lengths divided by the longest link), and if any other exchange, and none, makes it larger by the
#: second factor.
BETTER = 3.0

MOST_PAIRS = 150  #: Largest number of pairs that are tried; pairs on the same body come first.


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
    pairs = sorted(combinations(moving, 2), key=lambda pair: pair[0][0].body != pair[1][0].body)[:MOST_PAIRS]
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


#: Axes are probably wrong if the root mean square residual with other axes is below the first number (angles
#: in rad, lengths divided by the longest link) in so many rows, evenly distributed over the motion.
FITS, ROWS = 0.02, 5

#: Matrices that change the axes x and y.
CHANGES = {
    "x and y exchanged": ((0, 1), (1, 0)),
    "the sign of y reversed": ((1, 0), (0, -1)),
    "the sign of x reversed": ((-1, 0), (0, 1)),
    "the signs of x and y reversed": ((-1, 0), (0, -1)),
    "a quarter turn clockwise": ((0, 1), (-1, 0)),
    "a quarter turn counter-clockwise": ((0, -1), (1, 0)),
}

#: Matrices that compute x and y from the axes x, y and z of a table in which z points up.
OF_Z = {"z in place of y": ((1, 0, 0), (0, 0, 1)), "y in place of x, and z in place of y": ((0, 1, 0), (0, 0, 1))}


def changed_axes(problem: InverseProblem) -> str | None:
    """Return a clause that names the changes of the axes of all markers with which the mechanism fits the data, if it
    does not fit them as they are.
    """
    measured, fitter, start = problem.measured, problem.fitter, problem.prepared.equations.q0
    columns = np.array(list(marker_columns(measured).values()))
    if len(columns) < 2 or len(measured.names) <= fitter.manifold.freedoms:
        return None
    rows = np.unique(np.linspace(0, len(measured.time) - 1, ROWS).astype(int))
    target, results = measured.target.rows(rows), []
    if _fits(fitter, target, start):
        return None
    at = target.values[:, columns]
    positions = [(change, at @ np.array(matrix).T) for change, matrix in CHANGES.items()]
    if (z := _third_axis(problem, [measured.names[x] for x in columns[:, 0]])) is not None:
        at = np.concatenate([at, z[rows][..., None]], axis=2)
        positions += [(change, at @ np.array(matrix).T) for change, matrix in OF_Z.items()]
    for change, changed in positions:
        values = target.values.copy()
        values[:, columns] = changed
        if _fits(fitter, FitTarget(target.time, target.quantities, values, target.root_weight), start):
            results.append(change)
    if not results:
        return None
    return f"the axes of the markers are probably wrong: the mechanism fits with {listed(results, 'or with')}"


def _third_axis(problem: InverseProblem, names: Sequence[str]) -> np.ndarray | None:
    """Return the coordinates z (T, M) of markers whose columns of x have these names; None if the table lacks them."""
    spec = problem.spec
    if spec.motion.is_run or spec.motion.columns is not None:
        return None
    try:
        table = source_table(spec.motion, spec.folder, "motion")
        assert table is not None
        kept = rows_within(spec, times_of(table, spec.motion.time, "motion.time"))
        columns = [ColumnOfTable(column=f"{name.removesuffix('.x')}.z") for name in names]
        z = np.column_stack([si_values(column, table, "m", "motion")[kept] for column in columns])
    except SpecError:
        return None
    return z if np.all(np.isfinite(z)) else None


def _fits(fitter: Fitter, target: FitTarget, pose: np.ndarray) -> bool:
    """Return whether the mechanism fits all frames of a target, which are fitted one after the other."""
    with suppress(RunError):
        for row in range(len(target.time)):
            pose, residual = fitter.misfit(target.rows(slice(row, row + 1)), pose)
            if residual > FITS:
                return False
        return True
    return False


#: A marker seems to be on another body if the residuals of the other columns are smaller by the first factor without
#: it, and if the second factor is exceeded by the ratio of its root mean square distances from a fixed point of its own
#: body and of the other body.
ON_OTHER, FARTHER = 3.0, 4.0

ALONE = 8.0  #: A marker contradicts the others if their residuals are smaller by this factor without it.

CLEARER = 2.0  #: A marker is named only if leaving out any other one leaves residuals larger by this factor.

LEAST = 1e-6  #: Residuals below this size, in rad or longest links, are not compared.

#: Largest numbers of rows that are fitted, and of markers that are left out: those with the largest residuals.
FITTED_ROWS, MOST = 24, 12


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
    rows = np.unique(np.linspace(0, len(measured.time) - 1, FITTED_ROWS).astype(int))
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
