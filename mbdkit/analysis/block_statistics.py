"""Block maxima and means of a long, oscillating time series, and its effective number of independent values."""

from __future__ import annotations

import itertools

import numpy as np

BLOCKS = 24
"""Default number of blocks: enough to distinguish growth laws, and few enough for each to span an oscillation."""


def edges(time: np.ndarray, number: int = BLOCKS) -> np.ndarray:
    """Return the row numbers (K + 1,) that separate up to `number` blocks of equal duration.

    Parameters
    ----------
    time
        (T,) increasing times [s].
    number
        Maximum number of blocks; reduced so that each has at least four rows on average.
    """
    count = max(1, min(number, len(time) // 4))
    borders = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[1:-1], side="left")
    return np.unique(np.concatenate([[0], borders, [len(time)]]))


def block_maxima(time: np.ndarray, value: np.ndarray, number: int = BLOCKS) -> tuple[np.ndarray, np.ndarray]:
    """Return the times (K,) and the values (K,) of the maximum of each block."""
    borders = edges(time, number)
    at = np.array([a + int(np.argmax(value[a:b])) for a, b in itertools.pairwise(borders)])
    return time[at], value[at]


def block_means(time: np.ndarray, value: np.ndarray, number: int = BLOCKS) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean time (K,) and the mean value (..., K) of each block of the values (..., T)."""
    spans = list(itertools.pairwise(edges(time, number)))
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
