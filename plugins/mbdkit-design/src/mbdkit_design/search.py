"""Searches for the minimum cost of a problem, with the optimisers of SciPy and CMA-ES."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec

import numpy as np
from scipy.optimize import NonlinearConstraint, OptimizeResult, differential_evolution, least_squares, minimize
from scipy.stats import qmc

from mbdkit.base.errors import SpecError
from mbdkit_design.bundle_search import STUCK, beyond_kink, bundle_search
from mbdkit_design.design_spec import DesignSpec, EvolutionStrategy, GlobalOptimizer, LocalOptimizer, Optimizer
from mbdkit_design.problem import Problem

#: What the messages of optimisers have in common that ended at their largest number of iterations.
_RAN_OUT = re.compile(r"limit of iterations|iteration limit|maximum number|maxiter", re.IGNORECASE)


@dataclass(frozen=True)
class Search:
    """One search.

    Attributes
    ----------
    start, end
        First and last point (n,), as shares of the bounds.
    violation
        Relative violation of limits at the end; 0 if all limits are satisfied.
    cost
        Goal at the end, relative to that at the start of the design.
    message
        Reason why the search ended, as reported by the optimiser.
    is_least
        Whether the derivatives at several points near the end show that it is a local minimum, even if the goal or a
        limit has a kink there.
    is_converged
        Whether the optimiser ended because it converged, not because of the largest number of iterations.
    """

    start: np.ndarray
    end: np.ndarray
    violation: float
    cost: float
    message: str
    is_least: bool = False
    is_converged: bool = True

    @property
    def feasible(self) -> bool:
        """Whether the end satisfies all limits."""
        return self.violation == 0.0


def check_installed(spec: DesignSpec) -> None:
    """Raise SpecError if the optimiser of a design needs a package that is not installed."""
    if isinstance(spec.optimizer, EvolutionStrategy) and find_spec("cma") is None:
        message = "cma-es needs the package cma, which is not installed: pip install 'mbdkit[design]'"
        raise spec.placed(SpecError(message, key="optimizer.name"))


def searches(problem: Problem, optimizer: Optimizer, first: np.ndarray) -> list[Search]:
    """Return the searches from all starts, sorted: feasible ones by cost, then the others by violation.

    Parameters
    ----------
    first
        (n,) first start.
    """
    if isinstance(optimizer, GlobalOptimizer):
        return [_search(problem, first, lambda: _evolution(problem, optimizer, first))]
    if isinstance(optimizer, EvolutionStrategy):
        return [_search(problem, first, lambda: _strategy(problem, optimizer, first))]
    method = _squares if problem.sums_squares else _descent
    starts = [first, *(_straightened(problem, start) for start in _starts(optimizer, first)[1:])]
    found = [_search(problem, start, partial(method, problem, optimizer, start)) for start in starts]
    return sorted(found, key=lambda one: (one.violation, one.cost))


def advice(message: str) -> str:
    """Return a sentence that says what to do after a search that ended with this message without converging."""
    others = "try several `starts` or another optimizer."
    if _RAN_OUT.search(message):
        return f"Raise `optimizer.max_iterations`, or {others}"
    if STUCK in message:
        return (
            f"Goals and limits do not change as their derivatives promise there: make the runs more accurate, replace "
            f"goals and limits that jump, or {others}"
        )
    return f"More iterations do not help: {others}"


def _starts(optimizer: LocalOptimizer, first: np.ndarray) -> list[np.ndarray]:
    """Return the first start, and points of a Sobol sequence, generated for a power of two and then truncated."""
    more = optimizer.starts - 1
    if more < 1:
        return [first]
    sobol = qmc.Sobol(len(first), seed=optimizer.seed).random_base2(int(np.ceil(np.log2(more))))
    return [first, *sobol[:more]]


def _straightened(problem: Problem, start: np.ndarray) -> np.ndarray:
    """Return a start (n,) with straight tables, whose neighbouring values would otherwise differ at random."""
    names, start = [*problem.evaluator.spec.chosen], start.copy()
    for table in problem.evaluator.spec.tables.values():
        places = [names.index(key) for key in table.keys]
        start[places] = np.linspace(start[places[0]], start[places[-1]], len(places))
    return start


def _search(problem: Problem, start: np.ndarray, method: Callable[[], OptimizeResult]) -> Search:
    """Return the search by a method from one start.

    If the method ends at a point worse than the start, such as a point at which a run fails, the end of the search is
    the best point that was evaluated during the search.
    """
    before = len(problem.evaluator.evaluated)
    result = method()
    end, message, is_least = np.clip(result.x, 0.0, 1.0), str(result.message), result.get("is_least", False)
    worth, at_start = problem.worth(np.array([end, start]))
    if worth > at_start:
        points = np.array([start, *problem.evaluator.evaluated[before:]])
        found = problem.worth(points)
        worth = min(found)
        end = points[found.index(worth)]
        message, is_least = f"{message.rstrip('.')}; its last point is worse than this one", False
    return Search(start, end, *worth, message, is_least, bool(result.get("success", True)))


def _descent(problem: Problem, optimizer: LocalOptimizer, start: np.ndarray) -> OptimizeResult:
    """Return the result of the bundle method, or of a search along gradients that is continued if it ends at a kink."""
    if optimizer.name == "bundle":
        return bundle_search(problem, start, tolerance=optimizer.tolerance, most=optimizer.max_iterations)
    n, is_slsqp = len(start), optimizer.name == "slsqp"
    options: dict[str, float] = {"maxiter": optimizer.max_iterations}
    if is_slsqp:
        limits: list[object] = [{"type": "ineq", "fun": problem.margins, "jac": problem.margin_slopes}]
        options |= {"ftol": optimizer.tolerance}
    else:
        limits = [NonlinearConstraint(problem.margins, 0.0, np.inf, jac=problem.margin_slopes)]
        options |= {"xtol": optimizer.tolerance, "gtol": optimizer.tolerance}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # trust-constr issues warnings if a goal or limit is linear
        ended = minimize(
            problem.cost,
            start,
            jac=problem.slope,
            method=optimizer.name,
            bounds=[(0.0, 1.0)] * n,
            constraints=limits if problem.is_limited else (),
            options=options,
        )
    return beyond_kink(problem, ended, optimizer.tolerance, optimizer.max_iterations)


def _squares(problem: Problem, optimizer: LocalOptimizer, start: np.ndarray) -> OptimizeResult:
    """Return the result of least squares by a trust-region method, with the Jacobian of the terms."""
    tolerance = max(optimizer.tolerance, 2 * np.finfo(float).eps)  # SciPy does not accept smaller values
    return least_squares(
        problem.residuals,
        start,
        problem.residual_slopes,
        bounds=(0.0, 1.0),
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
        max_nfev=optimizer.max_iterations,
    )


def _evolution(problem: Problem, optimizer: GlobalOptimizer, first: np.ndarray) -> OptimizeResult:
    """Return the result of differential evolution, whose generations are evaluated at once."""
    limits = NonlinearConstraint(lambda x: problem.all_margins(_points(x)).T, 0.0, np.inf)
    return differential_evolution(
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
        constraints=(limits,) if problem.is_limited else (),
    )


def _strategy(problem: Problem, optimizer: EvolutionStrategy, first: np.ndarray) -> OptimizeResult:
    """Return the result of CMA-ES, whose generations are evaluated at once.

    Points that violate limits are ranked by their violation, after all feasible ones (K. Deb, An efficient constraint
    handling method for genetic algorithms, Comput. Methods Appl. Mech. Eng. 186 (2000) 311-338).
    """
    import cma

    options: dict[str, object] = {
        "bounds": [0.0, 1.0],
        "seed": optimizer.seed + 1,  # a seed of 0 would be replaced by the clock
        "maxiter": optimizer.max_iterations,
        "tolfunrel": optimizer.tolerance,
        "tolx": optimizer.tolerance,
        "tolfun": 0.0,
        "tolfunhist": 0.0,
        "verbose": -9,
        "verb_log": 0,  # write no files
        "signals_filename": "",  # do not read options from a file in the current folder
    }
    if optimizer.population is not None:
        options["popsize"] = optimizer.population
    strategy = cma.CMAEvolutionStrategy(first, optimizer.spread, options)
    best, least = first, problem.worth(first[None])[0]
    while not strategy.stop():
        points = np.array(strategy.ask())
        worth = problem.worth(points)
        beyond = 1.0 + max((cost for violation, cost in worth if not violation), default=0.0)
        strategy.tell(list(points), [beyond + violation if violation else cost for violation, cost in worth])
        index = worth.index(min(worth))
        if worth[index] < least:
            best, least = points[index], worth[index]
    ended = ", ".join(f"{name} {value:g}" for name, value in strategy.stop().items())
    return OptimizeResult(x=best, message=f"CMA-ES ended by {ended}", success="maxiter" not in strategy.stop())


def _points(x: np.ndarray) -> np.ndarray:
    """Return points (N, n) from the array (n, N), or the single point (n,), of SciPy."""
    return np.atleast_2d(x.T)
