"""Quantiles of chi-square distributions, the same on every machine."""

from __future__ import annotations

import numpy as np

LEVEL = 0.95  #: Probability that an error is smaller than its bar, and of the quantiles.

#: Coefficients of the quantile in Chebyshev polynomials of ``2 (freedoms - 1) - 1``, from its values at the roots of
#: the polynomial of degree 21, computed with 30 digits.
COEFFICIENTS = (
    4.948724172173654, 1.0716832300215249, -0.031859788707373736, 0.003267061186979377, -0.00039554897254128184,
    5.1573498986819626e-05, -7.0085774892335135e-06, 9.780253875930474e-07, -1.3903298726160478e-07,
    2.003621877900325e-08, -2.9175380872047716e-09, 4.282342182152059e-10, -6.32423321494023e-11,
    9.383079824226406e-12, -1.396828869374287e-12, 2.0840854152007787e-13, -3.113263548586723e-14,
    4.651746303275803e-15, -6.945166594970227e-16, 1.0346038467430608e-16,
)  # fmt: skip


def quantile(freedoms: np.ndarray | float) -> np.ndarray:
    """Return the quantile of the probability `LEVEL` for degrees of freedom from 1 to 2."""
    x = 2.0 * np.asarray(freedoms, dtype=float) - 3.0
    later, last = np.zeros_like(x), np.zeros_like(x)
    for c in COEFFICIENTS[:0:-1]:  # Clenshaw's summation
        later, last = 2.0 * x * later - last + c, later
    return np.asarray(x * later - last + COEFFICIENTS[0])


def quantile_of_many(freedoms: int) -> float:
    """Return the quantile for two degrees of freedom or more, within 1 % (E. B. Wilson and M. M. Hilferty, 1931)."""
    spread = 2.0 / (9.0 * freedoms)
    root = 1.0 - spread + 1.6448536269514722 * float(np.sqrt(spread))  # the one-sided quantile of normal numbers
    return freedoms * root * root * root
