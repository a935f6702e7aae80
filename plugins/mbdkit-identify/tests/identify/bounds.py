"""How often intervals contain true values at or near a bound: ``python -m tests.identify.bounds``.

An oscillation decays by damping and by friction, which is not negative, so that both are strongly correlated. In each
repeat, the true friction is at its bound or 0.5, 1 or 2 standard deviations away from it. With robust losses, one of
twenty values has a noise that is ten times as large. For the estimates that are passed on with a covariance, the value
that the model predicts later is compared with its band of 95 %; ``wrong`` is the share of all repeats in which a
covariance is passed on whose band misses the true value.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mbdkit_identify.estimation import best_fit, covariance_of, factors
from mbdkit_identify.intervals import Goal, interval_of
from mbdkit_identify.posterior import posterior
from mbdkit_identify.problem import Problem

from .regressions import Regression

LOSSES = ("linear", "soft_l1", "huber", "cauchy", "arctan")
DISTANCES = (0.0, 0.5, 1.0, 2.0)
"""Distances of the true friction from its bound, in standard deviations of its estimate without bound."""
TRUTH = np.array([1.4, 5.0, 0.30])
"""Amplitude, frequency and damping."""
TIMES, LATER, NOISE, LEVEL = np.linspace(0.0, 4.0, 101), 5.0, 0.03, 0.95
NAMES = ("amplitude", "frequency", "damping", "friction")


def oscillation(t: np.ndarray, amplitude: float, frequency: float, damping: float, friction: float) -> np.ndarray:
    """Return an oscillation whose amplitude decays exponentially and linearly; parameters may be complex."""
    return (amplitude * np.exp(-damping * t) - friction * t) * np.cos(frequency * t)


@dataclass(frozen=True)
class Repeat:
    """Whether the interval of each parameter contains its true value, whether a covariance is passed on, and whether
    the band that follows from it contains the true value.
    """

    distance: float
    covers: tuple[bool, ...]
    is_passed: bool
    is_right: bool


def repeat(loss: str, method: str, number: int) -> Repeat:
    """Return the result of one repeat."""
    dice = np.random.default_rng([LOSSES.index(loss), number])
    distance = DISTANCES[number % len(DISTANCES)]
    clean = Regression([*TIMES], [0.0] * len(TIMES), oscillation, (*TRUTH, 0.05), (), (), 0.0)
    deviation = NOISE * np.sqrt(covariance_of(clean.problem.slopes(np.array([*TRUTH, 0.0])), np.ones(4, bool))[3, 3])
    truth = np.array([*TRUTH, distance * deviation])
    noise = dice.normal(0.0, NOISE, len(TIMES))
    if loss != "linear":
        noise *= np.where(dice.random(len(TIMES)) < 0.05, 10.0, 1.0)
    free = replace(clean, y=[*(oscillation(TIMES, *truth) + noise)]).problem
    free.unknowns[3].low, free.unknowns[3].size = 0.0, deviation
    problem = Problem(free.unknowns, free.names, free.segments)
    fit = best_fit(problem, 1, 0, loss)
    covariance = factors(fit)[0] * covariance_of(fit.jacobian, np.ones(4, dtype=bool))
    covers, why = [], ""
    for place, direction in enumerate(np.eye(4)):
        low = 0.0 if place == 3 else -np.inf
        goal = Goal(NAMES[place], lambda x, k=place: float(x[k]), lambda x, d=direction: d, low)
        one = interval_of(problem, fit, goal, covariance, LEVEL, is_linear=method == "linear")
        covers.append(bool(one.lower <= truth[place] <= one.upper))
        why += one.why
    mean = fit.x
    if why and loss == "linear":
        mean, covariance = posterior(problem, fit, np.ones(4, dtype=bool), number) or (mean, covariance)
        why = "" if mean is not fit.x else why
    columns = np.linalg.cholesky(covariance).T
    changes = [oscillation(LATER, *(mean + one)) - oscillation(LATER, *(mean - one)) for one in columns]
    error = abs(oscillation(LATER, *mean) - oscillation(LATER, *truth))
    return Repeat(distance, tuple(covers), not why, bool(error <= 1.96 * np.linalg.norm(changes) / 2.0))


def repeats(loss: str, method: str, count: int, workers: int = 1) -> list[Repeat]:
    """Return the results of repeats with one loss."""
    one = partial(repeat, loss, method)
    if workers == 1:
        return [one(number) for number in range(count)]
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(one, range(count), chunksize=20))


def shares(some: Sequence[Repeat]) -> list[float]:
    """Return the coverage of each parameter, the share of covariances passed on, and the share of wrong ones."""
    covers = np.mean([one.covers for one in some], axis=0).tolist()
    return [*covers, np.mean([one.is_passed for one in some]), np.mean([one.is_passed > one.is_right for one in some])]


def main() -> None:
    """Print the coverage for each loss and distance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=1000)
    parser.add_argument("--losses", nargs="*", default=LOSSES)
    parser.add_argument("--method", default="profile", choices=("profile", "linear"))
    parser.add_argument("--workers", type=int, default=1)
    asked = parser.parse_args()
    print(f"{'loss':8} {'distance':>8} " + " ".join(f"{name:>9}" for name in (*NAMES, "passed on", "wrong")))
    for loss in asked.losses:
        done = repeats(loss, asked.method, asked.repeats, asked.workers)
        for distance in (*DISTANCES, None):
            some = [one for one in done if distance in (None, one.distance)]
            label = "all" if distance is None else f"{distance:g}"
            print(f"{loss:8} {label:>8} " + " ".join(f"{100 * one:8.1f}%" for one in shares(some)), flush=True)


if __name__ == "__main__":
    main()
