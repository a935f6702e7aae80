"""The noise of measured signals: independent, or autoregressive of order 1; its estimation by restricted likelihood.

With residuals r at samples k and the correlation phi from sample to sample, the innovations ``r_k - phi*r_(k-1)`` are
independent with the variance ``deviation**2*(1 - phi**2)``; see G. E. P. Box, G. M. Jenkins, Time Series Analysis
(1970). Restricted likelihood accounts for the parameters that were fitted; see H. D. Patterson, R. Thompson, Biometrika
58 (1971) 545-554.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

MOST = 0.999  #: Largest correlation from sample to sample.
LEAST_DEVIATION = 1e-9  #: Smallest deviation of noise, relative to the magnitude of the measured values.
#: Change of the inverse hyperbolic tangent of a correlation in differences of likelihoods and variances.
CHANGE = 0.05


@dataclass(frozen=True)
class Noise:
    """The noise of one signal.

    Attributes
    ----------
    deviation, correlation
        Standard deviation, and correlation from sample to sample.
    freedom
        Degrees of freedom of the estimated deviation; infinite if the deviation is given.
    error
        Standard error of the inverse hyperbolic tangent of the correlation; 0 if the correlation is given.
    """

    deviation: float
    correlation: float = 0.0
    freedom: float = np.inf
    error: float = 0.0

    def moved(self, change: float) -> Noise:
        """Return the noise with another inverse hyperbolic tangent of the correlation.

        An estimated deviation changes such that the innovations keep theirs, whose error is independent.
        """
        correlation = float(np.tanh(np.arctanh(self.correlation) + change))
        ratio = (1.0 - self.correlation**2) / (1.0 - correlation**2) if np.isfinite(self.freedom) else 1.0
        return replace(self, deviation=self.deviation * float(np.sqrt(ratio)), correlation=correlation)

    @property
    def innovation(self) -> float:
        """Standard deviation of what a sample adds to what follows from the sample before."""
        return self.deviation * float(np.sqrt(1.0 - self.correlation**2))


@dataclass(frozen=True)
class Pieces:
    """The places of the valid samples of a signal among the residuals, in pieces whose samples are in sequence.

    Attributes
    ----------
    places
        (N,) places of the samples in the vector of all residuals.
    gaps
        (N,) number of sampling intervals since the sample before; 0 at the beginning of a window.
    """

    places: np.ndarray
    gaps: np.ndarray

    def white(self, values: np.ndarray, noise: Noise) -> np.ndarray:
        """Return whitened residuals (N,), or derivatives (N, K), from those of all signals."""
        return self.white_part(values[self.places], noise)

    def white_part(self, own: np.ndarray, noise: Noise) -> np.ndarray:
        """Return whitened residuals (N,), or derivatives (N, K), from those of this signal."""
        if noise.correlation == 0.0:
            return np.asarray(own / noise.deviation)
        power = self._powers(noise.correlation)
        before = np.concatenate([own[:1], own[:-1]])
        more = (slice(None), *(None,) * (own.ndim - 1))
        return np.asarray((own - power[more] * before) / (noise.deviation * np.sqrt(1.0 - power**2)[more]))

    def normal(self, values: np.ndarray, noise: Noise) -> np.ndarray:
        """Return the products (K, K) of whitened derivatives, from those (R, K) of all signals."""
        white = self.white(values, noise)
        return np.asarray(white.T @ white)

    def _powers(self, correlation: float) -> np.ndarray:
        """Return the correlation (N,) of each sample with the one before."""
        with np.errstate(invalid="ignore"):
            power = correlation**self.gaps if correlation >= 0 else np.where(self.gaps == 1.0, correlation, 0.0)
        return np.where(self.gaps > 0, power, 0.0)

    def log_deviations(self, noise: Noise) -> float:
        """Return the sum of the logarithms of the deviations of the innovations."""
        if noise.correlation == 0.0:
            return len(self.places) * float(np.log(noise.deviation))
        power = self._powers(noise.correlation)
        return float(np.sum(np.log(noise.deviation) + 0.5 * np.log1p(-(power**2))))


@dataclass(frozen=True)
class Likelihood:
    """The restricted likelihood of one signal as a function of its correlation.

    `others` (K, K) is what priors and other signals know, `known` the given deviation, `first` a first guess, and
    `least` the smallest deviation.
    """

    piece: Pieces
    residuals: np.ndarray
    jacobian: np.ndarray
    others: np.ndarray
    known: float | None
    first: float
    least: float

    def noise(self, *, may_correlate: bool) -> Noise:
        """Return the most likely noise, whose samples may be correlated or not."""
        z = error = 0.0
        if may_correlate:
            cost = self.cost
            result = minimize_scalar(cost, bounds=(-2.0, np.arctanh(MOST)), method="bounded", options={"xatol": 1e-4})
            z = float(result.x)
            curvature = (cost(z - CHANGE) - 2.0 * cost(z) + cost(z + CHANGE)) / CHANGE**2
            error = 1.0 / float(np.sqrt(max(curvature, 1.0)))
        return replace(self.best(float(np.tanh(z)))[0], error=error)

    def cost(self, z: float) -> float:
        """Return the negative logarithm of the likelihood for an inverse hyperbolic tangent of the correlation."""
        return self.best(float(np.tanh(z)))[1]

    def best(self, correlation: float) -> tuple[Noise, float]:
        """Return the noise with the best deviation, and the negative logarithm of the restricted likelihood."""
        unit = Noise(1.0, correlation)
        e, j = self.piece.white_part(self.residuals, unit), self.piece.white_part(self.jacobian, unit)
        own, total, deviation, freedom = j.T @ j, float(e @ e), self.known or self.first, np.inf
        for _ in range(0 if self.known else 3):
            used = float(np.trace(solve(self.others + own / deviation**2, own))) / deviation**2
            freedom = max(len(e) - used, 1.0)
            deviation = max(float(np.sqrt(total / freedom)), self.least)
        matrix = self.others + own / deviation**2
        _, log_det = np.linalg.slogdet(matrix + 1e-300 * np.eye(len(matrix)))
        logs = self.piece.log_deviations(unit) + len(e) * float(np.log(deviation))
        noise = Noise(deviation, correlation, freedom)
        return noise, 0.5 * total / deviation**2 + logs + 0.5 * (log_det if np.isfinite(log_det) else 0.0)


def solve(matrix: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return ``matrix^-1 other``, also for matrices that are singular in directions in which both vanish."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    scaled = matrix / np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) @ (other / np.outer(scale, scale)))
