"""Repetition of a design optimisation with other settings of the runs, such as a coarse step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import RunError
from mbdkit.base.text import counted
from mbdkit_design.design_spec import LocalOptimizer
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.gains import goal_units
from mbdkit_design.known_points import DesignPoint, point_of
from mbdkit_design.problem import Problem
from mbdkit_design.search import searches
from mbdkit_design.stages import Stages
from mbdkit_report import with_unit


@dataclass(frozen=True)
class Comparison:
    """The best point found by a search with other settings of the runs.

    Attributes
    ----------
    name
        Name of the settings in `compare` of the design spec.
    believed
        The point, with goals and measures computed with the other settings; None if no point was found.
    actual
        The same point, with goals and measures computed with the settings of the design; None if no point was found.
    is_feasible
        Whether the point satisfies all limits with the settings of the design.
    reason
        Reason why there is no point, or that the point violates limits even with the other settings; empty otherwise.
    own_start, own_best
        The start and the best point of the design itself, with goals and measures computed with the other settings;
        None if no point was found, for example because a run fails at the start.
    """

    name: str
    believed: DesignPoint | None
    actual: DesignPoint | None
    is_feasible: bool
    reason: str = ""
    own_start: DesignPoint | None = None
    own_best: DesignPoint | None = None

    def confirmation(self, unit: str) -> str:
        """Return a sentence that compares the goal, in its unit, at the start and at the best point of the design, both
        computed with the other settings; empty if `own_start` or `own_best` is None.
        """
        if self.own_start is None or self.own_best is None:
            return ""
        (goal,) = self.own_best.goals
        before, after = self.own_start.goals[goal], self.own_best.goals[goal]
        if np.isnan(after):
            return f"With {self.name}, a run fails at the best point of this design."
        share = f" ({100 * (after - before) / abs(before):+.3g} %)" if before else ""
        change = f"from {before:.6g} to {with_unit(after, unit)}{share}"
        return f"With {self.name}, this design changes the {goal} {change}."

    @property
    def fails(self) -> bool:
        """Whether a run with the settings of the design fails at the point found with the other settings."""
        return self.actual is not None and any(map(np.isnan, self.actual.goals.values()))


def compare(evaluator: Evaluator, name: str, best: np.ndarray, stages: Stages) -> Comparison:
    """Search for the best point of a design with other settings, which have this name in `compare` of the spec.

    Goals and limits at the start and at the best point of the design are also computed with the other settings. The
    search begins at `best`, the best point of the design: if both settings are accurate, the other best point is near.
    If a run with the other settings fails there, the search begins at the start of the design.
    """
    other = Evaluator(evaluator.spec, evaluator.run, compared=name)
    stages.begin(f"comparison with {name}", other)
    optimizer, start = evaluator.spec.optimizer, evaluator.first
    try:
        problem = Problem(other)
        if not np.any(np.isnan(other.values(best[None]))):
            start = best
            if isinstance(optimizer, LocalOptimizer):
                optimizer = optimizer.model_copy(update={"starts": 1})
        result = searches(problem, optimizer, start)[0]
    except RunError as error:
        stages.notify(f"{name}: {error}")
        return Comparison(name, None, None, False, f"There is no best point with {name}: {str(error).rstrip('.')}.")
    end = result.end
    (unit,) = goal_units(evaluator.spec).values()
    stages.notify(f"{counted(evaluator.runs, 'run')}: with {name}, the least {evaluator.spec.totals[0]} seems to be "
                  f"{with_unit(other.totals(end)[0], unit)}")  # fmt: skip
    is_feasible = Problem(evaluator).is_feasible(end)
    reason = "" if result.feasible else f"With {name}, the search found no point that satisfies all limits."
    own = point_of(other, evaluator.first), point_of(other, best)
    return Comparison(name, point_of(other, end), point_of(evaluator, end), is_feasible, reason, *own)
