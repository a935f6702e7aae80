"""The answer of a study with tolerances: the smallest and the largest value of each measure, and what causes them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.base.text import listed, plus_minus
from mbdkit_report import Cell, Table, columns_of, key_words
from mbdkit_studies.points.corner_values import MOST_FOR_ALL_CORNERS
from mbdkit_studies.results.proven_bounds import is_bounded_by_corners
from mbdkit_studies.statistics.sample_groups import measured
from mbdkit_studies.store.study_point import axis_unit, point_words
from mbdkit_studies.texts import ERROR

if TYPE_CHECKING:
    from mbdkit_studies.study import Study

MOST_EFFECTS = 3  #: Largest number of tolerances whose effects a headline gives.


@dataclass(frozen=True)
class Effect:
    """Changes of a measure if one number alone is at its limits; nan where a run has no value.

    `is_monotone` is false if both limits change the measure in one direction, by more than the errors of the runs.
    """

    key: str
    deviations: tuple[str, ...]
    changes: tuple[float, ...]
    is_monotone: bool


@dataclass(frozen=True)
class Case:
    """A value of a measure with its error, in a run with this number and these values."""

    value: float
    error: float
    run: int
    words: str


@dataclass(frozen=True)
class WorstCase:
    """The value of a measure in the base, and its smallest and largest value in those runs that have one.

    `is_bound`: whether no combination of numbers within the limits can exceed the largest value.
    """

    name: str
    unit: str
    cases: dict[str, Case]
    known: int
    runs: int
    is_bound: bool
    effects: tuple[Effect, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the data that are printed as JSON."""
        cases = {key: {"value": one.value, "error": one.error, "run": one.run} for key, one in self.cases.items()}
        effects = {one.key: dict(zip(one.deviations, one.changes, strict=True)) for one in self.effects}
        told = {"name": self.name, "unit": self.unit, "worst_of": self.known, "bound": self.is_bound}
        return told | cases | {"effects": effects}

    def text(self, key: str, sign: str) -> str:
        """Return the base, the smallest or the largest value with its error and unit."""
        value, error = self.cases[key].value, self.cases[key].error
        return f"{f'{value:.6g}' if math.isnan(error) else plus_minus(value, error, sign)} {self.unit}".rstrip()

    def headline(self, sign: str) -> str:
        """Return the worst case as text, with parts that are separated by semicolons."""
        kind = "no bound"
        if self.is_bound:
            kind = "a bound: the motion is driven, and forces are linear in masses and moments of inertia"
        where = {key: f"in run {one.run} ({one.words})" for key, one in self.cases.items()}
        parts = [f"largest {self.text('largest', sign)}, worst of {self.known} runs, {kind}", where["largest"]]
        if self.known < self.runs:
            parts.insert(1, f"WITHOUT {self.runs - self.known} runs that failed or are rated bad")
        parts += [
            f"smallest {self.text('smallest', sign)}, {where['smallest']}",
            f"{self.text('base', sign)} in the base",
        ]
        for one in self.effects[:MOST_EFFECTS]:
            sides = zip(one.deviations, one.changes, strict=True)
            changes = ", ".join(f"{by} gives {change:+.3g} {self.unit}".rstrip() for by, change in sides)
            parts.append(f"{key_words(one.key)}: {changes}")
        if turns := [key_words(one.key) for one in self.effects if not one.is_monotone]:
            parts.append(f"NOT MONOTONE in {listed(turns, 'and')}: values inside the limits may be worse")
        return "; ".join(parts)


def worst_cases(study: Study) -> Iterator[WorstCase]:
    """Yield the worst case of each measure of a study with tolerances, if the base has a value."""
    table, columns = study.grid().table, study.columns()
    points, places = study.points, range(len(study.points))
    units = {key: axis_unit(key, points[:1]) for key in table}
    unknown = np.full(len(places), np.nan)
    for measure in study.spec.defined_measures():
        values = measured(study, measure.name, places) if measure.name in columns else unknown
        errors, known = columns.get(measure.name + ERROR, unknown), np.isfinite(values)
        if not known[0]:
            continue
        ends = {"base": 0, "smallest": int(np.nanargmin(values)), "largest": int(np.nanargmax(values))}
        yield WorstCase(
            measure.name,
            study.described(measure.name)[0].removesuffix("1"),
            {
                key: Case(float(values[at]), float(errors[at]), at + 1, point_words(points[at], units))
                for key, at in ends.items()
            },
            int(np.sum(known)),
            len(places),
            bool(np.all(known))
            and len(table) <= MOST_FOR_ALL_CORNERS
            and is_bounded_by_corners(points[0].spec, [*table], measure.expression),
            _effects(table, values, np.nan_to_num(errors), units),
        )


def _effects(
    table: Mapping[str, np.ndarray], values: np.ndarray, errors: np.ndarray, units: dict[str, str]
) -> tuple[Effect, ...]:
    """Return the effects of the numbers that deviate alone, the largest first."""
    effects = []
    off = np.array([column - column[0] for column in table.values()])
    for key, own in zip(table, off, strict=True):
        alone = np.flatnonzero((own != 0) & (np.count_nonzero(off, axis=0) == 1))
        changes = values[alone] - values[0]
        is_clear = np.abs(changes) > np.maximum(errors[alone] + errors[0], 1e-9 * abs(values[0]))
        is_turned = len(alone) == 2 and bool(np.all(is_clear)) and changes[0] * changes[1] > 0
        texts = tuple(f"{one:+.4g} {units[key]}".rstrip() for one in own[alone])
        effects.append(Effect(key, texts, tuple(changes.tolist()), not is_turned))
    return tuple(sorted(effects, key=lambda one: -np.max(np.nan_to_num(np.abs(one.changes), nan=np.inf))))


def worst_case_tables(study: Study) -> tuple[Table, ...]:
    """Return the table of the worst cases, and the table of the effects of single numbers."""
    cases = list(worst_cases(study))
    ends: Sequence[tuple[Cell, ...]] = [
        (one.name, *(one.text(key, "±") for key in one.cases), one.cases["smallest"].run, one.cases["largest"].run)
        for one in cases
    ]
    effects: Sequence[tuple[Cell, ...]] = [
        (case.name, key_words(one.key), by, change, case.unit)
        for case in cases
        for one in case.effects
        for by, change in zip(one.deviations, one.changes, strict=True)
    ]
    note = "The worst of the runs that were computed. Inside the limits, a measure that is not monotone may be worse."
    return (
        Table("worst", "Worst cases", columns_of("measure; base; smallest; largest; in run; in run"), tuple(ends), note,
              headline=True),
        Table("effects", "One number off", columns_of("measure; number; off by; change; unit"), tuple(effects)),
    )  # fmt: skip
