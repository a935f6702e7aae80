"""Mean, standard deviation and quantiles of a measure over the runs of a study, with confidence intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit_studies.points.planned_points import Label
from mbdkit_studies.statistics import sample_statistics
from mbdkit_studies.statistics.sample_groups import SampleGroup, measured, one_group
from mbdkit_studies.statistics.sample_statistics import CONFIDENCE, Estimate
from mbdkit_studies.store.study_runs import StudyRuns

QUANTILES = (0.05, 0.5, 0.95)
FEWEST = 3  #: Smallest number of values that have statistics.


@dataclass(frozen=True)
class MeasureStatistics:
    """Statistics of a measure over the runs of a study, with confidence intervals.

    Attributes
    ----------
    measure, unit
        Name and unit of the measure.
    mean, std
        Mean and standard deviation (`Estimate`: `value`, `low`, `high`).
    quantiles
        Quantiles by probability.
    confidence
        Probability of each interval.
    runs
        Number of runs that are used: those that are complete, are not rated bad, and have a value.
    bad
        Number of complete runs that are left out because they are rated bad.
    mean_with_bad
        Mean of the runs including those that are rated bad.
    """

    measure: str
    unit: str
    mean: Estimate
    std: Estimate
    quantiles: Mapping[float, Estimate]
    confidence: float
    runs: int
    bad: int
    mean_with_bad: float

    def __str__(self) -> str:
        lines = [("mean", self.mean), ("standard deviation", self.std)]
        lines += [(f"{100 * q:g} % quantile", quantile) for q, quantile in self.quantiles.items()]
        text = [f"{self.measure}: {self.runs} runs, {100 * self.confidence:g} % intervals"]
        return "\n".join([*text, *(f"{name:<18}  {found.text(self.unit)}" for name, found in lines)])


def statistics(
    study: StudyRuns, measure: str, *, where: Mapping[str, Label] | None = None, confidence: float = CONFIDENCE
) -> MeasureStatistics:
    """Return the statistics of a measure; see `Study.statistics`."""
    if not study.spec.is_sampled:
        raise MbdkitError("statistics need a sample: the values on the axes of a study are not drawn at random")
    if not 0 < confidence < 1:
        raise MbdkitError(f"the confidence should be a probability between 0 and 1, such as 0.95, not {confidence!r}")
    group = statistics_of_group(study, one_group(study, where), measure, confidence)
    if group is None:
        raise MbdkitError(
            f"statistics need values of '{measure}' from at least {FEWEST} complete runs that are not rated bad"
        )
    return group


def statistics_of_group(
    study: StudyRuns, group: SampleGroup, measure: str, confidence: float = CONFIDENCE
) -> MeasureStatistics | None:
    """Return the statistics of a measure over the runs of one sample; None if fewer than `FEWEST` runs have a value."""
    values = by_member(study, measured(study, measure, group.places))
    count = int(np.sum(np.isfinite(values)))
    if count < FEWEST:
        return None
    every = measured(study, measure, group.places, with_bad=True)
    known = every[np.isfinite(every)]
    return MeasureStatistics(
        measure=measure,
        unit=study.described(measure)[0].removesuffix("1"),
        mean=sample_statistics.mean(values, confidence),
        std=sample_statistics.standard_deviation(values, confidence),
        quantiles={q: sample_statistics.quantile(values, q, confidence) for q in QUANTILES},
        confidence=confidence,
        runs=count,
        bad=len(known) - count,
        mean_with_bad=float(np.mean(known)),
    )


def by_member(study: StudyRuns, values: np.ndarray) -> np.ndarray:
    """Return the values (N,) of the runs of a sample with one row for each member."""
    sample = study.spec.sample
    return values.reshape(-1, 1 if sample is None else sample.runs_of_member)
