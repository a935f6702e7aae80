"""Search for mirrored or exchanged axes of all markers, if a mechanism does not fit its data."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from mbdkit.base.errors import RunError, SpecError
from mbdkit.base.text import listed
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem
from mbdkit_biomech.inverse_dynamics.criteria.marker_distances import marker_columns
from mbdkit_biomech.inverse_dynamics.motion.fit import FitTarget, Fitter
from mbdkit_biomech.inverse_dynamics.motion.measured import rows_within, si_values, source_table, times_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import ColumnOfTable

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
