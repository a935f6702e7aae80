"""Estimates errors of a run from coarser runs of the same method; arrays only.

Runs with tolerances a > b > c have the errors C a^p, C b^p and C c^p. The differences of the first two runs from the
last one determine C and p for every body and every joint. The error of the last run is then ``d x / (1 - x)``, where d
is the difference of the last two runs and x = (c / b)^p. With a single coarser run, p is not observed, and `ASSUMED` is
used. Methods that control the error of each step have p near 1; `ASSUMED` is smaller, so that the estimate tends to be
too large.

This evidence is weaker than that of `error_estimate`, but costs nothing, because the coarser runs were needed to choose
the tolerance. An error that all runs share, such as a pulse between two evaluations, is detected in the loads
themselves (`check_run.resolved_until`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from mbdkit.base import elementary
from mbdkit.runs.accuracy.error_estimate import (
    AT_REST,
    LARGEST_ERROR,
    MINOR,
    ErrorEstimate,
    Estimated,
    Units,
    assemble,
    running_norms,
)
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.trust.measure_error import AGREED

#: Limits of the exponent p of the error in the tolerance.
#:
#: Differences count as decreasing if the observed exponent is at least `LEAST`. `ASSUMED` is used if no exponent is
#: observed, or if the observed one is larger, as with an exceptionally inaccurate coarse run.
LEAST, ASSUMED = 0.25, 0.8

#: Differences up to this many times the requested accuracy need not decrease at all times.
#:
#: Such differences are expected of runs whose tolerance is larger by a factor of 10 or more.
EXPECTED = 10.0

#: Factor by which all estimates are multiplied, because errors of single runs scatter about the tolerance. In 99 % of
#: the pairs of runs of 21 mechanisms, with tolerances from 1e-2 to 1e-13 and any ratio of them, the largest true error
#: over a run is at most 4.1 times the estimate without this factor. With `ASSUMED` nearer to 1, this number would grow
#: with the ratio. At single times, and for forces, true errors exceed the estimates more often, mostly at tolerances of
#: 1e-6 and above, by factors of 1 to 2.5 and in two of 147 runs by 8 and 12 (see the page on trust).
SAFETY = 4.0


def estimate_from_coarser(
    main: ObservedRows,
    coarser: Sequence[ObservedRows],
    tolerances: Sequence[float],
    units: Units,
    asked: float,
    equal_until: int,
) -> ErrorEstimate:
    """Estimate the errors of a run.

    - `main`: the run.
    - `coarser`: values of one or two runs of larger tolerance at the times of `main`, the coarsest first. Rows that
      they did not reach are nan.
    - `tolerances`: tolerances of the coarser runs, and that of the run.
    - `units`: natural units of the mechanism.
    - `asked`: requested accuracy; see `EXPECTED`.
    - `equal_until`: row up to which the runs may have taken the same steps, so that their differences contain no
      information.

    Returns the estimates; zero at the first row if all runs start from the same state.
    """
    estimated = partial(_Quantity, tolerances=tolerances, asked=asked, equal_until=equal_until)
    return assemble(main, (*coarser, main), units, estimated)


def error_share(differences: Sequence[float], tolerances: Sequence[float]) -> float:
    """Return the estimated error of the last of two or three runs, from the differences of the earlier runs from it.

    It is inf if the differences do not decrease with the tolerance, unless the last one is 0.
    """
    factor, falls = _factor([np.array(x) for x in differences], tolerances)
    if falls:
        return float(differences[-1] * factor)
    return 0.0 if differences[-1] == 0 and np.isfinite(factor) else math.inf


def _factor(differences: Sequence[np.ndarray], tolerances: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the estimated error as a share of the last difference of runs, and whether the differences decrease."""
    exponent = np.full(differences[-1].shape, ASSUMED)
    falls = np.full(differences[-1].shape, True)
    if len(differences) > 1:
        with np.errstate(divide="ignore", invalid="ignore"):
            observed = elementary.log(differences[0] / differences[1]) / elementary.log(tolerances[0] / tolerances[1])
        falls = observed >= LEAST
        exponent = np.clip(np.nan_to_num(observed, nan=LEAST, posinf=ASSUMED, neginf=LEAST), LEAST, ASSUMED)
    ratio = elementary.pow(tolerances[-1] / tolerances[-2], exponent)
    differs = ratio < 1.0  # otherwise the runs are equal and contain no information
    return np.where(differs, SAFETY * ratio / np.where(differs, 1.0 - ratio, 1.0), math.inf), falls & differs


class _Quantity(Estimated):
    """One quantity of all bodies or joints in all runs.

    `values` contains an array (T, B or J, K) for each coarser run, and then that of the run itself.
    """

    def __init__(
        self,
        values: list[np.ndarray],
        unit: float | np.ndarray,
        size: float,
        *,
        tolerances: Sequence[float],
        asked: float,
        equal_until: int,
    ):
        self._values, self._tolerances = values, tolerances
        main = values[-1]
        norms = [running_norms(main - other) for other in values[:-1]]
        self._all = [np.max(d, axis=1, initial=0.0, keepdims=True) for d in norms]
        factor, falls = _factor(norms, tolerances)
        _, common = _factor(self._all, tolerances)
        agreed = np.maximum(max(AGREED, EXPECTED * asked) * size, AT_REST * unit)
        largest = np.fmax.reduce(norms)
        tiny, minor = largest <= agreed, (largest <= MINOR * self._all[-1]) & common
        small = norms[-1] <= LARGEST_ERROR * size + agreed
        finite = np.isfinite(np.add.reduce(norms))
        self.seen = np.minimum.accumulate(finite & (falls | tiny | minor) & small, axis=0)
        # one factor for all times, because the factor of the small differences in the first steps is random
        last = np.maximum(np.sum(self.seen, axis=0) - 1, 0)[None]
        self._factor = np.broadcast_to(np.take_along_axis(factor, last, axis=0), factor.shape)
        self._equal_until = equal_until

    def estimates(self, size: Callable[[np.ndarray], np.ndarray], axes: tuple[slice | None, ...]) -> np.ndarray:
        difference = size(self._values[-1] - self._values[-2])
        estimate = self._factor[axes] * np.maximum.accumulate(difference, axis=0)
        estimate[1 : self._equal_until] = np.fmax(estimate[1 : self._equal_until], estimate[self._equal_until])
        return np.where(self.seen[axes], np.maximum.accumulate(np.nan_to_num(estimate), axis=0), np.nan)

    def order(self, count: int) -> float:
        """Return the exponent of the error in the tolerance at the last of `count` known rows; nan if not observed."""
        if not count or len(self._all) < 2:
            return math.nan
        first, second = (float(d[count - 1, 0]) for d in self._all)
        ratio = self._tolerances[0] / self._tolerances[1]
        return elementary.log(first / second) / elementary.log(ratio) if first > 0 and second > 0 else math.nan
