"""The goals of a design around its best point: cuts along each variable, and sensitivities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit_design.derivatives import differences
from mbdkit_design.evaluation import Evaluator

REACH = 0.1  #: Half width of a cut, as a share of the bounds.
POINTS = 21  #: Number of points of a cut.


@dataclass(frozen=True)
class Cut:
    """The goals along one variable, while the others stay at the best point.

    Attributes
    ----------
    variable
        Name of the variable.
    values
        (P,) values of the variable.
    goals
        (P, G) goals summed over the scenarios by their weights; nan where a run fails.
    """

    variable: str
    values: np.ndarray
    goals: np.ndarray


def cuts(evaluator: Evaluator, best: np.ndarray) -> list[Cut]:
    """Return, for each variable, a cut through the best point (n,) along this variable, within its bounds."""
    results = []
    for index, name in _single(evaluator):
        low, high = max(best[index] - REACH, 0.0), min(best[index] + REACH, 1.0)
        shares = np.union1d(np.linspace(low, high, POINTS), best[index])
        points = np.tile(best, (len(shares), 1))
        points[:, index] = shares
        evaluator.outcomes(points)  # vectorized where possible
        values = np.array([evaluator.variables(x)[name] for x in points])
        results.append(Cut(name, values, np.array([evaluator.totals(x) for x in points])))
    return results


def _single(evaluator: Evaluator) -> list[tuple[int, str]]:
    """Return the variables that are numbers, with their indices among all numbers."""
    return [(index, name) for index, name in enumerate(evaluator.spec.chosen) if name in evaluator.spec.single]


SHARE = 0.01  #: Change of a variable for which sensitivities are given, as a share of its bounds.
#: Distances from the best point at which goals and limits are evaluated, as shares of the bounds.
DISTANCES = (1e-4, 2e-4)
#: A measure counts as smooth if its second differences grow by at least this factor from the first to the second of
#: `DISTANCES`. The factor is 4 for a smooth measure, and 2 at a corner, where the slopes on both sides differ.
LEAST_GROWTH = 3.0
#: Smallest difference of the slopes on both sides of a corner, as a share of the larger slope.
LEAST_CORNER = 0.05
NOISE = 1e-9  #: Second differences below this share of the measure are attributed to errors of the runs.


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivities of a goal or limit to the variables at the best point.

    Attributes
    ----------
    scenario, measure
        Names of the scenario and of the goal or limit.
    changes
        Change of the measure, to first order, if a variable increases by `SHARE` of its bounds; nan where a run fails,
        and at a corner.
    corners
        Two changes, for a decrease and for an increase of a variable by `SHARE` of its bounds. Only variables in which
        the measure has different slopes on both sides of the best point are included.
    """

    scenario: str
    measure: str
    changes: dict[str, float]
    corners: dict[str, tuple[float, float]]


def sensitivities(evaluator: Evaluator, best: np.ndarray) -> list[Sensitivity]:
    """Return the sensitivities of all goals and limits at the best point (n,); nan where a run fails."""
    places = [index for index, _ in _single(evaluator)]
    slopes = SHARE * differences(evaluator, best, places)
    sides = _sides(evaluator, best, places)
    names = list(evaluator.spec.single)
    results = []
    for row, scenario in enumerate(evaluator.spec.situations):
        for column, measure in enumerate(evaluator.names):
            changes = dict(zip(names, slopes[row, column].tolist(), strict=True))
            corners = {
                name: (float(sides[0, row, column, index]), float(sides[1, row, column, index]))
                for index, name in enumerate(names)
                if np.all(np.isfinite(sides[:, row, column, index]))
            }
            results.append(Sensitivity(scenario, measure, changes | dict.fromkeys(corners, np.nan), corners))
    return results


def _sides(evaluator: Evaluator, best: np.ndarray, places: list[int]) -> np.ndarray:
    """Return the changes (2, S, K, n) of goals and limits if a variable decreases, and if it increases, by `SHARE`.

    They are nan except at corners: where a goal or limit is smooth, where the best point is at a bound of the variable,
    and where a run fails.
    """
    count, units = len(places), np.eye(len(best))[places]
    points = [best, *(best + sign * step * one for step in DISTANCES for sign in (-1, 1) for one in units)]
    inside = ((best - DISTANCES[1] >= 0.0) & (best + DISTANCES[1] <= 1.0))[places]
    values = evaluator.values(np.clip(points, 0.0, 1.0))
    away = (values[1:] - values[0]).reshape(2, 2, count, *values.shape[1:])  # (distance, side, variable, S, K)
    down, up = away[0]
    second = away[:, 0] + away[:, 1]
    with np.errstate(all="ignore"):
        is_corner = (
            (np.abs(second[1]) < LEAST_GROWTH * np.abs(second[0]))
            & (np.abs(second[0]) > NOISE * np.abs(values[0]))
            & (np.abs(second[0]) > LEAST_CORNER * np.maximum(np.abs(down), np.abs(up)))
            & inside[:, None, None]
        )
    return np.moveaxis(np.where(is_corner, np.stack([down, up]) * SHARE / DISTANCES[0], np.nan), 1, -1)
