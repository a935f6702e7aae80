"""Estimates errors from the differences of runs of increasing accuracy, by Richardson extrapolation; arrays only.

Three runs of one method with steps h, h/2 and h/4 have the results y0, y1 and y2, which differ by d01 = ``|y0 - y1|``
and d12 = ``|y1 - y2|``. If the error is C h^p, then d12 / d01 = 2^-p, and the error of the first
run is ``|y0 - y2| / (1 - (d12 / d01)^2)`` (Richardson 1911; Hairer, Norsett and Wanner 1993, II.4). Nothing is assumed
about p, because stabilization, stiffness and dense output change it, and it differs between positions and reactions.
Instead, p is observed for every body and every joint. The only requirement is that d12 / d01
is at most `LARGEST_RATIO`. The same holds for adaptive methods, with tolerances instead of steps.

Runs of one method may share an error, such as a pulse between two steps. A run by another method, the guard, must
therefore agree with the most accurate one. Conversely, the step may be too long for an order to be observed, as in
sudden turns of a pendulum. It is then sufficient that the distance of the most accurate run from the guard is at most
`CONFIRMED` times that of the first run.

If neither condition holds (because of chaos, another branch, or a step too long for the motion), the estimate is nan.
All differences are replaced by their running maxima, because a difference that changes its sign passes through zero.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.frozen import dataclass
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.trust.measure_error import AGREED, CONFIRMED, GUARD_RATIO, LARGEST_RATIO

#: Differences from the guard below this share of the size of a quantity are attributed to the tolerance of the guard.
#:
#: They are not included in the estimate.
ROUND_OFF = 1e-9

#: Lower limit of the size from which the limits by `ROUND_OFF` and `AGREED` are computed, for mechanisms that hardly
#: move.
#:
#: It is a share of the natural unit of the quantity (`Units`).
AT_REST = 1e-12

#: No order needs to be observed for bodies or joints whose differences are below this share of those of all bodies or
#: joints.
MINOR = 0.05

#: Errors above this share of the size of a quantity count as unknown, because they no longer depend linearly on earlier
#: errors.
LARGEST_ERROR = 0.1


@dataclass(frozen=True)
class Units:
    """Natural units of a mechanism.

    `length`: characteristic length [m]. Angles are multiplied by it, and torques divided, to compare them with lengths
    and forces. `speed`: length over duration of the run [m/s]. `force`: mass times length over the square of the
    duration [N]. `rounding`: factor, or (B,) one for each body, by which rounding errors of positions and velocities
    exceed those that follow from these units.
    """

    length: float
    speed: float
    force: float
    rounding: float | np.ndarray = 1.0


@dataclass(frozen=True)
class ErrorEstimate:
    """Estimated errors of a run; nan where unknown. They are envelopes, which never decrease with time.

    - `position`, `velocity`: (T, B, 3) errors of positions [m, rad] and velocities [m/s, rad/s].
    - `reaction`: (T, J) bounds of the norm of the error of reaction forces [N].
    - `torque`: (T, J) errors of reaction torques [N m].
    - `known_until`: time [s] until which all of these errors are known; nan if they are not even known at the first
      row.
    - `order`: observed exponent of the error of positions in the step, or in the tolerance of an adaptive run, at the
      last known row: log(d01 / d12) over the logarithm of the factor between the runs. It is nan if only rounding
      errors were observed.
    - `unknown`: quantities whose errors are unknown after `known_until`; empty if all are known.
    """

    position: np.ndarray
    velocity: np.ndarray
    reaction: np.ndarray
    torque: np.ndarray
    known_until: float
    order: float
    unknown: tuple[str, ...] = ()


def estimate_errors(
    runs: tuple[ObservedRows, ObservedRows, ObservedRows], guard: ObservedRows, units: Units, refinement: float = 2.0
) -> ErrorEstimate:
    """Estimate the errors of the first of three runs.

    `runs`: the run, and two companions of increasing accuracy, with values at the times of the run. Rows that a
    companion did not reach are nan. `guard`: a run by another method, at the same times. `units`: natural units of the
    mechanism. `refinement`: factor by which steps or tolerances decrease from one run to the next; base of the
    logarithms of the observed order. Returns the estimates; zero at the first row if all runs start from the same
    state.
    """
    return assemble(runs[0], (*runs, guard), units, partial(_Quantity, refinement=refinement))


class Estimated(ABC):
    """Estimates for one quantity of U bodies or joints with K components each."""

    seen: np.ndarray
    """(T, U) whether the error of each body or joint is known."""

    @property
    def known(self) -> np.ndarray:
        """(T,) whether the errors of all bodies or joints are known."""
        return np.asarray(np.all(self.seen, axis=1))

    def errors(self) -> np.ndarray:
        """Return the errors of the components, (T, U, K)."""
        return self.estimates(np.abs, np.s_[:, :, None])

    def norm_errors(self, part: slice) -> np.ndarray:
        """Return the errors of the norm of the components in a slice, (T, U)."""
        return self.estimates(lambda difference: np.linalg.norm(difference[..., part], axis=-1), np.s_[:, :])

    @abstractmethod
    def estimates(self, size: Callable[[np.ndarray], np.ndarray], axes: tuple[slice | None, ...]) -> np.ndarray:
        """Return the errors by which a size of the components differs; `axes` of that size, from those of `seen`."""

    @abstractmethod
    def order(self, count: int) -> float:
        """Return the observed order at the last of `count` known rows; nan if only rounding errors were observed."""


def assemble(
    main: ObservedRows,
    every: Sequence[ObservedRows],
    units: Units,
    estimated: Callable[[list[np.ndarray], float | np.ndarray, float], Estimated],
) -> ErrorEstimate:
    """Return the estimates for positions, velocities and reactions.

    - `main`: the run whose errors are estimated.
    - `every`: all runs, in the order that `estimated` expects.
    - `units`: natural units of the mechanism.
    - `estimated`: function ``estimated(values, unit, size)`` that estimates the errors of one quantity from its values
      (T, U, K) in every run, its natural unit and its size in the run. Angles are multiplied by the length of the
      mechanism, and torques divided by it.
    """
    length = units.length
    scale = np.array([1.0, 1.0, length])

    def of(values: list[np.ndarray], in_main: np.ndarray, unit: float | np.ndarray) -> Estimated:
        return estimated(values, unit, float(np.max(np.linalg.norm(in_main, axis=-1), initial=0.0)))

    def wrench(run: ObservedRows) -> np.ndarray:
        return np.concatenate([run.force, run.torque[..., None] / length], axis=-1)

    size = size_of_motion(main.position, length)
    position = estimated([run.position * scale for run in every], length * units.rounding, size)
    velocity = of([run.velocity * scale for run in every], main.velocity * scale, units.speed * units.rounding)
    reaction = of([wrench(run) for run in every], wrench(main), units.force)
    count = int(np.sum(position.known & velocity.known & reaction.known))
    quantities = {"positions": position, "velocities": velocity, "reactions": reaction}
    # of the first row that is not known; none if all are
    unknown = tuple(word for word, quantity in quantities.items() if not quantity.known[count : count + 1].all())
    return ErrorEstimate(
        position.errors() / scale,
        velocity.errors() / scale,
        reaction.norm_errors(slice(0, 2)),
        reaction.norm_errors(slice(2, 3)) * length,
        float(main.time[count - 1]) if count else math.nan,
        position.order(count),
        unknown,
    )


def size_of_motion(position: np.ndarray, length: float) -> float:
    """Return the largest displacement of a body [m], from positions (T, B, 3).

    Rotations are multiplied by `length`, and count up to 1 rad.
    """
    moved = np.abs(position - position[:1])
    across = float(np.max(np.linalg.norm(moved[..., :2], axis=-1), initial=0.0))
    return max(across, length * min(float(np.max(moved[..., 2], initial=0.0)), 1.0))


class _Quantity(Estimated):
    """One quantity in three runs and the guard.

    `values`: four arrays (T, B or J, K) in one unit of measurement. `unit`: natural unit of the quantity, or one for
    each body. `size`: size of the quantity. `refinement`: see `estimate_errors`.
    """

    def __init__(self, values: list[np.ndarray], unit: float | np.ndarray, size: float, refinement: float):
        first, second, third, guard = values
        self._values, self._refinement = values, refinement
        d01, d12, d02 = running_norms(first - second), running_norms(second - third), running_norms(first - third)
        d0g, d2g = running_norms(first - guard), running_norms(third - guard)
        all01, all12, all02 = (np.max(d, axis=1, initial=0.0, keepdims=True) for d in (d01, d12, d02))
        floor, agreed = (np.maximum(share * size, AT_REST * unit) for share in (ROUND_OFF, AGREED))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio, common = np.where(d01 > 0, d12 / d01, np.inf), np.where(all01 > 0, all12 / all01, np.inf)
        spread = _largest(d01, d12, d02, d0g)
        tiny = spread <= agreed
        minor = (_largest(d01, d12, d02) <= MINOR * all02) & (common <= LARGEST_RATIO)
        falls, confirmed = ratio <= LARGEST_RATIO, d2g <= CONFIRMED * d0g
        #: Factor of Richardson's extrapolation (T, U), for each of the U bodies or joints.
        self._factor = 1.0 / (1.0 - np.where(falls, ratio, 0.0) ** 2)
        self._falls = falls
        estimate = np.where(falls, self._factor * d02, np.where(confirmed, np.fmax(d02, d0g), spread))
        self._confirmed = confirmed
        agrees = d2g <= np.maximum(GUARD_RATIO * estimate, np.maximum(agreed, MINOR * all02))
        #: Whether the guard is too inaccurate to confirm the estimate, so that the difference from it is included.
        self._widened = (d2g > 0.5 * estimate) & (d2g > floor)
        finite = np.isfinite(d02) & np.isfinite(d2g)
        small = np.where(self._widened, np.fmax(estimate, d0g), estimate) <= np.maximum(LARGEST_ERROR * size, floor)
        seen = finite & (falls | confirmed | tiny | minor) & agrees & small
        self.seen = np.minimum.accumulate(seen, axis=0)
        self._all = (all01, all12, float(np.max(floor)))

    def estimates(self, size: Callable[[np.ndarray], np.ndarray], axes: tuple[slice | None, ...]) -> np.ndarray:
        first, second, third, guard = self._values
        d01, d12, d02, d0g = (
            np.maximum.accumulate(size(difference), axis=0)
            for difference in (first - second, second - third, first - third, first - guard)
        )
        known = (self._falls, self._confirmed, self._factor, self._widened, self.seen)
        falls, confirmed, factor, widened, seen = (x[axes] for x in known)
        spread = np.where(confirmed, np.fmax(d02, d0g), _largest(d01, d12, d02, d0g))
        estimate = np.where(falls, factor * d02, spread)
        estimate = np.where(widened, np.fmax(estimate, d0g), estimate)
        return np.where(seen, np.maximum.accumulate(np.nan_to_num(estimate), axis=0), np.nan)

    def order(self, count: int) -> float:
        """Return log(d01 / d12) / log(refinement); see `Estimated.order`."""
        all01, all12, floor = self._all
        if not count:
            return math.nan
        before, after = float(all01[count - 1, 0]), float(all12[count - 1, 0])
        if not (after > 0 and before > floor):
            return math.nan
        return elementary.log(before / after) / elementary.log(self._refinement)


def _largest(*arrays: np.ndarray) -> np.ndarray:
    """Return the elementwise maximum of several arrays; nan counts as smallest."""
    return np.asarray(np.fmax.reduce(arrays))


def running_norms(difference: np.ndarray) -> np.ndarray:
    """Return the running maxima over time of the norms of vectors (T, U, K), as (T, U); nan from the first nan on."""
    return np.asarray(np.maximum.accumulate(np.linalg.norm(difference, axis=-1), axis=0))
