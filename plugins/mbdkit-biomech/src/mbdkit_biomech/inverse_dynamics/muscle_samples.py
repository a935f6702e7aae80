"""Effects of uncertain muscle properties, which are drawn at random, on tensions and joint forces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import RunError
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem, forces_of
from mbdkit_biomech.inverse_dynamics.inverse_sections import MuscleDeviations
from mbdkit_biomech.inverse_dynamics.recruitment import Recruiter

PROPERTIES = ("max_force", "optimal_length", "tendon_length")


def with_drawn_muscles(problem: InverseProblem, random: np.random.Generator) -> Iterator[InverseProblem]:
    """Yield copies of a problem with muscles whose properties are drawn from log-normal distributions.

    Each property of each muscle is drawn independently; the median is its value in the spec. The number of copies is
    `MuscleDeviations.samples`; there are none if the spec has no `recruitment.deviations`.
    """
    recruiter = problem.recruiter
    deviations = None if recruiter is None else recruiter.asked.deviations
    if recruiter is None or deviations is None:
        return
    for _ in range(deviations.samples):
        yield replace(problem, recruiter=_drawn(recruiter, deviations, random))


def _drawn(recruiter: Recruiter, deviations: MuscleDeviations, random: np.random.Generator) -> Recruiter:
    """Return a recruiter whose muscles have properties drawn at random."""
    muscles = {}
    for name, muscle in recruiter.muscles.items():
        factors = elementary.exp([getattr(deviations, key) * random.standard_normal() for key in PROPERTIES])
        muscles[name] = muscle.model_copy(
            update={key: getattr(muscle, key) * float(by) for key, by in zip(PROPERTIES, factors, strict=True)}
        )
    return recruiter.with_muscles(muscles)


def forces_with(problem: InverseProblem, result: Inverse) -> Inverse | None:
    """Return the result for the same motion with other muscles; None if it cannot be computed, for example because a
    tendon is longer than its path.

    Tensions are nan in frames whose motion the muscles cannot produce.
    """
    try:
        return forces_of(problem, result.fitted, result.independent, result.motion, strict=False)
    except RunError:
        return None


def known_mean(samples: np.ndarray) -> np.ndarray:
    """Return the mean (...) over the finite samples of (S, ...); nan where more than half of them are not finite."""
    known = np.isfinite(samples)
    number = np.sum(known, axis=0)
    total = np.sum(np.where(known, samples, 0.0), axis=0)
    return np.asarray(np.where(2 * number >= len(samples), total / np.maximum(number, 1), np.nan))
