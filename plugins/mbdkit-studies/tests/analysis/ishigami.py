"""The function of Ishigami, whose Sobol indices and tail are known in closed form."""

from __future__ import annotations

import numpy as np

from mbdkit_studies.points.sampled_values import sampled_values
from mbdkit_studies.spec.sample_section import Sample

# T. Ishigami and T. Homma, 1990; with a = 7, b = 0.1 the variance is a^2/8 + b pi^4/5 + b^2 pi^8/18 + 1/2.
_A, _B = 7.0, 0.1


_VARIANCE = _A**2 / 8 + _B * np.pi**4 / 5 + _B**2 * np.pi**8 / 18 + 0.5


_OF_1 = 0.5 * (1 + _B * np.pi**4 / 5) ** 2


_OF_2 = _A**2 / 8


_OF_13 = _B**2 * np.pi**8 * (1 / 18 - 1 / 50)


FIRST = np.array([_OF_1, _OF_2, 0.0]) / _VARIANCE


TOTAL = np.array([_OF_1 + _OF_13, _OF_2, _OF_13]) / _VARIANCE


def ishigami(x: np.ndarray) -> np.ndarray:
    """Return the Ishigami function of x (3, N), (N,)."""
    return np.asarray(np.sin(x[0]) + _A * np.sin(x[1]) ** 2 + _B * x[2] ** 4 * np.sin(x[0]))


def values(n: int, method: str = "sobol", seed: int = 1) -> np.ndarray:
    """Return the function in a Saltelli design, (n, 5)."""
    variables = {name: {"uniform": [-np.pi, np.pi]} for name in "abc"}
    sample = Sample(n=n, method=method, seed=seed, design="saltelli", variables=variables)  # type: ignore[arg-type]
    return ishigami(np.array(list(sampled_values(sample).values()))).reshape(n, 5)


TAIL = np.array([1.0, 0.3**2, 0.02**2 * (np.e - 1) * np.e])
"""Variances of the terms of `tail`, of which the last is lognormal."""


TAIL_SHARES = TAIL / np.sum(TAIL)


def tail(n: int, seed: int) -> np.ndarray:
    """Return x + 0.3 y + 0.02 exp(z) with x, y and z normal in a Saltelli design of random members, (n, 5)."""
    a, b = np.random.default_rng(seed).normal(size=(2, n, 3))
    mixed = np.repeat(a[None], 3, axis=0)
    mixed[range(3), :, range(3)] = b.T
    points = np.stack([a, b, *mixed], axis=1)
    return np.asarray(points[..., 0] + 0.3 * points[..., 1] + 0.02 * np.exp(points[..., 2]))
