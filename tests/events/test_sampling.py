"""Sign changes of a scalar within a step are found from samples, against polynomials with known roots."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest

from mbdkit.events.sampling import INSIDE, refined

Scalar = Callable[[float], float]


def looked_at(scalar: Scalar, phases: Sequence[Scalar] = (), breaks: Sequence[Scalar] = ()) -> tuple[int, int]:
    """Return how often a scalar of theta changes sign between samples, and the number of samples."""

    def of_values(function: Scalar) -> Callable[[Sequence[float]], float]:
        return lambda values: function(values[0])

    points = [(theta, [theta]) for theta in (0.0, *INSIDE, 1.0)]
    parts = [[of_values(function) for function in part] for part in (phases, breaks)]
    found = refined(points, lambda theta: [theta], of_values(scalar), *parts, 0.0)
    assert found == sorted(found)
    assert all(value == scalar(theta) for theta, value in found)
    signs = [value > 0 for _, value in found if value]
    return sum(a != b for a, b in pairwise(signs)), len(found)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_all_roots_of_a_polynomial_of_low_degree_are_found(degree: int) -> None:
    rng = np.random.default_rng(degree)
    for _ in range(300):
        roots = rng.uniform(-0.3, 1.3, degree)
        coefficients = np.poly(roots)
        changes, samples = looked_at(lambda x, c=coefficients: float(np.polyval(c, x)))
        assert changes == np.sum((roots > 0) & (roots < 1))
        assert samples <= (9 if degree < 3 else 60)


def test_almost_all_roots_of_polynomials_of_the_degree_of_dense_output_are_found() -> None:
    rng = np.random.default_rng(0)
    missed = 0
    for _ in range(500):
        roots = rng.uniform(-0.3, 1.3, 7)
        coefficients = np.poly(roots)
        changes, _ = looked_at(lambda x, c=coefficients: float(np.polyval(c, x)))
        missed += changes != np.sum((roots > 0) & (roots < 1))
    assert missed <= 10


def test_a_smooth_scalar_far_from_zero_takes_no_further_samples() -> None:
    assert looked_at(lambda x: 2.0 + math.sin(x)) == (0, 5)
    assert looked_at(lambda x: x - 0.3) == (1, 5)
    assert looked_at(lambda x: 0.0) == (0, 5)


def test_a_scalar_that_touches_zero_takes_few_samples() -> None:
    changes, samples = looked_at(lambda x: (x - 0.3) ** 2 * (1 + x**3))
    assert changes == 0
    assert samples < 80


@pytest.mark.parametrize("depth", [1e-4, 1e-8, 1e-12])
def test_a_narrow_dip_is_found(depth: float) -> None:
    assert looked_at(lambda x: (x - 0.37) ** 2 - depth)[0] == 2
    assert looked_at(lambda x: math.cosh(x - 0.37) - 1 - depth)[0] == 2
    assert looked_at(lambda x: abs(x - 0.37) - depth, breaks=[lambda x: x - 0.37])[0] == 2


def test_periods_are_told_by_the_phase() -> None:
    assert looked_at(lambda x: math.sin(80 * x + 0.1), [lambda x: 80 * x + 0.1])[0] == 25
    assert looked_at(lambda x: math.sin(8 * math.pi * x + 1e-3), [lambda x: 8 * math.pi * x + 1e-3])[0] == 8
