"""Limits of profiles beside those of lmfit and pyPESTO: the same residuals, white noise, equal thresholds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_identify.estimation import Fit, best_fit, covariance_of
from mbdkit_identify.intervals import Goal, _ProfileSearch, profile_of, quantile
from mbdkit_identify.loading import load_identify_spec
from mbdkit_identify.measured_data import read_experiment
from mbdkit_identify.problem import Problem
from mbdkit_identify.segments import segments_of
from tests.margins import assert_within

from .other_profiles import lmfit_limits, pypesto_limits
from .regressions import MISRA1A, PUROMYCIN, THURBER, Regression

LEVELS = (0.6827, 0.95, 0.9973)
WIDTH = 0.01
"""Largest difference of a limit, as a share of the width of the interval."""

PENDULUM: dict[str, Any] = {
    "mbdkit": 1,
    "parameters": {"J": 0.08, "c": 0.3, "k": 2.0},
    "model": {
        "name": "mechanism",
        "bodies": {
            "a": {"mass": 1.0, "inertia": "J", "position": [0.5, 0]},
            "b": {"mass": 0.8, "inertia": 0.07, "position": [1.5, 0]},
        },
        "joints": {
            "hub": {"type": "revolute", "bodies": ["ground", "a"], "at": [0, 0]},
            "elbow": {"type": "revolute", "bodies": ["a", "b"], "at": [1, 0]},
        },
        "forces": {
            "hub": {"type": "torsion-spring", "bodies": ["ground", "a"], "stiffness": "k", "damping": 0.2},
            "elbow": {"type": "torsion-spring", "bodies": ["a", "b"], "stiffness": 0.0, "damping": "c"},
        },
    },
    "integrator": {"name": "rk4"},
    "time": {"end": 2.0, "step": 0.01},
}
CRANK: dict[str, Any] = {
    "mbdkit": 1,
    "parameters": {"J": 0.02, "c": 0.05, "m": 0.5},
    "model": {
        "name": "mechanism",
        "bodies": {
            "crank": {"mass": 0.4, "inertia": "J", "position": [0.1, 0], "angular_velocity": 12.0},
            "rod": {"mass": 0.3, "inertia": 0.01, "position": [0.45, 0]},
            "slider": {"mass": "m", "inertia": 0.001, "position": [0.7, 0]},
        },
        "joints": {
            "hub": {"type": "revolute", "bodies": ["ground", "crank"], "at": [0, 0]},
            "pin": {"type": "revolute", "bodies": ["crank", "rod"], "at": [0.2, 0]},
            "wrist": {"type": "revolute", "bodies": ["rod", "slider"], "at": [0.7, 0]},
            "guide": {"type": "prismatic", "bodies": ["ground", "slider"], "at": [0, 0], "axis": [1, 0]},
        },
        "forces": {
            "brake": {"type": "torsion-spring", "bodies": ["ground", "crank"], "stiffness": 0.0, "damping": "c"},
        },
    },
    "integrator": {"name": "gauss", "stages": 2},
    "time": {"end": 1.0, "step": 0.01},
}
MECHANISMS = {"pendulum": (PENDULUM, ("a.angle", "b.angle"), 0.1, 0.02), "crank": (CRANK, ("crank.angle",), 0.02, 0.01)}
"""Base, measured quantities, deviation of the noise, and sampling interval [s]."""
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in MECHANISMS]
"""Mechanisms, of which the other packages need thousands of runs."""
REGRESSIONS = {"Misra1a": MISRA1A, "Puromycin": PUROMYCIN, "Thurber": THURBER}


def problem_of(name: str, folder: Path) -> Problem:
    """Return a regression, or a mechanism with noise in synthetic data."""
    if name in REGRESSIONS:
        return REGRESSIONS[name].problem
    base, observed, deviation, interval = MECHANISMS[name]
    time = np.arange(0.0, base["time"]["end"] + 1e-9, interval)
    values = mbdkit.sensitivities(base, list(observed), time, ["J"]).values
    values = values + np.random.default_rng(7).normal(0.0, deviation, values.shape)
    columns = [f"y{k}" for k in range(len(observed))]
    table = np.column_stack([time, *values])
    np.savetxt(folder / "data.csv", table, delimiter=",", header=",".join(["time", *columns]), comments="")
    spec = load_identify_spec({
        "mbdkit_identify": 1,
        "base": base,
        "experiments": {
            "run": {
                "file": str(folder / "data.csv"),
                "observed": {
                    quantity: {"column": column, "correlation": "none"}
                    for quantity, column in zip(observed, columns, strict=True)
                },
            }
        },
        "parameters": {name: {"start": 1.1 * value} for name, value in base["parameters"].items()},
    })  # fmt: skip
    return Problem(*segments_of(spec, [read_experiment(spec, "run")]))


def our_limits(problem: Problem, fit: Fit, place: int, *, is_linear: bool = False) -> np.ndarray:
    """Return the limits (L, 2) at all levels; if `is_linear`, the search begins with derivatives at the best fit."""
    direction, covariance = np.eye(len(fit.x))[place], covariance_of(fit.jacobian, fit.free)
    goal = Goal("", lambda x: float(x[place]), lambda x: direction)
    found = (profile_of(problem, fit, goal, covariance, level, is_linear=is_linear) for level in LEVELS)
    return np.array([one[:2] for one in found])


def assert_equal(ours: np.ndarray, others: np.ndarray) -> None:
    assert_within((ours - others) / np.diff(others, axis=1), WIDTH)


@pytest.mark.parametrize("regression", REGRESSIONS.values(), ids=REGRESSIONS)
def test_estimates_and_deviations_are_the_published_ones(regression: Regression) -> None:
    problem = regression.problem
    fit = best_fit(problem, 1, 0, "linear")
    np.testing.assert_allclose(fit.x, regression.estimates, rtol=1e-4)  # margin: digits of the publication
    deviations = np.sqrt(np.diagonal(covariance_of(fit.jacobian, fit.free)))
    np.testing.assert_allclose(deviations, regression.errors, rtol=2e-4)
    # margin: digits of the publication
    assert fit.cost * problem.noises[0].deviation ** 2 == pytest.approx(regression.squares, rel=5e-4)


@pytest.mark.parametrize("name", ["Misra1a", "Puromycin", "Thurber", *SLOW])
def test_limits_are_those_of_lmfit(name: str, tmp_path: Path) -> None:
    pytest.importorskip("lmfit")
    problem = problem_of(name, tmp_path)
    fit = best_fit(problem, 1, 0, "linear")
    # a fit of lmfit with a fixed b6 of Thurber ends in another minimum
    places = [place for place in range(len(fit.x)) if (name, place) != ("Thurber", 5)]
    for place, others in zip(places, lmfit_limits(problem, fit, places, LEVELS), strict=True):
        assert_equal(our_limits(problem, fit, place), others)
        assert_equal(our_limits(problem, fit, place, is_linear=True), others)


def test_profiles_that_begin_with_derivatives_at_the_best_fit_need_few_others(tmp_path: Path) -> None:
    problem = problem_of("pendulum", tmp_path)
    fit, counts = best_fit(problem, 1, 0, "linear"), []
    for is_linear in (False, True):
        before = problem.derived
        our_limits(problem, fit, 0, is_linear=is_linear)
        counts.append(problem.derived - before)
    assert counts[1] <= 2 * len(LEVELS) + 1 < counts[0]  # one for each limit, which is confirmed


def test_a_search_that_ends_where_the_sum_is_discontinuous_confirms_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    # with derivatives elsewhere, the sum may be smaller, and the limit far away
    problem = MISRA1A.problem
    fit = best_fit(problem, 1, 0, "linear")
    direction, covariance = np.eye(2)[0], covariance_of(fit.jacobian, fit.free)
    search = _ProfileSearch(problem, fit, Goal("", lambda x: float(x[0]), lambda x: direction), covariance, 0.95)
    end = fit.x[0] + 0.7 * search.deviation
    monkeypatch.setattr(search, "_constrained", lambda value, x, *_: (fit.cost + (1e4 if value > end else 0.0), x))
    assert search.limit(1.0)[0] == pytest.approx(end, rel=1e-5)
    assert not search.is_confirmed()


@pytest.mark.parametrize("name", ["Misra1a", "Puromycin", *SLOW])
def test_limits_are_those_of_pypesto(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pypesto")
    problem = problem_of(name, tmp_path)
    fit = best_fit(problem, 1, 0, "linear")
    freedom, places = len(problem.measured) - len(fit.x), range(len(fit.x))
    found = pypesto_limits(problem, fit, places, LEVELS, lambda level: quantile(level, freedom) ** 2)
    for place, others in zip(places, found, strict=True):
        assert_equal(our_limits(problem, fit, place), others)
