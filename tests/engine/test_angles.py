"""The engine's cosine and sine against 120 binary digits of mpmath, and in lanes against single numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import mpmath
import numpy as np
import pytest

from mbdkit.engine.jit.bundle import PinnedBundle, bundle_loader
from mbdkit.engine.jit.decorators import kernel
from mbdkit.engine.jit.lane_arrays import new_lanes
from mbdkit.engine.jit.lane_width import WIDTH
from mbdkit.engine.kernels.angles import FAR, cosine_and_sine


class Angles(NamedTuple):
    x: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray


load_numbers = bundle_loader(lambda: Angles(*np.zeros((3, 1))))
load_lanes = bundle_loader(lambda: Angles(new_lanes(1), new_lanes(1), new_lanes(1)))


@kernel
def by_numbers(address):
    c = load_numbers(address)
    for i in range(len(c.x)):
        c.cosine[i], c.sine[i] = cosine_and_sine(c.x[i])


@kernel
def by_lanes(address):
    c = load_lanes(address)
    for i in range(len(c.x)):
        c.cosine[i], c.sine[i] = cosine_and_sine(c.x[i])


def evaluated(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bundle = Angles(np.ascontiguousarray(x), np.zeros(len(x)), np.zeros(len(x)))
    by_numbers(PinnedBundle(bundle).address)
    return bundle.cosine, bundle.sine


def drawn(scale: float, count: int = 2000) -> np.ndarray:
    """Return random angles up to `scale`; half of them near multiples of pi/2, where cosine or sine vanishes."""
    rng = np.random.default_rng(1)
    x = rng.uniform(-scale, scale, count)
    near = np.round(x[::2] / (np.pi / 2)) * (np.pi / 2)
    x[::2] = near + rng.uniform(-1, 1, len(near)) * 10.0 ** rng.uniform(-20, 0, len(near))
    return np.clip(x, -FAR, FAR)


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


def test_beyond_the_reduction_the_functions_of_the_c_library_are_used() -> None:
    x = np.array([FAR, -FAR, 1.23e7, -9.8e22, 1e300, 5e5, 2e5, 3e5])
    cosine, sine = evaluated(x)
    np.testing.assert_allclose(cosine, np.cos(x), rtol=1e-15)
    np.testing.assert_allclose(sine, np.sin(x), rtol=1e-15)


def test_angles_that_are_not_finite_have_no_cosine() -> None:
    for values in evaluated(np.array([np.inf, -np.inf, np.nan])):
        assert np.all(np.isnan(values))


def test_lanes_have_the_bits_of_numbers() -> None:
    # near and far angles side by side in one vector as well
    x = np.concatenate([drawn(scale, 256) for scale in (1e-6, 10.0, 1e3, FAR)] + [np.array([1e7, 0.3, -2e9, 1.0] * 64)])
    bundle = Angles(*(new_lanes(len(x) // WIDTH) for _ in range(3)))
    bundle.x[...] = x.reshape(-1, WIDTH)
    by_lanes(PinnedBundle(bundle).address)
    for found, expected in zip(bundle[1:], evaluated(x), strict=True):
        np.testing.assert_array_equal(np.asarray(found).ravel(), expected)
