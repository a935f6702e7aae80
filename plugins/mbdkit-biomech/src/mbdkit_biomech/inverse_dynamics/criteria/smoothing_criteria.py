"""Criterion of the verdict on the smoothing of a motion: a cutoff below frequencies that the motion contains."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.signal import periodogram

from mbdkit.base import elementary
from mbdkit.base.text import listed
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt
from mbdkit_biomech.inverse_dynamics.motion.smoothing import UNEVEN, cutoff_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Butterworth, OpenSimFilter, SmoothingSpline

#: Limits for what the smoothing removes near the cutoff.
#:
#: White noise has the same power density at all frequencies. The cutoff is too low if the differences between data and
#: smoothed motion have more than `EXCESS` times the power density near the cutoff that they have at high frequencies,
#: and if what is removed there changes the acceleration by more than the share `REMOVED`. In 80 random data sets with
#: cutoffs of at least 2.5 times the highest frequency of the motion, the share is at most 0.02 where the ratio of the
#: densities exceeds `EXCESS`; in the example `walking`, it is 0.15 with the usual cutoff of 6 Hz.
EXCESS, REMOVED = 10.0, 0.2

#: The cutoff is examined if the record has at least so many rows and periods of the cutoff.
FEWEST_ROWS, FEWEST_PERIODS = 50, 1.0

FEWEST_HIGH = 8  #: Least number of high frequencies that give the level of the noise.


def cutoff_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield a doubt if a cutoff given in the spec removes a part of the motion (residual analysis; D. A. Winter,
    Biomechanics and Motor Control of Human Movement, 4th edition, Wiley 2009, section 3.4.4.3).
    """
    how, independent, time = result.problem.spec.motion.smooth, result.independent, result.motion.time
    fixed = isinstance(how, Butterworth | OpenSimFilter) or (isinstance(how, SmoothingSpline) and how.parameter)
    if independent is None or len(independent.intervals) != 1 or not fixed or len(time) < FEWEST_ROWS:
        return
    steps, cutoff = np.diff(time), cutoff_of(time, how)
    rate = float(1 / np.mean(steps))
    if np.ptp(steps) > 2 * UNEVEN / rate or cutoff * (time[-1] - time[0]) < FEWEST_PERIODS:
        return
    smooth = independent.quantities.values(result.motion.q)
    left = independent.quantities.values(result.fitted.q) - smooth
    frequency, removed = periodogram(left, rate, window="hann", axis=0)
    _, kept = periodogram(smooth, rate, window="hann", axis=0)
    near, high = (frequency > 0.5 * cutoff) & (frequency < 2 * cutoff), frequency >= 2.5 * cutoff
    if np.sum(high) < FEWEST_HIGH:
        return
    noise = np.median(removed[high], axis=0) / elementary.log(2)  # the median of exponentially distributed densities
    tiny = np.finfo(float).tiny
    excess = np.mean(removed[near], axis=0) / np.maximum(noise, tiny)
    weight = (frequency**4 * (frequency < 2 * cutoff))[:, None]
    share = np.sqrt(
        np.sum(weight * np.maximum(0.0, removed - noise), axis=0) / np.maximum(np.sum(weight * kept, axis=0), tiny)
    )
    low = np.flatnonzero((excess > EXCESS) & (share > REMOVED))
    if low.size:
        texts = [f"{share[index]:.2g} of that of {independent.names[index]}" for index in low[:4]]
        yield doubt(
            "cutoff",
            f"the cutoff of {cutoff:.3g} Hz removes a part of the motion: the accelerations that it removes are "
            f"{listed(texts, 'and')} (doubtful above {REMOVED:g}), and noise does not explain them. Choose a higher "
            "cutoff.",
        )
