"""A reason to doubt measured data, and limits that several criteria use."""

from __future__ import annotations

from dataclasses import dataclass

from mbdkit_biomech.inverse_dynamics.inverse_sections import Criterion

ROUND_OFF = 1e-9
"""Change of a fitted quantity below which it counts as constant [m or rad]."""

TO_DEVIATION = 1.4826
"""Ratio of the standard deviation of Gaussian noise to the median of its absolute values."""


@dataclass(frozen=True)
class Doubt:
    """A reason to doubt measured data: the criterion, and a sentence that names the likely cause."""

    criterion: Criterion
    sentence: str
