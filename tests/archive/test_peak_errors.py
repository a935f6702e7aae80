"""Errors of the largest recorded values cover the peaks between rows."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.headlines import largest_loads
from mbdkit.archive.peak_errors import excess_between_rows, jumps


@pytest.mark.parametrize(("rows", "share"), [(4, 0.08), (6, 0.02), (10, 0.003)])
def test_the_peaks_of_random_sums_of_sines_are_covered(rows: int, share: float) -> None:
    """Three frequencies up to 1 Hz, in irregular rows, of which there are `rows` in a second."""
    random, missed, ratios = np.random.default_rng(7), 0, []
    frequencies = np.array([0.3, 0.6, 1.0])
    for _ in range(400):
        time = (np.arange(3 * rows) + random.uniform(-0.1, 0.1, 3 * rows)) / rows
        fine = np.linspace(time[0], time[-1], 10_001)
        size, phase = random.normal(size=3), random.uniform(0.0, 2.0 * math.pi, 3)
        curve, true = (np.sin(2.0 * math.pi * frequencies * t[:, None] + phase) @ size for t in (time, fine))
        excess, bar = np.max(true) - np.max(curve), excess_between_rows(time, curve[:, None])[0]
        missed += excess > bar + 1e-6
        ratios.append(bar / max(excess, 1e-9))
    assert missed <= share * 400
    assert np.median(ratios) < 2.2


def test_rows_at_equal_times_and_few_rows_are_no_peaks() -> None:
    time = np.array([0.0, 1.0, 1.0, 2.0])
    assert excess_between_rows(time, np.array([[0.0], [1.0], [1.0], [2.0]]))[0] == 0.0
    assert excess_between_rows(time[:2], np.array([[0.0], [1.0]]))[0] == 0.0


@pytest.mark.parametrize("step", [0.05, 0.11, 0.17])
def test_the_largest_force_of_a_pendulum_between_rows_is_covered(step: float) -> None:
    """A uniform rod that falls from the horizontal has the force 5/2 m g in its lowest position."""
    run = mbdkit.run("pendulum", time={"end": 2.0, "step": step}, check=True)
    largest = largest_loads(run)[0]
    true = 2.5 * 9.81
    assert abs(true - largest.value) <= largest.error < 0.1 * true


@pytest.mark.parametrize("jump", [0.71, 0.749, 0.7001])
def test_a_jump_between_rows_is_no_peak_but_the_curves_reach_it(jump: float) -> None:
    """exp(t) is continued to the jump from the rows before it; a spline through the jump would be far above."""
    time = np.arange(21) * 0.05
    size = np.where(time < jump, np.exp(time), 0.1)[:, None]
    bar = excess_between_rows(time, size, [jump])[0]
    true = math.exp(jump) - math.exp(0.7)
    assert true <= bar <= 2.2 * true + 1e-4
    assert excess_between_rows(time, size)[0] > 0.1


def test_forces_that_jump_at_impacts_have_small_errors() -> None:
    """The legs of the walker carry their weight by turns, so that the force of each jumps at every step of the walk."""
    run = mbdkit.run("walker")
    assert len(run.impacts.time) == 2
    size = np.linalg.norm(run.joints["left_leg"].reaction_force, axis=1)[:, None]
    assert excess_between_rows(run.time, size, jumps(run))[0] < 1e-4 * size.max()
