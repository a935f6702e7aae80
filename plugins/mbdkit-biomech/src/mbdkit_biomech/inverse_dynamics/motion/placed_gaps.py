"""Gaps of columns whose values follow from the other columns, such as those of a marker on a body with other markers.

The mechanism is fitted to the other columns in the gap and in the samples on both sides. The missing values are those
of this fit, plus the differences between data and fit in the two samples, interpolated linearly over time. Without
these differences, a marker that moves relative to its body would jump at both ends of the gap.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.engine.linear_systems import products, singular_values
from mbdkit_biomech.inverse_dynamics.motion.fit import FitError, FitTarget, Fitter
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured

#: The other columns determine the pose if the smallest singular value of their derivatives along the free directions is
#: at least this share of that of all columns.
DETERMINED = 0.1


@dataclass(frozen=True)
class PlacedGap:
    """A gap that is filled by means of the other columns.

    Attributes
    ----------
    column
        Index of the observed quantity.
    first, last
        First row without a value, and the row after the last one.
    """

    column: int
    first: int
    last: int

    def filled(self, time: np.ndarray, predicted: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Return the values that fill the gap, or their changes due to noise.

        Parameters
        ----------
        time
            (T,) times of all rows.
        predicted
            (last - first + 2, ...) values in the gap and in the rows on both sides, according to the other columns.
        known
            (2, ...) values of the column in the rows on both sides.
        """
        own = time[self.first - 1 : self.last + 1]
        share = ((own - own[0]) / (own[-1] - own[0])).reshape(-1, *[1] * (predicted.ndim - 1))
        off = known - predicted[[0, -1]]
        return np.asarray((predicted + (1 - share) * off[0] + share * off[1])[1:-1])


@dataclass(frozen=True)
class PlacedGaps:
    """All gaps that are filled by means of the other columns.

    Attributes
    ----------
    rows
        (R,) rows of these gaps, and the rows beside them.
    root_weight
        (R, K) square roots of the weights in these rows; zero for columns without a value in or beside the row.
    gaps
        The gaps.
    """

    rows: np.ndarray
    root_weight: np.ndarray
    gaps: tuple[PlacedGap, ...]

    def of(self, gap: PlacedGap) -> slice:
        """Return the places in `rows` of a gap and of the rows beside it."""
        return slice(*np.searchsorted(self.rows, [gap.first - 1, gap.last + 1]).tolist())

    def to_json(self, names: Sequence[str]) -> str:
        """Return the first rows of the gaps of each column as JSON, given the names of the columns."""
        results: dict[str, list[int]] = {}
        for gap in self.gaps:
            results.setdefault(names[gap.column], []).append(gap.first)
        return json.dumps(results)

    def interpolated(self, missing: np.ndarray) -> np.ndarray:
        """Return the missing values, (T, K), that are not in these gaps."""
        left = missing.copy()
        for gap in self.gaps:
            left[gap.first : gap.last, gap.column] = False
        return left


def place_gaps(fitter: Fitter, measured: Measured, q: np.ndarray) -> tuple[Measured, np.ndarray, PlacedGaps | None]:
    """Return a motion whose gaps are filled by means of the other columns wherever these determine the pose, the poses
    (T, n) that fit it best, and these gaps; None if there are none.

    Parameters
    ----------
    q
        (T, n) poses that fit the motion with all gaps interpolated over time.
    """
    missing = np.isnan(measured.raw)
    if not np.any(missing):
        return measured, q, None
    beside = missing.copy()
    beside[1:] |= missing[:-1]
    beside[:-1] |= missing[1:]
    weight = np.where(beside, 0.0, np.sqrt(measured.weight))
    determined = _determined(fitter, measured.target, q, weight)
    results = []
    for column in np.flatnonzero(np.any(missing, axis=0)).tolist():
        borders = np.flatnonzero(np.diff(np.concatenate([[False], missing[:, column], [False]])))
        results += [
            PlacedGap(column, first, last)
            for first, last in borders.reshape(-1, 2).tolist()
            if np.all(determined[first - 1 : last + 1])
        ]
    if not results:
        return measured, q, None
    rows = np.unique(np.concatenate([np.arange(result.first - 1, result.last + 1) for result in results]))
    placed = PlacedGaps(rows, weight[rows], tuple(results))
    try:
        others = fitter.refined(replace(measured.target.rows(rows), root_weight=placed.root_weight), q[rows])
        predicted, values = measured.quantities.values(others), measured.values.copy()
        for result in results:
            known = values[[result.first - 1, result.last], result.column]
            own = predicted[placed.of(result), result.column]
            values[result.first : result.last, result.column] = result.filled(measured.time, own, known)
        filled, poses = replace(measured, values=values), q.copy()
        poses[rows] = fitter.refined(filled.target.rows(rows), q[rows])
    except FitError:  # near a singular position; the interpolated values have a fit
        return measured, q, None
    return filled, poses, placed


def _determined(fitter: Fitter, target: FitTarget, q: np.ndarray, root_weight: np.ndarray) -> np.ndarray:
    """Return whether the columns with positive weights (T, K) determine the poses `q` of the rows (T,)."""
    manifold = fitter.manifold
    rows = np.flatnonzero(np.any(root_weight == 0.0, axis=1))
    values = np.zeros(len(q), dtype=bool)
    free = manifold.directions_at(target.time[rows], q[rows]).free
    seen = products(target.quantities.jacobian(q[rows]) * manifold.scale, free)
    if not free.shape[2] or root_weight.shape[1] < free.shape[2]:
        return values
    every, others = (
        singular_values(seen * weight[..., None])[:, -1] for weight in (target.root_weight, root_weight[rows])
    )
    values[rows] = others > DETERMINED * every
    return values
