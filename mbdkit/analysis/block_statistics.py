"""A long, oscillating history cut into blocks, and how many of them count as independent."""

from __future__ import annotations

import itertools

import numpy as np

BLOCKS = 24
"""Blocks that a history is cut into: enough to tell laws apart, few enough to span an oscillation each."""


def edges(time: np.ndarray, number: int = BLOCKS) -> np.ndarray:
    """Return the borders (K + 1,) of up to `number` blocks of equal duration with several rows each, as row numbers.

    Parameters
    ----------
    time
        (T,) increasing times [s].
    number
        Most blocks; fewer where there are too few rows for four in each.
    """
    count = max(1, min(number, len(time) // 4))
    borders = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[1:-1], side="left")
    return np.unique(np.concatenate([[0], borders, [len(time)]]))


def block_maxima(time: np.ndarray, value: np.ndarray, number: int = BLOCKS) -> tuple[np.ndarray, np.ndarray]:
    """Return when (K,) each block of a history is largest, and how large (K,)."""
    borders = edges(time, number)
    at = np.array([a + int(np.argmax(value[a:b])) for a, b in itertools.pairwise(borders)])
    return time[at], value[at]


def block_means(time: np.ndarray, value: np.ndarray, number: int = BLOCKS) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean time (K,) and the mean value (K,) of each block of a history."""
    borders = edges(time, number)
    spans = list(itertools.pairwise(borders))
    return np.array([time[a:b].mean() for a, b in spans]), np.array([value[a:b].mean() for a, b in spans])


def independent(residual: np.ndarray) -> float:
    """Return how many independent residuals (K,) are worth: K (1 - r) / (1 + r) for a lag-1 correlation r > 0.

    The effective sample size of a first-order autoregressive series; Bayley and Hammersley, J. R. Stat. Soc. 8 (1946)
    184-197.
    """
    count = len(residual)
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if count < 3 or power == 0.0:
        return float(count)
    r = min(max(float(centred[1:] @ centred[:-1]) / power, 0.0), 0.95)
    return count * (1 - r) / (1 + r)
