"""Butterworth filters of evenly sampled series; their coefficients are rounded once, so that they are the same on every
machine.

Source: A. V. Oppenheim and R. W. Schafer, Discrete-Time Signal Processing, 2010, section 7.2 (bilinear transformation).
"""

from __future__ import annotations

from functools import lru_cache

import mpmath
import numpy as np

from mbdkit.engine.kernels.filters import filter_rows

DIGITS = 50


@lru_cache(maxsize=64)
def single_cutoff(cutoff: float, order: int) -> float:
    """Return the cutoff of a filter that has an attenuation of 1.5 dB at `cutoff`, so that two passes have 3 dB."""
    with mpmath.workdps(DIGITS):
        return float(cutoff / (mpmath.sqrt(2) - 1) ** (mpmath.mpf(1) / (2 * order)))


@lru_cache(maxsize=64)
def butterworth_coefficients(order: int, cutoff: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients b and a (order + 1,) of a low-pass filter, with ``a[0] = 1``.

    Parameters
    ----------
    cutoff
        Frequency with an attenuation of 3 dB, below half of `rate`.
    rate
        Samples per unit of time.
    """
    with mpmath.workdps(DIGITS):
        width = mpmath.tan(mpmath.pi * mpmath.mpf(cutoff) / mpmath.mpf(rate))
        poles = [width * mpmath.expjpi(mpmath.mpf(2 * k + order + 1) / (2 * order)) for k in range(order)]
        a = [mpmath.mpc(1)]
        for pole in poles:
            z = (1 + pole) / (1 - pole)
            a = [x - z * before for x, before in zip([*a, 0], [0, *a], strict=True)]
        gain = width**order / mpmath.re(mpmath.fprod(1 - pole for pole in poles))
        b = [gain * mpmath.binomial(order, k) for k in range(order + 1)]
        return np.array(b, dtype=float), np.array([mpmath.re(x) for x in a], dtype=float)


def filtered(b: np.ndarray, a: np.ndarray, series: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Return filtered series (T, K), given the state (N, K) of the filter before the first row."""
    out: np.ndarray = np.array(series, dtype=float, order="C")
    filter_rows(b, a, np.array(state, dtype=float, order="C"), out)
    return out


def filtered_both_ways(b: np.ndarray, a: np.ndarray, series: np.ndarray, padding: int) -> np.ndarray:
    """Return series (T, K) filtered forward and backward.

    They are extended at both ends by `padding` rows, point-symmetric to the first and the last row, and each pass
    begins in the steady state of a constant series.
    """
    before, after = 2 * series[0] - series[padding:0:-1], 2 * series[-1] - series[-2 : -padding - 2 : -1]
    out = np.concatenate([before, series, after])
    steady = _steady_state(tuple(b.tolist()), tuple(a.tolist()))[:, None]
    for _ in range(2):
        out = filtered(b, a, out, steady * out[0])[::-1]
    return out[padding : len(out) - padding]


def state_after(b: np.ndarray, a: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the state (N, K) of a filter after the last N rows (N, K), which are both its input and its output."""
    order = len(rows)
    state = np.zeros_like(rows)
    for i in range(order):
        for j in range(order - i):
            state[i] += (b[i + j + 1] - a[i + j + 1]) * rows[order - 1 - j]
    return state


@lru_cache(maxsize=64)
def _steady_state(b: tuple[float, ...], a: tuple[float, ...]) -> np.ndarray:
    """Return the state (N,) of a filter whose input has always been 1."""
    with mpmath.workdps(DIGITS):
        output = mpmath.fsum(b) / mpmath.fsum(a)
        rest = [x - output * y for x, y in zip(b, a, strict=True)]
        return np.array([mpmath.fsum(rest[i:]) for i in range(1, len(rest))], dtype=float)
