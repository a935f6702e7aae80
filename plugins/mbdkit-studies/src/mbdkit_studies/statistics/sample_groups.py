"""The groups of runs of a study with a sample or a table of members: one group for each combination of axis values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import did_you_mean, listed
from mbdkit_studies.points.planned_points import Label
from mbdkit_studies.store.study_runs import StudyRuns


@dataclass(frozen=True)
class SampleGroup:
    """The runs of a sample for one combination of the axes of a study.

    Parameters
    ----------
    family
        Name of the family; empty in a study without families.
    axes
        Labels on the axes by dotted key, without the values of the sampled variables; empty in a study without axes.
    places
        Indices of the runs of the group among the points of the study, from 0.
    """

    family: str
    axes: Mapping[str, Label]
    places: range

    @property
    def words(self) -> str:
        """Family and labels as one line; empty in a study without families and axes."""
        return ", ".join(filter(None, [self.family, *[f"{key} {label}" for key, label in self.axes.items()]]))

    @property
    def where(self) -> dict[str, Label]:
        """Labels that select the runs of the group, as for `groups_where`; empty in a study with a single group."""
        return ({"family": self.family} if self.family else {}) | dict(self.axes)


def sample_groups(study: StudyRuns) -> list[SampleGroup]:
    """Return the groups of a study in the order of its points; a study without axes has a single group."""
    groups, start = list[SampleGroup](), 0
    for grid in map(study.grid, study.families):
        for combination in range(grid.count // grid.rows):
            labels, _, _ = grid.point(combination * grid.rows)
            axes = {key: label for key, label in labels.items() if key not in grid.table}
            groups.append(SampleGroup(grid.name, axes, range(start, start + grid.rows)))
            start += grid.rows
    return groups


def groups_where(study: StudyRuns, where: Mapping[str, Label] | None) -> list[SampleGroup]:
    """Return the groups with the given family and labels.

    Parameters
    ----------
    where
        Labels on axes by dotted key, and the name of the family under the key ``family``; None for all groups.

    Raises
    ------
    MbdkitError
        If there is no such group.
    """
    groups = sample_groups(study)
    if (wanted := dict(where or {})) and not any(group.words for group in groups):
        raise MbdkitError("the study has only one sample, without axes and families; leave out `where`")
    keys = list(dict.fromkeys(key for group in groups for key in ("family", *group.axes)))
    for key in wanted:
        if key not in keys:
            raise MbdkitError(f"the study has no axis '{key}'{did_you_mean(key, keys) or f'; axes: {listed(keys)}'}")
    results = [
        group
        for group in groups
        if all((group.family if key == "family" else group.axes.get(key)) == label for key, label in wanted.items())
    ]
    if not results:
        raise MbdkitError(f"the study has no runs with these labels; there are: {_told(groups)}")
    return results


def one_group(study: StudyRuns, where: Mapping[str, Label] | None) -> SampleGroup:
    """Return the only group with the given family and labels; raise MbdkitError if there is no such group, or
    several.
    """
    groups = groups_where(study, where)
    if len(groups) > 1:
        choice = f"choose one by `where`, such as where={groups[0].where!r}: {_told(groups)}"
        raise MbdkitError(f"the study has {len(groups)} samples; {choice}")
    return groups[0]


def _told(groups: Sequence[SampleGroup]) -> str:
    return "; ".join(group.words for group in groups[:6]) + ("; ..." if len(groups) > 6 else "")


def measured(study: StudyRuns, name: str, places: range, *, with_bad: bool = False) -> np.ndarray:
    """Return the values of a numeric column for some points; nan where a run is not complete or is rated bad.

    Parameters
    ----------
    with_bad
        Whether the values of runs that are rated bad are included.

    Raises
    ------
    MbdkitError
        If there is no such column, or it is not numeric.
    """
    columns = study.columns()
    numbers = [key for key, column in columns.items() if key != "number" and np.asarray(column).dtype.kind in "fiu"]
    if name not in numbers:
        hint = did_you_mean(name, numbers) or f"; columns: {listed(numbers)}"
        raise MbdkitError(f"the study has no measure '{name}'{hint}")
    chosen = slice(places.start, places.stop)
    values = np.array(columns[name][chosen], np.float64)
    values[np.asarray(columns["status"][chosen], object) != "complete"] = np.nan
    if not with_bad:
        values[is_bad(columns)[chosen]] = np.nan
    return values


def is_bad(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return which runs (N,) of a table are rated bad. Their measures are not used in statistics."""
    return np.asarray(np.asarray(columns["verdict"], object) == "bad")
