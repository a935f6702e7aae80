"""Combinations of variables that are not determined, such as the stiffnesses of two springs in parallel.

At an optimum, the first derivatives of a goal are zero, so that its second derivatives show which changes of the
variables do not affect the goal. The second derivatives of a sum of squares follow from the Jacobian of its terms.
Active limits determine variables by the first derivatives of the limits, and a bound beyond which the goal would
decrease fixes its variable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.gains import variable_unit
from mbdkit_design.problem import Problem

#: Largest step of second differences, as a share of the bounds, and how much and how often it is shortened where the
#: goal is not quadratic within it, as with wide bounds.
STEP, SHRINK, STEPS = 1e-3, 8.0, 12
#: Relative difference of the second differences of a step and of its half below which the goal counts as quadratic.
QUADRATIC = 1e-3
#: Changes of the goal below this, relative to its value at the start or at the point, are rounding errors.
NOISE = 1e-12
#: A direction is not determined if its singular value, relative to those of single variables, is below this; a variable
#: is not if its second derivative is, relative to the largest one or to the goal, over the width of the bounds.
NEGLIGIBLE = 1e-5
#: A bound may be active at a point if its distance, as a share of the bounds, is below this. A limit counts as
#: active if its margin is below this (see `Problem.margins`).
ACTIVE = 1e-5
#: Decrease of the goal beyond a bound, relative to its value at the start or at the point, from which the bound fixes
#: its variable.
EFFECT = 1e-6
MOST = 10  #: Largest number of variables for which the second derivatives are computed.


def undetermined(problem: Problem, best: np.ndarray) -> tuple[dict[str, float], ...]:
    """Return changes of variables, by name, that do not affect the goal and the active limits at the best point (n,).

    Each change is scaled such that the largest change of a variable is 1 % of the width of its bounds. Variables that
    do not take part are omitted. The result is empty if a run near the best point fails, or if more variables than
    `MOST` are not at a bound, or a variable is a table.
    """
    if problem.evaluator.spec.tables:  # neighbouring values are hardly determined one by one
        return ()
    is_free = _free(problem, best)
    free, best = np.flatnonzero(is_free), np.where(is_free, best, np.round(best))
    if not 0 < len(free) <= MOST:
        return ()
    if problem.sums_squares:
        rows = problem.residual_slopes(best)[:, free]
        size = np.linalg.norm(rows, axis=0)
    else:
        rows = _second_derivatives(problem, best, free)
        size = np.sqrt(np.abs(np.diag(rows)))
    active = problem.margin_slopes(best)[np.abs(problem.margins(best)) < ACTIVE][:, free]
    # in units in which all single variables that have an effect have the same: wide bounds are no evidence
    most = min(float(np.max(size, initial=0.0)), max(1.0, abs(problem.cost(best))))
    has_effect = size > NEGLIGIBLE ** (1.0 if problem.sums_squares else 0.5) * most
    size = np.where(has_effect, size, 1.0)
    rows = np.where(has_effect, rows / size, 0.0)
    if not problem.sums_squares:
        rows = np.where(has_effect[:, None], rows / size[:, None], 0.0)
    active = active[np.linalg.norm(active, axis=1) > 0] / size
    matrix = np.vstack([rows, active / np.linalg.norm(active, axis=1, keepdims=True)])
    if not np.all(np.isfinite(matrix)):
        return ()
    _, values, directions = np.linalg.svd(matrix)
    rank = int(np.sum(values > NEGLIGIBLE * values.max(initial=0.0)))
    return tuple(_change(problem, free, direction / size) for direction in directions[rank:])


def _free(problem: Problem, best: np.ndarray) -> np.ndarray:
    """Return which variables (n,) no bound fixes.

    A value may be at a bound, or near it relative to the width of the bounds, although the goal would hardly decrease
    beyond it: by half the square of the first derivative over the second one.
    """
    near = np.flatnonzero((best <= ACTIVE) | (best >= 1 - ACTIVE))
    is_free = np.ones(len(best), dtype=bool)
    if not near.size:
        return is_free
    if problem.sums_squares:
        rows = problem.residual_slopes(best)[:, near]
        slope, curvature = 2.0 * problem.residuals(best) @ rows, 2.0 * np.sum(rows * rows, axis=0)
    else:
        slope, curvature = problem.slope(best)[near], np.diag(_second_derivatives(problem, best, near, is_alone=True))
    is_free[near] = slope * slope <= 2.0 * EFFECT * max(1.0, abs(problem.cost(best))) * np.nan_to_num(curvature)
    return is_free


def _second_derivatives(problem: Problem, best: np.ndarray, free: np.ndarray, *, is_alone: bool = False) -> np.ndarray:
    """Return the second derivatives (F, F) of the cost with respect to F variables; nan where a run fails, zero for two
    variables if `is_alone`.
    """
    noise, steps = NOISE * max(1.0, abs(problem.cost(best))), np.full(len(free), STEP)
    for _ in range(STEPS):
        whole, half = (np.diag(_differences(problem, best, free, share * steps, ())) for share in (1.0, 0.5))
        with np.errstate(invalid="ignore"):
            smooth = (np.abs(whole - 4.0 * half) < QUADRATIC * np.abs(whole)) | (np.abs(whole) < noise)
        if np.all(smooth):
            break
        steps = np.where(smooth, steps, steps / SHRINK)
    pairs = () if is_alone else tuple(combinations(range(len(free)), 2))
    whole, half = (_differences(problem, best, free, share * steps, pairs) for share in (1.0, 0.5))
    result = (16.0 * half - whole) / 3.0  # without the term of fourth order
    return np.asarray(result / (steps[:, None] * steps))


def _differences(
    problem: Problem, best: np.ndarray, free: np.ndarray, steps: np.ndarray, pairs: Sequence[tuple[int, int]]
) -> np.ndarray:
    """Return the second derivatives (F, F) of the cost times the steps (F,) of both variables; those of two variables
    for `pairs` only.
    """
    single = [step * np.eye(len(best))[place] for step, place in zip(steps, free, strict=True)]
    center = best.copy()
    center[free] = np.clip(best[free], steps, 1.0 - steps)
    moves = [0.0 * best, *single, *(0.5 * (single[i] + single[j]) for i, j in pairs)]
    costs = problem.costs(np.array([center + side * move for side in (1, -1) for move in moves]), failed=np.nan)
    even = costs[: len(moves)] + costs[len(moves) :] - 2.0 * costs[0]
    values = np.diag(even[1 : 1 + len(free)])
    for (i, j), value in zip(pairs, even[1 + len(free) :], strict=True):
        values[i, j] = values[j, i] = 2.0 * value - 0.5 * (values[i, i] + values[j, j])
    return values


def _change(problem: Problem, free: np.ndarray, direction: np.ndarray) -> dict[str, float]:
    """Return a direction (F,) of the free variables as changes by name; the first change is positive."""
    direction = direction / direction[np.argmax(np.abs(direction))]
    variables = problem.evaluator.spec.chosen
    names = list(variables)
    results = {
        names[place]: 0.01 * float(share) * variables[names[place]].width
        for place, share in zip(free, direction, strict=True)
        if abs(share) > 1e-2
    }
    side = np.sign(next(iter(results.values())))
    return {name: float(side * value) for name, value in results.items()}


def sentence(spec: DesignSpec, change: Mapping[str, float]) -> str:
    """Return a message to the user about a combination of variables that is not determined."""
    if len(change) == 1:
        return f"{next(iter(change))} is not determined: the goal does not depend on it near the best point."
    parts = ", ".join(f"{name} by {value:+.3g} {variable_unit(spec, name)}".rstrip() for name, value in change.items())
    return (
        f"Only a combination of {', '.join(change)} is determined: changing {parts} together does not affect the goal. "
        "Fix one of them, or add a goal or limit."
    )
