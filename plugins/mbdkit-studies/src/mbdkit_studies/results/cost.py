"""Comparison of runs at equal cost."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def at_equal_work(work: Sequence[float], result: Sequence[float], wanted: float) -> float:
    """Return the result at a given cost by log-log interpolation between neighbouring runs.

    Parameters
    ----------
    work
        (K,) costs of the runs, in any order; runs with costs that are not positive are ignored.
    result
        (K,) errors or misalignments of the runs; runs with values that are not finite or not positive are ignored.
    wanted
        Cost at which to interpolate.

    Returns
    -------
    float
        Interpolated result; nan if `wanted` lies outside the range of the costs, because nothing is extrapolated.
    """
    pairs = sorted((w, r) for w, r in zip(work, result, strict=True) if w > 0 and r > 0 and math.isfinite(r))
    if not pairs or not pairs[0][0] <= wanted <= pairs[-1][0]:
        return math.nan
    x, y = np.log(np.array(pairs)).T
    return float(np.exp(np.interp(math.log(wanted), x, y)))


def work_for(work: Sequence[float], result: Sequence[float], wanted: float) -> float:
    """Return the smallest cost from which on all results are at most `wanted`.

    Parameters
    ----------
    work
        (K,) costs of the runs, in any order; runs with costs that are not positive are ignored.
    result
        (K,) errors or misalignments of the runs; a value that is not finite counts as too large.
    wanted
        Result to reach.

    Returns
    -------
    float
        Cost, interpolated between two runs in logarithms where their results allow it; nan if the result of the most
        expensive run exceeds `wanted`, or if there are no runs.
    """
    pairs = sorted((w, r if math.isfinite(r) else math.inf) for w, r in zip(work, result, strict=True) if w > 0)
    last_bad = max((i for i, (_, r) in enumerate(pairs) if r > wanted), default=-1)
    if last_bad == len(pairs) - 1:
        return math.nan
    if last_bad < 0 or not math.isfinite(pairs[last_bad][1]) or pairs[last_bad + 1][1] <= 0:
        return pairs[last_bad + 1][0]
    (w0, r0), (w1, r1) = pairs[last_bad], pairs[last_bad + 1]
    return math.exp(math.log(w0) + math.log(wanted / r0) / math.log(r1 / r0) * math.log(w1 / w0))
