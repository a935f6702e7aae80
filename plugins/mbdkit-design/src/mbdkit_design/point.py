"""A point of a design: values of its variables, and the results for them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator

from mbdkit_design.evaluation import Evaluator

#: A number; stored results have null in place of nan.
Stored = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]

Notify = Callable[[str], None]  #: Function that receives a sentence for the user.


@dataclass(frozen=True)
class DesignPoint:
    """Values of the variables and the results for them.

    Attributes
    ----------
    variables
        Values of the variables by name.
    goals
        Goals by name, summed over the scenarios by their weights.
    measures
        Goals and limits by name, for each scenario. The name of the scenario is empty if there is only the base.
    """

    variables: dict[str, Stored]
    goals: dict[str, Stored]
    measures: dict[str, dict[str, Stored]]


def point_of(evaluator: Evaluator, x: np.ndarray) -> DesignPoint:
    """Return the point at these shares (n,) of the bounds."""
    values, goals = evaluator.values(x[None])[0], evaluator.totals(x)
    return DesignPoint(
        variables=evaluator.variables(x),
        goals=dict(zip(evaluator.spec.totals, goals.tolist(), strict=True)),
        measures={
            name: dict(zip(evaluator.names, row.tolist(), strict=True))
            for name, row in zip(evaluator.spec.situations, values, strict=True)
        },
    )
