"""The goals of a design around its best point: cuts along each variable, and sensitivities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.designs.derivatives import differences
from mbdkit.designs.evaluation import Evaluator

REACH = 0.1
"""Half width of a cut, as a share of the bounds."""
POINTS = 21
"""Number of points of a cut."""


@dataclass(frozen=True)
class Cut:
    """The goals along one variable, while the others stay at the best point.

    Attributes
    ----------
    variable
        Name of the variable.
    values
        (P,) its values.
    goals
        (P, G) goals summed over the scenarios by their weights; nan where a run fails.
    """

    variable: str
    values: np.ndarray
    goals: np.ndarray


def cuts(evaluator: Evaluator, best: np.ndarray) -> list[Cut]:
    """Return a cut through the best point (n,) along each variable, within its bounds."""
    found = []
    for index, name in enumerate(evaluator.spec.variables):
        low, high = max(best[index] - REACH, 0.0), min(best[index] + REACH, 1.0)
        shares = np.union1d(np.linspace(low, high, POINTS), best[index])
        points = np.tile(best, (len(shares), 1))
        points[:, index] = shares
        evaluator.outcomes(points)  # vectorized where possible
        values = np.array([evaluator.variables(x)[name] for x in points])
        found.append(Cut(name, values, np.array([evaluator.totals(x) for x in points])))
    return found


SHARE = 0.01
"""Change of a variable for which sensitivities are given, as a share of its bounds."""


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivities of a goal or limit to the variables at the best point.

    Attributes
    ----------
    scenario, measure
        Names of the scenario and of the goal or limit.
    changes
        Change of the measure, to first order, if a variable increases by `SHARE` of its bounds.
    """

    scenario: str
    measure: str
    changes: dict[str, float]


def sensitivities(evaluator: Evaluator, best: np.ndarray) -> list[Sensitivity]:
    """Return the sensitivities of all goals and limits at the best point (n,); nan where a run fails."""
    slopes = SHARE * differences(evaluator, best)
    return [
        Sensitivity(scenario, measure, dict(zip(evaluator.spec.variables, slopes[row, column].tolist(), strict=True)))
        for row, scenario in enumerate(evaluator.spec.situations)
        for column, measure in enumerate(evaluator.names)
    ]
