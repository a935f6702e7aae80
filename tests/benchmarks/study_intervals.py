"""How often the confidence intervals of studies contain the true value: ``python -m tests.benchmarks.study_intervals``.

Means, standard deviations and quantiles are those of known distributions. Sobol indices are those of the Ishigami
function, of a product (1 + a x)(1 + b y)(1 + c z), of the products of (|2 x| + a)/(1 + a) by I. M. Sobol with four and
six variables between -1 and 1, and of a sum x + 0.3 y + 0.02 exp(z) of functions of normal variables, whose indices
have closed forms.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.stats
from tests.analysis.ishigami import FIRST, TAIL_SHARES, TOTAL, ishigami, tail

from mbdkit_studies.points.sampled_values import sampled_values
from mbdkit_studies.spec.sample_section import Sample
from mbdkit_studies.statistics import sample_statistics
from mbdkit_studies.statistics.sobol_indices import sobol_indices

SEEDS = 400
SIZES = (8, 16, 32, 64, 128, 512)
LAWS = {"normal": scipy.stats.norm(10, 2), "uniform": scipy.stats.uniform(0, 1), "lognormal": scipy.stats.lognorm(0.5)}

_FACTORS = np.array([0.8, 0.3, 0.05])
_PARTS = _FACTORS**2 / 3  # variances of the factors with x, y, z uniform between -1 and 1
_WHOLE = np.prod(1 + _PARTS) - 1
_TOTALS = _PARTS * np.array([np.prod(np.delete(1 + _PARTS, place)) for place in range(3)]) / _WHOLE


def product(x: np.ndarray) -> np.ndarray:
    """Return the product of the factors at points x (3, N), (N,)."""
    return np.asarray(np.prod(1 + _FACTORS[:, None] * x, axis=0))


def _kinked(*a: float) -> tuple[Callable[[np.ndarray], np.ndarray], float, np.ndarray]:
    """Return a function of Sobol of points x (d, N), (N,), the end of the range of x, and its 2 d indices."""
    known = np.array(a)
    parts = 1 / (3 * (1 + known) ** 2)
    others = np.array([np.prod(np.delete(1 + parts, place)) for place in range(len(a))])
    indices = np.concatenate([parts, parts * others]) / (np.prod(1 + parts) - 1)
    return lambda x: np.prod((np.abs(2 * x) + known[:, None]) / (1 + known[:, None]), axis=0), 1.0, indices


FUNCTIONS = {
    "Ishigami": (ishigami, np.pi, np.concatenate([FIRST, TOTAL])),
    "product": (product, 1.0, np.concatenate([_PARTS / _WHOLE, _TOTALS])),
    "Sobol, four": _kinked(0, 0, 0, 0),
    "Sobol, six": _kinked(0, 0.5, 3, 9, 99, 99),
}


def main() -> None:
    """Print the shares of intervals that contain the true value."""
    print("law, members: mean, standard deviation, 5 % and 95 % quantile")
    for name, law in LAWS.items():
        truth = law.mean(), law.std(), law.ppf(0.05), law.ppf(0.95)
        for n in SIZES:
            hits = np.zeros(4)
            for seed in range(SEEDS):
                values = law.rvs((n, 1), random_state=seed)
                ends = [sample_statistics.quantile(values, q) for q in (0.05, 0.95)]
                found = [sample_statistics.mean(values), sample_statistics.standard_deviation(values), *ends]
                hits += [one.low <= true <= one.high for one, true in zip(found, truth, strict=True)]
            print(f"{name}, {n}: {np.round(hits / SEEDS, 3)}", flush=True)
    print("function, method, members: first-order and total indices")
    for name, (function, end, expected) in FUNCTIONS.items():
        variables = {key: {"uniform": [-end, end]} for key in "xyzuvw"[: len(expected) // 2]}
        for method in ("random", "sobol", "halton"):
            for n in SIZES:
                total = np.zeros(len(expected))
                for seed in range(SEEDS // 2):
                    sample = Sample(n=n, method=method, seed=seed, design="saltelli", variables=variables)
                    values = function(np.array(list(sampled_values(sample).values()))).reshape(n, -1)
                    total += _hits(values, expected, seed)
                print(f"{name}, {method}, {n}: {np.round(total / (SEEDS // 2), 3)}", flush=True)
    for n in SIZES:
        total = np.zeros(6)
        for seed in range(SEEDS // 2):
            total += _hits(tail(n, seed), np.tile(TAIL_SHARES, 2), seed)
        print(f"lognormal, random, {n}: {np.round(total / (SEEDS // 2), 3)}", flush=True)


def _hits(values: np.ndarray, expected: np.ndarray, seed: int) -> np.ndarray:
    """Return which of the first-order and total indices are in their intervals, (2 d,)."""
    one = sobol_indices(values, resamples=400, seed=seed)
    low, high = np.concatenate([one.first_low, one.total_low]), np.concatenate([one.first_high, one.total_high])
    return (low <= expected) & (expected <= high)


if __name__ == "__main__":
    main()
