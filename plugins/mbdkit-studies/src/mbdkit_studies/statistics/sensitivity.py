"""Sobol sensitivity indices of a measure with respect to the variables of a sample."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.text import listed
from mbdkit_report import data_frame, key_words
from mbdkit_studies.statistics.sample_groups import measured, one_group
from mbdkit_studies.statistics.sample_statistics import CONFIDENCE
from mbdkit_studies.statistics.sobol_indices import RESAMPLES, SobolIndices, members_for, sobol_indices
from mbdkit_studies.texts import ERROR

if TYPE_CHECKING:
    import pandas

    from mbdkit_studies.points.planned_points import Label
    from mbdkit_studies.store.study_runs import StudyRuns

NARROW = 0.05  #: Width of the intervals of indices for which a note says how many members are needed.


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sobol indices of a measure.

    Attributes
    ----------
    measure
        Name of the measure.
    variables
        The d variables, as dotted keys of the run spec.
    indices
        Indices of the variables with confidence intervals. `first` and `total` are also attributes of this object.
    confidence
        Probability of the intervals.
    members
        Number of members of the sample that are used: those for which all runs have a value of the measure.
    left_out
        Number of members that are not used, because one of their runs failed, is rated bad or has no value.
    reason
        Sentence that says why all indices are nan; empty otherwise. A single index is also nan if its interval covers 0
        to 1.
    """

    measure: str
    variables: tuple[str, ...]
    indices: SobolIndices
    confidence: float
    members: int
    left_out: int
    reason: str = ""

    @property
    def first(self) -> np.ndarray:
        """(d,) first-order indices: the share of the variance that each variable explains alone."""
        return self.indices.first

    @property
    def total(self) -> np.ndarray:
        """(d,) total indices: the share of the variance that each variable explains alone or together with others."""
        return self.indices.total

    @property
    def note(self) -> str:
        """Sentence on total indices below first-order indices, which are sampling errors; empty if there are none."""
        places = np.flatnonzero(self.total < self.first)
        if not len(places):
            return ""
        ends, several = self.indices, len(places) > 1
        widest = float(np.max(np.maximum(ends.first_high - ends.first_low, ends.total_high - ends.total_low)[places]))
        words = listed([key_words(self.variables[place]) for place in places], "and")
        told = (
            f"The total {'indices' if several else 'index'} of {self.measure} for {words} "
            f"{'are smaller than the first-order indices' if several else 'is smaller than the first-order index'}, "
            f"because of sampling errors: from {self.members} members, the intervals are up to {widest:.2g} wide"
        )
        if not NARROW < widest < math.inf:
            return f"{told}."
        return f"{told}; about sample.n={members_for(self.members, widest, NARROW)} makes them {NARROW:g} wide."

    def to_frame(self) -> pandas.DataFrame:
        """Return a table with a row for each variable.

        Raises
        ------
        MbdkitError
            If pandas is not installed.
        """
        names = ("first", "first_low", "first_high", "total", "total_low", "total_high")
        return data_frame({name: getattr(self.indices, name) for name in names}, self.variables, "variable")

    def __str__(self) -> str:
        width = max(map(len, ("variable", *self.variables)))
        indices = self.indices
        lines = [f"{'variable':<{width}}  {'first order':<26}  total"]
        for index, name in enumerate(self.variables):
            first, total = (
                f"{_shown(value[index])} ({low[index]:.3f} to {high[index]:.3f})"
                for value, low, high in (
                    (indices.first, indices.first_low, indices.first_high),
                    (indices.total, indices.total_low, indices.total_high),
                )
            )
            lines.append(f"{name:<{width}}  {first:<26}  {total}")
        return "\n".join([*lines, *filter(None, [self.reason, self.note])])


def _shown(index: float) -> str:
    return "unknown" if np.isnan(index) else f"{index:.3f}"


def sensitivity(
    study: StudyRuns,
    measure: str,
    *,
    where: Mapping[str, Label] | None = None,
    confidence: float = CONFIDENCE,
    members: int | None = None,
    resamples: int = RESAMPLES,
) -> Sensitivity:
    """Return the Sobol indices of a measure; see `Study.sensitivity`."""
    sample = study.spec.sample
    if sample is None or sample.design != "saltelli":
        message = "Sobol indices need a sample with `design: saltelli`, which creates the runs needed to compute them"
        raise study.spec.placed(SpecError(message, key="sample" if sample is None else "sample.design"))
    if not 0 < confidence < 1:
        raise MbdkitError(f"the confidence should be a probability between 0 and 1, such as 0.95, not {confidence!r}")
    if resamples < 1:
        raise MbdkitError(f"the number of bootstrap samples should be positive, not {resamples!r}")
    if members is not None and not 2 <= members <= sample.n:
        raise MbdkitError(f"the sample has {sample.n} members; choose from 2 to {sample.n} of them, not {members!r}")
    group = one_group(study, where)
    values = measured(study, measure, group.places).reshape(-1, sample.runs_of_member)[:members]
    known = values[np.all(np.isfinite(values), axis=1)]
    if len(known) < 2:
        raise MbdkitError(
            f"Sobol indices need values of '{measure}' from all runs of at least two members of the sample"
        )
    indices = sobol_indices(known, confidence=confidence, resamples=resamples, seed=sample.seed).informative()
    reason = _within_errors(study, measure, group.places, known)
    if reason:
        indices = sobol_indices(np.zeros_like(known))
    return Sensitivity(
        measure, tuple(sample.variables), indices, confidence, len(known), len(values) - len(known), reason
    )


def _within_errors(study: StudyRuns, measure: str, places: range, values: np.ndarray) -> str:
    """Return a sentence if the variation of values (n, d + 2) can be explained by their errors; otherwise an empty
    text.
    """
    if measure + ERROR not in study.columns():
        return ""
    errors = measured(study, measure + ERROR, places)
    largest, spread = float(np.max(errors[np.isfinite(errors)], initial=0.0)), float(np.ptp(values))
    if spread >= 2.0 * largest:  # the errors at both ends of the range may add up
        return ""
    return f"The values of {measure} differ by {spread:.3g}, within their estimated errors of up to {largest:.3g}."
