"""The plan of a study: its points, its distinct runs, and its measures, all checked before the first run."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from functools import cached_property

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, path_text
from mbdkit.measures.take import SpecMeasure
from mbdkit.runs.angles_in_degrees import angles_in_degrees
from mbdkit.runs.preparation import caution
from mbdkit.runs.run_criteria import zero_reactions
from mbdkit.spec.reading import parse_key
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit_studies.points.planned_points import PlannedPoint, PlannedPoints, distinct_runs, grids
from mbdkit_studies.points.varied_values import notes_on_varied_values, start_warnings_of_study
from mbdkit_studies.results.judge import find_verdict
from mbdkit_studies.spec.measures import MEASURES, Description, has_error
from mbdkit_studies.spec.sample_section import typical_values
from mbdkit_studies.spec.study_spec import StudySpec, expressions_of
from mbdkit_studies.store.storage import StudyBlocks
from mbdkit_studies.store.study_index import COLUMNS, axis_column
from mbdkit_studies.texts import ERROR, without_numbers

#: Number of runs, of a study stored in blocks (files of many runs), whose specs are validated before the first run.
#:
#: The specs of all other runs are validated when the runs are computed.
SAMPLES = 8


class StudyPlan:
    """The plan of a study: its points, its distinct runs, and its measures.

    Parameters
    ----------
    spec
        The study spec. For a study in blocks, its `store` must be set.

    Attributes
    ----------
    points
        Points in the order of the study, including those that are left out.
    validated
        The distinct specs that are validated before the first run, with names for error messages: all of them, or for
        a study in blocks those of some points.
    defined
        Units and descriptions of the measures that the study defines.

    Raises
    ------
    SpecError
        If there are too many points, or if a run or a measure is invalid. For a study in blocks, only the sampled runs
        are validated, and the error is raised if all of them are invalid.
    """

    def __init__(self, spec: StudySpec):
        self.spec = spec
        self.points = PlannedPoints(spec)
        self.validated = self.valid_samples if spec.in_blocks else list(distinct_runs(self.points))
        self.defined = describe_measures(spec, self.validated)

    @cached_property
    def blocks(self) -> StudyBlocks:
        """The division of the runs into blocks."""
        return StudyBlocks.of(self.spec, self.points)

    @cached_property
    def built_in(self) -> list[str]:
        """Names of the built-in measures to compute from the results of each run."""
        wanted = tuple(MEASURES) if self.spec.built_in_measures is None else self.spec.built_in_measures
        compared = any(grid.reference for grid in self.points.grids)
        return [name for name in wanted if name in MEASURES and (compared or not MEASURES[name].needs)]

    @cached_property
    def samples(self) -> list[PlannedPoint]:
        """Up to `SAMPLES` points, at equal distances from the first to the last."""
        last = len(self.points) - 1
        places = dict.fromkeys(last * number // max(1, SAMPLES - 1) for number in range(SAMPLES))
        return [self.points[place] for place in places]

    @cached_property
    def valid_samples(self) -> list[tuple[str, RunSpec]]:
        """The valid specs of the samples, with names for error messages; SpecError is raised if no sample is valid."""
        valid, errors = [], []
        for point in self.samples:
            if point.lacking:
                continue
            try:
                valid.append((f"run {point.number}", point.spec))
            except SpecError as error:
                errors.append(error)
        if errors and not valid:
            raise errors[0]
        return valid

    def warnings(self) -> list[str]:
        """Return the warnings about the validated specs of runs, and about values that the runs vary.

        If several differ only in numbers, the first one is returned.
        """
        found: dict[str, str] = {}
        for warning in (str(one) for _, spec in self.validated for one in caution(spec, self.expressions)):
            found.setdefault(without_numbers(warning), warning)
        of_starts = start_warnings_of_study(spec for _, spec in self.valid_samples)
        of_sample = self.warnings_of_sample()
        of_runs = (warning for text, warning in found.items() if text not in of_sample)
        return [*of_runs, *of_starts, *of_sample.values(), *self.notes()]

    def notes(self) -> list[str]:
        """Return notes that the single runs do not give: on reactions that are always zero in measures of the study,
        and on values that the study varies.
        """
        own = [measure for measure in self.spec.defined_measures() if not measure.of_base]
        of_measures = [note for _, spec in self.validated[:1] for note in zero_reactions(spec, own)]
        return [*of_measures, *notes_on_varied_values(self.spec)]

    def warnings_of_sample(self) -> dict[str, str]:
        """Return warnings about distributions of angles that are probably meant in degrees.

        Limits and means of the distributions are checked, because drawn values have many decimals. The keys are the
        warnings about single runs, without their numbers.
        """
        if self.spec.sample is None or not self.validated:
            return {}
        spec = self.validated[0][1]
        varied = VariedSpecs(spec.canonical_json())
        found: dict[str, str] = {}
        of_others = set(angles_in_degrees(spec))  # with the same numbers for each value of a variable
        for key, distribution in self.spec.sample.variables.items():
            for value in typical_values(distribution):
                with suppress(SpecError):  # a limit may be invalid although all drawn values are valid
                    for warning in angles_in_degrees(varied.spec([(parse_key(key), value)])):
                        if warning not in of_others:
                            place = path_text(("sample", "variables", key))
                            found.setdefault(without_numbers(warning), f"{place}: with {value:g}, {warning}")
        return found

    @cached_property
    def expressions(self) -> tuple[str, ...]:
        """Expressions of the measures that the study itself defines, without those of its bases."""
        return expressions_of(self.spec.defined_measures())


def plan_study(spec: StudySpec) -> StudyPlan:
    """Return the plan of a study, after validating the specs of its runs and building their mechanisms.

    For a study in blocks, only some runs are validated. An invalid one is an error unless the study is an ensemble,
    which begins if at least one of these runs is valid.

    Raises
    ------
    SpecError
        If the study, one of the runs that are validated (for an ensemble, all of them) or a measure is invalid.
    """
    if spec.verdict:
        find_verdict(spec)
    check_column_names(spec)
    plan = StudyPlan(spec)
    if spec.members is None or spec.sample is not None:
        for point in plan.samples:
            if not point.lacking:
                point.spec  # noqa: B018  # raises an error if it is invalid
    return plan


def describe_measures(spec: StudySpec, runs: Iterable[tuple[str, RunSpec]]) -> dict[str, Description]:
    """Check the measures that a study defines with all runs, and return units and descriptions of their columns.

    Parameters
    ----------
    runs
        Each distinct run of the study with a name for error messages.

    Raises
    ------
    SpecError
        If an expression is not valid for a run, or if its values have different units in two runs.
    """
    measures = spec.defined_measures()
    described: dict[str, Description] = {}
    first: dict[str, str] = {}
    for number, (label, run) in enumerate(runs if measures else ()):
        for measure in measures:
            if not (taken := SpecMeasure(measure, run)).is_taken:
                continue
            try:
                now = Description(*taken.describe())
            except SpecError as error:
                text = f" (in {label})" if number else ""
                raise _placed(spec, measure, SpecError(error.message + text, key=error.key)) from None
            if (before := described.setdefault(measure.name, now)) != now:
                message = f"its unit is {before.units} in {first[measure.name]} and {now.units} in {label}"
                raise _placed(spec, measure, SpecError(f"{message}; a column of the index has one unit"))
            first.setdefault(measure.name, label)
            if has_error(measure, run):
                described.setdefault(measure.name + ERROR, Description(now.units, f"estimated error of {measure.name}"))
    return described


def _placed(spec: StudySpec, measure: DefinedMeasure, error: SpecError) -> SpecError:
    """Return an error about a measure with the file and line of its definition."""
    return spec.placed(error.located(prefix=path_text(measure.place)))


#: Longest name of a column [bytes of UTF-8]; netCDF has the same limit.
LONGEST = 255

#: Characters that HDF5 cannot store, and all characters that names must not contain: these and control characters.
_UNSTORED = re.compile(r"[\x00\ud800-\udfff]")
_CONTROL = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]")

#: Columns that only the tables of `Study` have.
_OF_TABLES = {"number"}


def check_column_names(spec: StudySpec) -> None:
    """Check the names of measures, axes, variables and families, and the labels of values.

    Raises
    ------
    SpecError
        If a name or label cannot be stored, if two columns would have the same name, or if an axis or variable sets a
        measure.
    """
    with SpecError.place_by(spec.placed):
        measures = {measure.name: measure.place for measure in spec.defined_measures()}
    for name, where in measures.items():
        if name in COLUMNS | _OF_TABLES:
            message = f"'{name}' is a column of the index of every study; choose another name for this measure"
            raise spec.placed(SpecError(message, key=path_text(where)))
        if name.endswith(ERROR) and name.removesuffix(ERROR) in measures:
            message = f"'{name}' is the column of the error of '{name.removesuffix(ERROR)}'; choose another name"
            raise spec.placed(SpecError(message, key=path_text(where)))
    columns: dict[str, str] = {}

    def check_key(key: str, place: Path, word: str) -> None:
        """Check the key of an axis or of a variable."""
        if axis_column(key) in measures:
            message = f"'{key}' is also {word} of this study; choose another name for the measure"
            raise spec.placed(SpecError(message, key=path_text(measures[axis_column(key)])))
        if why := _refusal(key, columns.setdefault(axis_column(key), key)):
            raise spec.placed(SpecError(why, key=path_text(place)))

    for grid in grids(spec):
        _check_text(spec, grid.name, ("families",), _CONTROL)
        for number, axis in enumerate(grid.axes):
            for key, values in axis:
                place: Path = (*grid.axes_place, number, key)
                _check_text(spec, key, place, _CONTROL)
                for value in values:
                    for changed in value.value if value.together else (key,):
                        _check_sets_no_measure(spec, changed, (*place, *value.place))
                    _check_text(spec, str(value.label), (*place, *value.place), _UNSTORED)
                check_key(key, place, "a measure")
        for key in grid.table:
            place = (*grid.table_place, key)
            _check_sets_no_measure(spec, key, place)
            _check_text(spec, key, place, _CONTROL)
            check_key(key, place, "a variable")


def _check_sets_no_measure(spec: StudySpec, key: str, place: Path) -> None:
    if parse_key(key)[:1] == ("measures",):
        message = "a measure is a column of the study, and cannot vary between its runs; define several measures"
        raise spec.placed(SpecError(message, key=path_text(place)))


def _refusal(key: str, other: str) -> str:
    """Return the reason why an axis cannot have this name; empty if it can."""
    if not key.strip():
        return "is blank; an axis needs a name"
    if len(key.encode()) > LONGEST:
        return f"is longer than {LONGEST} bytes, the limit for a name of an axis"
    if axis_column(key) in COLUMNS | _OF_TABLES:
        return f"'{key}' is a column of the index of every study; choose another name for this axis"
    if other != key:
        return (
            f"'{key}' and '{other}' would be one column of the index, where '/' is written as '|'; rename one of them"
        )
    return ""


def _check_text(spec: StudySpec, text: str, place: Path, refused: re.Pattern[str]) -> None:
    if match := refused.search(text):
        message = f"contains the character {match[0]!r}, which cannot be stored in a name or label"
        raise spec.placed(SpecError(message, key=_CONTROL.sub("?", path_text(place))))
