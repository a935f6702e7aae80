"""Gains of a design, changes of its goals, and costs, changes of loads; limits that may be meant in degrees."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.headlines import largest_loads
from mbdkit.base.plain_data import path_text
from mbdkit.measures.take import SpecMeasure
from mbdkit.runs.angles_in_degrees import looks_like_degrees
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import variable_path
from mbdkit_design.design_spec import FEASIBLE, GOAL, DesignSpec
from mbdkit_report import key_unit, with_unit

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit_design.known_points import DesignPoint
    from mbdkit_design.trust import Trust

LEAST_CHANGE = 0.01  #: Smallest relative change of a load that is reported as a cost.


@dataclass(frozen=True)
class Gain:
    """The change of a goal from the start to the best point.

    `error` is the error at the best point. `is_real` is whether the goal decreases by more than the errors of both
    points, and `is_loss` whether it grows by more. If the errors are unknown, `error` is nan and `is_real` is None.
    `start_violations` says which limits the start violates; empty if it satisfies all.
    """

    name: str
    unit: str
    start: float
    best: float
    error: float
    is_real: bool | None
    is_loss: bool = False
    start_violations: str = ""

    def text(self) -> str:
        """Return the change in words, such as ``from 441 to 75.1 N (-83 %), which exceeds the errors``."""
        unit = f" {self.unit}" if self.unit else ""
        share = f" ({100 * (self.best - self.start) / abs(self.start):+.3g} %)" if self.start else ""
        exceeds = {True: ", which exceeds the errors", False: ", which does NOT exceed the errors", None: ""}
        judged = ", which is worse by more than the errors" if self.is_loss else exceeds[self.is_real]
        told = f"from {self.start:.4g} to {self.best:.4g}{unit}{share}{judged}"
        return f"{told}; but the start is not allowed: {self.start_violations}" if self.start_violations else told


@dataclass(frozen=True)
class Cost:
    """The change of the largest force or torque of a joint from the start to the best point."""

    scenario: str
    label: str
    unit: str
    start: float
    best: float

    @property
    def share(self) -> float:
        """Relative change; inf if the load is zero at the start."""
        return (self.best - self.start) / self.start if self.start else np.inf

    def text(self) -> str:
        """Return the change in words."""
        where = f" ({self.scenario})" if self.scenario else ""
        return f"{self.label}{where} from {self.start:.4g} to {self.best:.4g} {self.unit} ({100 * self.share:+.3g} %)"


def variable_unit(spec: DesignSpec, name: str) -> str:
    """Return the unit of a variable, for tables of its values; empty if it is unknown."""
    if name in spec.tables:
        return spec.tables[name].units[1]
    return key_unit(variable_path(name), spec.specs.values())


def table_units(name: str, spec: ModelSpec) -> tuple[str, str]:
    """Return the units of the arguments and of the values of a table that is a variable."""
    if variable_path(name)[1] == "joints":  # the profile of a cam
        return "rad", "m"
    unit = key_unit((*variable_path(name), 0, 0), [spec])
    return unit, "N m" if unit == "rad" else "N"


def goal_words(name: str) -> str:
    """Return a goal in words."""
    return "goal" if name == GOAL else f"goal {name}"


def measure_units(spec: DesignSpec) -> dict[tuple[str, str], str]:
    """Return the units of goals and limits by scenario and name; empty for numbers without a unit."""
    found = {
        (scenario, measure.name): SpecMeasure(measure, one).describe()[0]
        for scenario, one in spec.specs.items()
        for measure in spec.defined_measures()
    }
    return {place: "" if unit == "1" else unit for place, unit in found.items()}


def goal_units(spec: DesignSpec) -> dict[str, str]:
    """Return the units of the goals by name; empty for a sum of squares, and for goals whose unit differs between
    scenarios.
    """
    if spec.sums_squares:
        return dict.fromkeys(spec.totals, "")
    units = measure_units(spec)
    found = {name: {units[scenario, name] for scenario in spec.specs} for name in spec.totals}
    return {name: one.pop() if len(one) == 1 else "" for name, one in found.items()}


def gains(spec: DesignSpec, start: DesignPoint, best: DesignPoint, trust: Trust) -> list[Gain]:
    """Return the gain of each goal from the start to the best point."""
    units, wrong = goal_units(spec), "; ".join(violations(spec, start, start))
    return [
        Gain(
            name=name,
            unit=units[name],
            start=start.goals[name],
            best=value,
            error=trust.errors[name],
            is_real=trust.is_gain[name],
            is_loss=-trust.gain[name] > trust.gain_errors[name],
            start_violations=wrong,
        )
        for name, value in best.goals.items()
    ]


def violations(spec: DesignSpec, point: DesignPoint, start: DesignPoint) -> list[str]:
    """Return the limits that a point violates, and by how much, in words. The tolerance is that of the search."""
    units, found = measure_units(spec), []
    for scenario, measures in point.measures.items():
        for name, limit in spec.subject_to.items():
            value, unit = measures[name], units[scenario, name]
            sizes = [abs(one) for one in (limit.min, limit.max, start.measures[scenario][name]) if one is not None]
            slack = FEASIBLE * max(size for size in sizes if np.isfinite(size))
            label = f"{name} in {scenario}" if scenario else name
            shown = with_unit(value, unit, 4)
            for side, end, word in ((1.0, limit.max, "above"), (-1.0, limit.min, "below")):
                if end is not None and side * (value - end) > slack:
                    away = with_unit(side * (value - end), unit, 4)
                    found.append(f"{label} is {shown}, {away} {word} its limit of {with_unit(end, unit)}")
    for key, table in spec.tables.items():
        found += table.violations(key, point.variables, FEASIBLE)
    return found


def costs(pairs: Mapping[str, Mapping[str, Run]]) -> list[Cost]:
    """Return the changes of the largest loads of joints, in descending order of the relative change.

    Changes by less than `LEAST_CHANGE` are left out.

    Parameters
    ----------
    pairs
        Runs at the ``start`` and at the ``best`` point, by scenario.
    """
    found: list[Cost] = []
    for scenario, pair in pairs.items():
        before = {load.label: load.value for load in largest_loads(pair["start"])}
        loads = largest_loads(pair["best"])
        found += (Cost(scenario, one.label, one.unit, before.get(one.label, 0.0), one.value) for one in loads)
    return sorted((cost for cost in found if abs(cost.share) >= LEAST_CHANGE), key=lambda cost: -cost.share)


#: What expressions contain that convert radians to degrees, or whose angles are multiples of pi.
_CONVERSION = re.compile(r"\bpi\b|\b180\b|\b57\.[23]|\b0?\.0174")


def limits_in_degrees(spec: DesignSpec) -> Iterator[str]:
    """Yield a warning for each limit without a unit of an angle that is above one turn, and probably in degrees."""
    angles = {name for (_, name), unit in measure_units(spec).items() if unit == "rad"}
    for name, limit in spec.subject_to.items():
        if name not in angles or "unit" in limit.measure or _CONVERSION.search(limit.value):
            continue
        for key, value in (("max", limit.max), ("min", limit.min)):
            if value is not None and looks_like_degrees(value):
                yield (
                    f"the angle of {value:g} rad at {path_text(('subject_to', name, key))} is more than a full "
                    f"rotation; if degrees are intended, write `{key}: {value:.16g} deg`, otherwise "
                    f"`{key}: {value:.16g} rad`"
                )
