"""The answer of a study with tolerances: the smallest and the largest value of each measure, what causes them, and
proofs that the largest value over the box of tolerances is at one of its corners.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdkit.base.plain_data import Path
from mbdkit.base.text import listed, plus_minus
from mbdkit.mechanism.parameters import names_in
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec.reading import parse_key
from mbdkit.spec.run_spec import RunSpec
from mbdkit_report import Cell, Table, columns_of, key_words
from mbdkit_studies.points.sampled_values import MOST_FOR_ALL_CORNERS
from mbdkit_studies.statistics.sample_groups import measured
from mbdkit_studies.store.study_point import axis_unit, point_words
from mbdkit_studies.study import Study
from mbdkit_studies.texts import ERROR

#: Convex functions of reactions of joints.
_CONVEX = re.compile(r"(max|mean|rms|final)\(\s*(abs\(\s*)?joints\.(\w+|'[^']*')\.(force|torque)(\.[xy])?\s*\)?\s*\)")
_SECTIONS = {"name", "gravity", "bodies", "joints", "forces", "markers", "coordinates", "assembly"}
_TYPES = {
    "joints": {"revolute", "prismatic", "fixed", "point-on-line", "driver"},
    "forces": {"force", "torque", "spring-damper", "torsion-spring"},
}

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


def is_bounded_by_corners(spec: RunSpec, keys: Sequence[str], expression: str) -> bool:
    """Return whether the largest value of a measure over a box of numbers is proved to be at a corner of the box.

    In a mechanism all of whose coordinates are driven, the motion does not depend on masses and moments of inertia. If
    no force depends on reactions, and no joint is redundant, the reactions are linear functions of these numbers. A
    convex function of the reactions, such as their largest norm, is then largest at a corner.
    """
    data = json.loads(spec.canonical_json())
    model, paths = data["model"], [parse_key(key) for key in keys]
    names = {str(path[1]) for path in paths if path[0] == "parameters"}
    if (
        not _CONVEX.fullmatch(expression.strip())
        or model["name"] != "mechanism"
        or data.get("events")
        or any(value for section, value in model.items() if section not in _SECTIONS)
        or any(
            one["type"] not in kinds or one.get("friction") or "joints" in names_in(one)
            for section, kinds in _TYPES.items()
            for one in model.get(section, {}).values()
        )
        or not all(_is_inertial(path) for path in paths if path[0] != "parameters")
        or names & names_in(data.get("parameters", {}))
        or any(names & names_in(text) and not _is_linear(path, text, names) for path, text in _texts(model, ("model",)))
    ):
        return False
    mechanism = RunSetup.of(spec).workspace.mechanism
    return mechanism.freedoms().startswith("0 ") and not mechanism.redundancy.rows


def _is_inertial(path: Path) -> bool:
    return len(path) == 4 and path[1] == "bodies" and path[3] in ("mass", "inertia")


def _is_linear(path: Path, text: str, names: set[str]) -> bool:
    """Return whether a mass or an inertia is one of the names, or its product: ``m``, ``m*length**2/12``."""
    first, _, rest = re.sub(r"\s", "", text).partition("*")
    return _is_inertial(path) and first in names and not rest.startswith("*") and not names & names_in(rest)


def _texts(holder: object, path: Path) -> Iterator[tuple[Path, str]]:
    """Yield the texts in plain data with their paths."""
    if isinstance(holder, dict | list):
        for key, value in holder.items() if isinstance(holder, dict) else enumerate(holder):
            yield from _texts(value, (*path, key))
    elif isinstance(holder, str):
        yield path, holder
