"""The engine's cosine and sine against 120 binary digits of mpmath, and in lanes against single numbers."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest

import mbdkit
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.kernels.angles import FAR
from mbdkit.engine.kernels.observe import constraints_at
from tests.engine.drawn_angles import drawn

BODIES = 100


def evaluated(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cosine and sine of angles, as the kernels compute them for the bodies of a mechanism."""
    m = mbdkit.Mechanism()
    for i in range(BODIES):
        m.body(f"b{i}", mass=1.0, inertia=1.0)
    workspace, _ = workspace_at_start(m)
    scratch, found = workspace.scratch, np.zeros((2, len(x)))
    for first in range(0, len(x), BODIES):
        part = x[first : first + BODIES]
        q = np.zeros(3 * (BODIES + 1))
        q[2 : 3 * len(part) : 3] = part
        constraints_at(workspace.mechanism.topology, scratch, 0.0, q, np.zeros_like(q))
        found[:, first : first + len(part)] = scratch.cs[: len(part)].T
    return found[0], found[1]


def error(function: Any, x: float, value: float) -> float:
    """Return the error of a value in units of the last place."""
    with mpmath.workprec(160):
        exact = function(mpmath.mpf(x))
        return float(abs(mpmath.mpf(value) - exact)) / float(np.spacing(abs(float(exact))))


@pytest.mark.parametrize("scale", [1e-300, 1e-6, 1.0, 10.0, 1e3, FAR])
def test_the_error_is_below_one_unit_of_the_last_place(scale: float) -> None:
    # expected: mpmath with 160 binary digits
    x = drawn(scale)
    cosine, sine = evaluated(x)
    assert max(error(mpmath.cos, *pair) for pair in zip(x.tolist(), cosine.tolist(), strict=True)) < 1.0
    assert max(error(mpmath.sin, *pair) for pair in zip(x.tolist(), sine.tolist(), strict=True)) < 1.0


def test_larger_angles_are_reduced_as_exactly() -> None:
    # expected: mpmath with 160 binary digits, which reduces these angles itself
    x = np.array([FAR, -FAR, 1.23e7, -9.8e22, 1e300, 5e5, 2e5, 3e5])
    cosine, sine = evaluated(x)
    assert max(error(mpmath.cos, *pair) for pair in zip(x.tolist(), cosine.tolist(), strict=True)) < 1.0
    assert max(error(mpmath.sin, *pair) for pair in zip(x.tolist(), sine.tolist(), strict=True)) < 1.0


def test_angles_that_are_not_finite_have_no_cosine() -> None:
    for values in evaluated(np.array([np.inf, -np.inf, np.nan])):
        assert np.all(np.isnan(values))
