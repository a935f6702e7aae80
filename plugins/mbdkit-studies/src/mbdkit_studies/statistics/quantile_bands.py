"""Quantiles of a quantity over the runs of a study, at each time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.measures.measure_expression import SeriesExpression
from mbdkit_report import data_frame
from mbdkit_studies.statistics.sample_groups import groups_where, is_bad, one_group

if TYPE_CHECKING:
    import pandas

    from mbdkit_studies.points.planned_points import Label
    from mbdkit_studies.store.study_runs import StudyRuns


QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
#: Largest number of times at which quantiles are computed by default, if all runs recorded the same times.
MOST_ROWS = 501
#: Number of times at which quantiles are computed by default, if the runs recorded different times.
TIMES = 201


@dataclass(frozen=True, eq=False)
class QuantileBands:
    """Quantiles of a quantity over many runs.

    Attributes
    ----------
    quantity, unit
        The expression, and the SI unit of its value.
    q
        (Q,) probabilities.
    time
        (K,) times [s].
    values
        (Q, K) quantiles; nan where no run has a value.
    count
        (K,) number of runs with a value.
    error
        (Q, K) estimated errors of the quantiles that interpolation between the rows of runs causes: their changes if
        the interpolation is linear. Zero where the runs recorded all times.
    """

    quantity: str
    unit: str
    q: np.ndarray
    time: np.ndarray
    values: np.ndarray
    count: np.ndarray
    error: np.ndarray

    @property
    def told(self) -> str:
        """A sentence on the interpolation between rows; empty if there is none."""
        largest = float(np.max(np.nan_to_num(self.error), initial=0.0))
        unit = "" if self.unit == "1" else f" {self.unit}"
        return "" if not largest else (
            f" The times of the runs differ; interpolation between their rows changes the quantiles by up to "
            f"{largest:.2g}{unit}. `output: {{interval: SECONDS}}` in the base records common times."
        )  # fmt: skip

    def to_frame(self) -> pandas.DataFrame:
        """Return a table with a row for each time, and a column for each probability.

        Raises
        ------
        MbdkitError
            If pandas is not installed.
        """
        columns = {float(probability): row for probability, row in zip(self.q, self.values, strict=True)}
        return data_frame(columns, self.time, "time")


def quantiles(
    study: StudyRuns,
    quantity: str,
    q: float | Sequence[float] = QUANTILES,
    *,
    where: Mapping[str, Label] | None = None,
    times: Sequence[float] | np.ndarray | None = None,
) -> QuantileBands:
    """Return quantiles of a quantity at each time; see `Study.quantiles`."""
    probabilities = np.atleast_1d(np.asarray(q, float))
    if probabilities.ndim != 1 or not len(probabilities) or not np.all((probabilities >= 0) & (probabilities <= 1)):
        raise MbdkitError(f"the probabilities should be numbers from 0 to 1, such as [0.05, 0.5, 0.95], not {q!r}")
    # Quantiles are those of one sample. In a study without a sample, all selected runs are combined.
    groups = [one_group(study, where)] if study.spec.has_table else groups_where(study, where)
    excluded = is_bad(study.columns())
    places = {place for group in groups for place in group.places if not excluded[place]}
    grid = _Grid.of(study, places) if times is None else _Grid(_given(times), has_rows=False)
    rows: list[np.ndarray] = []
    lines: list[np.ndarray] = []
    unit = ""
    for run, numbers, counts in study.rows_of_runs():
        expression = SeriesExpression.parse(quantity, run.run_spec)
        unit = expression.unit.text
        values = np.broadcast_to(expression.rows(run), run.time.shape)
        for time, own in _by_run(run.time, values, numbers, counts, places):
            lines.append(grid.at(time, own))
            rows.append(lines[-1] if grid.has_rows else grid.smooth(time, own, lines[-1]))
    if not rows:
        raise MbdkitError("there are no quantiles, because each run is rated bad or has no results")
    bands, count = _quantiles(np.array(rows), probabilities)
    error = np.abs(bands - _quantiles(np.array(lines), probabilities)[0])
    return QuantileBands(quantity, unit, probabilities, grid.time, bands, count, error)


def _given(times: object) -> np.ndarray:
    time = np.asarray(times, float)
    if time.ndim != 1 or not len(time) or not np.all(np.isfinite(time)):
        raise MbdkitError("the times should be an array (K,) of finite numbers")
    return time


def _by_run(
    time: np.ndarray, values: np.ndarray, numbers: Iterable[int], counts: np.ndarray, places: Set[int]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield times and values of each run whose index in the study is in `places`, from the joined rows of runs.

    `numbers` are the numbers of the joined runs, `counts` their numbers of rows.
    """
    ends = np.cumsum(counts)
    for number, end, count in zip(numbers, ends.tolist(), counts.tolist(), strict=True):
        if number - 1 in places and count:
            yield time[end - count : end], values[end - count : end]


