"""Combinations of variables that are not determined, such as the stiffnesses of two springs in parallel.

At an optimum, the first derivatives of a goal are zero, so that its second derivatives show which changes of the
variables do not affect the goal. The second derivatives of a sum of squares follow from the Jacobian of its terms.
Active limits determine variables by the first derivatives of the limits, and an active bound fixes its variable.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.gains import variable_unit
from mbdkit_design.problem import Problem

STEP = 1e-3
"""Step of second differences, as a share of the bounds."""
NEGLIGIBLE = 1e-5
"""A direction is not determined if its singular value, relative to the largest one, is below this."""
ACTIVE = 1e-5
"""A bound counts as active at a point if its distance, as a share of the bounds, is below this. A limit counts as
active if its margin is below this (see `Problem.margins`)."""
MOST = 10
"""Largest number of variables for which the second derivatives are computed."""


def undetermined(problem: Problem, best: np.ndarray) -> tuple[dict[str, float], ...]:
    """Return changes of variables, by name, that do not affect the goal and the active limits at the best point (n,).

    Each change is scaled such that the largest change of a variable is 1 % of the width of its bounds. Variables that
    do not take part are omitted. The result is empty if a run near the best point fails, or if more variables than
    `MOST` are not at a bound.
    """
    is_free = (best > ACTIVE) & (best < 1 - ACTIVE)
    free, best = np.flatnonzero(is_free), np.where(is_free, best, np.round(best))
    if not 0 < len(free) <= MOST:
        return ()
    rows = problem.residual_slopes(best) if problem.sums_squares else _second_derivatives(problem, best, free)
    if problem.sums_squares:
        rows = rows[:, free]
    size = float(np.max(np.abs(rows), initial=0.0))
    active = problem.margin_slopes(best)[np.abs(problem.margins(best)) < ACTIVE][:, free]
    active = active[np.linalg.norm(active, axis=1) > 0]
    matrix = np.vstack([rows / (size or 1.0), active / np.linalg.norm(active, axis=1, keepdims=True)])
    if not np.all(np.isfinite(matrix)):
        return ()
    _, values, directions = np.linalg.svd(matrix)
    rank = int(np.sum(values > NEGLIGIBLE * values.max(initial=0.0)))
    return tuple(_change(problem, free, direction) for direction in directions[rank:])


def _second_derivatives(problem: Problem, best: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the second derivatives (F, F) of the cost with respect to the free variables, which are not at a bound.

    They are nan where a run fails.
    """
    center = best.copy()
    center[free] = np.clip(best[free], 2 * STEP, 1 - 2 * STEP)
    single = [STEP * np.eye(len(best))[place] for place in free]
    pairs = list(combinations(range(len(free)), 2))
    steps = [0 * center, *single, *(single[i] + single[j] for i, j in pairs)]
    costs = problem.costs(np.array([center + side * step for side in (1, -1) for step in steps]), failed=np.nan)
    even = 0.5 * (costs[: len(steps)] + costs[len(steps) :]) - costs[0]
    alone, together = even[1 : 1 + len(free)], even[1 + len(free) :]
    found = np.diag(2 * alone)
    for (i, j), value in zip(pairs, together, strict=True):
        found[i, j] = found[j, i] = value - alone[i] - alone[j]
    return np.asarray(found / STEP**2)


def _change(problem: Problem, free: np.ndarray, direction: np.ndarray) -> dict[str, float]:
    """Return a direction (F,) of the free variables as changes by name; the first change is positive."""
    direction = direction / direction[np.argmax(np.abs(direction))]
    variables = problem.evaluator.spec.variables
    names = list(variables)
    found = {
        names[place]: 0.01 * float(share) * variables[names[place]].width
        for place, share in zip(free, direction, strict=True)
        if abs(share) > 1e-2
    }
    side = np.sign(next(iter(found.values())))
    return {name: float(side * value) for name, value in found.items()}


def sentence(spec: DesignSpec, change: Mapping[str, float]) -> str:
    """Return a message to the user about a combination of variables that is not determined."""
    if len(change) == 1:
        return f"{next(iter(change))} is not determined: the goal does not depend on it near the best point."
    parts = ", ".join(f"{name} by {value:+.3g} {variable_unit(spec, name)}".rstrip() for name, value in change.items())
    return (
        f"Only a combination of {', '.join(change)} is determined: changing {parts} together does not affect the goal. "
        "Fix one of them, or add a goal or limit."
    )
