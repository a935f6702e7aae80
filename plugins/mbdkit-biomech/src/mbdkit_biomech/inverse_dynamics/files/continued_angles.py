"""Measured angles, which may jump by full turns, as continuous functions of time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit_biomech.cited_text import cited

#: Largest number of intervals next to a gap from which the rate of an angle is computed; with fewer intervals, noise
#: would have a greater effect.
RATE_SAMPLES = 5


def continued(
    time: np.ndarray, values: np.ndarray, period: float, where: tuple[Callable[..., SpecError], str, np.ndarray]
) -> np.ndarray:
    """Return an angle (T,) continued over full turns, from sample to sample and across gaps, which remain nan.

    Between neighbouring samples, the angle changes by at most half a turn. Across a gap, the number of turns is chosen
    that agrees best with the rates on both sides.

    Raises
    ------
    SpecError
        If the number of turns during a gap is uncertain.
    """
    known = np.flatnonzero(~np.isnan(values))
    turned = np.unwrap(values[known], period=period)
    if known.size and np.ptp(values[known]) > period / 2:  # otherwise, the angle does not turn
        gap = np.diff(known) > 1
        change = np.diff(turned)
        for place in np.flatnonzero(gap).tolist():
            lasts = time[known[place + 1]] - time[known[place]]
            sides = [_rate_beside(time[known], change, gap, place, step) for step in (-1, 1)]
            expected = [rate * lasts for rate in sides if rate is not None]
            off = float(np.mean(expected)) - change[place] if expected else 0.0
            turns = np.round(off / period)
            turned[place + 1 :] += period * turns
            if not expected or abs(off - period * turns) > period / 4 or np.ptp(expected) > period / 2:
                error, heading, rows = where
                raise error(
                    f"column '{cited(heading)}': the number of full turns during a gap of {lasts:.4g} s is not "
                    "certain; fill the gap, or cut the motion with `time.start` and `time.end`",
                    row=int(rows[known[place] + 1]),
                )
    found = values.copy()
    found[known] = turned
    return found


def _rate_beside(time: np.ndarray, change: np.ndarray, gap: np.ndarray, place: int, step: int) -> float | None:
    """Return the mean rate of a column before (`step` -1) or after (`step` 1) a gap; None if it is not known.

    At most `RATE_SAMPLES` intervals are used, none of which lies beyond another gap.
    """
    last = place
    while abs(last - place) < RATE_SAMPLES and 0 <= last + step < len(change) and not gap[last + step]:
        last += step
    if last == place:
        return None
    first, end = (last, place) if step < 0 else (place + 1, last + 1)
    return float(np.sum(change[first:end]) / (time[end] - time[first]))
