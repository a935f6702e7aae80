"""Filters and quantiles whose numbers are the same on every machine, against closed forms and mpmath."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from mbdkit_biomech.inverse_dynamics.signals.chi_square import LEVEL, quantile
from mbdkit_biomech.inverse_dynamics.signals.digital_filters import (
    butterworth_coefficients,
    filtered,
    filtered_both_ways,
    single_cutoff,
    state_after,
)


@pytest.mark.parametrize(("order", "cutoff"), [(1, 3.0), (2, 6.0), (3, 0.5), (4, 40.0)])
def test_the_gain_of_a_butterworth_filter(order: int, cutoff: float) -> None:
    b, a = butterworth_coefficients(order, cutoff, 100.0)
    frequency = np.linspace(0.5, 49.5, 99)
    z = np.exp(-2j * np.pi * frequency / 100.0)
    gain = np.abs(np.polyval(b[::-1], z) / np.polyval(a[::-1], z))
    ratio = np.tan(np.pi * frequency / 100.0) / np.tan(np.pi * cutoff / 100.0)
    np.testing.assert_allclose(gain, (1.0 + ratio ** (2 * order)) ** -0.5, rtol=1e-9, atol=1e-15)


def test_two_passes_halve_the_power_at_the_cutoff_and_shift_no_phase() -> None:
    time = np.arange(4000) / 100.0
    b, a = butterworth_coefficients(4, single_cutoff(8.0, 4), 100.0)
    wave = np.stack([np.cos(2 * np.pi * 8.0 * time), np.sin(2 * np.pi * 8.0 * time)], axis=1)
    middle = slice(1500, 2500)
    # Of the prototype; the bilinear transformation moves the frequency of 3 dB a little.
    once = 1.0 / (1.0 + (np.tan(0.08 * np.pi) / np.tan(np.pi * single_cutoff(8.0, 4) / 100.0)) ** 8)
    np.testing.assert_allclose(filtered_both_ways(b, a, wave, 50)[middle], once * wave[middle], atol=1e-12)
    assert once == pytest.approx(0.5**0.5, abs=0.01)


def test_straight_lines_pass_the_filter() -> None:
    b, a = butterworth_coefficients(2, 6.0, 100.0)
    line = np.arange(50.0)[:, None] * [1.0, -0.5] + 3.0
    np.testing.assert_allclose(filtered(b, a, np.ones((50, 1)), state_after(b, a, np.ones((2, 1)))), 1.0, rtol=1e-12)
    np.testing.assert_allclose(filtered_both_ways(b, a, line, 40)[20:30], line[20:30], rtol=1e-3)


@pytest.mark.parametrize("freedoms", [1.0, 1.001, 1.37, 1.9, 2.0])
def test_quantiles_of_chi_square(freedoms: float) -> None:
    with mpmath.workdps(30):
        reached = mpmath.gammainc(freedoms / 2, 0, mpmath.mpf(float(quantile(freedoms))) / 2, regularized=True)
        assert abs(float(reached - mpmath.mpf(str(LEVEL)))) < 1e-15
