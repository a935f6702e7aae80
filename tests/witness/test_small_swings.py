"""The double pendulum's natural frequencies, from tiny swings about the rest position."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import least_squares

from .running import gauss, run

#: 2.68011... and 7.18867... rad/s: w^2 = (g / L) (3 -+ 6 / sqrt(7)), the roots of 7/36 z^2 - 7/6 z + 3/4 = 0 for
#: z = w^2 L / g, of two uniform rods of L = 1 m with M = [[4/3, 1/2], [1/2, 1/3]] and K = g diag(3/2, 1/2).
SLOW, FAST = 2.68011401225338, 7.18867087028771
AMPLITUDE = 1e-6  #: rad; a frequency falls by a part of the order of its square, here some 1e-12


def shapes() -> Any:
    """Return both modes' (theta1, theta2), slow one first, as columns."""
    return eigh(np.diag([1.5, 0.5]) * 9.81, np.array([[4 / 3, 1 / 2], [1 / 2, 1 / 3]]))[1]


def swings(tilts: Any, end: float = 40.0) -> tuple[Any, Any]:
    """Return times and both rods' tilts from the vertical (T, 2) after a release from rest at `tilts` [rad]."""
    model = {"name": "double-pendulum", "angles": [-math.pi / 2 + tilt for tilt in tilts]}
    result = run(model, gauss(5), end=end, step=0.02)
    return np.asarray(result.time), np.column_stack([result[rod].angle for rod in ("rod1", "rod2")]) + math.pi / 2


def fitted(time: Any, tilt: Any, guesses: list[float]) -> Any:
    """Return the frequencies [rad/s] of the sum of undamped waves that is nearest to `tilt`, ascending."""

    def rest(frequencies: Any) -> Any:
        waves = np.column_stack([wave(w * time) for w in frequencies for wave in (np.cos, np.sin)])
        return tilt - waves @ np.linalg.lstsq(waves, tilt, rcond=None)[0]

    scale = np.abs(tilt).max()
    return least_squares(lambda w: rest(w) / scale, guesses, xtol=1e-15, ftol=1e-15, gtol=1e-15).x


def test_yardstick_frequencies_are_the_roots_of_the_characteristic_polynomial() -> None:
    # expected: the closed form, and the generalized eigenvalues of M and K
    closed = [math.sqrt(9.81 * (3 - 6 / math.sqrt(7))), math.sqrt(9.81 * (3 + 6 / math.sqrt(7)))]
    np.testing.assert_allclose([SLOW, FAST], closed, rtol=1e-14)
    M = np.array([[4 / 3, 1 / 2], [1 / 2, 1 / 3]])
    np.testing.assert_allclose(np.sqrt(eigh(9.81 * np.diag([1.5, 0.5]), M, eigvals_only=True)), closed, rtol=1e-14)


@pytest.mark.parametrize("mode", [0, 1], ids=["slow", "fast"])
def test_both_rods_swing_at_the_natural_frequency_of_the_mode_they_are_released_in(mode: int) -> None:
    # expected: the characteristic polynomial's root
    shape = shapes()[:, mode]
    time, tilts = swings(AMPLITUDE * shape / np.abs(shape).max())
    for tilt in tilts.T:
        assert fitted(time, tilt, [(2.7, 7.2)[mode]]) == pytest.approx((SLOW, FAST)[mode], rel=0, abs=5e-11)
    # and in the mode's own shape: the two tilts keep their ratio
    np.testing.assert_allclose(tilts[:, 0] * shape[1], tilts[:, 1] * shape[0], rtol=0, atol=1e-8 * AMPLITUDE)


def test_any_tiny_swing_is_made_of_the_two_natural_frequencies() -> None:
    # expected: the characteristic polynomial's roots
    time, tilts = swings([AMPLITUDE, -0.5 * AMPLITUDE])
    for tilt in tilts.T:
        np.testing.assert_allclose(fitted(time, tilt, [2.7, 7.2]), [SLOW, FAST], rtol=0, atol=5e-11)


@pytest.mark.parametrize("mode", [0, 1], ids=["slow", "fast"])
def test_frequencies_fall_with_the_square_of_the_amplitude(mode: int) -> None:
    # expected: the first correction of a symmetric well is of second order (Lindstedt), the next one of fourth
    shape = shapes()[:, mode] / np.abs(shapes()[:, mode]).max()
    shifts = []
    for amplitude in (1e-3, 2e-3):
        time, tilts = swings(amplitude * shape)
        shifts.append(fitted(time, tilts[:, 0], [(2.7, 7.2)[mode]])[0] - (SLOW, FAST)[mode])
    assert shifts[0] < 0
    assert shifts[1] / shifts[0] == pytest.approx(4.0, rel=1e-3)