@dataclass(frozen=True, eq=False)
class _Grid:
    """Times at which quantiles are computed.

    Parameters
    ----------
    has_rows
        Whether the times are recorded times of all runs, except for those runs that ended early.
    step
        If `has_rows`, the times are those of every `step`-th recorded row.
    """

    time: np.ndarray
    has_rows: bool
    step: int = 1

    @classmethod
    def of(cls, study: StudyRuns, places: Set[int]) -> _Grid:
        """Return the recorded times of the runs if all runs have the same times, otherwise equally spaced times."""
        longest = np.empty(0)
        start, end, same = np.inf, -np.inf, True
        for run, numbers, counts in study.rows_of_runs():
            for time, _ in _by_run(run.time, run.time, numbers, counts, places):
                common = min(len(time), len(longest))
                same = same and np.array_equal(time[:common], longest[:common])
                longest = time if len(time) > len(longest) else longest
                start, end = min(start, time[0]), max(end, time[-1])
        if not len(longest):
            raise MbdkitError("there are no quantiles, because each run is rated bad or has no results")
        if not same:
            return cls(np.linspace(start, end, TIMES), has_rows=False)
        step = -(-len(longest) // MOST_ROWS)
        return cls(longest[::step], has_rows=True, step=step)

    def at(self, time: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return values of a run at the times of the grid, (K,); nan outside the run."""
        if not self.has_rows:
            return np.asarray(np.interp(self.time, time, values, left=np.nan, right=np.nan))
        row = np.full(len(self.time), np.nan)
        chosen = values[:: self.step]
        row[: len(chosen)] = chosen
        return row

    def smooth(self, time: np.ndarray, values: np.ndarray, line: np.ndarray) -> np.ndarray:
        """Return values of a run at the times of the grid, (K,), by cubic polynomials that do not overshoot at jumps
        (modified Akima), given the linearly interpolated ones.
        """
        from scipy.interpolate import Akima1DInterpolator

        known = np.isfinite(values) & (np.diff(time, prepend=-np.inf) > 0)
        if np.sum(known) < 3:
            return line
        curve = Akima1DInterpolator(time[known], values[known], method="makima")
        return np.where(np.isnan(line), np.nan, curve(self.time))


def _quantiles(values: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the quantiles (Q, K) of the columns of `values` (N, K), and the number (K,) of values that are not nan.

    Quantiles are interpolated linearly; nan values are ignored. `values` is sorted in place. `numpy.nanquantile` takes
    a hundred times longer.
    """
    values.sort(axis=0)
    count = np.sum(~np.isnan(values), axis=0)
    place = q[:, None] * np.maximum(count - 1, 0)
    low = place.astype(int)
    high = np.minimum(low + 1, np.maximum(count - 1, 0))
    column = np.arange(values.shape[1])
    return values[low, column] + (place - low) * (values[high, column] - values[low, column]), count
