"""Reasons to doubt measured data, limits that several criteria use, and what criteria take and return."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from mbdkit.registry.seam import Seam
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Criterion

ROUND_OFF = 1e-9  #: Change of a fitted quantity below which it counts as constant [m or rad].

#: Ratio of the standard deviation of Gaussian noise to the median of its absolute values.
TO_DEVIATION = 1.4826


def doubt(criterion: Criterion, sentence: str) -> Finding:
    """Return a reason to doubt measured data; the sentence names the likely cause."""
    return Finding(criterion, "doubtful", sentence)


def doubts(criterion: Criterion, sentences: Iterable[str]) -> Iterator[Finding]:
    """Yield a reason to doubt measured data for each sentence."""
    return (doubt(criterion, sentence) for sentence in sentences)


@Seam
def data_criterion(result: Inverse, bars: ResultBars | None, /) -> Iterable[str | Finding]:
    """Return what is doubtful in measured data, from the result of inverse dynamics and its error bars, if any."""
    raise NotImplementedError
