"""How often intervals of estimates contain the true values: ``python -m tests.identify.coverage``.

Each case of `synthetic_cases` is simulated with its true parameters. Each repeat adds noise, white or autoregressive
with a correlation of 0.7 from sample to sample, and estimates all unknowns and the noise from wrong starts. Widths are
relative to the bound of Cramer and Rao with all nuisance parameters, from the derivatives at the truth and the true
noise.

A fit of a model takes 0.2 to 4 s. With ``--interpolated``, a polynomial in all unknowns replaces the model near the
truth, so that a fit takes about 0.02 s; its largest error is printed. Searches then begin 3 standard deviations from
the truth.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, dataclass
from functools import cache, partial
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np
from scipy.stats import norm

import mbdkit
from mbdkit.plugin.equations import one_thread_of_linear_algebra
from mbdkit_identify.estimation import best_fit, covariance_of
from mbdkit_identify.identify import _Identification
from mbdkit_identify.intervals import freedom_of, profile_of, quantile
from mbdkit_identify.loading import load_identify_spec
from mbdkit_identify.noise import Noise
from mbdkit_identify.problem import Problem

from .synthetic_cases import SyntheticCase, synthetic_cases

CORRELATIONS = {"white": 0.0, "ar": 0.7}
LEVEL = 0.95
DEGREE = 4
"""Degree of the polynomials that replace models."""
REACH = 5.5
"""Distance from the truth up to which polynomials are used, in standard deviations of the best estimates."""
AWAY = 3.0
"""Distance of the starts of searches with polynomials."""


@dataclass(frozen=True)
class Campaign:
    """Repeats of one experiment: names of a case and of its noise, method of the intervals, polynomials, seed."""

    case: str
    noise: str
    method: str = "linear"
    is_interpolated: bool = True
    seed: int = 1


@dataclass(frozen=True)
class Coverage:
    """Results of N repeats for K parameters.

    Attributes
    ----------
    names
        Names of the parameters.
    covers
        (N, K) whether intervals contain the true values.
    widths, errors
        (N, K) widths of the intervals, and errors of the estimates, relative to those of the Cramer-Rao bound.
    seconds
        (N,) processor times [s].
    """

    names: tuple[str, ...]
    covers: np.ndarray
    widths: np.ndarray
    errors: np.ndarray
    seconds: np.ndarray


class Repeats:
    """The repeats of a campaign.

    Attributes
    ----------
    truth
        (n,) true values of the unknowns, of which the parameters come first.
    bound
        (n, n) Cramer-Rao bound of the covariance of their estimates.
    """

    def __init__(self, campaign: Campaign):
        self.campaign, case = campaign, synthetic_cases()[campaign.case]
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "record.csv"
            _write(case, file)
            self.stages = _Identification(load_identify_spec(case.spec(str(file), campaign.method)), lambda _: None)
        problem = self.stages.problem
        with mbdkit.open(case.base) as simulation:
            self.truth = np.array([
                simulation.read([one.name.split(": ")[1]])[0] if one.is_initial else case.truth[one.name]
                for one in problem.unknowns
            ])  # fmt: skip
        self.noises = [Noise(one, CORRELATIONS[campaign.noise]) for one in case.deviations.values()]
        problem.noises = list(self.noises)
        self.bound = covariance_of(problem.jacobian(self.truth), np.ones(len(self.truth), dtype=bool))
        if campaign.is_interpolated:
            problem = self.stages.problem = InterpolatedProblem(problem, self.truth, self.bound)
        self.problem, self.clean = problem, problem.predicted(self.truth)

    def one(self, number: int) -> tuple[np.ndarray, float]:
        """Return estimates, lower and upper limits (3, K) of one repeat, and its processor time [s]."""
        dice = np.random.default_rng([self.campaign.seed, number, *self.campaign.case.encode()])
        measured = self.clean.copy()
        for piece, noise in zip(self.problem.pieces, self.noises, strict=True):
            drawn = dice.normal(size=len(piece.places))
            drawn[1:] *= np.sqrt(1.0 - noise.correlation**2)
            for k in range(1, len(drawn)):
                drawn[k] += noise.correlation * drawn[k - 1]
            measured[piece.places] += noise.deviation * drawn
        self.problem.measure(measured)
        begin = time.process_time()
        fit = self.stages.fit = best_fit(self.problem, 1, 0, "linear")
        covariance = covariance_of(fit.jacobian, fit.free)
        found = []
        for goal in self.stages.goals():
            value, slope = goal.value(fit.x), goal.slope(fit.x)
            if self.campaign.method == "linear":
                half = quantile(LEVEL, freedom_of(self.problem, fit, slope)) * np.sqrt(slope @ covariance @ slope)
                found.append((value, value - half, value + half))
            else:
                found.append((value, *profile_of(self.problem, fit, goal, covariance, LEVEL)[:2]))
        return np.array(found).T, time.process_time() - begin

    def coverage(self, numbers: range) -> Coverage:
        """Return the results of some repeats."""
        with one_thread_of_linear_algebra():
            found, seconds = zip(*map(self.one, numbers), strict=True)
        values, lower, upper = np.moveaxis(np.array(found), 1, 0)
        names = tuple(self.stages.names)
        truth, deviations = self.truth[: len(names)], np.sqrt(np.diagonal(self.bound))[: len(names)]
        widths = (upper - lower) / (2.0 * norm.ppf(0.5 * (1.0 + LEVEL)) * deviations)
        covers = (lower <= truth) & (truth <= upper)
        return Coverage(names, covers, widths, (values - truth) / deviations, np.array(seconds))


def _write(case: SyntheticCase, file: Path) -> None:
    """Write the file of an experiment without noise."""
    section = case.base["time"]
    times = section["step"] * np.arange(round(section["end"] / section["step"]) + 1)
    values = mbdkit.sensitivities(case.base, list(case.deviations), times, [*case.base["parameters"]][:1]).values
    for row, quantity in enumerate(case.deviations):
        if (sensor := case.sensors.get(quantity)) is not None:
            values[row] = sensor["gain"] * values[row] + case.truth[sensor["offset"]]
    headings = ",".join(["time", *map(str, range(len(values)))])
    np.savetxt(file, np.column_stack([times, *values]), delimiter=",", header=headings, comments="")


class InterpolatedProblem(Problem):
    """A problem whose model is replaced by a polynomial near a point, and whose start is near this point.

    The polynomial is fitted to predictions and their derivatives at random points.

    Attributes
    ----------
    error
        Largest error at 10 other random points, in standard deviations of the noise.
    """

    def __init__(self, problem: Problem, center: np.ndarray, covariance: np.ndarray):
        self.__dict__ |= problem.__dict__
        count = len(center)
        self.center, self.factor = center, REACH * np.linalg.cholesky(covariance)
        terms = combinations_with_replacement(range(count + 1), DEGREE)
        self.powers = np.array([np.bincount(some, minlength=count + 1)[1:] for some in terms])
        dice = np.random.default_rng(0)
        rows, values = [], []
        for point in _in_ball(dice, 2 * len(self.powers) // (count + 1) + 4, count):
            x = center + self.factor @ point
            slopes = super().slopes(x) @ self.factor  # before the predictions, which it evaluates too
            rows += [self._terms(point), *self._slopes_of_terms(point)]
            values += [super().predicted(x), *slopes.T]
        self.coefficients = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0]
        deviations = np.concatenate([
            np.full(len(one.places), noise.deviation) for one, noise in zip(self.pieces, self.noises, strict=True)
        ])  # fmt: skip
        self.error = 0.0
        for x in center + _in_ball(dice, 10, count) @ self.factor.T:
            super().slopes(x)
            wrong = np.abs(self.predicted(x) - super().predicted(x)) / deviations
            self.error = max(self.error, float(np.max(wrong)))
        self.first = center + self.factor @ np.full(count, AWAY / REACH / np.sqrt(count))

    def _terms(self, u: np.ndarray) -> np.ndarray:
        return np.asarray(np.prod(u**self.powers, axis=1))

    def _slopes_of_terms(self, u: np.ndarray) -> np.ndarray:
        lower = np.maximum(self.powers - np.eye(len(u), dtype=int)[:, None], 0)
        return np.asarray(self.powers.T * np.prod(u**lower, axis=2))

    def predicted(self, x: np.ndarray) -> np.ndarray:
        u = np.linalg.solve(self.factor, x - self.center)
        return np.asarray(self._terms(u) @ self.coefficients) if u @ u < 1.0 else super().predicted(x)

    def slopes(self, x: np.ndarray) -> np.ndarray:
        u = np.linalg.solve(self.factor, x - self.center)
        if u @ u >= 1.0:
            return super().slopes(x)
        return np.asarray(np.linalg.solve(self.factor.T, self._slopes_of_terms(u) @ self.coefficients).T)


def _in_ball(dice: np.random.Generator, number: int, count: int) -> np.ndarray:
    """Return points (number, count) with uniform density in the unit ball."""
    found = dice.normal(size=(number, count))
    return np.asarray(found * (dice.uniform(size=(number, 1)) ** (1 / count) / np.linalg.norm(found, axis=1)[:, None]))


@cache
def _repeats(campaign: Campaign) -> Repeats:
    with one_thread_of_linear_algebra():
        return Repeats(campaign)


def coverage(campaign: Campaign, numbers: range) -> Coverage:
    """Return the results of some repeats of a campaign."""
    return _repeats(campaign).coverage(numbers)


def main() -> None:
    """Print coverage, mean widths, biases and spreads of the estimates."""
    parser = argparse.ArgumentParser(prog="python -m tests.identify.coverage")
    parser.add_argument("--case", nargs="+", choices=synthetic_cases(), default=[*synthetic_cases()])
    parser.add_argument("--noise", nargs="+", choices=CORRELATIONS, default=[*CORRELATIONS])
    parser.add_argument("--method", choices=("linear", "profile"), default="linear")
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--interpolated", action="store_true", help="replace models by polynomials near the truth")
    asked = parser.parse_args()
    parts = [range(k, asked.repeats, asked.jobs) for k in range(asked.jobs)]
    with ProcessPoolExecutor(asked.jobs) as pool:
        for campaign in (
            Campaign(case, noise, asked.method, asked.interpolated, asked.seed)
            for case in asked.case for noise in asked.noise
        ):  # fmt: skip
            found = list((pool.map if asked.jobs > 1 else map)(partial(coverage, campaign), parts))
            covers, widths, errors, seconds = (
                np.concatenate(some) for some in zip(*(astuple(one)[1:] for one in found), strict=True)
            )
            print(
                f"{campaign.case}, {campaign.noise}, {campaign.method}: {asked.repeats} repeats, "
                f"{np.mean(seconds):.3f} s each"
            )
            if asked.jobs == 1 and isinstance(problem := _repeats(campaign).problem, InterpolatedProblem):
                print(f"  error of the polynomials {problem.error:.1e} standard deviations of the noise")
            for k, name in enumerate(found[0].names):
                print(
                    f"  {name}: covered {np.mean(covers[:, k]):.1%}, width {np.mean(widths[:, k]):.3f},"
                    f" bias {np.mean(errors[:, k]):+.3f}, spread {np.std(errors[:, k]):.3f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
