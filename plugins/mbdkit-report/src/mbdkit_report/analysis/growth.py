"""Growth law of misalignment over time (bounded, linear, quadratic or exponential) and its certainty."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from mbdkit.archive.run import Run

Law = Literal["none", "bounded", "linear", "quadratic", "exponential", "unclear"]

#: Largest number of blocks: enough to distinguish growth laws, but so few that each block should span an oscillation.
BLOCKS = 24
FEWEST = 6  #: Minimum number of blocks needed to determine a law.
#: Difference in AICc above which a law counts as worse than the best one.
#:
#: Burnham and Anderson describe differences of 4 to 7 as "considerably less support".
CLEAR = 4.0
#: The law is unclear if the root mean square of log(block maxima / best law) is larger than this.
LOOSE = math.log(2.0)
#: A law counts as growth if it rises over the series by at least this factor; otherwise, it counts as bounded.
STEADY = 1.5


class LawFit(NamedTuple):
    """One law fitted to the logarithms of the block maxima of a time series.

    Attributes
    ----------
    law
        Name of the law.
    rise
        Factor by which the law rises over the series, at most `BLOCKS` for the power laws.
    scatter
        Root mean square of log(maxima / law); a value of 0.1 means that the maxima differ from the law by about 10 %.
    aicc
        Akaike information criterion, corrected for small samples, for the effective number of independent maxima; lower
        is better.
    """

    law: Law
    rise: float
    scatter: float
    aicc: float


@dataclass(frozen=True)
class Growth:
    """The growth law of a time series.

    Attributes
    ----------
    law
        The law with the most support; ``none`` if all values are zero, ``unclear`` if none of the four laws fits or
        fewer than six block maxima are positive.
    candidates
        All laws that the data do not distinguish from the best one, beginning with the best; only one law if it is
        certain.
    exponent
        Exponent p of the power law s^p fitted to the maxima; nan if fewer than six block maxima are positive.
    """

    law: Law
    candidates: tuple[Law, ...]
    exponent: float


def growth_law(time: np.ndarray, value: np.ndarray) -> Growth:
    """Determine the growth law of a time series.

    The series is divided into blocks of equal duration. The maxima of the blocks are not affected by oscillation within
    a block. Their logarithms are fitted by least squares with the logarithms of the laws c, c + a s, c + a s^2
    (c, a >= 0) and c exp(r s) (r >= 0), where s is the time since the start, divided by the duration. The laws are
    ranked by the corrected Akaike criterion. Its sample size is the effective number of independent maxima, computed
    from the correlation of the residuals, so that a slow oscillation is not mistaken for growth. All laws that the data
    do not distinguish from the best one are returned as candidates.

    Parameters
    ----------
    time
        (T,) increasing times [s].
    value
        (T,) values >= 0, such as a joint's misalignment [m].

    Returns
    -------
    Growth
        The best law, and all candidates.

    Raises
    ------
    ValueError
        If there are fewer than 24 values, if the numbers of times and values differ, or if values are negative or not
        finite.

    References
    ----------
    Burnham, Anderson, *Model Selection and Multimodel Inference*, Springer 2002, section 2.6.
    """
    time, value = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    if len(time) != len(value) or len(time) < 4 * FEWEST:
        raise ValueError(
            f"a growth law needs at least {4 * FEWEST} values and one time for each, not {len(value)} values and "
            f"{len(time)} times"
        )
    if not np.all(np.isfinite(value)) or np.any(value < 0):
        raise ValueError("a growth law is fitted to finite values that are not negative")
    rows = np.array([a + int(np.argmax(value[a:b])) for a, b in itertools.pairwise(edges(time))])
    at, largest = time[rows], value[rows]
    keep = largest > 0
    if not np.any(keep):
        return Growth("none", ("none",), math.nan)
    if keep.sum() < FEWEST:
        return Growth("unclear", ("unclear",), math.nan)
    s, y = (at[keep] - time[0]) / (time[-1] - time[0]), np.log(largest[keep])
    residuals = {law: fit(s, y) for law, fit in _FITS.items()}
    nearest = min(residuals.values(), key=lambda residual: float(residual[0] @ residual[0]))
    count = max(float(independent(nearest[0])), float(FEWEST))
    fits = sorted((_fit(law, residual, count, len(y)) for law, residual in residuals.items()), key=lambda fit: fit.aicc)
    exponent = float(np.polyfit(np.log(np.maximum(s, 1e-12)), y, 1)[0])
    if fits[0].scatter > LOOSE:
        return Growth("unclear", ("unclear",), exponent)
    likely = [fit for fit in fits if fit.aicc - fits[0].aicc < CLEAR]
    laws: list[Law] = ["bounded" if fit.rise < STEADY else fit.law for fit in likely]
    candidates = tuple(dict.fromkeys(laws))
    return Growth(candidates[0], candidates, exponent)


#: A fit: residuals, factor by which the law rises over the series, and number of parameters.
_Found = tuple[np.ndarray, float, int]


def _bounded(s: np.ndarray, y: np.ndarray) -> _Found:
    return y - y.mean(), 1.0, 1


def _power(p: int) -> Callable[[np.ndarray, np.ndarray], _Found]:
    def fit(s: np.ndarray, y: np.ndarray) -> _Found:
        from scipy.optimize import minimize_scalar  # takes a quarter of a second to load

        def shape(log_offset: float) -> np.ndarray:
            return np.asarray(np.log(math.exp(log_offset) + s**p))

        def spread(log_offset: float) -> float:
            return float(np.var(y - shape(log_offset)))

        # The variance may have two local minima, one of them at small offsets. Therefore the search starts with a
        # coarse grid.
        grid = np.linspace(-18.0, 6.0, 49)
        start = float(grid[int(np.argmin([spread(x) for x in grid]))])
        best = float(minimize_scalar(spread, bounds=(start - 0.5, start + 0.5), method="bounded").x)
        difference, offset = y - shape(best), math.exp(best)
        return difference - difference.mean(), 1.0 / max(offset / (1 + offset), 1.0 / BLOCKS), 2

    return fit


def _exponential(s: np.ndarray, y: np.ndarray) -> _Found:
    slope, start = np.polyfit(s, y, 1)
    if slope <= 0:
        return y - y.mean(), 1.0, 2
    return y - (start + slope * s), math.exp(slope), 2


_FITS: dict[Law, Callable[[np.ndarray, np.ndarray], _Found]] = {
    "bounded": _bounded,
    "linear": _power(1),
    "quadratic": _power(2),
    "exponential": _exponential,
}


def _fit(law: Law, found: _Found, count: float, maxima: int) -> LawFit:
    residual, rise, parameters = found
    variance = max(float(residual @ residual) / maxima, 1e-12)  # laws with a scatter below 1e-6 count as equal
    k = parameters + 1  # the variance is a parameter too
    correction = 2 * k * (k + 1) / max(count - k - 1, 0.5)
    return LawFit(law, rise, math.sqrt(variance), count * math.log(variance) + 2 * k + correction)


def edges(time: np.ndarray) -> np.ndarray:
    """Return the row indices (K + 1,) that separate up to `BLOCKS` blocks of equal duration, which have at least four
    rows on average; the times (T,) [s] increase.
    """
    count = max(1, min(BLOCKS, len(time) // 4))
    borders = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[1:-1], side="left")
    return np.unique(np.concatenate([[0], borders, [len(time)]]))


def block_means(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean time (K,) and the mean value (..., K) of each block of the values (..., T)."""
    spans = list(itertools.pairwise(edges(time)))
    means = [np.stack([x[..., a:b].mean(axis=-1) for a, b in spans], axis=-1) for x in (time, value)]
    return means[0], means[1]


def independent(residual: np.ndarray) -> np.ndarray:
    """Return the effective sample size of residuals (..., K): K (1 - r) / (1 + r) for a lag-1 correlation r > 0.

    This is the effective sample size of a first-order autoregressive series; Bayley and Hammersley, J. R. Stat. Soc. 8
    (1946) 184-197. r is clipped to the range 0 to 0.95.
    """
    count = residual.shape[-1]
    centred = residual - residual.mean(axis=-1, keepdims=True)
    power = np.sum(centred * centred, axis=-1)
    if count < 3:
        return np.full(power.shape, float(count))
    correlated = np.sum(centred[..., 1:] * centred[..., :-1], axis=-1)
    r = np.clip(np.divide(correlated, power, out=np.zeros_like(power), where=power != 0.0), 0.0, 0.95)
    return np.asarray(count * (1 - r) / (1 + r))


def worst_history(run: Run) -> np.ndarray:
    """Return the largest misalignment (T,) [m] of any joint at each recorded time."""
    return np.asarray(np.max(run.array("joints/misalignment"), axis=1, initial=0.0))
