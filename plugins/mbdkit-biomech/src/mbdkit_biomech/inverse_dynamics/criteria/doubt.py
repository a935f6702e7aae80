"""Reasons to doubt measured data, and limits that several criteria use."""

from __future__ import annotations

from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Criterion

ROUND_OFF = 1e-9  #: Change of a fitted quantity below which it counts as constant [m or rad].

#: Ratio of the standard deviation of Gaussian noise to the median of its absolute values.
TO_DEVIATION = 1.4826


def doubt(criterion: Criterion, sentence: str) -> Finding:
    """Return a reason to doubt measured data; the sentence names the likely cause."""
    return Finding(criterion, "doubtful", sentence)
