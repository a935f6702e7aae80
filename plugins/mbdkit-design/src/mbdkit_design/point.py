"""A point of a design: values of its variables, and the results for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.evaluation import Evaluator

Notify = Callable[[str], None]
"""Function that receives a sentence for the user."""


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

    variables: dict[str, float]
    goals: dict[str, float]
    measures: dict[str, dict[str, float]]

    @classmethod
    def from_dict(cls, spec: DesignSpec, data: Mapping[str, Any]) -> DesignPoint:
        """Return the point of a design from plain data."""
        if [*data["variables"]] != [*spec.variables] or [*data["goals"]] != [*spec.totals]:
            raise ValueError
        measures = {name: numbers(found) for name, found in data["measures"].items()}
        return cls(numbers(data["variables"]), numbers(data["goals"]), measures)


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


def numbers(data: Mapping[str, Any]) -> dict[str, float]:
    """Return numbers by name, with nan in place of None."""
    return {str(name): np.nan if value is None else float(value) for name, value in data.items()}
