"""Error estimates and dense output of explicit Runge-Kutta methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class EmbeddedPair:
    """Error estimates and dense output of an explicit tableau with S stages; equal to itself only.

    Parameters
    ----------
    error
        (1 or 2, S) weights of the stages in the estimates of the local error divided by h, higher order first.
    estimate_order
        Order of the estimate, as a power of h; with two estimates, the order of their combination.
    a, c
        (E, E) and (E,) coefficients and nodes, including the additional stages of dense output, E >= S.
    dense
        (E, degree) dense output: the weight of stage i at theta is ``sum_k dense[i, k] theta^(k + 1)``.
    """

    error: np.ndarray
    estimate_order: int
    a: np.ndarray
    c: np.ndarray
    dense: np.ndarray


def nested_polynomials(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Expand dense output given as ``theta (F_0 + (1 - theta) (F_1 + theta (F_2 + (1 - theta) (...))))``.

    Parameters
    ----------
    parts
        F_0, F_1, ...: weights of the stages, (E,) each.

    Returns
    -------
    (E, number of parts) array
        Coefficients of theta, theta^2, ...
    """
    theta, rest = np.polynomial.Polynomial([0.0, 1.0]), np.polynomial.Polynomial([1.0, -1.0])
    out = np.zeros((len(parts[0]), len(parts)))
    for i in range(len(parts[0])):
        value = np.polynomial.Polynomial([0.0])
        for k in reversed(range(len(parts))):
            value = (value + parts[k][i]) * (theta if k % 2 == 0 else rest)
        out[i, : len(value.coef) - 1] = value.coef[1:]
    return out
