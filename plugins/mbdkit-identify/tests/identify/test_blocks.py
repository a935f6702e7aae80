"""Intervals contain true values, and those of pieces of a record agree, where residuals are coloured in other ways.

The noise is never the autoregressive one of order 1 that intervals assume: that of an encoder and a slow disturbance, a
moving average, rounding to steps, and one with heavy tails.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from mbdkit_identify.blocks import growth_by_blocks
from mbdkit_identify.estimation import best_fit, covariance_of
from mbdkit_identify.intervals import freedom_of, quantile

from .regressions import Regression

COUNT, PIECES, INTERVAL, LEVEL = 1200, 4, 0.02, 0.95
TIMES = INTERVAL * np.arange(COUNT)
TRUTH = np.array([1.3, 4.2, 0.06, 0.02, 0.3])
"""Amplitude, frequency, damping, offset and phase."""


def swing(t: np.ndarray, a: complex, w: complex, d: complex, offset: complex, phase: complex) -> np.ndarray:
    return a * np.exp(-d * t) * np.cos(w * t + phase) + offset


def disturbed(dice: np.random.Generator) -> np.ndarray:
    slow = dice.normal(0.0, 0.01 * np.sqrt(1.0 - 0.95**2), COUNT + 200)
    for k in range(1, len(slow)):
        slow[k] += 0.95 * slow[k - 1]
    return slow[200:] + dice.normal(0.0, 0.004, COUNT)


def averaged(dice: np.random.Generator) -> np.ndarray:
    return 0.01 / np.sqrt(15) * np.convolve(dice.normal(size=COUNT + 14), np.ones(15), "valid")


def rounded(dice: np.random.Generator) -> np.ndarray:
    clean, shift = swing(TIMES, *TRUTH), 0.02 * dice.random()
    return 0.02 * np.round((clean + shift) / 0.02) - shift - clean


def heavy(dice: np.random.Generator) -> np.ndarray:
    return dice.laplace(0.0, 0.01, COUNT)


KINDS = (disturbed, averaged, rounded, heavy)


def shares(kind: Callable[[np.random.Generator], np.ndarray], records: int, seed: int = 1) -> np.ndarray:
    """Return the shares of true values in intervals, and of successive pieces that agree, without and with blocks."""
    covers, agree = [], []
    for number in range(records):
        data = swing(TIMES, *TRUTH) + kind(np.random.default_rng([seed, number, *kind.__name__.encode()]))
        errors, halves = [], []
        for some in np.array_split(np.arange(COUNT), PIECES):
            begin = TIMES[some[0]]
            truth = TRUTH * [np.exp(-TRUTH[2] * begin), 1, 1, 1, 1] + [0, 0, 0, 0, TRUTH[1] * begin]
            problem = Regression(TIMES[some] - begin, data[some], swing, tuple(1.01 * truth), (), (), 0.0).problem
            problem.may_correlate = [True]
            fit = best_fit(problem, 1, 0, "linear")
            deviations = np.sqrt(np.diagonal(covariance_of(fit.jacobian, fit.free)))
            half = deviations * [quantile(LEVEL, freedom_of(problem, fit, unit)) for unit in np.eye(5)]
            errors.append(fit.x - truth)
            halves.append([half, half * growth_by_blocks(problem, fit, LEVEL)])
        covers.append(np.abs(errors)[:, None] <= halves)
        for (e1, h1), (e2, h2) in pairwise(zip(errors, np.array(halves), strict=True)):
            agree.append(np.abs(e1 - e2)[1:4] <= np.hypot(h1, h2)[:, 1:4])  # what pieces have in common
    return np.array([np.mean(np.concatenate(covers), axis=(0, 2)), np.mean(agree, axis=(0, 2))])


def test_blocks_widen_intervals_where_the_noise_is_not_the_one_that_is_assumed() -> None:
    (plain, grown), (apart, together) = shares(disturbed, 6)
    assert plain < 0.9 <= grown  # of 120 intervals
    assert apart < 0.9 <= together  # of 54 pairs


def test_blocks_do_not_widen_most_intervals_of_white_noise() -> None:
    dice, growths = np.random.default_rng(4), []
    for _ in range(40):
        columns = dice.normal(size=(3, 120))
        model = lambda x, *b, c=columns: sum(one * column for one, column in zip(b, c, strict=True))  # noqa: E731
        problem = Regression([*range(120)], dice.normal(size=120), model, (0.1, 0.1, 0.1), (), (), 0.0).problem
        growths.append(growth_by_blocks(problem, best_fit(problem, 1, 0, "linear"), LEVEL))
    assert np.mean(np.array(growths) > 1.0) < 0.15  # two tests with a probability of 5 % each


def test_the_deviation_of_a_mean_follows_from_the_means_of_its_blocks() -> None:
    # of 7 equal blocks: the spread of their means, with 6 degrees of freedom
    data = np.repeat(np.random.default_rng(1).normal(size=7), 20) + np.random.default_rng(2).normal(0.0, 0.01, 140)
    problem = Regression([*range(140)], data, lambda x, b: b + 0.0 * x, (0.5,), (), (), 0.0).problem
    fit = best_fit(problem, 1, 0, "linear")
    half = quantile(LEVEL, 6) * np.std(data.reshape(7, 20).mean(axis=1), ddof=1) / np.sqrt(7)
    usual = quantile(LEVEL, 139) * np.std(data, ddof=1) / np.sqrt(140)
    assert growth_by_blocks(problem, fit, LEVEL)[0] == pytest.approx(half / usual, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_of_pieces_agree_for_noise_of_all_kinds(kind: Callable[[np.random.Generator], np.ndarray]) -> None:
    (_, grown), (_, together) = shares(kind, 50, seed=3)
    assert grown >= 0.92
    assert together >= 0.92
