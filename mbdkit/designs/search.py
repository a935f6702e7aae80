"""Searches for the least cost of a problem, with the optimisers of SciPy and CMA-ES."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.optimize import NonlinearConstraint, OptimizeResult, differential_evolution, least_squares, minimize
from scipy.stats import qmc

from mbdkit.designs.problem import FEASIBLE, Problem
from mbdkit.errors import SpecError
from mbdkit.spec import DesignSpec
from mbdkit.spec.design_spec import EvolutionStrategy, GlobalOptimizer, LocalOptimizer, Optimizer


@dataclass(frozen=True)
class Search:
    """One search.

    Attributes
    ----------
    start, end
        First and last point (n,), as shares of the bounds.
    cost
        Goal at the end, relative to that at the start of the design.
    feasible
        Whether the end satisfies all limits.
    message
        Why the search ended, in the words of the package that made it.
    """

    start: np.ndarray
    end: np.ndarray
    cost: float
    feasible: bool
    message: str


def check_installed(spec: DesignSpec) -> None:
    """Raise SpecError if the optimiser of a design needs a package that is not installed."""
    if isinstance(spec.optimizer, EvolutionStrategy) and find_spec("cma") is None:
        message = "cma-es needs the package cma, which is not installed: pip install 'mbdkit[design]'"
        raise spec.placed(SpecError(message, key="optimizer.name"))


def searches(problem: Problem, optimizer: Optimizer, first: np.ndarray) -> list[Search]:
    """Return searches from all starts, the best one first: feasible ones by their cost, and then all others.

    Parameters
    ----------
    first
        (n,) first start.
    """
    if isinstance(optimizer, GlobalOptimizer):
        return [_evolution(problem, optimizer, first)]
    if isinstance(optimizer, EvolutionStrategy):
        return [_strategy(problem, optimizer, first)]
    search = _squares if problem.sums_squares else _descent
    found = [search(problem, optimizer, start) for start in _starts(optimizer, first)]
    return sorted(found, key=lambda one: (not one.feasible, one.cost))


def _starts(optimizer: LocalOptimizer, first: np.ndarray) -> list[np.ndarray]:
    """Return the first start, and points of a Sobol sequence, whose number is a power of two before it is cut."""
    more = optimizer.starts - 1
    if more < 1:
        return [first]
    sobol = qmc.Sobol(len(first), seed=optimizer.seed).random_base2(int(np.ceil(np.log2(more))))
    return [first, *sobol[:more]]


def _descent(problem: Problem, optimizer: LocalOptimizer, start: np.ndarray) -> Search:
    """Return a search along gradients."""
    n, is_slsqp = len(start), optimizer.name == "slsqp"
    options: dict[str, float] = {"maxiter": optimizer.max_iterations}
    if is_slsqp:
        limits: list[object] = [{"type": "ineq", "fun": problem.margins, "jac": problem.margin_slopes}]
        options |= {"ftol": optimizer.tolerance}
    else:
        limits = [NonlinearConstraint(problem.margins, 0.0, np.inf, jac=problem.margin_slopes)]
        options |= {"xtol": optimizer.tolerance, "gtol": optimizer.tolerance}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of trust-constr, where a goal or limit is linear
        result = minimize(
            problem.cost,
            start,
            jac=problem.slope,
            method=optimizer.name,
            bounds=[(0.0, 1.0)] * n,
            constraints=limits if problem.bounds else (),
            options=options,
        )
    return _search(problem, start, result)


def _squares(problem: Problem, optimizer: LocalOptimizer, start: np.ndarray) -> Search:
    """Return a search for the least sum of squares, by a trust region and the Jacobian of the terms."""
    tolerance = max(optimizer.tolerance, 2 * np.finfo(float).eps)  # SciPy accepts no smaller one
    result = least_squares(
        problem.residuals,
        start,
        problem.residual_slopes,
        bounds=(0.0, 1.0),
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
        max_nfev=optimizer.max_iterations,
    )
    return _search(problem, start, result)


def _evolution(problem: Problem, optimizer: GlobalOptimizer, first: np.ndarray) -> Search:
    """Return a search by differential evolution, whose generations are evaluated at once."""
    limits = NonlinearConstraint(lambda x: problem.all_margins(_points(x)).T, 0.0, np.inf)
    result = differential_evolution(
        lambda x: problem.costs(_points(x)),
        [(0.0, 1.0)] * len(first),
        x0=first,
        popsize=optimizer.population,
        maxiter=optimizer.max_iterations,
        tol=optimizer.tolerance,
        seed=optimizer.seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        constraints=(limits,) if problem.bounds else (),
    )
    return _search(problem, first, result)


def _strategy(problem: Problem, optimizer: EvolutionStrategy, first: np.ndarray) -> Search:
    """Return a search by CMA-ES, whose generations are evaluated at once.

    Points that violate limits are ranked by their violation, after all others (K. Deb, An efficient constraint handling
    method for genetic algorithms, Comput. Methods Appl. Mech. Eng. 186 (2000) 311-338).
    """
    import cma

    options: dict[str, Any] = {
        "bounds": [0.0, 1.0],
        "seed": optimizer.seed + 1,  # 0 would be the clock
        "maxiter": optimizer.max_iterations,
        "tolfunrel": optimizer.tolerance,
        "tolx": optimizer.tolerance,
        "tolfun": 0.0,
        "tolfunhist": 0.0,
        "verbose": -9,
        "verb_log": 0,  # no files
        "signals_filename": "",  # options from a file in the current folder
    }
    if optimizer.population is not None:
        options["popsize"] = optimizer.population
    strategy = cma.CMAEvolutionStrategy(first, optimizer.spread, options)
    best, least = first, _worth(problem, first[None])[0]
    while not strategy.stop():
        points = np.array(strategy.ask())
        worth = _worth(problem, points)
        beyond = 1.0 + max((cost for violation, cost in worth if not violation), default=0.0)
        strategy.tell(list(points), [beyond + violation if violation else cost for violation, cost in worth])
        place = worth.index(min(worth))
        if worth[place] < least:
            best, least = points[place], worth[place]
    ended = ", ".join(f"{name} {value:g}" for name, value in strategy.stop().items())
    return _search(problem, first, OptimizeResult(x=best, message=f"CMA-ES ended by {ended}"))


def _worth(problem: Problem, points: np.ndarray) -> list[tuple[float, float]]:
    """Return the violation of limits, 0 if there is none, and the cost of points (N, n); smaller ones are better."""
    costs = problem.costs(points)
    violation = np.sum(np.maximum(-problem.all_margins(points) - FEASIBLE, 0.0), axis=1)
    return list(zip(violation.tolist(), costs.tolist(), strict=True))


def _points(x: np.ndarray) -> np.ndarray:
    """Return points (N, n) from the array (n, N), or the single point (n,), of SciPy."""
    return np.atleast_2d(x.T)


def _search(problem: Problem, start: np.ndarray, result: OptimizeResult) -> Search:
    end: np.ndarray = np.clip(result.x, 0.0, 1.0)
    return Search(start, end, problem.cost(end), problem.is_feasible(end), str(result.message))
